"""Grows models of the paper's size for many seeds and checks each with other programs. Not part of scripts/test: a seed
takes about a minute.

Usage: seeds.py [--binary target/release/oviduct] [--preset paper] [--seeds 1..20] [--backend auto]
"""

import argparse
import os
import tempfile
import time

import mesh
from grown import Oviduct, of_paper_size

HERE = os.path.dirname(os.path.abspath(__file__))


def seeds(text):
    """`3`, `1..20`, or `1,5,7..9`."""
    found = []
    for part in text.split(","):
        first, _, last = part.partition("..")
        found += range(int(first), int(last or first) + 1)
    return found


def row(*cells):
    widths = [5, 9, 9, 14, 9, 8, 9, 9, 8, 8, 7]
    print("  ".join(str(cell).rjust(width) for cell, width in zip(cells, widths)), flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", default=os.path.join(HERE, "..", "..", "target", "release", "oviduct"))
    parser.add_argument("--preset", default="paper")
    parser.add_argument("--seeds", type=seeds, default=seeds("1..20"))
    parser.add_argument("--backend", default="auto")
    options = parser.parse_args()
    oviduct = Oviduct(options.binary)
    faults, rows = [], []
    for seed in options.seeds:
        with tempfile.TemporaryDirectory() as folder:
            begin = time.monotonic()
            told = oviduct.generate(os.path.join(folder, "model"), "--preset", options.preset, "--seed", str(seed),
                                    "--backend", options.backend)
            judged = mesh.judge(os.path.join(folder, "model", "model.glb"))
            wrong = of_paper_size(told) + judged.faults
            faults += [f"{options.preset} seed {seed}: {fault}" for fault in wrong]
            proof = told["certificate"]
            rows.append((
                seed, told["sections"], told["sections_added"],
                f"{told['particles']['start']}→{told['particles']['end']}", told["vertices"],
                f"{100 * (told['vertices'] / 790_211 - 1):+.2f}%", f"{proof['min_gap_um']:.3f}", judged.crossing,
                "yes" if judged.closed else "NO", f"{time.monotonic() - begin:.0f}", "ok" if not wrong else "WRONG",
            ))
    row("seed", "sections", "added", "particles", "vertices", "of 790k", "gap/um", "crossing", "closed", "seconds", "")
    for cells in rows:
        row(*cells)
    for fault in faults:
        print(fault)
    print(f"seeds: {len(rows)} models of preset {options.preset}, {len(faults)} faults")
    raise SystemExit(1 if faults else 0)


if __name__ == "__main__":
    main()
