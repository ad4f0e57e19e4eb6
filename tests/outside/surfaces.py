"""Judges even and smooth surfaces with numpy, trimesh and VTK.

Usage: surfaces.py OVIDUCT_BINARY [--kind even] [--seeds 1-10] [--presets pig,human] [--length 5]
                   [--set steps=200]

Checks the angles of triangles, the distances from a reference surface, and the turns of contours.
The reference of an even surface (mesh.resolution_um) of a piece of the ampulla is the loft through
the sections of every step. The reference of a surface with smooth contours (mesh.smooth_um) is the
same model without smoothing. Sparse surfaces are even ones of tubes with a sparse outer wall.
Distances are measured from wall to wall in both directions, at vertices, midpoints of edges and
centres of triangles.
"""

import argparse
import json
import os
import tempfile

import numpy as np
import trimesh
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

from grown import grown

HERE = os.path.dirname(os.path.abspath(__file__))
TOLERANCE_UM = 4.0
SMOOTH_UM = 5.0
# Maximum number of vertices per wall whose distances are measured.
SAMPLES = 200_000
WALLS = ("inner_wall", "outer_wall")
# Seeds of sparse tubes. The first once exceeded the tolerance.
SPARSE_SEEDS = (2305843, 7)
# A short tube whose outer particles are about 100 µm apart.
SPARSE = ("steps=400", "length_mm=5", 'particles.outer={"keys":[[0,38],[1,105]],"ease":"linear"}',
          'particles.total={"keys":[[0,248],[1,2905]],"ease":"linear"}')


def straight(binary, folder, preset, seed, *settings):
    """Generates a model without lean; returns its report."""
    # Without lean, contours lie in planes, and distances are those of the loft.
    return grown(binary, folder, preset, seed, *settings, "lean.strength_um=0")


def walls(folder):
    """Returns the vertices, in micrometres, and the triangles of each wall."""
    scene = trimesh.load(os.path.join(folder, "model.glb"), process=False)
    found = {}
    for name in WALLS:
        mesh = next(mesh for key, mesh in scene.geometry.items() if name in key)
        found[name] = np.asarray(mesh.vertices) * 1e6, np.asarray(mesh.faces)
    return found


def places(vertices, triangles):
    """Returns points on a surface: vertices, midpoints of edges, centres of triangles."""
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    return np.concatenate([vertices[np.unique(triangles)], vertices[edges].mean(axis=1), vertices[triangles].mean(axis=1)])


def distances(points, vertices, triangles):
    """Returns the distances of points from a surface."""
    surface = vtk.vtkPolyData()
    corners = vtk.vtkPoints()
    corners.SetData(numpy_to_vtk(np.ascontiguousarray(vertices), deep=True))
    surface.SetPoints(corners)
    cells = vtk.vtkCellArray()
    cells.SetData(3, numpy_to_vtk(np.ascontiguousarray(triangles.ravel()), deep=True, array_type=vtk.VTK_ID_TYPE))
    surface.SetPolys(cells)
    function = vtk.vtkImplicitPolyDataDistance()
    function.SetInput(surface)
    found = vtk.vtkDoubleArray()
    function.EvaluateFunction(numpy_to_vtk(np.ascontiguousarray(points), deep=True), found)
    return np.abs(vtk_to_numpy(found))


def least_angles(vertices, triangles):
    """Returns the minimum angle of each triangle (degrees) and its longest to shortest edge."""
    sides = np.stack([np.linalg.norm(vertices[triangles[:, k]] - vertices[triangles[:, k - 1]], axis=1) for k in range(3)], axis=1)
    a, b, c = np.sort(sides, axis=1).T
    return np.degrees(np.arccos(np.clip((b * b + c * c - a * a) / (2 * b * c), -1, 1))), c / a


def farthest(made, reference):
    """Returns the maximum distances between walls: from those made to the reference, and back."""
    worst = {}
    for name in WALLS:
        z = made[name][0][:, 2]
        within = places(*reference[name])
        within = within[(within[:, 2] >= z.min()) & (within[:, 2] <= z.max())]
        worst[name] = distances(places(*made[name]), *reference[name]).max(), distances(within, *made[name]).max()
    return worst


def told(worst):
    there_and_back = (f"{name} {there:.2f} and {back:.2f} µm" for name, (there, back) in worst.items())
    return f"distance there and back: {', '.join(there_and_back)}"


def judge_sparse(binary, seed, resolution_um):
    """Judges a tube whose outer wall has few particles, which bulge soon after they are added."""
    with tempfile.TemporaryDirectory() as folder:
        even, every = (os.path.join(folder, name) for name in ("even", "every"))
        straight(binary, even, "paper", seed, *SPARSE, f"mesh.resolution_um={resolution_um}", f"mesh.tolerance_um={TOLERANCE_UM}")
        straight(binary, every, "paper", seed, *SPARSE, "solver.record_every=1")
        worst = farthest(walls(even), walls(every))
    print(f"sparse {seed}: {told(worst)}", flush=True)
    assert max(map(max, worst.values())) <= TOLERANCE_UM, worst


