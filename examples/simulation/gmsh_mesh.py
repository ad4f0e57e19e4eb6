"""Meshes lumen and tissue of a model together (Gmsh), with a group per patch and region.

Usage: gmsh_mesh.py DIR [--out DIR] [--size MM] [--formats]

Reads regions.ascii.stl. Gmsh makes one surface of each solid in it and joins their vertices, so
both volumes share the inner wall. Writes regions.msh. `--formats` only tries to read each surface
file of DIR and prints what Gmsh finds in it.
"""

import glob
import os
import time

import gmsh
import numpy as np

from bodies import arguments, expect, read, volumes

# Patches that bound each region.
REGIONS = {"lumen": ["inner_wall", "inlet", "outlet"],
           "tissue": ["inner_wall", "outer_wall", "cap_isthmus", "cap_ampulla"]}
TETRAHEDRON = 4


def load(path):
    """Reads a file; returns its number of vertices, and the tag of each surface by name."""
    gmsh.clear()
    gmsh.merge(path)
    surfaces = {gmsh.model.getEntityName(2, tag) or f"surface {tag}": tag for _, tag in gmsh.model.getEntities(2)}
    return len(gmsh.model.mesh.getNodes()[0]), surfaces


def triangles(tag):
    """Returns the number of triangles of a surface."""
    return sum(len(tags) for tags in gmsh.model.mesh.getElements(2, tag)[1])


def try_formats(folder):
    """Prints which surface files Gmsh can read."""
    for kind in ("ascii.stl", "stl", "ply", "obj"):
        for path in sorted(glob.glob(os.path.join(folder, f"*.{kind}"))):
            if kind == "stl" and path.endswith(".ascii.stl"):
                continue
            try:
                vertices, surfaces = load(path)
                print(f"{os.path.basename(path)}: {vertices} vertices; triangles:",
                      ", ".join(f"{name} {triangles(tag)}" for name, tag in surfaces.items()))
            except Exception as error:  # Gmsh raises nothing more specific.
                print(f"{os.path.basename(path)}: not read ({error})")


def tetrahedra(volume):
    """Returns nodes and tetrahedra of a region: positions, and rows of four indices."""
    tags, places, _ = gmsh.model.mesh.getNodes()
    index = np.zeros(int(tags.max()) + 1, int)
    index[tags] = np.arange(len(tags))
    _, nodes = gmsh.model.mesh.getElementsByType(TETRAHEDRON, volume)
    return places.reshape(-1, 3), index[nodes].reshape(-1, 4)


def main():
    options = arguments(__doc__, ("--size", {"type": float, "metavar": "MM", "help": "largest edge inside the regions"}),
                        ("--formats", {"action": "store_true", "help": "only try which files Gmsh reads"}))
    gmsh.initialize()
    gmsh.option.setNumber("General.Verbosity", 0)
    if options.formats:
        return try_formats(options.folder)

    start = time.perf_counter()
    regions = read(options.folder, "regions")
    vertices, surfaces = load(os.path.join(options.folder, "regions.ascii.stl"))
    expect(sorted(surfaces) == sorted(regions.names), f"the surfaces are {list(surfaces)}")
    before = {name: triangles(tag) for name, tag in surfaces.items()}
    expect(vertices == len(regions.points), f"{vertices} vertices, not {len(regions.points)}: solids are not joined")

    volume = {}
    for name, patches in REGIONS.items():
        loop = gmsh.model.geo.addSurfaceLoop([surfaces[patch] for patch in patches])
        volume[name] = gmsh.model.geo.addVolume([loop])
    gmsh.model.geo.synchronize()
    for name, tag in surfaces.items():
        gmsh.model.addPhysicalGroup(2, [tag], name=name)
    for name, tag in volume.items():
        gmsh.model.addPhysicalGroup(3, [tag], name=name)
    if options.size:
        gmsh.option.setNumber("Mesh.MeshSizeMax", options.size)
    gmsh.model.mesh.generate(3)

    after = {name: triangles(tag) for name, tag in surfaces.items()}
    expect(after == before, f"the triangles of the surfaces changed from {before} to {after}")
    used = {}
    for name, tag in volume.items():
        nodes, cells = tetrahedra(tag)
        used[name] = np.unique(cells)
        filled = np.abs(volumes(nodes, cells)).sum()
        enclosed = read(options.folder, {"lumen": "lumen", "tissue": "model"}[name]).volume
        quality = gmsh.model.mesh.getElementQualities(gmsh.model.mesh.getElementsByType(TETRAHEDRON, tag)[0], "minSICN")
        print(f"{name}: {len(cells)} tetrahedra, {len(used[name])} nodes; volume {filled:.12g} mm³, "
              f"surface {enclosed:.12g} mm³, relative difference {abs(filled / enclosed - 1):.1e}; "
              f"quality (SICN) median {np.median(quality):.2f}, below 0.1 {np.mean(np.array(quality) < 0.1):.1%}")
        # The text of the STL file may have fewer digits than the VTP file.
        expect(abs(filled / enclosed - 1) < 1e-6, f"{name}: the volumes differ")
    wall = len(np.unique(regions.of("inner_wall")))
    shared = len(np.intersect1d(used["lumen"], used["tissue"]))
    expect(shared == wall, f"the regions share {shared} nodes, the wall has {wall}")
    path = os.path.join(options.out, "regions.msh")
    gmsh.write(path)
    print(f"wall: {before['inner_wall']} triangles and {shared} nodes, used by both regions")
    print(f"groups: {', '.join(gmsh.model.getPhysicalName(*group) for group in gmsh.model.getPhysicalGroups())}")
    print(f"{path}: {os.path.getsize(path) / 1e6:.1f} MB, {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
