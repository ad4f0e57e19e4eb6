"""Reads the bodies of a model (.vtp) and writes meshes (.vtu); shared by the other scripts.

Lengths are in millimetres. A patch is a named part of a surface, such as the `wall`, `inlet` and
`outlet` of a lumen.
"""

import argparse
import os
import sys
from dataclasses import dataclass

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy


@dataclass
class Surface:
    """Triangles of a closed surface, each with the index of its patch in `names`."""

    points: np.ndarray
    triangles: np.ndarray
    patch: np.ndarray
    names: list

    def of(self, *names):
        """Returns the triangles of the named patches."""
        return self.triangles[np.isin(self.patch, [self.names.index(name) for name in names])]

    @property
    def volume(self):
        """Enclosed volume, mm³."""
        # Relative to the centroid: sums of large products of opposite sign would lose digits.
        a, b, c = (self.points[self.triangles[:, k]] - self.points.mean(axis=0) for k in range(3))
        return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


def read_polydata(path):
    """Reads a .vtp file; returns the VTK object and the strings of its field data."""
    if not os.path.exists(path):
        sys.exit(f"{path} is missing: grow the model with --bodies tissue,lumen,regions --outputs vtp,centreline")
    reader = vtk.vtkXMLPolyDataReader()
    reader.SetFileName(path)
    reader.Update()
    data = reader.GetOutput()
    fields = data.GetFieldData()
    arrays = [fields.GetAbstractArray(k) for k in range(fields.GetNumberOfArrays())]
    strings = {array.GetName(): [array.GetValue(k) for k in range(array.GetNumberOfValues())]
               for array in arrays if isinstance(array, vtk.vtkStringArray)}
    return data, strings


def read(folder, name):
    """Reads the surface of a body: `model` (tissue), `lumen` or `regions` (both)."""
    data, strings = read_polydata(os.path.join(folder, f"{name}.vtp"))
    if strings.get("units") != ["mm"]:
        sys.exit(f"{name}.vtp is in {strings.get('units')}, not in mm")
    triangles = vtk_to_numpy(data.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    return Surface(vtk_to_numpy(data.GetPoints().GetData()).astype(np.float64), triangles.astype(np.int32),
                   vtk_to_numpy(data.GetCellData().GetArray("patch")).astype(np.int32), strings["patch_names"])


def volumes(points, tetrahedra):
    """Returns the volume of each tetrahedron, mm³."""
    a, b, c, d = (points[tetrahedra[:, k]] for k in range(4))
    return np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6


def write_vtu(path, points, tetrahedra, triangles=None, points_data=None, cells_data=None, numbers=None):
    """Writes tetrahedra of 4 or 10 nodes, then triangles, with arrays by name.

    Arrays of `cells_data` have one row per tetrahedron, then one per triangle. `numbers` go into
    the field data, by name.
    """
    triangles = np.empty((0, 3), int) if triangles is None else triangles
    grid = vtk.vtkUnstructuredGrid()
    places = vtk.vtkPoints()
    places.SetData(numpy_to_vtk(np.ascontiguousarray(points, dtype=np.float64), deep=True))
    grid.SetPoints(places)
    nodes = tetrahedra.shape[1]
    sizes = np.repeat([nodes, 3], [len(tetrahedra), len(triangles)])
    kind = {4: vtk.VTK_TETRA, 10: vtk.VTK_QUADRATIC_TETRA}[nodes]
    kinds = np.repeat([kind, vtk.VTK_TRIANGLE], [len(tetrahedra), len(triangles)]).astype(np.uint8)
    ids = np.concatenate([tetrahedra.ravel(), triangles.ravel()]).astype(np.int64)
    cells = vtk.vtkCellArray()
    cells.SetData(numpy_to_vtk(np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64), deep=True), numpy_to_vtk(ids, deep=True))
    grid.SetCells(numpy_to_vtk(kinds, deep=True), cells)
    for target, arrays in ((grid.GetPointData(), points_data), (grid.GetCellData(), cells_data)):
        for name, values in (arrays or {}).items():
            array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
            array.SetName(name)
            target.AddArray(array)
    # One number per name, because some readers refuse strings in a .vtu file.
    for name, number in (numbers or {}).items():
        array = numpy_to_vtk(np.array([number], dtype=np.int32), deep=True)
        array.SetName(name)
        grid.GetFieldData().AddArray(array)
    writer = vtk.vtkXMLUnstructuredGridWriter()
    writer.SetFileName(path)
    writer.SetInputData(grid)
    writer.Write()


def arguments(doc, *options):
    """Parses `DIR [--out DIR]` and further options, each a pair (name, settings of argparse)."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("folder", metavar="DIR", nargs="?", default=".", help="folder of the model's files")
    parser.add_argument("--out", metavar="DIR", help="folder for the results (default: that of the model)")
    for name, settings in options:
        parser.add_argument(name, **settings)
    chosen = parser.parse_args()
    chosen.out = chosen.out or chosen.folder
    os.makedirs(chosen.out, exist_ok=True)
    return chosen


def expect(condition, reason):
    """Ends the program with status 1 and the reason if a check fails."""
    if not condition:
        sys.exit(f"failed: {reason}")
