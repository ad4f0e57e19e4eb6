"""Checks with trimesh and pymeshlab that a surface is one closed, oriented solid torus.

Usage: mesh.py FILE...

Each FILE is a .glb or .obj file. The surface must also be free of self-intersections.
"""

import sys
from dataclasses import dataclass

import numpy as np
import pymeshlab
import trimesh


def body(path):
    """Returns the surface of a file in micrometres, with vertices at equal positions merged."""
    scene = trimesh.load(path, process=False)
    mesh = scene.to_geometry() if isinstance(scene, trimesh.Scene) else scene
    positions, index = np.unique(np.asarray(mesh.vertices, dtype=np.float64), axis=0, return_inverse=True)
    faces = index.reshape(-1)[np.asarray(mesh.faces)]
    # Degenerate triangles, which have a vertex twice, connect the parts of a triangle strip.
    a, b, c = faces.T
    return positions * 1e6, faces[(a != b) & (b != c) & (c != a)]


@dataclass
class Verdict:
    """Results for one file."""

    # A sentence for each fault.
    faults: list
    # Number of self-intersecting faces (pymeshlab).
    crossing: int
    # True if the surface is watertight with consistent winding (trimesh).
    closed: bool


def judge(path):
    """Checks a file."""
    vertices, faces = body(path)
    faults = []

    def expect(condition, text):
        if not condition:
            faults.append(text)

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    expect(mesh.is_watertight, "trimesh: not watertight")
    expect(mesh.is_winding_consistent, "trimesh: winding is not consistent")
    expect(mesh.volume > 0, f"trimesh: volume {mesh.volume} is not positive")
    expect(mesh.euler_number == 0, f"trimesh: Euler number {mesh.euler_number}, not 0")

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=vertices, face_matrix=faces.astype(np.int32)))
    topology = meshes.get_topological_measures()
    bodies = topology["connected_components_number"]
    expect(bodies == 1, f"pymeshlab: {bodies} bodies, not 1")
    for name in ("boundary_edges", "non_two_manifold_edges", "non_two_manifold_vertices", "number_holes"):
        expect(topology[name] == 0, f"pymeshlab: {name} = {topology[name]}")
    expect(topology["is_mesh_two_manifold"], "pymeshlab: not two-manifold")
    expect(topology["unreferenced_vertices"] == 0, "pymeshlab: unreferenced vertices")
    meshes.compute_selection_by_self_intersections_per_face()
    crossing = meshes.current_mesh().selected_face_number()
    expect(crossing == 0, f"pymeshlab: {crossing} self-intersecting faces")
    print(f"trimesh, pymeshlab: {path}: {len(vertices)} vertices, {len(faces)} faces, {crossing} self-intersecting",
          flush=True)
    return Verdict(faults, crossing, bool(mesh.is_watertight and mesh.is_winding_consistent))


def main():
    paths = sys.argv[1:]
    if not paths:
        sys.exit("no files to judge")
    faults = [f"{path}: {fault}" for path in paths for fault in judge(path).faults]
    for fault in faults:
        print(fault, file=sys.stderr)
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main()