def judge_even(binary, preset, seed, length_mm, resolution_um):
    # The reference covers a slightly longer piece of the ampulla.
    with open(os.path.join(HERE, "..", "..", "presets", f"{preset}.json"), encoding="utf-8") as file:
        tube_mm = json.load(file)["spec"]["length_mm"]
    begin, end = 0.6, 0.6 + length_mm / tube_mm
    with tempfile.TemporaryDirectory() as folder:
        even, every = (os.path.join(folder, name) for name in ("even", "every"))
        report = straight(binary, even, preset, seed, f"mesh.resolution_um={resolution_um}", f"mesh.tolerance_um={TOLERANCE_UM}",
                          f"piece.from={begin}", f"piece.to={end}")
        straight(binary, every, preset, seed, "solver.record_every=1", f"piece.from={begin - 0.02}", f"piece.to={end + 0.02}")
        certificate = report["certificate"]
        assert certificate["passed"], certificate["failures"]
        made, reference = walls(even), walls(every)
        scene = trimesh.load(os.path.join(even, "model.glb"), process=False)
        angles, ratios = (np.concatenate(part) for part in zip(
            *(least_angles(np.asarray(mesh.vertices), np.asarray(mesh.faces)) for mesh in scene.geometry.values())))
    share = np.mean(angles >= 20)
    quality = certificate["quality"]
    assert len(angles) == certificate["triangles"]
    assert abs(share - quality["least_angles_from_20"]) < 1e-6, (share, quality)
    # A triangle whose angle lies on the boundary of a bin may be counted in the neighbouring bin.
    counted = np.histogram(angles, bins=np.arange(0, 61, 5))[0]
    assert np.abs(counted - quality["least_angles"]).sum() <= 4, (counted, quality)
    worst = farthest(made, reference)
    print(f"{preset} {seed}: {length_mm} mm, {len(angles)} triangles, {100 * share:.3f} % of least angles from 20°, "
          f"least {angles.min():.1f}°, {100 * np.mean(ratios <= 4):.3f} % of edge ratios to 4; {told(worst)}", flush=True)
    assert share >= 0.99, f"only {share} of the least angles are at least 20 degrees"
    assert max(map(max, worst.values())) <= TOLERANCE_UM, worst


def greatest_turn(vertices, triangles):
    """Returns the maximum turn of a contour, degrees.

    Contours are the edges within a section.
    """
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    edges = edges[vertices[edges[:, 0], 2] == vertices[edges[:, 1], 2]]
    ends = np.concatenate([edges, edges[:, ::-1]])
    ends = ends[np.argsort(ends[:, 0], kind="stable")]
    assert np.array_equal(ends[::2, 0], ends[1::2, 0]) and len(np.unique(ends[:, 0])) * 2 == len(ends), "contours are not closed"
    at, before, after = vertices[ends[::2, 0], :2], vertices[ends[::2, 1], :2], vertices[ends[1::2, 1], :2]
    u, v = at - before, after - at
    return np.degrees(np.abs(np.arctan2(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0], (u * v).sum(axis=1)))).max()


def sample(wall):
    """Returns a sample of a wall's vertices, the same in every run."""
    vertices = wall[0]
    return vertices if len(vertices) <= SAMPLES else np.random.default_rng(1).choice(vertices, SAMPLES, replace=False)


def judge_smooth(binary, preset, seed, settings):
    with tempfile.TemporaryDirectory() as folder:
        smooth, plain = (os.path.join(folder, name) for name in ("smooth", "plain"))
        report = straight(binary, smooth, preset, seed, f"mesh.smooth_um={SMOOTH_UM}", *settings)
        certificate, summary = report["certificate"], report["summary"]
        assert certificate["passed"], certificate["failures"]
        assert straight(binary, plain, preset, seed, *settings)["summary"]["particles"] == summary["particles"]
        made, reference = walls(smooth), walls(plain)
    turn = max(greatest_turn(*made[name]) for name in WALLS)
    sharp = max(greatest_turn(*reference[name]) for name in WALLS)
    # The distance between contours is largest at their points.
    some = [(sample(made[name]), reference[name]) for name in WALLS] + [(sample(reference[name]), made[name]) for name in WALLS]
    worst = max(distances(points, *surface).max() for points, surface in some)
    print(f"{preset} {seed}: {certificate['triangles']} triangles, {summary['sections_added']} sections added; greatest turn "
          f"{turn:.1f}° (before {sharp:.1f}°), distance {worst:.2f} µm", flush=True)
    assert turn <= 60, f"a contour turns by {turn} degrees"
    assert worst <= SMOOTH_UM, f"the wall moved by {worst} µm"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("binary")
    parser.add_argument("--kind", choices=["even", "sparse", "smooth"], default="even")
    parser.add_argument("--seeds", default="3-3")
    parser.add_argument("--presets", default="pig")
    parser.add_argument("--length", type=float, default=0.8, help="of the piece with an even surface, mm")
    parser.add_argument("--resolution", type=float, default=40)
    parser.add_argument("--set", action="append", default=[], help="setting of smooth models")
    options = parser.parse_args()
    first, last = map(int, options.seeds.split("-"))
    if options.kind == "sparse":
        for seed in SPARSE_SEEDS:
            judge_sparse(options.binary, seed, options.resolution)
    for preset in options.presets.split(","):
        for seed in range(first, last + 1):
            if options.kind == "even":
                judge_even(options.binary, preset, seed, options.length, options.resolution)
            if options.kind == "smooth":
                judge_smooth(options.binary, preset, seed, options.set)


if __name__ == "__main__":
    main()
