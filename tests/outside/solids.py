"""Random closed solids with flat faces of any number of corners, and their volumes."""

import math

import numpy as np


def signed_volume(points, faces):
    """Volume by the divergence theorem, with each face as a fan."""
    corners = np.array([points[[f[0], a, b]] for f in faces for a, b in zip(f[1:], f[2:])])
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6


class Solid:
    """Vertices, faces (lists of vertices, counter-clockwise from outside), and the enclosed volume.

    Coordinates are numbers of single precision, so that every format holds the same ones.
    """

    def __init__(self, kind, points, faces, volume):
        self.kind = kind
        self.points = np.asarray(points, dtype=np.float32).astype(float)
        self.faces = [list(face) for face in faces]
        self.volume = volume
        found = signed_volume(self.points, self.faces)
        assert abs(found / volume - 1) < 1e-6, (kind, found, volume)

    def triangles(self):
        """Triangles, if all faces are convex from their first corner, else None."""
        if any(len(face) > 4 for face in self.faces):
            return None
        return [[f[0], a, b] for f in self.faces for a, b in zip(f[1:], f[2:])]


def placed(kind, points, faces, volume, rng):
    """The solid turned and moved at random."""
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    if np.linalg.det(q) < 0:
        q[:, 0] = -q[:, 0]
    return Solid(kind, np.asarray(points, dtype=float) @ q.T + rng.uniform(-2, 2, 3), faces, volume)


def area(ring):
    return sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(ring, ring[1:] + ring[:1])) / 2


def prism(kind, ring, height, rng):
    """A prism over a simple, counter-clockwise polygon. Each lid is one face."""
    n = len(ring)
    points = [(x, y, z) for z in (0.0, height) for x, y in ring]
    start = int(rng.integers(n))
    lid = [(start + k) % n for k in range(n)]
    sides = [[k, (k + 1) % n, (k + 1) % n + n, k + n] for k in range(n)]
    faces = [lid[::-1], [n + k for k in lid], *sides]
    return placed(kind, points, faces, area(ring) * height, rng)


def star(rng):
    n = int(rng.integers(5, 40))
    radii = rng.uniform(0.4, 2.0, n)
    return [(r * math.cos(math.tau * k / n), r * math.sin(math.tau * k / n)) for k, r in enumerate(radii)]


def comb(rng):
    """Teeth of different lengths, with corners on straight edges."""
    teeth = int(rng.integers(2, 9))
    ring = [(0.0, -1.0), (teeth / 2, -1.0), (float(teeth), -1.0)]
    for k in reversed(range(teeth)):
        high = rng.uniform(0.3, 3.0)
        ring += [(k + 0.9, 0.0), (k + 0.6, high), (k + 0.4, high), (k + 0.1, 0.0)]
    return ring


def box(rng):
    x, y, z = rng.uniform(0.5, 3, 3)
    return prism("box", [(0.0, 0.0), (x, 0.0), (x, y), (0.0, y)], z, rng)


def frame(rng):
    """A box with a hole through it. A bridge joins the hole of each lid to its outline."""
    outer, inner, z = rng.uniform(2, 3), rng.uniform(0.5, 1.5), rng.uniform(0.5, 2)
    low, high = (outer - inner) / 2, (outer + inner) / 2
    ring = [(0, 0), (outer, 0), (outer, outer), (0, outer), (low, low), (high, low), (high, high), (low, high)]
    points = [(x, y, h) for h in (0.0, z) for x, y in ring]
    lid = [0, 1, 2, 3, 0, 4, 7, 6, 5, 4]
    sides = [[k, (k + 1) % 4, (k + 1) % 4 + 8, k + 8] for k in range(4)]
    holes = [[4 + (k + 1) % 4, 4 + k, 12 + k, 12 + (k + 1) % 4] for k in range(4)]
    faces = [lid[::-1], [8 + k for k in lid], *sides, *holes]
    return placed("frame", points, faces, (outer**2 - inner**2) * z, rng)


def torus(rng):
    around, across = (int(n) for n in rng.integers(5, 25, 2))
    ring, tube = rng.uniform(1.5, 2.5), rng.uniform(0.3, 1.2)
    points, faces = [], []
    for i in range(around):
        for j in range(across):
            u, v = math.tau * i / around, math.tau * j / across
            r = ring + tube * math.cos(v)
            points.append((r * math.cos(u), r * math.sin(u), tube * math.sin(v)))
    for i in range(around):
        for j in range(across):
            a, b, c, d = (
                ((i + di) % around) * across + (j + dj) % across for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1))
            )
            faces.append([a, b, c, d])
    # A wedge between two sections has the area of a section times the mean height. The section is
    # a regular polygon, and the height is proportional to the distance from the axis.
    section = across / 2 * math.sin(math.tau / across) * tube**2
    volume = section * ring * around * math.sin(math.tau / around)
    return placed("torus", points, faces, volume, rng)


def sphere(rng):
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=int(rng.integers(1, 4)), radius=rng.uniform(0.5, 2))
    return placed("sphere", ball.vertices, ball.faces.tolist(), float(ball.volume), rng)


def together(rng):
    """Two solids apart from each other."""
    first, second = any_solid(rng, parts=False), any_solid(rng, parts=False)
    points = np.vstack([first.points, second.points + [32.0, 0.0, 0.0]])
    faces = first.faces + [[v + len(first.points) for v in face] for face in second.faces]
    return Solid("together", points, faces, first.volume + second.volume)


def any_solid(rng, parts=True):
    kinds = [
        box,
        lambda r: prism("star", star(r), r.uniform(1, 3), r),
        lambda r: prism("comb", comb(r), r.uniform(1, 3), r),
        frame,
        torus,
        sphere,
        *([together] if parts else []),
    ]
    return kinds[int(rng.integers(len(kinds)))](rng)
