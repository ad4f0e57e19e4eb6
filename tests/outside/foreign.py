"""Checks that `oviduct check` reads files of other programs as trimesh does.

Usage: foreign.py OVIDUCT_BINARY [--keep FOLDER]

Writes files of random solids in all formats, with trimesh and with the traits of other programs. Each
must pass with the volume of its solid, and with the volume that trimesh finds (VTK for VTP), if it
can read the file. The same holds for the files in tests/cases that pass.
"""

import json
import logging
import os
import subprocess
import sys
import tempfile

import numpy as np
import trimesh
import vtk
from vtk.util.numpy_support import vtk_to_numpy

import writers
from solids import any_solid, signed_volume

HERE = os.path.dirname(os.path.abspath(__file__))
CASES = os.path.join(HERE, "..", "cases")
SEED = 44
ROUNDS = 3
PRECISION = 1e-6

# Traits that trimesh reads as another shape without a word. The volume of the solid decides.
WRONG_BY_TRIMESH = {
    "stl_text-spaced": "`end facet` in two words is no facet",
    "stl_text-polygons": "facets have three vertices",
    "obj-cr": "line ends are LF",
    "ply-strips": "no strips",
    "stl_binary-trailing": "the length must match the header",
    "stl_binary-solid-trailing": "the length must match the header",
    "glb-quantized": "normalized integers are not divided",
    "glb-sparse": "no sparse accessors",
    "glb-instances": "no instances",
}
# Files of tests/cases that trimesh refuses or reads wrongly.
CASES_NOT_BY_TRIMESH = {
    "obj-backslash-comment/cube.obj": "joins the comment with the next line",
    "obj-bom/cube.obj": "the mark is part of the first word",
    "obj-continuation-space/cube.obj": "`\\` with a space after it",
    "obj-cr-only/cube.obj": "line ends are LF",
    "obj-mixed/cube.obj": "a comment after a face",
    "ply-big-endian-extras/cube.ply": "lists before the vertices of a face",
    "ply-tristrips/cube.ply": "no strips",
    "stl-end-solid/cube.stl": "`end solid` in two words",
    "stl-trailing-bytes/cube.stl": "the length must match the header",
    "glb-nul-padding/cube.glb": "the padding is not JSON",
    "gltf-quantized/cube.glb": "normalized integers are not divided",
    "gltf-sparse/cube.gltf": "no sparse accessors",
    "gltf-skin-node-scale/cube.gltf": "a skinned mesh does not ignore the transform of its node",
}


def own_files(rng):
    """Kind, extension, content and volume of files from our own writers."""

    def triangulated():
        while True:
            solid = any_solid(rng)
            if solid.triangles():
                return solid

    for trait in ("plain", "upper", "spaced", "ind", "nan", "color", "cr", "crlf", "bom", "padded", "one-line"):
        solid = triangulated()
        yield f"stl_text-{trait}", "stl", writers.stl_text(solid, trait), solid.volume
    solid = any_solid(rng)
    yield "stl_text-polygons", "stl", writers.stl_text(solid, "polygons"), solid.volume
    for trait in ("plain", "solid", "nan", "trailing", "solid-trailing"):
        solid = triangulated()
        yield f"stl_binary-{trait}", "stl", writers.stl_binary(solid, trait), solid.volume
    for trait in (
        "plain",
        "negative",
        "mixed",
        "normals",
        "colours",
        "w",
        "continued",
        "materials",
        "faces-first",
        "nan",
        "elements",
        "cr",
        "crlf",
        "bom",
    ):
        solid = any_solid(rng)
        yield f"obj-{trait}", "obj", writers.obj(solid, trait), solid.volume
    for encoding in ("ascii", "binary_little_endian", "binary_big_endian"):
        for trait in ("plain", "extras", "bytes", "shorts", "floats", "faces-first", "crlf", "cr"):
            solid = any_solid(rng)
            yield f"ply-{trait}", "ply", writers.ply(solid, encoding, trait), solid.volume
        solid = triangulated()
        yield "ply-strips", "ply", writers.ply(solid, encoding, "strips"), solid.volume
    for form in ("ascii", "binary", "raw", "encoded", "binary-zlib", "raw-zlib", "encoded-zlib"):
        for trait in ("plain", "lines", "faces", "patch", "strips"):
            solid = triangulated() if trait == "strips" else any_solid(rng)
            yield f"vtp-{form}-{trait}", "vtp", writers.vtp(solid, form, trait), solid.volume
    for trait in ("plain", "mirrored", "quantized", "sparse", "instances"):
        solid = triangulated()
        content, copies = writers.glb(solid, trait)
        # Integers of 16 bits round positions.
        yield f"glb-{trait}", "glb", content, None if trait == "quantized" else copies * solid.volume


def trimesh_files(rng):
    """The same of files that trimesh writes."""
    forms = [("stl", {}), ("stl_ascii", {}), ("obj", {}), ("ply", {}), ("ply", {"encoding": "ascii"}), ("glb", {})]
    for name, options in forms:
        solid = any_solid(rng)
        while not solid.triangles():
            solid = any_solid(rng)
        mesh = trimesh.Trimesh(solid.points, solid.triangles(), process=False)
        content = mesh.export(file_type=name, **options)
        content = content.encode() if isinstance(content, str) else content
        yield f"trimesh-{name}", name.removesuffix("_ascii"), content, solid.volume


