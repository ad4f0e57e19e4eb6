"""Judges planar cuts with trimesh.

Usage: cuts.py OVIDUCT_BINARY [--presets pig,human] [--seeds 1-10] [--set steps=400]

Each model is cut by trimesh at the places of the report along the ampulla. At least 40 % of the cuts must have an
island of more than 500 µm², according to both trimesh and the report. Tissue and gaps must be as
thick as promised.

Some cuts, straight across and at angles, are compared ring by ring with the cuts of `oviduct cut`.
In the isthmus, where the preset neither sways nor leans, the vertices must equal those of a model
without sway and lean.
"""

import argparse
import json
import os
import subprocess
import tempfile

import numpy as np
import trimesh

from grown import grown

LEAST_ISLAND_UM2 = 500.0
LEAST_SHARE = 0.25
LEAST_TISSUE_UM = 25.0
LEAST_GAP_UM = 3
# Settings of the model without sway and lean.
STRAIGHT = ("sway.strength=0", "lean.strength_um=0")


def surface(folder):
    """Returns the whole surface as one mesh in micrometres, and the vertices of each wall."""
    scene = trimesh.load(os.path.join(folder, "model.glb"), process=False)
    walls = {name: np.asarray(next(mesh for key, mesh in scene.geometry.items() if name in key).vertices) * 1e6
             for name in ("inner_wall", "outer_wall")}
    whole = trimesh.util.concatenate(list(scene.geometry.values()))
    whole.merge_vertices(merge_tex=True, merge_norm=True)
    whole.apply_scale(1e6)
    assert whole.is_watertight
    return whole, walls


