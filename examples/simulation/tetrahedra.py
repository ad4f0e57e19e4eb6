"""Fills the lumen and the tissue of a model with tetrahedra, separately and as one mesh (TetGen).

Usage: tetrahedra.py DIR [--out DIR] [--ratio R]

Reads model.vtp, lumen.vtp and regions.vtp, and does not repair, move or remesh them. Writes
lumen.vtu, tissue.vtu and regions.vtu: tetrahedra with the cell array `region`, then the boundary
triangles with the cell array `patch`. The field data has the number of each name. `--ratio 1.8`
adds points inside the regions until the circumradius of most tetrahedra is at most 1.8 times their
shortest edge.
"""

import os
import time

import numpy as np
import tetgen

from bodies import arguments, expect, read, volumes, write_vtu

REGIONS = {"lumen": 1, "tissue": 2}


def fill(surface, ratio=None, size=None, regions=False):
    """Fills a surface; returns nodes, tetrahedra, their regions, boundary triangles, their patches.

    TetGen keeps the triangles of the surface, and its points become the first nodes. Regions have
    TetGen's numbers. `size` limits the volume of a tetrahedron, mm³.
    """
    # TetGen reserves marker 0 for facets without a marker.
    mesh = tetgen.TetGen(surface.points, surface.triangles, surface.patch + 1)
    quality = {"quality": False} if ratio is None else {"minratio": ratio, "steinerleft": -1}
    limit = {} if size is None else {"fixedvolume": True, "maxvolume": size}
    nodes, cells, region, patch = mesh.tetrahedralize(plc=True, nobisect=True, regionattrib=regions, **quality, **limit)
    return nodes, cells, np.rint(region).astype(int).ravel(), np.asarray(mesh.trifaces), patch - 1


def keys(triangles, patch=0):
    """Returns triangles in a canonical order, as rows of three sorted nodes and a patch."""
    rows = np.column_stack([np.sort(triangles, axis=1), np.broadcast_to(patch, len(triangles))])
    return rows[np.lexsort(rows.T[::-1])]


def smallest_angles(nodes, cells):
    """Returns the smallest dihedral angle of each tetrahedron, degrees."""
    normals = []
    for face in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)):
        a, b, c = (nodes[cells[:, k]] for k in face)
        normal = np.cross(b - a, c - a)
        normals.append(normal / np.linalg.norm(normal, axis=1, keepdims=True))
    cosines = [-np.einsum("ij,ij->i", normals[i], normals[j]) for i in range(4) for j in range(i)]
    return np.degrees(np.arccos(np.clip(np.max(cosines, axis=0), -1, 1)))


def check(name, surface, nodes, cells, triangles, patch):
    """Checks that a mesh keeps the surface, prints its sizes, returns the volumes of its cells."""
    size = volumes(nodes, cells)
    angles = smallest_angles(nodes, cells)
    expect(np.array_equal(nodes[:len(surface.points)], surface.points), f"{name}: vertices of the surface were moved")
    expect(np.array_equal(keys(triangles, patch), keys(surface.triangles, surface.patch)),
           f"{name}: {len(surface.triangles)} boundary triangles became {len(triangles)} others")
    expect(size.min() > 0, f"{name}: a tetrahedron has the volume {size.min()} mm³")
    print(f"{name}: {len(nodes)} nodes ({len(nodes) - len(surface.points)} added), {len(cells)} tetrahedra, "
          f"{len(triangles)} boundary triangles kept; smallest angle {angles.min():.2g}°, median {np.median(angles):.3g}°, "
          f"below 5° {np.mean(angles < 5):.1%}")
    return size


def conserve(name, filled, enclosed):
    """Checks that a meshed volume equals the volume of the surface."""
    print(f"{name}: volume {filled:.12g} mm³, surface {enclosed:.12g} mm³, relative difference {abs(filled / enclosed - 1):.1e}")
    expect(abs(filled / enclosed - 1) < 1e-9, f"{name}: the volumes differ")


