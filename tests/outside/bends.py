"""Judges bent models with trimesh, pymeshlab, numpy and TetGen.

Usage: bends.py OVIDUCT_BINARY [--presets pig] [--seeds 3-3] [--courses arc,random:1,...]
                [--set steps=400] [--fill]

Each model is grown straight and along the courses. A bent surface must be one closed, oriented
solid torus without self-intersections.

For an arc, this script computes the centre line itself. All vertices must lie where the bending map
moves the vertices of the straight surface. Cuts across the centre line, by the program and by
trimesh, must equal the cuts of the straight tube.

With --fill, TetGen fills lumen and tissue of the first course. The program may refuse a course only
if it names the place.
"""

import argparse
import json
import math
import os
import re
import subprocess
import sys
import tempfile

import numpy as np
import tetgen
import trimesh

from cuts import depths, islands, rings, surface
from mesh import judge

SHAPES = {
    "arc": {"shape": "arc", "turn_deg": 150},
    "sigmoid": {"shape": "sigmoid", "turn_deg": 80},
    "coil": {"shape": "coil", "windings": 2.5, "pitch_mm": 8},
    "turns": {"shape": "turns", "turns": [[0.25, 170, 0, 0.3], [0.7, 150, 90, 0.3]]},
    "points": {"shape": "points", "points_mm": [[0, 0, 0], [0, 0, 20], [8, 4, 34], [25, 4, 38], [40, -6, 30]]},
}
PLACES = 8


def course(name):
    """Returns the course with a name; `random:SEED` is a random course of tortuosity 1.5."""
    if name.startswith("random"):
        return {"shape": "random", "tortuosity": 1.5, "seed": int(name.partition(":")[2] or 1)}
    return SHAPES[name]


def grow(binary, folder, preset, seed, settings, patch, bodies="tissue"):
    """Grows a model; returns its report, or None if its course was refused with its place."""
    with open(os.path.join(folder, "patch.json"), "w", encoding="utf-8") as file:
        json.dump({"course": patch}, file)
    options = [f"--set={setting}" for setting in settings]
    done = subprocess.run(
        [binary, "generate", "--preset", preset, "--seed", str(seed), "--outputs", "glb,obj", "--bodies", bodies,
         "--spec", os.path.join(folder, "patch.json"), "--out", folder, *options], capture_output=True, text=True)
    if done.returncode != 0:
        refusal = re.search(r"/spec/course/\S+: .* (at|parts at) [\d.]+ mm", done.stderr)
        assert refusal, f"{patch}: {done.stderr}"
        print(f"  refused: {done.stderr.strip().splitlines()[-1]}", flush=True)
        return None
    with open(os.path.join(folder, "report.json"), encoding="utf-8") as file:
        return json.load(file)


def vertices(folder):
    """Returns the vertices of the OBJ file in their order, µm."""
    with open(os.path.join(folder, "model.obj"), encoding="utf-8") as file:
        return 1e6 * np.array([line.split()[1:4] for line in file if line.startswith("v ")], dtype=float)


def on_arc(points, length, turn):
    """Returns the positions of a straight tube's points on an arc that bends toward x."""
    radius = length / turn
    angle = points[:, 2] / radius
    inward = radius - points[:, 0]
    return np.stack([radius - inward * np.cos(angle), points[:, 1], inward * np.sin(angle)], axis=1)


def arc_frame(place, length, turn):
    """Returns origin, u, v and tangent at a place on an arc."""
    angle = place * turn / length
    sin, cos = math.sin(angle), math.cos(angle)
    origin = on_arc(np.array([[0.0, 0.0, place]]), length, turn)[0]
    return origin, np.array([cos, 0, -sin]), np.array([0.0, 1, 0]), np.array([sin, 0, cos])


