"""Compares files of one surface in several formats, as other programs read them.

Usage: formats.py FOLDER

FOLDER contains model.* in every format, and likewise lumen.* and regions.*; other .vtp files
contain a line.

Other programs read each file. The result must have the vertices of the OBJ file, its triangles with
the same order of triangles and corners, and the patch of each triangle. Coordinates in the unit of
the OBJ file must be equal. In other units they may differ by the rounding of a 32-bit float.
"""

import os
import re
import sys
import warnings
import zipfile
from dataclasses import dataclass, field
from xml.etree import ElementTree

import gmsh
import meshio
import numpy as np
import trimesh
import vtk
from vtk.util.numpy_support import vtk_to_numpy

METRES = {"m": 1.0, "metres": 1.0, "meter": 1.0, "mm": 1e-3, "millimeter": 1e-3, "um": 1e-6, "micron": 1e-6}
# Maximum relative difference of coordinates in different units: two roundings of a 32-bit float.
ROUNDING = 2.0**-22


@dataclass
class Surface:
    """A surface as a program reads it."""

    # Coordinates of the corners of each triangle.
    corners: np.ndarray
    # Name of the patch of each triangle; None if the program does not read patches.
    patches: list | None = None
    # All vertices, if the program keeps the vertices of the file.
    vertices: np.ndarray | None = None
    # Sentences about other faults.
    faults: list = field(default_factory=list)


def indexed(vertices, triangles, patches=None):
    vertices = np.asarray(vertices, dtype=np.float64)
    return Surface(vertices[np.asarray(triangles, dtype=np.int64)], patches, vertices)


def joined(parts):
    """Joins parts (name, vertices, triangles) to one surface; each part is a patch."""
    surfaces = [indexed(vertices, triangles) for _, vertices, triangles in parts]
    patches = [name for (name, _, triangles) in parts for _ in range(len(triangles))]
    return Surface(np.concatenate([s.corners for s in surfaces]), patches, np.concatenate([s.vertices for s in surfaces]))


def yardstick(path):
    """Returns the surface of an OBJ file, the names of its patches in order, and its unit."""
    vertices, triangles, patches, names, unit = [], [], [], [], None
    with open(path, encoding="utf-8") as file:
        for line in file:
            match line.split():
                case ["v", *numbers]:
                    vertices.append([float(np.float32(x)) for x in numbers[:3]])
                case ["f", *corners]:
                    triangles.append([int(c.split("/")[0]) - 1 for c in corners])
                    patches.append(names[-1])
                case ["g", *words]:
                    names.append(" ".join(words))
                case ["#", *_] if found := re.search(r"units: (\w+)", line):
                    unit = METRES[found[1]]
    return indexed(vertices, triangles, patches), names, unit


def output(reader, path):
    reader.SetFileName(path)
    reader.Update()
    return reader.GetOutput()


