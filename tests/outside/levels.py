"""Checks the levels of detail of a model with trimesh and pymeshlab.

Usage: levels.py FOLDER

FOLDER contains model.glb, report.json and the levels decoded by gltf.mjs. Each level must be
closed, have all patches, and be as close to the full surface as the report states.
"""

import json
import os
import sys

import numpy as np
import pymeshlab
import trimesh

import mesh

PATCHES = ["cap_ampulla", "cap_isthmus", "inner_wall", "outer_wall"]
# Tolerances. Random points may be farther away than the vertices, midpoints and centroids that the
# program measures.
SLACK = 1.1
SLACK_UM = 0.05


def judge(path, level, meshes):
    """Returns a sentence for each fault of a level.

    Mesh 0 of `meshes` is the full surface in micrometres.
    """
    faults = []
    geometry = trimesh.load(path, process=False).geometry
    if sorted(geometry) != PATCHES:
        faults.append(f"its patches are {sorted(geometry)}")
    vertices, faces = mesh.body(path)
    if (len(vertices), len(faces)) != (level["vertices"], level["triangles"]):
        faults.append(f"{len(vertices)} vertices and {len(faces)} triangles, stated {level['vertices']} and {level['triangles']}")
    body = trimesh.Trimesh(vertices, faces, process=False)
    if not (body.is_watertight and body.is_winding_consistent and body.volume > 0 and body.euler_number == 0):
        faults.append(f"watertight {body.is_watertight}, winding consistent {body.is_winding_consistent}, "
                      f"volume {body.volume}, Euler number {body.euler_number}")
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=vertices, face_matrix=faces.astype(np.int32)))
    own = meshes.current_mesh_id()
    most = 0
    for sampled, target in [(0, own), (own, 0)]:
        found = meshes.get_hausdorff_distance(sampledmesh=sampled, targetmesh=target, samplevert=True, sampleedge=False,
                                              sampleface=True, samplenum=1_000_000)
        most = max(most, found["max"])
    stated = level["distance_um"]
    print(f"trimesh, pymeshlab: {path}: {len(faces)} faces, {most:.3f} µm from the full surface, stated {stated} µm", flush=True)
    if most > SLACK * stated + SLACK_UM:
        faults.append(f"{most} µm from the full surface, stated {stated}")
    return faults


def main(folder):
    with open(os.path.join(folder, "report.json")) as file:
        levels = json.load(file)["levels"]
    assert [level["file"] for level in levels] == [f"model.lod{i}.glb" for i in range(3)], levels
    vertices, faces = mesh.body(os.path.join(folder, "model.glb"))
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=vertices, face_matrix=faces.astype(np.int32)))
    faults = []
    for level in levels:
        path = os.path.join(folder, level["file"].replace(".glb", ".decoded.glb"))
        faults += [f"{path}: {fault}" for fault in judge(path, level, meshes)]
    for fault in faults:
        print(fault, file=sys.stderr)
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main(sys.argv[1])
