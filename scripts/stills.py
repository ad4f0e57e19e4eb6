"""Draws the stained pictures of README.md and docs/histology.md: the model of a pig's oviduct cut
open, and cuts across it. Needs Pillow; scripts/pictures runs it.

Usage: stills.py OVIDUCT_BINARY IMAGES
"""

import io
import json
import pathlib
import subprocess
import sys
import tempfile

from PIL import Image

PLACES_MM = [3, 11, 19, 24, 32, 44, 56]
COLUMNS = 4
CELL = 480
UM_PER_PIXEL = 8.0
# Colour of an empty slide in the pictures of cuts.
SLIDE = "#f7f4f8"


def main(binary, images):
    def run(*arguments):
        subprocess.run([binary, *map(str, arguments)], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    with tempfile.TemporaryDirectory() as folder:
        model = pathlib.Path(folder, "pig")
        run("generate", "--preset", "pig", "--seed", 7, "--outputs", "glb", "--out", model)
        surface, found = model / "model.glb", pathlib.Path(folder, "cut.json")
        run("render", surface, "--size", 1200, "--out", images / "model.png")
        whole = Image.open(images / "model.png").convert("RGBA")
        white = Image.new("RGBA", whole.size, "white")
        Image.alpha_composite(white, whole).convert("RGB").quantize(256).save(images / "model.png", optimize=True)
        run("cut", surface, "--z", "44mm", "--preset", "pig", "--size", 1000, "--out", images / "histology.png")
        rows = -(-len(PLACES_MM) // COLUMNS)
        sheet = Image.new("RGB", (COLUMNS * CELL, rows * CELL), SLIDE)
        for number, place in enumerate(PLACES_MM):
            corner = [number % COLUMNS * CELL, number // COLUMNS * CELL]
            cut = ["cut", surface, "--z", f"{place}mm", "--preset", "pig", "--out"]
            run(*cut, found)
            points = json.loads(found.read_text())["rings"][0]["points"]
            extent = max(max(axis) - min(axis) for axis in zip(*points))
            size = round(extent / UM_PER_PIXEL)
            picture = pathlib.Path(folder, "cut.png")
            # Drawn at twice the size, so that cells are smooth.
            run(*cut, picture, "--size", 2 * size)
            stained = Image.open(io.BytesIO(picture.read_bytes())).convert("RGB")
            stained.thumbnail((size, size), Image.Resampling.LANCZOS)
            sheet.paste(stained, [c + (CELL - side) // 2 for c, side in zip(corner, stained.size)])
        sheet.quantize(256).save(images / "sections.png", optimize=True)


if __name__ == "__main__":
    main(sys.argv[1], pathlib.Path(sys.argv[2]))
