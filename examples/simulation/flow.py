"""Computes the Stokes flow through the lumen of a model for a pressure difference (scikit-fem).

Usage: flow.py DIR [--out DIR] [--pressure PA] [--viscosity PA_S] [--size MM3] [--self-test]

Solves -μ Δu + ∇p = 0, ∇·u = 0 with Taylor–Hood elements (P2, P1). Boundary conditions: no slip at
`wall`, pressure PA at `inlet` (isthmus), pressure 0 at `outlet` (ampulla). With mm, s and Pa,
speeds are in mm/s, fluxes in mm³/s, which is µl/s, and resistances in Pa·s/µl. Writes flow.vtu and
flow.png. `--self-test` solves a straight cylinder instead and compares it with the law of Hagen
and Poiseuille.
"""

import os
import resource
import time

import matplotlib
import numpy as np
import scipy.sparse.linalg as linalg
from scipy.spatial import Delaunay
from skfem import Basis, BilinearForm, ElementTetP1, ElementTetP2, FacetBasis, LinearForm, MeshTet
from skfem.models.poisson import laplace, mass

from bodies import Surface, arguments, expect, read, write_vtu
from tetrahedra import fill

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402


class Flow:
    """The flow at unit pressure and unit viscosity; other flows are multiples of it."""

    def __init__(self, lumen, size=None):
        # Adds points inside: without them, velocities in corners would have no degree of freedom.
        nodes, cells, _, triangles, patch = fill(lumen, ratio=1.8, size=size)
        self.mesh = MeshTet(nodes.T.copy(), cells.T.astype(np.int64).copy())
        self.facets = {name: self.facets_of(triangles[patch == k]) for k, name in enumerate(lumen.names)}
        self.velocity_basis = Basis(self.mesh, ElementTetP2(), intorder=3)
        self.pressure_basis = self.velocity_basis.with_element(ElementTetP1())
        self.ends = {name: FacetBasis(self.mesh, ElementTetP2(), facets=self.facets[name]) for name in ("inlet", "outlet")}
        self.solve()

    def facets_of(self, triangles):
        """Returns the indices of the mesh facets that are equal to these triangles."""
        def code(rows):
            a, b, c = np.sort(rows, axis=1).astype(np.int64).T
            return (a * self.mesh.nvertices + b) * self.mesh.nvertices + c
        known = code(self.mesh.facets.T)
        order = np.argsort(known)
        found = order[np.searchsorted(known, code(triangles), sorter=order)]
        assert (known[found] == code(triangles)).all()
        return found

    def normals(self, end):
        """Integrates test functions times the outward normal over an end; one column per axis."""
        return np.column_stack([LinearForm(lambda v, w, i=i: w.n[i] * v).assemble(self.ends[end]) for i in range(3)])

    def solve(self):
        """Computes the velocity (one column per component) and the pressure.

        The three components share one matrix, which is factorised once. This leaves an equation for
        the pressure with a symmetric positive matrix. Conjugate gradients solve it, with the mass
        matrix as preconditioner.
        """
        fixed = self.velocity_basis.get_dofs(self.facets["wall"]).all()
        free = np.setdiff1d(np.arange(self.velocity_basis.N), fixed)
        stiffness = laplace.assemble(Basis(self.mesh, ElementTetP2(), intorder=2))[free][:, free]
        factor = linalg.splu(stiffness.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0,
                             options={"SymmetricMode": True})
        bases = self.velocity_basis, self.pressure_basis
        divergence = [BilinearForm(lambda u, q, _, i=i: -u.grad[i] * q).assemble(*bases)[:, free] for i in range(3)]
        # The unit pressure at the inlet acts against the outward normal.
        push = -self.normals("inlet")[free]

        def diverge(velocity):
            return sum(matrix @ velocity[:, i] for i, matrix in enumerate(divergence))

        def move(pressure):
            return factor.solve(np.column_stack([matrix.T @ pressure for matrix in divergence]))

        weight = linalg.splu(mass.assemble(self.pressure_basis).tocsc())
        shape = (self.pressure_basis.N,) * 2
        driven = factor.solve(push)
        z = self.mesh.p[2]
        self.iterations = 0

        def count(_):
            self.iterations += 1

        self.pressure, state = linalg.cg(linalg.LinearOperator(shape, lambda p: diverge(move(p))), diverge(driven),
                                         x0=(z.max() - z) / np.ptp(z), M=linalg.LinearOperator(shape, weight.solve),
                                         rtol=1e-6, maxiter=2000, callback=count)
        expect(state == 0, f"no convergence in {self.iterations} iterations")
        self.velocity = np.zeros((self.velocity_basis.N, 3))
        self.velocity[free] = driven - move(self.pressure)

    def flux(self, end):
        """Returns the volume that leaves through an end per unit of time."""
        return np.sum(self.normals(end) * self.velocity)

    def cut(self, axis, at):
        """Cuts the mesh with a plane; returns barycentric coordinates (n, 3, 4) and cells."""
        height = self.mesh.p[axis][self.mesh.t.T] - at
        order = np.argsort(height, axis=1)
        below = (height < 0).sum(axis=1)
        # Cut edges as pairs of corners, which are ordered by height; by number of corners below.
        edges = {1: [[(0, 1), (0, 2), (0, 3)]], 3: [[(0, 3), (1, 3), (2, 3)]],
                 2: [[(0, 2), (0, 3), (1, 3)], [(0, 2), (1, 3), (1, 2)]]}
        shares, cells = [], []
        for number, triangles in edges.items():
            chosen = np.flatnonzero(below == number)
            row = np.arange(len(chosen))
            for triangle in triangles:
                share = np.zeros((len(chosen), 3, 4))
                for k, (i, j) in enumerate(triangle):
                    low, high = order[chosen, i], order[chosen, j]
                    part = height[chosen, low] / (height[chosen, low] - height[chosen, high])
                    share[row, k, low], share[row, k, high] = 1 - part, part
                shares.append(share)
                cells.append(chosen)
        return np.concatenate(shares), np.concatenate(cells)

    def values(self, shares, cells):
        """Returns positions, velocities and pressures at barycentric coordinates (n, m, 4)."""
        nodes = self.mesh.t.T[cells]
        places = np.einsum("nmk,nkd->nmd", shares, self.mesh.p.T[nodes])
        pressure = np.einsum("nmk,nk->nm", shares, self.pressure[nodes])
        velocity = np.zeros_like(places)
        for i, dof in enumerate(self.velocity_basis.element_dofs[:, cells]):
            weight, _ = self.velocity_basis.elem.lbasis(np.moveaxis(shares[..., 1:], -1, 0), i)
            velocity += weight[..., None] * self.velocity[dof][:, None, :]
        return places, velocity, pressure

    def flux_through(self, at):
        """Returns the area of the cut at height z, and the volume that passes per unit of time."""
        shares, cells = self.cut(2, at)
        # The rule of edge midpoints is exact for a quadratic velocity.
        places, velocity, _ = self.values((shares + np.roll(shares, 1, axis=1)) / 2, cells)
        a, b, c = np.moveaxis(places, 1, 0)
        # The triangle of midpoints has a quarter of the area.
        areas = 2 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return areas.sum(), areas @ velocity[..., 2].mean(axis=1)

    def write(self, path, pressure, viscosity):
        """Writes velocity and pressure on quadratic tetrahedra."""
        dofs = self.velocity_basis.element_dofs.T
        ends = np.full(self.velocity_basis.N, np.nan)
        at_vertices = self.pressure[self.mesh.t.T]
        pairs = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
        ends[dofs[:, :4]] = at_vertices
        for k, pair in enumerate(pairs):
            ends[dofs[:, 4 + k]] = at_vertices[:, pair].mean(axis=1)
        write_vtu(path, self.velocity_basis.doflocs.T, dofs,
                  points_data={"velocity_mm_s": self.velocity * pressure / viscosity, "pressure_pa": ends * pressure})