def polygons(data):
    """Returns points and triangles of a VTK PolyData object."""
    triangles = vtk_to_numpy(data.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    return vtk_to_numpy(data.GetPoints().GetData()), triangles


def glb_trimesh(path, _):
    return joined([(name, part.vertices, part.faces) for name, part in trimesh.load(path, process=False).geometry.items()])


def glb_vtk(path, _):
    blocks = output(vtk.vtkGLTFReader(), path).NewIterator()
    blocks.InitTraversal()
    parts = []
    while not blocks.IsDoneWithTraversal():
        parts.append((None, *polygons(blocks.GetCurrentDataObject())))
        blocks.GoToNextItem()
    surface = joined(parts)
    surface.patches = None
    return surface


def obj_meshio(path, names):
    mesh = meshio.read(path)
    patches = [names[i] for ids in mesh.cell_data["obj:group_ids"] for i in np.ravel(ids)]
    return indexed(mesh.points.astype(np.float32), np.concatenate([block.data for block in mesh.cells]), patches)


def obj_vtk(path, names):
    data = output(vtk.vtkOBJReader(), path)
    points, triangles = polygons(data)
    ids = vtk_to_numpy(data.GetCellData().GetArray("GroupIds")).astype(int)
    return indexed(points.astype(np.float32), triangles, [names[i] for i in ids])


def stl_trimesh(path, names):
    mesh = trimesh.load(path, process=False)
    surface = indexed(mesh.vertices, mesh.faces, [names[a - 1] for a in mesh.face_attributes["stl"].ravel()])
    surface.faults = normals(mesh.face_normals, surface.corners)
    return surface


def stl_meshio(path, _):
    mesh = meshio.read(path)
    return indexed(mesh.points.astype(np.float32), mesh.cells[0].data)


def stl_vtk(path, _):
    reader = vtk.vtkSTLReader()
    reader.MergingOff()
    return indexed(*polygons(output(reader, path)))


def by_gmsh(path, _):
    """Reads text STL with Gmsh, which turns each solid into a surface with its name."""
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        # With a tolerance, Gmsh would merge neighbouring vertices.
        gmsh.option.setNumber("Geometry.Tolerance", 0)
        gmsh.merge(path)
        tags, points, _ = gmsh.model.mesh.getNodes()
        at = np.zeros(int(tags.max()) + 1, dtype=np.int64)
        at[tags.astype(np.int64)] = np.arange(len(tags))
        parts = []
        for entity in gmsh.model.getEntities(2):
            _, _, [nodes] = gmsh.model.mesh.getElements(*entity)
            triangles = at[nodes.astype(np.int64)].reshape(-1, 3)
            parts.append((gmsh.model.getEntityName(*entity), points.reshape(-1, 3).astype(np.float32), triangles))
    finally:
        gmsh.finalize()
    surface = joined(parts)
    if not path.endswith(".ascii.stl"):
        surface.patches = None
    return surface


def ascii_trimesh(path, _):
    loaded = trimesh.load(path, process=False)
    # trimesh returns one solid as a mesh, several solids as a scene.
    meshes = loaded.geometry if isinstance(loaded, trimesh.Scene) else {loaded.metadata["name"]: loaded}
    surface = joined([(name, part.vertices.astype(np.float32), part.faces) for name, part in meshes.items()])
    surface.faults = normals(np.concatenate([part.face_normals for part in meshes.values()]), surface.corners)
    return surface


def ascii_vtk(path, _):
    reader = vtk.vtkSTLReader()
    reader.MergingOff()
    reader.ScalarTagsOn()
    data = output(reader, path)
    solids = reader.GetHeader().split("\n")
    ids = vtk_to_numpy(data.GetCellData().GetArray("STLSolidLabeling")).astype(int)
    return indexed(*polygons(data), [solids[i] for i in ids])


def ply_trimesh(path, _):
    """Reads a PLY file with trimesh, and the names of the patches from the comments itself."""
    mesh = trimesh.load(path, process=False)
    with open(path, "rb") as file:
        header = file.read(1 << 20).split(b"end_header\n")[0].decode()
    patches, at = [], 0
    for first, count, name in re.findall(r"^comment patch (\d+) (\d+) (.*)$", header, re.MULTILINE):
        assert int(first) == at, f"{path}: the patch {name} begins at {first}, not at {at}"
        at += int(count)
        patches += int(count) * [name]
    return indexed(mesh.vertices, mesh.faces, patches)


def ply_meshio(path, _):
    mesh = meshio.read(path)
    return indexed(mesh.points, mesh.cells_dict["triangle"])


def ply_vtk(path, _):
    return indexed(*polygons(output(vtk.vtkPLYReader(), path)))


def strings(data, name):
    array = data.GetFieldData().GetAbstractArray(name)
    if not isinstance(array, vtk.vtkStringArray):
        raise AssertionError(f"the field data {name} are {array and array.GetClassName()}")
    return [array.GetValue(i) for i in range(array.GetNumberOfValues())]


def vtp_vtk(path, _):
    data = output(vtk.vtkXMLPolyDataReader(), path)
    names = strings(data, "patch_names")
    surface = indexed(*polygons(data), [names[i] for i in vtk_to_numpy(data.GetCellData().GetArray("patch"))])
    surface.faults = unit_length(vtk_to_numpy(data.GetPointData().GetNormals()))
    for name in ("name", "generator", "citation"):
        if len(strings(data, name)) != 1:
            surface.faults.append(f"the field data {name} are {strings(data, name)}")
    # The faces of SimVascular.
    patches, faces = (vtk_to_numpy(data.GetCellData().GetArray(name)) for name in ("patch", "ModelFaceID"))
    if strings(data, "ModelFaceName") != names or not np.array_equal(faces, patches + 1):
        surface.faults.append("ModelFaceID and ModelFaceName are not those of the patches")
    return surface


def threemf_model(path):
    """Returns the XML of a 3MF file, without its namespace."""
    with zipfile.ZipFile(path) as package:
        assert package.testzip() is None, f"{path}: a part is damaged"
        text = package.read("3D/3dmodel.model")
    namespace = b' xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"'
    return ElementTree.fromstring(text.replace(namespace, b""))


def threemf_trimesh(path, _):
    """Reads a 3MF file with trimesh, and the patches from the materials itself.

    `regions` has two closed objects: the second one, the lumen, begins with the reversed inner wall.
    """
    scene = trimesh.load(path, process=False)
    model = threemf_model(path)
    names = [base.get("name") for base in model.find("resources/basematerials")]
    parts, faults = [], []
    for stored in model.iter("object"):
        part = scene.geometry[stored.get("name")]
        patches = [names[int(t.get("p1"))] for t in stored.iter("triangle")]
        parts.append(indexed(part.vertices, part.faces, patches))
        if not part.is_watertight or not part.is_winding_consistent or part.volume <= 0:
            faults.append(f"trimesh finds that {stored.get('name')} is not a closed object")
    if len(parts) == 2:
        tissue, lumen = parts
        wall = np.array([patch == "inner_wall" for patch in lumen.patches])
        own = lumen.corners[wall][:, [0, 2, 1]]
        if not np.array_equal(own, tissue.corners[[patch == "inner_wall" for patch in tissue.patches]]):
            faults.append("the wall of the lumen is not the inner wall of the tissue")
        lids = [patch for patch, is_wall in zip(lumen.patches, wall) if not is_wall]
        parts = [tissue, Surface(lumen.corners[~wall], lids, lumen.vertices)]
    return Surface(np.concatenate([part.corners for part in parts]), sum((part.patches for part in parts), []),
                   np.concatenate([part.vertices for part in parts]), faults)


READERS = {
    "glb": [("trimesh", glb_trimesh), ("vtk", glb_vtk)],
    "gltf": [("trimesh", glb_trimesh), ("vtk", glb_vtk)],
    "obj": [("meshio", obj_meshio), ("vtk", obj_vtk)],
    "stl": [("trimesh", stl_trimesh), ("meshio", stl_meshio), ("vtk", stl_vtk), ("gmsh", by_gmsh)],
    "ascii.stl": [("trimesh", ascii_trimesh), ("meshio", stl_meshio), ("vtk", ascii_vtk), ("gmsh", by_gmsh)],
    "ply": [("trimesh", ply_trimesh), ("meshio", ply_meshio), ("vtk", ply_vtk), ("gmsh", by_gmsh)],
    "vtp": [("vtk", vtp_vtk)],
    "3mf": [("trimesh", threemf_trimesh)],
}


def unit_length(vectors):
    error = np.abs(np.linalg.norm(vectors.astype(np.float64), axis=1) - 1).max(initial=0)
    return [f"a normal has not the length 1 but differs by {error}"] if error > 1e-6 else []


def normals(stated, corners):
    """Compares the stated normals with those of the corners; zero means a triangle without area."""
    a, b, c = corners.transpose(1, 0, 2)
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    own = np.divide(cross, length, out=np.zeros_like(cross), where=length > 0)
    error = np.abs(own - stated).max(initial=0)
    return [f"a normal is off by {error}"] if error > 1e-5 else []


def unit_of(stem, extension):
    """Returns the metres per unit that a file states; text STL uses the unit of the binary file."""
    path = f"{stem}.{extension}"
    match extension:
        case "glb" | "gltf":
            return 1.0
        case "ascii.stl":
            return unit_of(stem, "stl") if os.path.exists(f"{stem}.stl") else 1.0
        case "3mf":
            return METRES[threemf_model(path).get("unit")]
        case "vtp":
            return METRES[strings(output(vtk.vtkXMLPolyDataReader(), path), "units")[0]]
        case _:
            with open(path, "rb") as file:
                head = file.read(80 if extension == "stl" else 1 << 20)
            if extension == "stl" and head.startswith(b"solid"):
                raise AssertionError(f"{path} begins as if it were text")
            return METRES[re.search(rb"units[:=] ?(\w+)", head)[1].decode()]


def distinct(points):
    return np.unique(np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3) + 0.0, axis=0)