def other_volume(path):
    """Volume that trimesh or VTK finds; None if it does not read the file."""
    if path.endswith(".vtp"):
        return volume_by_vtk(path)
    try:
        return float(trimesh.load(path, force="mesh").volume)
    except Exception:  # trimesh fails in many ways.
        return None


def volume_by_vtk(path):
    """Volume of the polygons and strips that VTK reads, which does not depend on how they are split."""
    reader = vtk.vtkXMLPolyDataReader()
    reader.SetFileName(path)
    reader.Update()
    data, cells = reader.GetOutput(), []
    for array, strips in ((data.GetPolys(), False), (data.GetStrips(), True)):
        corners, ends = vtk_to_numpy(array.GetConnectivityArray()), vtk_to_numpy(array.GetOffsetsArray())
        for cell in (corners[a:b] for a, b in zip(ends, ends[1:])):
            cells += (
                [cell[k : k + 3] if k % 2 == 0 else cell[[k + 1, k, k + 2]] for k in range(len(cell) - 2)]
                if strips
                else [cell]
            )
    return signed_volume(vtk_to_numpy(data.GetPoints().GetData()).astype(float), cells)


def differ(found, expected):
    return not abs(found - expected) <= PRECISION * abs(expected)


def checked(binary, paths):
    """What `oviduct check --json` says of each file."""
    done = subprocess.run([binary, "check", "--json", *paths], capture_output=True, text=True, timeout=600)
    assert done.returncode in (0, 1), done.stderr
    return json.loads(done.stdout)


def volume(told):
    """Volume in units of the file, which count as metres where the file states none."""
    return told["certificate"]["volume_mm3"] * 1e-9


def generated(binary, folder):
    """Checks all generated files; returns sentences about the wrong ones."""
    files, counts, by_other = [], {}, 0
    for round_ in range(ROUNDS):
        rng = np.random.default_rng([SEED, round_])
        for number, (kind, extension, content, expected) in enumerate([*own_files(rng), *trimesh_files(rng)]):
            path = os.path.join(folder, f"{round_}-{number:03d}-{kind}.{extension}")
            with open(path, "wb") as file:
                file.write(content)
            files.append((kind, path, expected))
            counts[extension] = counts.get(extension, 0) + 1
    assert len(files) >= 200, len(files)
    wrong = []
    for (kind, path, expected), told in zip(files, checked(binary, [path for _, path, _ in files])):
        name = os.path.basename(path)
        if told["error"]:
            # Instances may be refused by the name of the extension, but never shown as one.
            if kind != "glb-instances" or "EXT_mesh_gpu_instancing" not in told["error"]:
                wrong.append(f"{name}: {told['error']}")
            continue
        if not told["certificate"]["passed"]:
            wrong.append(f"{name}: {[failure['kind'] for failure in told['certificate']['failures']]}")
        if expected is not None and differ(volume(told), expected):
            wrong.append(f"{name}: volume {volume(told)}, not {expected}")
        other = None if kind in WRONG_BY_TRIMESH else other_volume(path)
        by_other += other is not None
        if other is not None and differ(volume(told), other):
            wrong.append(f"{name}: volume {volume(told)}, and {other} by another program")
    assert by_other >= 150, by_other
    print(f"{len(files)} generated files {counts}, {by_other} of them also read by trimesh or VTK")
    return wrong


def cases(binary):
    """Checks the files of tests/cases that pass."""
    paths = [
        os.path.join(folder, name)
        for folder, _, names in os.walk(CASES)
        for name in names
        if name.endswith((".stl", ".obj", ".ply", ".vtp", ".glb", ".gltf"))
    ]
    wrong, compared = [], 0
    for path, told in zip(sorted(paths), checked(binary, sorted(paths))):
        name = os.path.relpath(path, CASES)
        if told["error"] or not told["certificate"]["passed"] or name in CASES_NOT_BY_TRIMESH:
            continue
        compared += 1
        other = other_volume(path)
        if other is None or differ(volume(told), other):
            wrong.append(f"{name}: volume {volume(told)}, and {other} by another program")
    assert compared >= 10, compared
    print(f"{compared} files of tests/cases have the volume that trimesh or VTK finds")
    return wrong


def main(folder):
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    wrong = generated(BINARY, folder) + cases(BINARY)
    print("\n".join(wrong))
    if wrong:
        sys.exit(f"foreign: {len(wrong)} differences")
    print("foreign: all checks passed")


if __name__ == "__main__":
    BINARY = os.path.abspath(sys.argv[1])
    if sys.argv[2:3] == ["--keep"]:
        os.makedirs(sys.argv[3], exist_ok=True)
        main(sys.argv[3])
    elif sys.argv[2:]:
        sys.exit(__doc__)
    else:
        with tempfile.TemporaryDirectory() as place:
            main(place)
