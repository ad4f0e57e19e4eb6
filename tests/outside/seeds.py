"""Grows full models of many presets, seeds and courses and lets other programs judge them.

Usage: seeds.py [--binary target/release/oviduct] [--presets paper|pig,human|all] [--seeds 1..20]
                [--courses straight,bent] [--judged 1] [--fill] [--backend auto]

Bent means the course of the preset, or an arc of 90° if the preset is straight. --judged N judges
every Nth model. With --fill, TetGen fills tissue and lumen of the first model of each preset.
scripts/test does not run this script: a model takes 1 to 30 s, a judgement up to one minute, and
TetGen several minutes.
"""

import argparse
import json
import os
import tempfile
import time

import bends
import mesh
from grown import Oviduct, of_paper_size

HERE = os.path.dirname(os.path.abspath(__file__))
COLUMNS = {"preset": 20, "seed": 4, "course": 8, "sections": 8, "particles": 12, "vertices": 8, "gap/um": 7, "islands": 7,
           "crossing": 8, "closed": 6, "seconds": 7, "": 5}


def seeds(text):
    """Parses seeds such as `3`, `1..20`, or `1,5,7..9`."""
    found = []
    for part in text.split(","):
        first, _, last = part.partition("..")
        found += range(int(first), int(last or first) + 1)
    return found


def course(wanted, own):
    """Returns the requested course for a preset with the course `own`."""
    if wanted == "straight":
        return {"shape": "straight"}
    return own if own["shape"] != "straight" else {"shape": "arc", "turn_deg": 90}


def row(*cells):
    print("  ".join(str(cell).rjust(width) for cell, width in zip(cells, COLUMNS.values())), flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", default=os.path.join(HERE, "..", "..", "target", "release", "oviduct"))
    parser.add_argument("--presets", default="paper")
    parser.add_argument("--seeds", type=seeds, default=seeds("1..20"))
    parser.add_argument("--courses", default="straight")
    parser.add_argument("--judged", type=int, default=1)
    parser.add_argument("--fill", action="store_true")
    parser.add_argument("--backend", default="auto")
    options = parser.parse_args()
    oviduct = Oviduct(options.binary)
    presets = {preset["name"]: preset["spec"] for preset in json.loads(oviduct.run("presets", "--json"))}
    names = list(presets) if options.presets == "all" else options.presets.split(",")
    faults, models, judgements, filled = [], 0, 0, set()
    row(*COLUMNS)
    for name, seed, wanted in ((n, s, c) for n in names for s in options.seeds for c in options.courses.split(",")):
        with tempfile.TemporaryDirectory() as folder:
            begin = time.monotonic()
            patch, out = os.path.join(folder, "patch.json"), os.path.join(folder, "model")
            with open(patch, "w", encoding="utf-8") as file:
                json.dump({"course": course(wanted, presets[name]["course"])}, file)
            fills = options.fill and name not in filled
            bodies = "tissue,lumen" if fills else "tissue"
            told = oviduct.generate(out, "--preset", name, "--seed", str(seed), "--backend", options.backend,
                                    "--spec", patch, "--bodies", bodies)
            if fills:
                filled.add(name)
                bends.fill(out)
            wrong = of_paper_size(told) if (name, wanted) == ("paper", "straight") else []
            crossing = closed = "-"
            if models % options.judged == 0:
                judged = mesh.judge(os.path.join(out, "model.glb"))
                wrong += judged.faults
                crossing, closed = judged.crossing, "yes" if judged.closed else "NO"
                judgements += 1
            with open(os.path.join(out, "report.json"), encoding="utf-8") as file:
                cuts = json.load(file)["cuts"]
        models += 1
        faults += [f"{name} seed {seed} {wanted}: {fault}" for fault in wrong]
        row(name, seed, wanted, told["sections"], f"{told['particles']['start']}→{told['particles']['end']}", told["vertices"],
            f"{told['certificate']['min_gap_um']:.3f}", f"{cuts['with_islands']:.0%}" if cuts else "-", crossing, closed,
            f"{time.monotonic() - begin:.0f}", "ok" if not wrong else "WRONG")
    for fault in faults:
        print(fault)
    print(f"seeds: {models} certified models of {len(names)} presets, {judgements} of them judged, {len(faults)} faults")
    raise SystemExit(1 if faults else 0)


if __name__ == "__main__":
    main()