def judge_arc(binary, straight, bent, report):
    """Compares a tube on an arc with the straight tube, vertex by vertex and cut by cut."""
    length, turn = 1e3 * report["spec"]["length_mm"], math.radians(report["spec"]["course"]["turn_deg"])
    before, after = vertices(straight), vertices(bent)
    assert len(after) == len(before) + report["course"]["split"], "vertices"
    off = np.linalg.norm(on_arc(before, length, turn) - after[: len(before)], axis=1).max()
    assert off < 0.05, f"a vertex is {off} µm from its place"
    theirs, _ = surface(straight)
    ours, _ = surface(bent)
    x, y, z = np.eye(3)
    worst = 0.0
    for k in range(PLACES):
        place = length * (k + 0.5) / PLACES
        expected = rings(theirs, np.array([0, 0, place]), z, x, y)
        origin, u, v, tangent = arc_frame(place, length, turn)
        found = rings(ours, origin, tangent, u, v)
        out = os.path.join(bent, "cut.json")
        subprocess.run([binary, "cut", os.path.join(bent, "model.glb"), "--z-um", repr(place), "--out", out], check=True,
                       capture_output=True)
        with open(out, encoding="utf-8") as file:
            own = json.load(file)
        assert np.allclose(own["plane"]["u"], u, atol=1e-5) and np.allclose(own["plane"]["origin_um"], origin, atol=0.1)
        # Flat triangles deviate from the map by a fraction of a micrometre, so the cuts may differ
        # by one small island.
        for other in (found, sorted(depths(own), key=lambda ring: -ring[0])):
            assert islands(other) == islands(expected) or abs(islands(other) - islands(expected)) <= 1
            for (a, _), (b, _) in list(zip(other, expected))[:2]:
                worst = max(worst, abs(a / b - 1))
    assert worst < 0.003, f"areas of cuts differ by {worst:.2%}"
    print(f"  on the arc: vertices within {off:.3f} µm, areas of cuts within {worst:.3%}", flush=True)


def fill(folder):
    """Fills lumen and tissue with TetGen."""
    for stem in ("model", "lumen"):
        scene = trimesh.load(os.path.join(folder, f"{stem}.glb"), process=False)
        mesh = trimesh.util.concatenate(list(scene.geometry.values()))
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        points = np.asarray(mesh.vertices, dtype=np.float64) * 1e6
        filler = tetgen.TetGen(points, np.asarray(mesh.faces, dtype=np.int32))
        filler.tetrahedralize(switches="pYQ")
        nodes, cells = np.asarray(filler.node), np.asarray(filler.elem)
        a, b, c, d = (nodes[cells[:, k]] for k in range(4))
        volume = np.abs(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)).sum() / 6
        exact = trimesh.Trimesh(points, mesh.faces, process=False).volume
        assert abs(volume / exact - 1) < 1e-9, (stem, volume, exact)
        print(f"  TetGen: {stem}: {len(points)} vertices, {len(cells)} tetrahedra, volume equal to {abs(volume / exact - 1):.1e}",
              flush=True)


def main():
    """Judges the requested models."""
    parser = argparse.ArgumentParser()
    parser.add_argument("binary")
    parser.add_argument("--presets", default="pig")
    parser.add_argument("--seeds", default="3-3")
    parser.add_argument("--courses", default="arc,coil,random:1,random:2")
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--fill", action="store_true")
    options = parser.parse_args()
    first, last = map(int, options.seeds.split("-"))
    faults = []
    for preset in options.presets.split(","):
        for seed in range(first, last + 1):
            with tempfile.TemporaryDirectory() as straight:
                plain = grow(options.binary, straight, preset, seed, options.set, {"shape": "straight"})
                for number, name in enumerate(options.courses.split(",")):
                    with tempfile.TemporaryDirectory() as bent:
                        filled = options.fill and number == 0
                        report = grow(options.binary, bent, preset, seed, options.set, course(name),
                                      "tissue,lumen,regions" if filled else "tissue")
                        if report is None:
                            continue
                        found = report["course"]
                        print(f"{preset}, seed {seed}, {name}: tortuosity {found['tortuosity']:.3f}, met {found['met']}, split "
                              f"{found['split']} in {found['rounds']} rounds; cuts {(report['cuts'] or {}).get('with_islands')}",
                              flush=True)
                        assert report["certificate"]["passed"]
                        ratio = report["certificate"]["volume_mm3"] / plain["certificate"]["volume_mm3"]
                        assert abs(ratio - 1) < 0.02, f"the volume changed by {ratio - 1:.2%}"
                        faults += [f"{preset} {seed} {name}: {fault}" for fault in judge(os.path.join(bent, "model.glb")).faults]
                        if name == "arc":
                            judge_arc(options.binary, straight, bent, report)
                        if filled:
                            fill(bent)
    for fault in faults:
        print(fault, file=sys.stderr)
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main()