def write(path, surface, nodes, cells, region, triangles, patch):
    """Writes a mesh with both arrays: tetrahedra have patch -1, boundary triangles region 0."""
    labels = {"region": np.concatenate([region, np.zeros(len(triangles), int)]).astype(np.int32),
              "patch": np.concatenate([np.full(len(cells), -1), patch]).astype(np.int32)}
    write_vtu(path, nodes, cells, triangles, cells_data=labels,
              numbers={**{name: k for k, name in enumerate(surface.names)}, **REGIONS})


def sides(nodes, cells, region, triangles):
    """Returns the regions on both sides of each triangle, ascending; 0 where there is none."""
    faces = np.sort(np.vstack([cells[:, k] for k in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))]), axis=1).astype(np.int64)
    code = (faces[:, 0] * len(nodes) + faces[:, 1]) * len(nodes) + faces[:, 2]
    order = np.argsort(code, kind="stable")
    code, owner = code[order], np.tile(region, 4)[order]
    a, b, c = np.sort(triangles, axis=1).astype(np.int64).T
    wanted = (a * len(nodes) + b) * len(nodes) + c
    first, last = np.searchsorted(code, wanted), np.searchsorted(code, wanted, side="right")
    one = np.where(last > first, owner[np.minimum(first, len(owner) - 1)], 0)
    two = np.where(last > first + 1, owner[np.minimum(first + 1, len(owner) - 1)], 0)
    return np.sort(np.column_stack([one, two]), axis=1)


def main():
    options = arguments(__doc__, ("--ratio", {"type": float, "help": "bound of circumradius by shortest edge, such as 1.8"}))

    def out(name):
        return os.path.join(options.out, name)

    bodies = {"lumen": read(options.folder, "lumen"), "tissue": read(options.folder, "model")}

    lumen, tissue = bodies.values()
    _, same = np.unique(np.vstack([lumen.points, tissue.points]), axis=0, return_inverse=True)
    same = same.ravel()
    wall, inner = keys(same[lumen.of("wall")]), keys(same[len(lumen.points) + tissue.of("inner_wall")])
    expect(np.array_equal(wall, inner), "the lumen's wall is not the inner wall")
    print(f"wall: {len(wall)} triangles, exactly the same in both bodies")

    for name, surface in bodies.items():
        start = time.perf_counter()
        nodes, cells, _, triangles, patch = fill(surface, options.ratio)
        took = time.perf_counter() - start
        size = check(name, surface, nodes, cells, triangles, patch)
        conserve(name, size.sum(), surface.volume)
        write(out(f"{name}.vtu"), surface, nodes, cells, np.full(len(cells), REGIONS[name]), triangles, patch)
        print(f"{name}: {took:.1f} s")

    # Both regions in one mesh. TetGen numbers them; the patches next to them tell which is which.
    start = time.perf_counter()
    surface = read(options.folder, "regions")
    nodes, cells, found, triangles, patch = fill(surface, options.ratio, regions=True)
    took = time.perf_counter() - start
    size = check("regions", surface, nodes, cells, triangles, patch)
    expect(len(np.unique(found)) == 2, f"regions: {len(np.unique(found))} regions, not 2")
    beside = sides(nodes, cells, found, triangles)
    inlet, outside = (beside[patch == surface.names.index(name)] for name in ("inlet", "outer_wall"))
    inside, around = inlet[0, 1], outside[0, 1]
    expect((inlet == [0, inside]).all() and (outside == [0, around]).all() and inside != around, "regions: ends and walls mix")
    shared = beside[patch == surface.names.index("inner_wall")]
    expect((shared == sorted([inside, around])).all(), "regions: the wall does not have a region on each side")
    for name, number in (("lumen", inside), ("tissue", around)):
        conserve(f"regions, {name}", size[found == number].sum(), bodies[name].volume)
    numbers = np.where(found == inside, REGIONS["lumen"], REGIONS["tissue"])
    write(out("regions.vtu"), surface, nodes, cells, numbers, triangles, patch)
    print(f"regions: {len(shared)} triangles of the wall have a tetrahedron of each region; {took:.1f} s")


if __name__ == "__main__":
    main()