def compare(found, expected, factor):
    """Returns a sentence for each difference.

    `factor` converts the unit of the expected surface to the unit of the found one.
    """
    faults = list(found.faults)
    if found.corners.shape != expected.corners.shape:
        return [*faults, f"{len(found.corners)} triangles, not {len(expected.corners)}"]
    scaled = np.float64(np.float32(expected.corners * factor))
    same = found.corners == scaled
    if factor != 1.0:
        same |= np.abs(found.corners - scaled) <= ROUNDING * np.abs(scaled)
    if not same.all():
        wrong = np.flatnonzero(~same.all(axis=(1, 2)))
        first = wrong[0]
        faults.append(f"{len(wrong)} triangles differ, the first is {first}: {found.corners[first].tolist()}, "
                      f"not {scaled[first].tolist()}")
    # Formats without a list of vertices contain only the vertices that triangles use.
    own = distinct(found.corners if found.vertices is None else found.vertices)
    wanted = [distinct(np.float32(points * factor)) for points in (expected.vertices, expected.corners)]
    # Rounding could merge two vertices, but this is very unlikely.
    if not any(np.array_equal(own, points) if factor == 1.0 else len(own) == len(points) for points in wanted):
        faults.append(f"its {len(own)} vertices are not the {len(wanted[0])} expected")
    if found.patches is not None and found.patches != expected.patches:
        wrong = [i for i, pair in enumerate(zip(found.patches, expected.patches)) if pair[0] != pair[1]]
        first = wrong[0]
        faults.append(f"triangle {first} is in {found.patches[first]!r}, not in {expected.patches[first]!r}; {len(wrong)} are wrong")
    return faults


