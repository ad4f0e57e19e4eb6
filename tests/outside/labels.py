"""Grows a small model with a label volume; reads the volume with tifffile and nibabel.

Usage: labels.py OVIDUCT_BINARY
"""

import json
import os
import struct
import sys
import tempfile

import nibabel
import numpy as np
import tifffile
from PIL import Image

from grown import Oviduct

# Without lean, slices of the volume can be compared with sections.
SMALL = ["--set", "lean.strength_um=0", "--set", "steps=200", "--set", 'particles.total={"keys":[[0,400],[1,900]]}']
VOXEL_UM, SLICE_UM = 5.0, 100.0
FROM, TO = 0.2, 0.6


def places(path):
    """Returns z of every section of a sections.bin, µm; see docs/sections-bin.md."""
    with open(path, "rb") as file:
        content = file.read()
    index, count = struct.unpack("<QQ", content[-64:-48])
    return [struct.unpack("<d", content[index + 48 * k + 32:index + 48 * k + 40])[0] for k in range(count)]


def lumen_area(oviduct, sections, k, path):
    """Returns the area of the lumen of a section, counted on its label image, µm²."""
    oviduct.run("section", sections, "--index", str(k), "--size", "2048", "--labels", "--out", path)
    with Image.open(path) as image:
        assert image.mode == "L", image.mode
        pixels = np.asarray(image)
        # Pillow converts the pixels per metre of the pHYs chunk to dots per inch.
        um_per_pixel = 25_400 / image.info["dpi"][0]
    found = set(np.unique(pixels).tolist())
    assert set(range(8)) <= found <= set(range(10)), found
    return (pixels == 1).sum() * um_per_pixel**2


def main(folder):
    oviduct = Oviduct(sys.argv[1])
    out = os.path.join(folder, "model")
    told = oviduct.generate(out, "--seed", "7", "--outputs", "labels", *SMALL, "--set", f"labels.voxel_um={VOXEL_UM}",
                            "--set", f"labels.slice_um={SLICE_UM}", "--set", f"labels.from={FROM}", "--set", f"labels.to={TO}")
    with open(os.path.join(out, "report.json")) as file:
        report = json.load(file)
    length_um = report["spec"]["length_mm"] * 1000
    slices = round((TO - FROM) * length_um / SLICE_UM)

    with tifffile.TiffFile(os.path.join(out, "labels.ome.tif")) as file:
        assert file.is_ome and file.series[0].axes == "ZYX", file.series
        pixels = tifffile.xml2dict(file.ome_metadata)["OME"]["Image"]["Pixels"]
        stack = file.asarray()
    sizes = [float(pixels[f"PhysicalSize{axis}"]) for axis in "XYZ"]
    assert sizes == [VOXEL_UM, VOXEL_UM, SLICE_UM] and pixels["PhysicalSizeXUnit"] == "\u00b5m", pixels
    assert stack.dtype == np.uint8 and stack.shape[0] == slices, stack.shape
    assert list(stack.shape[::-1]) == report["labels"]["size"]

    image = nibabel.load(os.path.join(out, "labels.nii.gz"))
    header = image.header
    assert header.get_xyzt_units()[0] == "micron" and header.get_data_dtype() == np.uint8
    assert np.allclose(header.get_zooms(), [VOXEL_UM, VOXEL_UM, SLICE_UM])
    assert np.array_equal(np.asarray(image.dataobj).T, stack), "the two volumes differ"
    # Rows run downward and y points upward, in both matrices.
    first = report["labels"]["first_um"]
    expected = np.diag([VOXEL_UM, -VOXEL_UM, SLICE_UM, 1.0])
    expected[:3, 3] = first
    assert np.allclose(image.affine, expected) and np.allclose(image.get_qform(), expected), image.affine
    assert first[2] == FROM * length_um + SLICE_UM / 2

    # Every slice contains the tissues of an isthmus, and its border contains only the outside.
    for plane in stack:
        found = set(np.unique(plane).tolist())
        assert set(range(8)) <= found <= set(range(10)), found
        assert not plane[[0, -1]].any() and not plane[:, [0, -1]].any()

    # The area of the lumen at a section lies between the areas of the neighbouring slices.
    sections = os.path.join(out, "sections.bin")
    compared = 0
    for k, z in enumerate(places(sections)):
        at = (z - first[2]) / SLICE_UM
        below = int(np.floor(at))
        if not 0 <= below < slices - 1:
            continue
        areas = [(stack[i] == 1).sum() * VOXEL_UM**2 for i in (below, below + 1)]
        between = areas[0] * (1 - at + below) + areas[1] * (at - below)
        expected = lumen_area(oviduct, sections, k, os.path.join(folder, "section.png"))
        assert abs(between / expected - 1) < 0.02, f"section {k}: {between} and {expected} µm²"
        compared += 1
    assert compared >= 5, compared
    print(f"labels: {stack.shape} voxels agree in both files and with {compared} sections")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        main(folder)
