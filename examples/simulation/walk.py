"""Simulates sperm-like walkers in the lumen of a model: persistent random walks along walls (VTK).

Usage: walk.py DIR [--out DIR] [--seed N] [--walkers N] [--steps N] [--speed MM_S]
               [--persistence S] [--drift MM_S]

Walkers start near the isthmus and swim at a constant speed in randomly changing directions. They
slide along the wall; the ends of the lumen are closed. A positive drift carries them towards the
ampulla along centreline.vtp. The signed distance of every walker from the surface is computed at
every step, and the program fails if a walker has left the lumen. Writes walk.csv and walk.png.
"""

import os
import time

import matplotlib
import numpy as np
import vtk
from scipy.spatial import cKDTree
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy

from bodies import arguments, expect, read, read_polydata

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

# Time step, s; minimum distance of a walker's centre from the wall, mm; fraction of the length
# in which walkers start.
STEP, CLEARANCE, START = 0.04, 0.001, 0.1


def polydata(points, triangles):
    """Converts triangles to a VTK object."""
    data, places, cells = vtk.vtkPolyData(), vtk.vtkPoints(), vtk.vtkCellArray()
    places.SetData(numpy_to_vtk(points, deep=True))
    cells.SetData(3, numpy_to_vtkIdTypeArray(triangles.astype(np.int64).ravel(), deep=True))
    data.SetPoints(places)
    data.SetPolys(cells)
    return data


class Wall:
    """Answers geometric queries about a closed surface."""

    def __init__(self, points, triangles):
        self.data = polydata(points, triangles)
        self.distance = vtk.vtkImplicitPolyDataDistance()
        self.distance.SetInput(self.data)
        self.lines = vtk.vtkStaticCellLocator()
        self.lines.SetDataSet(self.data)
        self.lines.BuildLocator()

    def depth(self, points):
        """Returns the depth of points inside the surface, mm; negative outside."""
        values = vtk.vtkDoubleArray()
        self.distance.FunctionValue(numpy_to_vtk(np.ascontiguousarray(points), deep=True), values)
        return -vtk_to_numpy(values).copy()

    def nearest(self, point):
        """Returns the nearest point of the surface."""
        found = [0.0, 0.0, 0.0]
        self.distance.EvaluateFunctionAndGetClosestPoint(point, found)
        return np.array(found)

    def between(self, one, other):
        """Returns whether the line between two points intersects the surface."""
        at, place, local, part = vtk.reference(0.0), [0.0] * 3, [0.0] * 3, vtk.reference(0)
        return self.lines.IntersectWithLine(one, other, 0.0, at, place, local, part) != 0

    def sample(self, random, count, low, high):
        """Draws points inside the surface, uniformly distributed between two heights."""
        x0, x1, y0, y1, _, _ = self.data.GetBounds()
        found = np.empty((0, 3))
        while len(found) < count:
            drawn = random.uniform([x0, y0, low], [x1, y1, high], (4 * count, 3))
            found = np.vstack([found, drawn[self.depth(drawn) > CLEARANCE]])
        return found[:count]


class Centreline:
    """The centre line of a model."""

    def __init__(self, folder):
        data, _ = read_polydata(os.path.join(folder, "centreline.vtp"))
        points = vtk_to_numpy(data.GetPoints().GetData()).astype(float)
        self.tangents = np.gradient(points, axis=0)
        self.tangents /= np.linalg.norm(self.tangents, axis=1, keepdims=True)
        self.points = points
        self.length = vtk_to_numpy(data.GetPointData().GetArray("arc_length"))
        self.tree = cKDTree(points)

    def at(self, places):
        """Returns tangents of the centre line near points, and their lengths along it, mm."""
        near = self.tree.query(places)[1]
        tangents = self.tangents[near]
        return tangents, self.length[near] + np.einsum("ij,ij->i", places - self.points[near], tangents)


def directions(random, count):
    """Draws random unit vectors."""
    drawn = random.normal(size=(count, 3))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def step(wall, random, places, depths, heading, options, drift):
    """Moves all walkers and changes their headings; returns places, depths and refused moves."""
    # The correlation of directions decays as exp(-t / persistence).
    heading += np.sqrt(STEP / options.persistence) * random.normal(size=heading.shape)
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    moved = places + STEP * (options.speed * heading + drift)
    reached = wall.depth(moved)
    touched = np.flatnonzero(reached < CLEARANCE)
    for i in touched:
        # Moves back to the clearance along the normal, and keeps the heading along the wall.
        foot = wall.nearest(moved[i])
        normal = (moved[i] - foot) * np.sign(reached[i])
        normal /= max(np.linalg.norm(normal), 1e-12)
        moved[i] = foot + 1.5 * CLEARANCE * normal
        heading[i] -= min(heading[i] @ normal, 0) * normal
    if len(touched):
        heading[touched] /= np.maximum(np.linalg.norm(heading[touched], axis=1, keepdims=True), 1e-12)
        reached[touched] = wall.depth(moved[touched])
    # A move shorter than the distance to the wall cannot cross it; other moves are tested. A walker
    # whose move is refused stays and takes a new direction.
    far = np.linalg.norm(moved - places, axis=1) >= depths
    stuck = [i for i in np.flatnonzero(far | (reached < 0.1 * CLEARANCE))
             if reached[i] < 0.1 * CLEARANCE or wall.between(places[i], moved[i])]
    moved[stuck], reached[stuck], heading[stuck] = places[stuck], depths[stuck], directions(random, len(stuck))
    return moved, reached, len(stuck)


