"""Judges the frames of a contraction with VTK, trimesh and pymeshlab.

Usage: frames.py FOLDER

FOLDER contains frames.xdmf, frames.bin, animation.glb, report.json and model.obj.

VTK reads the time series. Each frame must be one closed, oriented solid torus without
self-intersections, with the volumes in the report and the triangles of the model. Its volume of
tissue may differ from the model's by 2 %. Each frame of the animation must have the positions of
the time series.
"""

import json
import os
import struct
import sys

import numpy as np
import pymeshlab
import trimesh
from scipy.spatial import KDTree
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXdmf2 import vtkXdmfReader

MOST_DEVIATION = 0.02
# Tolerance of the animation in metres. Positions are sums of a base and a displacement, both in
# single precision.
NEAR_M = 1e-8


def series(path):
    """Returns the times; and for each time the points in metres, the triangles and their patches.
    """
    reader = vtkXdmfReader()
    reader.SetFileName(path)
    reader.UpdateInformation()
    information = reader.GetOutputInformation(0)
    key = reader.GetExecutive().TIME_STEPS()
    times = [information.Get(key, step) for step in range(information.Length(key))]
    frames = []
    for time in times:
        reader.UpdateTimeStep(time)
        data = reader.GetOutputDataObject(0)
        while data.IsA("vtkMultiBlockDataSet"):
            data = data.GetBlock(0)
        cells = data.GetCells()
        triangles = vtk_to_numpy(cells.GetConnectivityArray()).reshape(-1, 3)
        patches = vtk_to_numpy(data.GetCellData().GetArray("patch"))
        frames.append((vtk_to_numpy(data.GetPoints().GetData()).copy(), triangles.copy(), patches.copy()))
    return times, frames


def animation(path):
    """Returns the times, and the positions of all patches for each frame, metres."""
    with open(path, "rb") as file:
        content = file.read()
    length = struct.unpack_from("<I", content, 12)[0]
    document = json.loads(content[20:20 + length])
    data = content[28 + length:]

    def read(number, width):
        accessor = document["accessors"][number]
        start = document["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
        return np.frombuffer(data, "<f4", accessor["count"] * width, start).reshape(-1, width)

    [moving] = document["animations"]
    [sampler] = moving["samplers"]
    times = read(sampler["input"], 1).ravel()
    weights = read(sampler["output"], 1).reshape(len(times), -1)
    primitives = [part for mesh in document["meshes"] for part in mesh["primitives"]]
    assert len(moving["channels"]) == len(document["meshes"]), "each mesh is animated"
    frames = []
    for row in weights:
        parts = []
        for part in primitives:
            moved = [read(target["POSITION"], 3) for target in part["targets"]]
            parts.append(read(part["attributes"]["POSITION"], 3) + sum(w * d for w, d in zip(row, moved, strict=True)))
        frames.append(np.concatenate(parts))
    return times, frames


def volume(points, triangles):
    """Returns the enclosed volume, mm³."""
    a, b, c = (1e3 * points[triangles.T].astype(np.float64))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def main(folder):
    with open(os.path.join(folder, "report.json"), encoding="utf-8") as file:
        report = json.load(file)
    stated = report["contraction"]
    times, frames = series(os.path.join(folder, "frames.xdmf"))
    assert np.allclose(times, [frame["time_s"] for frame in stated["frames"]]), times
    with open(os.path.join(folder, "model.obj"), encoding="utf-8") as file:
        corners = [line.split()[1:] for line in file if line.startswith("f ")]
    faces = np.array([[int(corner.split("/")[0]) for corner in three] for three in corners]) - 1
    rest = report["certificate"]["volume_mm3"]
    faults = []
    for number, ((points, triangles, patches), frame) in enumerate(zip(frames, stated["frames"], strict=True)):
        def expect(condition, text, number=number):
            if not condition:
                faults.append(f"frame {number}: {text}")

        expect(np.array_equal(triangles, faces), "not the triangles of the model")
        expect(len(np.unique(patches)) == 4, f"patches {np.unique(patches)}")
        body = trimesh.Trimesh(points.astype(np.float64), triangles, process=False)
        expect(body.is_watertight and body.is_winding_consistent and body.euler_number == 0, "not a closed torus")
        found = volume(points, triangles)
        expect(abs(found / frame["tissue_volume_mm3"] - 1) < 1e-5, f"tissue {found} mm³, stated {frame['tissue_volume_mm3']}")
        expect(abs(found / rest - 1) < MOST_DEVIATION, f"tissue {found} mm³, {rest} at rest")
        meshes = pymeshlab.MeshSet()
        meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=1e6 * points.astype(np.float64), face_matrix=triangles.astype(np.int32)))
        meshes.compute_selection_by_self_intersections_per_face()
        crossing = meshes.current_mesh().selected_face_number()
        expect(crossing == 0, f"{crossing} self-intersecting faces")
        print(f"VTK, trimesh, pymeshlab: frame {number} at {times[number]} s: {len(triangles)} faces, tissue {found:.5f} mm³, "
              f"{crossing} self-intersecting", flush=True)
    moved = max(float(np.abs(points - frames[0][0]).max()) for points, _, _ in frames)
    assert moved > 1e-5, "nothing moves"
    steps, shown = animation(os.path.join(folder, "animation.glb"))
    assert np.allclose(steps, [*times, stated["period_s"]], rtol=1e-6), steps
    for number, positions in enumerate(shown):
        whole = frames[number % len(frames)][0].astype(np.float64)
        apart = KDTree(whole).query(positions)[0].max()
        if apart > NEAR_M:
            faults.append(f"animation, frame {number}: {apart} m from the series")
    for fault in faults:
        print(fault, file=sys.stderr)
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main(sys.argv[1])
