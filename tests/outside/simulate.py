"""Runs the scripts of examples/simulation on a small model; reads their output with meshio.

Usage: simulate.py OVIDUCT_BINARY
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time

import meshio
import numpy as np

from grown import Oviduct

HERE = os.path.dirname(os.path.abspath(__file__))
SCRIPTS = os.environ.get("SIMULATION_SCRIPTS", os.path.join(HERE, "..", "..", "examples", "simulation"))
# Few particles at large distances: a tube with folds whose triangles are not too thin.
SMALL = ["--set", "length_mm=3", "--set", "steps=200", "--set", "particles.edge_um=20",
         "--set", 'particles.total={"keys":[[0,250],[1,400]]}', "--set", 'particles.outer={"keys":[[0,60],[1,60]]}']


def script(name, *arguments, expect=0):
    """Runs a script; returns its output, or its error message if it is expected to fail."""
    start = time.monotonic()
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([sys.executable, os.path.join(SCRIPTS, name), *arguments], capture_output=True, text=True,
                          timeout=600, env=environment)
    if done.returncode != expect:
        sys.exit(f"{name} {' '.join(arguments)} ended with {done.returncode}, not {expect}:\n{done.stdout}{done.stderr}")
    print(f"{name}: {time.monotonic() - start:.1f} s", flush=True)
    return done.stdout if expect == 0 else done.stderr


def volume(points, cells):
    """Returns the volume of tetrahedra, mm³."""
    a, b, c, d = (points[cells[:, k]] for k in range(4))
    return np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)).sum() / 6


def expect_regions(mesh, region, patch, numbers, certified, tolerance):
    """Checks a mesh of both regions: volumes, and that they share exactly the wall's nodes."""
    cells, triangles = mesh.cells_dict["tetra"], mesh.cells_dict["triangle"]
    nodes = {}
    for name, expected in certified.items():
        own = cells[region == numbers[name]]
        filled = abs(volume(mesh.points, own))
        assert abs(filled / expected - 1) < tolerance, f"{name}: {filled} mm³ filled, {expected} mm³ certified"
        nodes[name] = np.unique(own)
    wall = np.unique(triangles[patch == numbers["inner_wall"]])
    assert np.array_equal(np.intersect1d(nodes["lumen"], nodes["tissue"]), wall), "the regions do not share the wall"


def inside(points, cells, places):
    """Returns for each place whether it lies in a tetrahedron."""
    corner = points[cells[:, 3]]
    turn = np.linalg.inv(np.stack([points[cells[:, k]] - corner for k in range(3)], axis=2))
    # If a place lies in the plane of a face, rounding may put it outside both tetrahedra.
    found = []
    for place in places:
        shares = np.einsum("nij,nj->ni", turn, place - corner)
        found.append(np.any((shares.min(axis=1) > -1e-9) & (shares.sum(axis=1) < 1 + 1e-9)))
    return np.array(found)


def main(folder):
    def out(name):
        return os.path.join(folder, name)

    model, other = out("model"), out("another")
    for seed, place in (("3", model), ("4", other)):
        Oviduct(sys.argv[1]).generate(place, "--seed", seed, "--bodies", "tissue,lumen,regions",
                                      "--outputs", "vtp,stl-ascii,glb,centreline", *SMALL)
    with open(os.path.join(model, "report.json")) as file:
        report = json.load(file)
    # The volumes in mm³, the unit of the files.
    certified = {surface["body"]: surface["certificate"]["volume_mm3"] for surface in report["surfaces"]
                 if surface["unit"] == "mm" and surface["body"] != "regions"}

    # TetGen: each body alone, and both together.
    script("tetrahedra.py", model, "--out", out("tetrahedra"))
    for name, expected in certified.items():
        mesh = meshio.read(out(f"tetrahedra/{name}.vtu"))
        filled = volume(mesh.points, mesh.cells_dict["tetra"])
        assert abs(filled / expected - 1) < 1e-9, f"{name}: {filled} mm³ filled, {expected} mm³ certified"
        assert set(np.unique(mesh.cell_data_dict["patch"]["triangle"])) == set(range(4 if name == "tissue" else 3))
    mesh = meshio.read(out("tetrahedra/regions.vtu"))
    numbers = {name: int(value[0]) for name, value in mesh.field_data.items()}
    arrays = mesh.cell_data_dict
    expect_regions(mesh, arrays["region"]["tetra"], arrays["patch"]["triangle"], numbers, certified, 1e-9)

    # Gmsh.
    said = script("gmsh_mesh.py", model, "--out", out("gmsh"))
    assert "used by both regions" in said, said
    mesh = meshio.read(out("gmsh/regions.msh"))
    numbers = {name: int(value[0]) for name, value in mesh.field_data.items()}
    kinds = mesh.cell_data_dict["gmsh:physical"]
    expect_regions(mesh, kinds["tetra"], kinds["triangle"], numbers, certified, 1e-6)

    # Stokes flow.
    script("flow.py", "--self-test", "--out", out("flow"))
    said = script("flow.py", model, "--out", out("flow"))
    entering, leaving = (float(number) for number in re.search(r"flux: in (\S+) µl/s, out (\S+) µl/s", said).groups())
    assert leaving > 0 and abs(entering / leaving - 1) < 0.01, said
    assert os.path.getsize(out("flow/flow.png")) > 10_000 and os.path.getsize(out("flow/flow.vtu")) > 10_000

    # Walkers: equal results for equal seeds, and all walkers inside the tetrahedra of the lumen.
    few = ["--walkers", "200", "--steps", "100"]
    tables = {}
    for name, seed in (("one", "1"), ("again", "1"), ("other", "2")):
        script("walk.py", model, "--out", out(name), "--seed", seed, *few)
        with open(out(f"{name}/walk.csv")) as file:
            tables[name] = file.read()
    assert tables["one"] == tables["again"] != tables["other"], "the walk does not depend on its seed alone"
    said = script("walk.py", model, "--out", out("walk"), "--drift", "0.02")
    assert "none left the lumen" in said, said
    mesh = meshio.read(out("tetrahedra/lumen.vtu"))
    ends = np.loadtxt(out("walk/walk.csv"), delimiter=",", skiprows=1)[:, 3:6]
    found = inside(mesh.points, mesh.cells_dict["tetra"], ends)
    assert len(found) == 1000 and found.all(), f"{(~found).sum()} of {len(found)} walkers are outside"
    assert not inside(mesh.points, mesh.cells_dict["tetra"], [mesh.points.max(axis=0)]).any()

    script("view.py", model, "--out", out("view"))
    assert os.path.getsize(out("view/view.png")) > 10_000

    # Missing files, and a lumen of another model.
    os.remove(os.path.join(model, "lumen.vtp"))
    assert "is missing" in script("flow.py", model, expect=1)
    shutil.copy(os.path.join(other, "lumen.vtp"), model)
    assert "the lumen's wall is not the inner wall" in script("tetrahedra.py", model, expect=1)
    print("simulate: all checks passed")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        main(folder)