def judge(stem):
    """Returns a sentence for each fault of a surface's files."""
    expected, names, unit = yardstick(f"{stem}.obj")
    faults = []
    for extension, readers in READERS.items():
        path = f"{stem}.{extension}"
        if not os.path.exists(path):
            faults.append(f"{path} is missing")
            continue
        for program, read in readers:
            metres = unit_of(stem, extension)
            found = read(path, names)
            new = compare(found, expected, 1.0 if metres == unit else unit / metres)
            patches = "patches" if found.patches is not None else "no patches"
            print(f"{program}: {path}: {len(found.corners)} triangles, unit {metres} m, {patches}: "
                  f"{'same' if not new else 'NOT THE SAME'}", flush=True)
            faults += [f"{program}: {path}: {fault}" for fault in new]
    text = f"{stem}.ascii.stl"
    return faults + solids(text, expected.patches) if os.path.exists(text) else faults


# Lines of text STL that the lexer of OpenFOAM accepts (STLsurfaceFormatASCII.L of OpenFOAM-dev).
NUMBERS = r"( [-+]?(\d*\.\d+|\d+\.?)([eE][-+]?\d+)?){3}"
LINES = re.compile(rf"facet normal{NUMBERS}|outer loop|vertex{NUMBERS}|endloop|endfacet|(end)?solid .+")


def solids(path, patches):
    """Returns a sentence for each line that OpenFOAM may refuse, and for wrong solid names."""
    with open(path, encoding="utf-8") as file:
        lines = file.read().splitlines()
    faults = [f"{path}: the line {line!r}" for line in lines if not LINES.fullmatch(line)]
    names = [line for line in lines if line.startswith("solid")]
    if names != [f"solid {name}" for name in dict.fromkeys(patches)]:
        faults.append(f"{path}: its solids are {names}")
    return faults


def line(path):
    """Returns a sentence for each fault of a file that contains a line."""
    data = output(vtk.vtkXMLPolyDataReader(), path)
    points = data.GetNumberOfPoints()
    order = vtk_to_numpy(data.GetLines().GetConnectivityArray())
    arrays = [data.GetPointData().GetArray(i) for i in range(data.GetPointData().GetNumberOfArrays())]
    print(f"vtk: {path}: a line of {points} points with {[array.GetName() for array in arrays]}", flush=True)
    faults = []
    if data.GetNumberOfCells() != 1 or not np.array_equal(order, np.arange(points)) or points < 2:
        faults.append(f"{path}: not one line through all points in order")
    if data.GetPoints().GetDataType() != vtk.VTK_DOUBLE or any(array.GetDataType() != vtk.VTK_DOUBLE for array in arrays):
        faults.append(f"{path}: the numbers are not all of 64 bits")
    if any(array.GetNumberOfTuples() != points or array.GetNumberOfComponents() != 1 for array in arrays):
        faults.append(f"{path}: an array has not one value for each point")
    if strings(data, "units")[0] not in METRES:
        faults.append(f"{path}: its unit is {strings(data, 'units')}")
    return faults


def main(folder):
    # meshio first takes text STL for binary STL and warns about the implausible number of
    # triangles.
    warnings.filterwarnings("ignore", category=RuntimeWarning, module="meshio")
    vtk.vtkObject.GlobalWarningDisplayOff()
    stems = [os.path.join(folder, stem) for stem in ("model", "lumen", "regions")]
    stems = [stem for stem in stems if os.path.exists(f"{stem}.obj")]
    lines = sorted(name for name in os.listdir(folder) if name.endswith(".vtp"))
    lines = [os.path.join(folder, name) for name in lines if os.path.join(folder, name[:-4]) not in stems]
    if not stems:
        sys.exit(f"{folder} holds no OBJ file to compare with")
    faults = [fault for stem in stems for fault in judge(stem)] + [fault for path in lines for fault in line(path)]
    for fault in faults:
        print(fault, file=sys.stderr)
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main(*sys.argv[1:])