def refined(shares):
    """Divides triangles in barycentric coordinates into four each."""
    a, b, c = np.moveaxis(shares, 1, 0)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    return np.concatenate([np.stack(corners, axis=1) for corners in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])


def draw(flow, path, pressure, viscosity):
    """Draws the speed half way along the tube, and speed and pressure in a lengthwise cut."""
    low, high = flow.mesh.p[2].min(), flow.mesh.p[2].max()
    middle = flow.mesh.p[0].mean()
    figure, axes = plt.subplot_mosaic([["across", "speed"], ["across", "pressure"]], figsize=(13, 5), layout="constrained",
                                      width_ratios=[1, 1.5])
    views = {"across": (2, (low + high) / 2, (0, 1)), "speed": (0, middle, (2, 1)), "pressure": (0, middle, (2, 1))}
    for name, (axis, at, across) in views.items():
        # Refined, because velocity is quadratic in a cell, but colour is linear in a triangle.
        shares, cells = flow.cut(axis, at)
        places, velocity, pressures = flow.values(refined(refined(shares)), np.tile(cells, 16))
        shown = pressures * pressure if name == "pressure" else np.linalg.norm(velocity, axis=2) * pressure / viscosity
        x, y = places.reshape(-1, 3)[:, across].T
        drawn = axes[name].tripcolor(x, y, np.arange(len(x)).reshape(-1, 3), shown.ravel(), shading="gouraud", rasterized=True,
                                     cmap="plasma" if name == "pressure" else "viridis")
        axes[name].set(title=f"{'xyz'[axis]} = {at:.3g} mm", xlabel=f"{'xyz'[across[0]]}, mm", ylabel=f"{'xyz'[across[1]]}, mm")
        figure.colorbar(drawn, ax=axes[name], label="pressure, Pa" if name == "pressure" else "speed, mm/s",
                        location="bottom" if name == "across" else "right")
    axes["across"].set_aspect("equal")
    figure.savefig(path, dpi=120)


