"""Grows models with the release binary and checks them with other programs.

Usage: models.py OVIDUCT_BINARY [--night]

Also checks equal bytes, refusals and exit codes. With --night, other programs also judge the
surfaces of paper size and of the demo, levels of large models, and formats in a second unit.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time

from grown import Oviduct, of_paper_size
from service import ENDLESS

HERE = os.path.dirname(os.path.abspath(__file__))
JUDGES = os.path.join(HERE, "..", "..", "target", "judges")
SURFACES = {name: name for name in ("glb", "gltf", "obj", "stl", "ply", "vtp", "3mf")} | {"stl-ascii": "ascii.stl"}
STEMS = ["model", "lumen", "regions"]
SMALL = ["--set", "steps=200", "--set", 'particles.total={"keys":[[0,400],[1,900]]}']


def hashes(told):
    # The report and the manifest contain the spec, which may differ in the neighbour search.
    own = {"report.json", "manifest.json"}
    return {file["name"]: file["sha256"] for file in told["files"] if file["name"] not in own}


def formats(oviduct, out):
    """Checks every format of every body, in two units.

    Other programs must read the same surface from every format. Generation must be repeatable, and
    conversion must give the same surface.
    """
    everything = ["--seed", "7", *SMALL, "--outputs", ",".join([*SURFACES, "centreline"]), "--bodies", "tissue,lumen,regions"]
    judge = [sys.executable, os.path.join(HERE, "formats.py")]
    grown = oviduct.generate(out("bodies"), *everything)
    assert hashes(oviduct.generate(out("bodies-again"), *everything)) == hashes(grown), "other bytes"
    files = [out(f"bodies/{stem}.{ending}") for stem in STEMS for ending in SURFACES.values()]
    subprocess.run([*judge, out("bodies")], check=True)
    # Without patch names, a file with both bodies is not a valid surface.
    # oviduct writes 3MF and does not read it.
    readable = [file for file in files if not file.endswith((".3mf", "regions.stl"))]
    oviduct.run("check", *readable)
    oviduct.run("check", out("bodies/regions.stl"), expect=1)
    glbs = [file for file in files if file.endswith((".glb", ".gltf"))]
    subprocess.run(["node", os.path.join(HERE, "gltf.mjs"), os.path.join(JUDGES, "node"), *glbs], check=True)
    if NIGHT:
        oviduct.generate(out("bodies-um"), *everything, "--units", "um")
        subprocess.run([*judge, out("bodies-um")], check=True)

    # Convert from VTP and from text to all other formats.
    for number, source in enumerate(["vtp", "obj"] if NIGHT else ["vtp"]):
        for stem in STEMS:
            for ending in SURFACES.values():
                oviduct.run("convert", out(f"bodies/{stem}.{source}"), out(f"converted-{number}/{stem}.{ending}"))
        subprocess.run([*judge, out(f"converted-{number}")], check=True)


def main(folder):
    def out(name):
        return os.path.join(folder, name)

    oviduct = Oviduct(BINARY)
    generate = oviduct.generate

    # All CPU backends and neighbour searches must give the same bytes.
    small = generate(out("small"), "--seed", "7", "--outputs", "glb,obj", *SMALL)
    for i, other in enumerate(
        [["--backend", "cpu-single"], ["--set", "solver.search=grid"], ["--set", "solver.search=all_pairs"]]
    ):
        again = generate(out(f"again-{i}"), "--seed", "7", "--outputs", "glb,obj", *SMALL, *other)
        assert hashes(again).keys() == hashes(small).keys()
        # The neighbour search never changes results.
        assert hashes(again) == hashes(small), f"{other} gives other bytes"
    assert generate(out("other"), "--seed", "8", *SMALL)["digest"] != small["digest"]
    generate(out("strips"), "--seed", "7", "--set", "mesh.strips=true", *SMALL)

    # A model of paper size.
    paper = generate(out("paper"), "--preset", "paper", "--seed", "1", "--outputs", "glb,obj")
    assert of_paper_size(paper) == [], of_paper_size(paper)
    # A model with levels of detail, and one with ten times as many triangles. Both use only the
    # CPU, because GPU drivers also use memory.
    detailed = generate(out("detailed"), "--preset", "paper", "--seed", "1", "--backend", "cpu", "--gpu", "off")
    many = generate(out("many"), "--preset", "paper", "--seed", "1", "--outputs", "vtp", "--units", "m", "--backend", "cpu",
                    "--gpu", "off", "--set", "solver.record_every=1")
    assert many["triangles"] > 9.9 * paper["triangles"], many["triangles"]
    for grown, most in [(detailed, 150_000_000), (many, 1_500_000_000)]:
        if grown["peak_rss_bytes"] is not None:
            assert grown["peak_rss_bytes"] < most, f"{grown['peak_rss_bytes']} bytes at the peak, allowed are {most}"
    oviduct.run("check", "--euler", "0", out("many/model.vtp"))
    # The demo below covers the full size.
    generate(out("pig"), "--seed", "7", "--set", "steps=600")

    # The frames of a contraction.
    generate(out("contracting"), "--seed", "7", "--outputs", "obj", "--set", "contraction.frames=5", "--set", "length_mm=20", *SMALL)
    subprocess.run([sys.executable, os.path.join(HERE, "frames.py"), out("contracting")], check=True)

    models = [out(f"{name}/model.{kind}") for name, kind in
              [("small", "glb"), ("small", "obj"), ("strips", "glb"), ("pig", "glb"), *([("paper", "obj")] if NIGHT else [])]]
    glbs = [*(model for model in models if model.endswith(".glb")), out("paper/model.glb"), out("contracting/animation.glb")]
    node = os.path.join(JUDGES, "node")
    with_levels = ["strips", *(["pig", "detailed"] if NIGHT else [])]
    levels = [out(f"{name}/model.lod{level}.glb") for name in with_levels for level in range(3)]
    subprocess.run(["node", os.path.join(HERE, "gltf.mjs"), node, *glbs, *levels], check=True)
    subprocess.run([sys.executable, os.path.join(HERE, "mesh.py"), *models], check=True)
    for name in with_levels:
        subprocess.run([sys.executable, os.path.join(HERE, "levels.py"), out(name)], check=True)
    assert os.path.getsize(out("pig/model.lod2.glb")) < 1_000_000
    oviduct.run("check", "--euler", "0", *models)

    formats(oviduct, out)

    # `oviduct check` and the other programs must detect a hole in the surface.
    with open(out("small/model.obj")) as whole, open(out("hole.obj"), "w") as holed:
        lines = whole.readlines()
        first_face = next(i for i, line in enumerate(lines) if line.startswith("f "))
        holed.writelines(lines[:first_face] + lines[first_face + 1:])
    oviduct.run("check", out("hole.obj"), expect=1)
    judged = subprocess.run([sys.executable, os.path.join(HERE, "mesh.py"), out("hole.obj")], capture_output=True)
    assert judged.returncode == 1, "the other programs did not find the hole"

    # The error message names all faults, and no file is left.
    said = oviduct.run("generate", "--out", out("bad"), "--set", "steps=-4", "--set", "colour=red", expect=2)
    assert "/spec/steps" in said and "/spec/colour" in said, said
    assert not os.path.exists(out("bad")) or os.listdir(out("bad")) == []
    with open(out("endless.json"), "w") as file:
        json.dump(ENDLESS, file)
    line = [BINARY, "generate", "--out", out("stopped"), "--spec", out("endless.json")]
    running = subprocess.Popen(line, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 900
    while not (os.path.isdir(out("stopped")) and os.listdir(out("stopped"))) and time.monotonic() < deadline:
        time.sleep(0.01)
    running.send_signal(signal.SIGINT)
    assert running.wait(900) == 130, running.returncode
    assert os.listdir(out("stopped")) == [], os.listdir(out("stopped"))

    # The demo from the README.
    done = subprocess.run([BINARY, "demo", "--exit"], cwd=folder, capture_output=True, text=True, timeout=3600)
    assert done.returncode == 0, done.stdout + done.stderr
    found = set(os.listdir(out("demo")))
    assert {"model.glb", "model.lod2.glb", "report.json", "sections.bin"} <= found, found
    oviduct.run("check", "--euler", "0", out("demo/model.glb"))
    if NIGHT:
        subprocess.run([sys.executable, os.path.join(HERE, "mesh.py"), out("demo/model.glb")], check=True)
    print("models: all checks passed")


if __name__ == "__main__":
    BINARY = os.path.abspath(sys.argv[1])
    NIGHT = sys.argv[2:] == ["--night"]
    if sys.argv[2:] not in ([], ["--night"]):
        sys.exit(__doc__)
    with tempfile.TemporaryDirectory() as folder:
        main(folder)