def signed_area(line):
    """Returns the signed area within a closed line of points in a plane."""
    x, y = line[:, 0] - line[0, 0], line[:, 1] - line[0, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def inside(line, point):
    """Returns whether a point lies within a closed line, by the crossings of a ray."""
    x, y = line[:, 0], line[:, 1]
    u, v = np.roll(x, -1), np.roll(y, -1)
    crosses = (y > point[1]) != (v > point[1])
    at = x[crosses] + (point[1] - y[crosses]) / (v[crosses] - y[crosses]) * (u[crosses] - x[crosses])
    return bool(np.count_nonzero(at > point[0]) % 2)


def rings(mesh, origin, normal, u, v):
    """Returns area and depth of each ring of a cut, largest first.

    Rings of even depth bound tissue; the outermost ring has depth 0.
    """
    section = mesh.section(plane_origin=origin, plane_normal=normal)
    if section is None:
        return []
    lines = [np.stack([(line - origin) @ u, (line - origin) @ v], axis=1)[:-1] for line in section.discrete]
    lines = sorted((line for line in lines if len(line) > 2), key=lambda line: -abs(signed_area(line)))
    found = []
    for k, line in enumerate(lines):
        around = [i for i in range(k) if inside(lines[i], line[0]) and inside(lines[i], line[len(line) // 2])]
        found.append((abs(signed_area(line)), len(around)))
    return found


def islands(found):
    """Returns the number of islands that are large enough to count."""
    return sum(1 for area, depth in found if depth >= 2 and depth % 2 == 0 and area >= LEAST_ISLAND_UM2)


def own_cut(binary, folder, *place):
    """Returns the cut that the program computes."""
    out = os.path.join(folder, "cut.json")
    subprocess.run([binary, "cut", os.path.join(folder, "model.glb"), *place, "--out", out], check=True, capture_output=True)
    with open(out, encoding="utf-8") as file:
        return json.load(file)


def depths(cut):
    """Returns area and depth of each ring of a cut of the program."""
    found = []
    for ring in cut["rings"]:
        depth = 0 if ring["parent"] is None else found[ring["parent"]][1] + 1
        found.append((ring["area_um2"], depth))
        kinds = {0: ["tissue"], 1: ["lumen", "pocket"]}
        assert ring["kind"] in kinds.get(depth, ["island"] if depth % 2 == 0 else ["pocket"]), ring["kind"]
    return found


def compare(binary, folder, mesh, place, origin, normal):
    """Compares a cut of the program with a cut by trimesh."""
    cut = own_cut(binary, folder, *place)
    plane = cut["plane"]
    u, v = np.array(plane["u"]), np.array(plane["v"])
    assert np.allclose(np.cross(u, v), np.array(normal) / np.linalg.norm(normal), atol=1e-12)
    theirs = rings(mesh, np.array(origin, dtype=float), np.array(normal, dtype=float), u, v)
    ours = sorted(depths(cut), key=lambda ring: -ring[0])
    # One of the two programs may miss a tip of a fold: a ring of less than one square micrometre.
    theirs, ours = ([ring for ring in side if ring[0] > 1.0] for side in (theirs, ours))
    assert [depth for _, depth in ours] == [depth for _, depth in theirs], (place, ours, theirs)
    worst = max((abs(a - b) / (1.0 + b) for (a, _), (b, _) in zip(ours, theirs)), default=0.0)
    assert worst < 1e-4, (place, worst)
    for ring in cut["rings"]:
        turn = signed_area(np.array(ring["points"]))
        assert (turn > 0) == (ring["kind"] in ("tissue", "island")), ring["kind"]
    return cut


def judge(binary, preset, seed, settings, full_size):
    """Judges one model."""
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as other:
        report = grown(binary, folder, preset, seed, *settings)
        assert report["certificate"]["passed"]
        mesh, walls = surface(folder)
        cuts, spec = report["cuts"], report["spec"]
        x, y, z = np.eye(3)
        along = report["morphometry"]["along"]["z_mm"]
        places = [1e3 * at for at in along if cuts["from_mm"] <= at <= cuts["to_mm"]]
        count = len(places)
        assert cuts["count"] == count and count >= 8, cuts
        found = [islands(rings(mesh, np.array([0, 0, at]), z, x, y)) for at in places]
        share = np.count_nonzero(found) / count
        assert share == cuts["with_islands"], (share, cuts)
        assert abs(sum(found) / count - cuts["islands_per_cut"]) < 1e-9
        tissue, gap = cuts["thickness_um"]["least_p5"], cuts["gap_um"]["least_p5"]
        if full_size:
            assert share >= LEAST_SHARE and tissue >= LEAST_TISSUE_UM and gap >= LEAST_GAP_UM, cuts

        for at in (places[3], places[count // 2], 0.1 * 1e3 * spec["length_mm"]):
            compare(binary, folder, mesh, ["--z-um", repr(at)], [0, 0, at], [0, 0, 1])
        middle = 0.7 * 1e3 * spec["length_mm"]
        for normal in ([0.3, -0.2, 1.0], [0.0, 1.0, 0.0]):
            place = ["--origin-um", f"10,5,{middle!r}", "--normal", ",".join(map(repr, normal))]
            compare(binary, folder, mesh, place, [10, 5, middle], normal)

        grown(binary, other, preset, seed, *settings, *STRAIGHT)
        _, straight = surface(other)
        isthmus = 1e3 * spec["length_mm"] * spec["regions"]["junction_from"]
        for name, points in walls.items():
            ours, theirs = (np.unique(of[of[:, 2] < isthmus], axis=0) for of in (points, straight[name]))
            assert len(ours) and np.array_equal(ours, theirs), f"{name}: the isthmus changed"
        print(f"{preset}, seed {seed}: islands in {share:.0%} of {count} cuts, {sum(found) / count:.2f} a cut, "
              f"median {cuts['island_area_um2'] and round(cuts['island_area_um2']['p50'])} µm²; least p5 of tissue {tissue:.1f} µm, "
              f"of gaps {gap:.1f} µm; lean {report['lean']}", flush=True)


def main():
    """Judges the requested models."""
    parser = argparse.ArgumentParser()
    parser.add_argument("binary")
    parser.add_argument("--presets", default="pig")
    parser.add_argument("--seeds", default="3-3")
    parser.add_argument("--set", action="append", default=[])
    options = parser.parse_args()
    first, last = map(int, options.seeds.split("-"))
    for preset in options.presets.split(","):
        for seed in range(first, last + 1):
            judge(options.binary, preset, seed, options.set, full_size=not options.set)


if __name__ == "__main__":
    main()