def cylinder(radius, length, around):
    """Builds a closed cylinder with the patches of a lumen."""
    step = 2 * np.pi / around

    def circle(size, count):
        angles = np.arange(count) / count * 2 * np.pi
        return size * np.column_stack([np.cos(angles), np.sin(angles)])

    rim = circle(radius, around)
    layers = round(length / (radius * step))
    heights = np.linspace(0, length, layers + 1)
    wall = np.vstack([np.column_stack([rim, np.full(around, z)]) for z in heights])
    i = np.arange(around * layers)
    right = i - i % around + (i + 1) % around
    sides = np.vstack([np.column_stack([i, right, right + around]), np.column_stack([i, right + around, i + around])])
    inside = np.vstack([[[0, 0]], *(circle(k * step * radius, round(2 * np.pi * k)) for k in range(1, round(1 / step)))])
    disc = np.vstack([rim, inside])
    cap = Delaunay(disc).simplices
    a, b, c = disc[cap[:, 0]], disc[cap[:, 1]], disc[cap[:, 2]]
    turned = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0
    cap[turned] = cap[turned][:, ::-1]
    count = len(wall)
    first = np.where(cap < around, cap, cap - around + count)
    last = np.where(cap < around, cap + layers * around, cap - around + count + len(inside))
    points = np.vstack([wall, *(np.column_stack([inside, np.full(len(inside), z)]) for z in (0, length))])
    triangles = np.vstack([sides, first[:, ::-1], last]).astype(np.int32)
    return Surface(points, triangles, np.repeat([0, 1, 2], [len(sides), len(cap), len(cap)]).astype(np.int32),
                   ["wall", "inlet", "outlet"])


def self_test():
    """Compares the flow through a cylinder with the law of Hagen and Poiseuille."""
    radius, length = 0.3, 2.0
    flow = Flow(cylinder(radius, length, 40))
    resistance, law = 1 / flow.flux("outlet"), 8 * length / (np.pi * radius**4)
    print(f"cylinder: {flow.mesh.nelements} tetrahedra; resistance by viscosity {resistance:.1f} mm⁻³, "
          f"Hagen–Poiseuille {law:.1f} mm⁻³, difference {resistance / law - 1:+.2%}")
    expect(abs(resistance / law - 1) < 0.03, "the resistance of a cylinder is wrong")
    _, middle = flow.flux_through(length / 2)
    expect(abs(middle * resistance - 1) < 0.01, "the flux changes along a cylinder")


def main():
    options = arguments(
        __doc__,
        ("--pressure", {"type": float, "metavar": "PA", "default": 0.1, "help": "at the inlet (default: %(default)s)"}),
        ("--viscosity", {"type": float, "metavar": "PA_S", "default": 1e-3, "help": "of the fluid (default: that of water)"}),
        ("--size", {"type": float, "metavar": "MM3", "help": "largest volume of a tetrahedron"}),
        ("--self-test", {"action": "store_true", "help": "solve a cylinder, whose resistance is known"}))
    if options.self_test:
        return self_test()

    start = time.perf_counter()
    lumen = read(options.folder, "lumen")
    flow = Flow(lumen, options.size)
    scale = options.pressure / options.viscosity
    fluxes = {end: flow.flux(end) * scale for end in ("inlet", "outlet")}
    print(f"{flow.mesh.nelements} tetrahedra, {3 * flow.velocity_basis.N + flow.pressure_basis.N} unknowns, "
          f"{flow.iterations} iterations")
    print(f"flux: in {-fluxes['inlet']:.5g} µl/s, out {fluxes['outlet']:.5g} µl/s")
    expect(fluxes["outlet"] > 0 and abs(fluxes["inlet"] / fluxes["outlet"] + 1) < 0.01, "the fluxes differ")

    z = lumen.points[:, 2]
    for share in (0.25, 0.5, 0.75):
        at = z.min() + share * np.ptp(z)
        area, through = flow.flux_through(at)
        through *= scale
        print(f"z = {at:.3g} mm: lumen {area:.4g} mm², flux {through:.5g} µl/s, mean speed {through / area:.3g} mm/s")
        expect(abs(through / fluxes["outlet"] - 1) < 0.03, "the flux changes along the lumen")
    # Density of water, 1000 kg/m³; lengths and speeds are in mm.
    reynolds = 1e-3 * fluxes["outlet"] / area * 2 * np.sqrt(area / np.pi) / options.viscosity
    print(f"Reynolds number {reynolds:.2g}" + ("" if reynolds < 1 else ": inertia matters, the Stokes equations do not hold"))
    print(f"resistance: {options.pressure / fluxes['outlet']:.5g} Pa·s/µl for {np.ptp(z):.4g} mm")
    flow.write(os.path.join(options.out, "flow.vtu"), options.pressure, options.viscosity)
    draw(flow, os.path.join(options.out, "flow.png"), options.pressure, options.viscosity)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"{time.perf_counter() - start:.1f} s, peak {peak:.2f} GB")


if __name__ == "__main__":
    main()