def outline(wall, height):
    """Returns the lines in which the plane z = height cuts the surface: (n, 2, 2)."""
    plane = vtk.vtkPlane()
    plane.SetOrigin(0, 0, height)
    plane.SetNormal(0, 0, 1)
    cutter = vtk.vtkCutter()
    cutter.SetCutFunction(plane)
    cutter.SetInputData(wall.data)
    cutter.Update()
    cut = cutter.GetOutput()
    lines = vtk_to_numpy(cut.GetLines().GetConnectivityArray()).reshape(-1, 2)
    return vtk_to_numpy(cut.GetPoints().GetData())[lines][:, :, :2]


def draw(path, wall, tracks, distances, uniform):
    """Draws walkers in a slice, tracks along the tube, and distances from the wall."""
    figure, axes = plt.subplots(1, 3, figsize=(15, 5), layout="constrained", width_ratios=[1, 1.3, 1])
    low, high = wall.data.GetBounds()[4:]
    height = np.median(tracks[-1, :, 2])
    near = np.abs(tracks[-1, :, 2] - height) < 0.02 * (high - low)
    axes[0].plot(*outline(wall, height).transpose(2, 1, 0), color="0.3", linewidth=1)
    axes[0].plot(*tracks[-1, near, :2].T, ".", markersize=4, color="tab:red")
    axes[0].set(aspect="equal", title=f"{near.sum()} walkers near z = {height:.2f} mm", xlabel="x, mm", ylabel="y, mm")
    for track in np.moveaxis(tracks[:, :40], 1, 0):
        axes[1].plot(track[:, 2], track[:, 0], linewidth=0.6)
    axes[1].set(title="tracks of 40 walkers", xlabel="z, mm (isthmus to ampulla)", ylabel="x, mm", xlim=(low, high))
    bins = np.linspace(0, 1000 * max(distances.max(), uniform.max()), 25)
    axes[2].hist([1000 * distances, 1000 * uniform], bins, label=["walkers", "spread evenly"], color=["tab:red", "0.7"])
    axes[2].set(title="distance from the wall", xlabel="µm", ylabel="walkers")
    axes[2].legend()
    figure.savefig(path, dpi=120)


def main():
    options = arguments(
        __doc__, ("--seed", {"type": int, "default": 1}), ("--walkers", {"type": int, "default": 1000}),
        ("--steps", {"type": int, "default": 500, "help": f"of {STEP} s"}),
        ("--speed", {"type": float, "metavar": "MM_S", "default": 0.05, "help": "of swimming (default: %(default)s)"}),
        ("--persistence", {"type": float, "metavar": "S", "default": 2.0, "help": "of a direction (default: %(default)s)"}),
        ("--drift", {"type": float, "metavar": "MM_S", "default": 0.0, "help": "towards the ampulla (default: none)"}))
    start = time.perf_counter()
    random = np.random.default_rng(options.seed)
    lumen = read(options.folder, "lumen")
    wall, centreline = Wall(lumen.points, lumen.triangles), Centreline(options.folder)
    low, high = wall.data.GetBounds()[4:]

    places = wall.sample(random, options.walkers, low, low + START * (high - low))
    depths, heading = wall.depth(places), directions(random, options.walkers)
    tracks, touching, turned, least = [places], 0, 0, depths.min()
    for number in range(options.steps):
        drift = options.drift * centreline.at(places)[0]
        places, depths, stuck = step(wall, random, places, depths, heading, options, drift)
        expect(depths.min() > 0, f"{np.sum(depths <= 0)} walkers left the lumen in step {number}")
        tracks.append(places)
        touching += np.sum(depths < 2 * CLEARANCE)
        turned += stuck
        least = min(least, depths.min())

    tracks = np.array(tracks)
    side = Wall(lumen.points, lumen.of("wall"))
    distances = np.abs(side.depth(places))
    uniform = np.abs(side.depth(wall.sample(random, options.walkers, places[:, 2].min(), places[:, 2].max())))
    along = centreline.at(places)[1] - centreline.at(tracks[0])[1]
    net = np.linalg.norm(places - tracks[0], axis=1)
    print(f"{options.walkers} walkers, {options.steps} steps of {STEP} s, seed {options.seed}: none left the lumen; "
          f"least distance from its surface {1000 * least:.2g} µm")
    print(f"at the wall {touching / options.walkers / options.steps:.0%} of the time; {turned} moves refused")
    print("distance from the wall, µm: " + ", ".join(f"p{p} {1000 * np.percentile(distances, p):.3g}" for p in (5, 50, 95)) +
          "; spread evenly: " + ", ".join(f"p{p} {1000 * np.percentile(uniform, p):.3g}" for p in (5, 50, 95)))
    print(f"net displacement: mean {net.mean():.4g} mm of {options.steps * STEP * options.speed:.4g} mm swum; "
          f"along the tube mean {along.mean():+.4g} mm, farthest {along.max():.4g} mm")
    table = np.column_stack([tracks[0], places, distances])
    np.savetxt(os.path.join(options.out, "walk.csv"), table, delimiter=",", fmt="%.6f", comments="",
               header="x0_mm,y0_mm,z0_mm,x_mm,y_mm,z_mm,wall_distance_mm")
    draw(os.path.join(options.out, "walk.png"), wall, tracks, distances, uniform)
    print(f"{time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
