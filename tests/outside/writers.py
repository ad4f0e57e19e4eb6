"""Writers of surface files with the traits of many programs. Each returns the bytes of a file."""

import base64
import json
import struct
import zlib

import numpy as np


def fans(faces):
    return [[f[0], a, b] for f in faces for a, b in zip(f[1:], f[2:])]


def number(x):
    return repr(float(x))


# STL


def stl_text(solid, trait):
    facets = solid.faces if trait == "polygons" else solid.triangles()
    normal = {"ind": "-1.#IND00 -1.#IND00 -1.#IND00", "nan": "nan(ind) -nan 1.#QNAN"}.get(trait, "0 0 0")
    lines = ["solid a part"]
    for facet in facets:
        lines += [f"facet normal {normal}", *(["color 1 0 0"] if trait == "color" else []), " outer loop"]
        lines += ["  vertex " + " ".join(number(x) for x in solid.points[v]) for v in facet]
        lines += ["end loop", "end facet"] if trait == "spaced" else [" endloop", "endfacet"]
    lines += ["end solid" if trait == "spaced" else "endsolid a part"]
    text = "\n".join(lines) + "\n"
    if trait == "upper":
        text = text.upper()
    text = {
        "cr": text.replace("\n", "\r"),
        "crlf": text.replace("\n", "\r\n"),
        "one-line": text.replace("\n", " "),
    }.get(trait, text)
    return (b"\xef\xbb\xbf" if trait == "bom" else b"") + text.encode() + (b"\0" * 7 if trait == "padded" else b"")


def stl_binary(solid, trait):
    triangles = solid.triangles()
    header = b"solid binary" if trait == "solid" else b"made by hand"
    data = header.ljust(80, b" " if trait == "solid" else b"\0") + struct.pack("<I", len(triangles))
    normal = float("nan") if trait == "nan" else 0.0
    for t in triangles:
        data += struct.pack("<12fH", *[normal] * 3, *solid.points[t].ravel(), 7)
    return data + (b"\0" * 84 if trait in ("trailing", "solid-trailing") else b"")


# OBJ


def obj(solid, trait):
    vertices = ["v " + " ".join(number(x) for x in p) for p in solid.points]
    if trait == "colours":
        vertices = [f"{v} 0.1 0.2 0.3" for v in vertices]
    if trait == "w":
        vertices = [f"{v} 1.0" for v in vertices]
    n = len(vertices)
    corner = {"negative": lambda v: str(v - n), "mixed": lambda v: f"{v + 1}/1/1", "normals": lambda v: f"{v + 1}//1"}
    corner = corner.get(trait, lambda v: str(v + 1))
    faces = []
    for k, f in enumerate(solid.faces):
        words = [corner(v) for v in f]
        if trait == "continued":
            words.insert(len(words) // 2, "\\ \n")
        if trait == "materials":
            faces.append(f"usemtl part{k % 3}")
        faces.append("f " + " ".join(words))
    lines = ["# from C:\\models\\", "mtllib C:\\models\\", "o a part", "vt 0 0", "vn 0 0 1"]
    lines += {"faces-first": faces + vertices, "nan": vertices + ["v nan nan nan"] + faces}.get(trait, vertices + faces)
    lines += ["l 1 2", "p 1", "f", "f 1 2"] if trait == "elements" else []
    text = "\n".join(lines) + "\n"
    text = {"cr": text.replace("\n", "\r"), "crlf": text.replace("\n", "\r\n")}.get(trait, text)
    return (b"\xef\xbb\xbf" if trait == "bom" else b"") + text.encode()


# PLY


def ply(solid, encoding, trait):
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(encoding)
    wide = trait == "extras"
    index = {"bytes": ("uchar", "B"), "floats": ("float", "f"), "shorts": ("ushort", "H")}.get(trait, ("int", "i"))
    if index[1] == "B" and len(solid.points) > 255:
        index = ("int", "i")

    def row(kinds, values):
        if order is None:
            words = (number(v) if kind in "fd" else str(int(v)) for kind, v in zip(kinds, values))
            return (" ".join(words) + "\n").encode()
        return struct.pack(order + kinds, *(v if kind in "fd" else int(v) for kind, v in zip(kinds, values)))

    strips = trait == "strips"
    vertex = b"".join(row("Bddd" if wide else "fff", [*([9] if wide else []), *p]) for p in solid.points)
    kind = "double" if wide else "float"
    of_vertex = [
        f"element vertex {len(solid.points)}",
        *(["property uchar flags"] if wide else []),
        f"property {kind} x",
        f"property {kind} y",
        f"property {kind} z",
    ]
    if strips:
        list_ = [v for t in solid.triangles() for v in [*t, -1]]
        face = row("i" + "i" * len(list_), [len(list_), *list_])
        of_face = ["element tristrips 1", "property list int int vertex_indices"]
    else:
        face = b"".join(
            row(("Bff" if wide else "") + "B" + index[1] * len(f), [*([2, 0.5, 0.5] if wide else []), len(f), *f])
            for f in solid.faces
        )
        of_face = [
            f"element face {len(solid.faces)}",
            *(["property list uchar float texcoord"] if wide else []),
            f"property list uchar {index[0]} {'vertex_index' if trait == 'faces-first' else 'vertex_indices'}",
        ]
    parts = [(of_vertex, vertex), (of_face, face)]
    if wide:
        parts.insert(1, (["element edge 1", "property int vertex1", "property int vertex2"], row("ii", [0, 1])))
    if trait == "faces-first":
        parts.reverse()
    head = [
        "ply",
        f"format {encoding} 1.0",
        "obj_info scanned",
        "comment by hand",
        *(line for part, _ in parts for line in part),
        "comment last",
        "end_header",
    ]
    end = {"crlf": "\r\n", "cr": "\r"}.get(trait, "\n")
    body = b"".join(data for _, data in parts)
    if order is None:
        body = body.replace(b"\n", end.encode())
    return (end.join(head) + end).encode() + body


# VTP


def vtp(solid, form, trait):
    """`form` is ascii, binary (base64 in place), raw or encoded (appended), each with or without `zlib`."""
    place, _, compressed = form.partition("-")
    appended = b""

    def array(kind, name, values, components=1):
        nonlocal appended
        start = f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}"'
        values = np.asarray(values, dtype={"Float32": "<f4", "Float64": "<f8", "Int32": "<i4", "Int64": "<i8"}[kind])
        if place == "ascii":
            words = " ".join(number(v) if kind.startswith("Float") else str(v) for v in values.ravel())
            return f'{start} format="ascii">{words}</DataArray>'
        data = values.tobytes()
        if compressed:
            packed = zlib.compress(data)
            head, data = struct.pack("<4I", 1, len(data), 0, len(packed)), packed
        else:
            head = struct.pack("<I", len(data))
        text = base64.b64encode(head) + base64.b64encode(data) if compressed else base64.b64encode(head + data)
        if place == "binary":
            return f'{start} format="binary">{text.decode()}</DataArray>'
        offset = len(appended)
        appended += head + data if place == "raw" else text
        return f'{start} format="appended" offset="{offset}"/>'

    def cells(tag, faces):
        corners = [v for f in faces for v in f]
        ends = np.cumsum([len(f) for f in faces])
        return f"<{tag}>{array('Int64', 'connectivity', corners)}{array('Int64', 'offsets', ends)}</{tag}>"

    faces = solid.triangles() if trait == "strips" else solid.faces
    tag, lines = ("Strips" if trait == "strips" else "Polys"), ([[0, 1]] if trait == "lines" else [])
    count = len(faces) + len(lines)
    data = {
        "faces": lambda: array("Int32", "ModelFaceID", np.arange(count) // 3 + 1),
        "patch": lambda: array("Float32", "patch", np.full(count, 0.5)),
    }
    piece = f'<Piece NumberOfPoints="{len(solid.points)}" NumberOfLines="{len(lines)}" NumberOf{tag}="{len(faces)}">'
    piece += f"<CellData>{data[trait]()}</CellData>" if trait in data else ""
    piece += f"<Points>{array('Float32', 'Points', solid.points, 3)}</Points>"
    piece += (cells("Lines", lines) if lines else "") + cells(tag, faces) + "</Piece>"
    zlib_ = ' compressor="vtkZLibDataCompressor"' if compressed else ""
    text = f'<?xml version="1.0"?>\n<VTKFile type="PolyData" version="0.1"'
    text += f' byte_order="LittleEndian"{zlib_}><PolyData>{piece}</PolyData>'
    data = text.encode()
    if appended:
        encoding = "raw" if place == "raw" else "base64"
        data += f'<AppendedData encoding="{encoding}">_'.encode() + appended + b"</AppendedData>"
    return data + b"</VTKFile>"


# glTF


def glb(solid, trait):
    """Returns the file, and how often it shows the solid: with instances more than once."""
    points, triangles = solid.points, np.array(fans(solid.faces))
    views, accessors, data = [], [], b""

    def accessor(values, component, kind, normalized=False, bounds=False):
        nonlocal data
        data += b"\0" * (-len(data) % 4)
        raw = values.tobytes()
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(raw)})
        data += raw
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "type": kind, "count": len(values)})
        if normalized:
            accessors[-1]["normalized"] = True
        if bounds:
            flat = values[:, :3]
            accessors[-1] |= {"min": flat.min(axis=0).tolist(), "max": flat.max(axis=0).tolist()}
        return len(accessors) - 1

    node, extensions, copies = {"mesh": 0}, [], 1
    if trait == "quantized":
        low, size = points.min(axis=0), float(np.ptp(points, axis=0).max())
        grid = np.zeros((len(points), 4), dtype="<u2")
        grid[:, :3] = np.rint((points - low) / size * 65535)
        raw = accessor(grid, 5123, "VEC3", normalized=True, bounds=True)
        views[-1]["byteStride"] = 8
        node |= {"translation": low.tolist(), "scale": [size] * 3}
        extensions = ["KHR_mesh_quantization"]
        position = raw
    elif trait == "sparse":
        moved = points.astype("<f4").copy()
        moved[0] += 9
        position = accessor(moved, 5126, "VEC3", bounds=True)
        where, what = (
            accessor(np.array([0], dtype="<u2"), 5123, "SCALAR"),
            accessor(points[:1].astype("<f4"), 5126, "VEC3"),
        )
        accessors[position]["sparse"] = {
            "count": 1,
            "indices": {"bufferView": where, "componentType": 5123},
            "values": {"bufferView": what},
        }
        accessors[position] |= {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
    else:
        position = accessor(points.astype("<f4"), 5126, "VEC3", bounds=True)
    indices = accessor(triangles.astype("<u4").ravel(), 5125, "SCALAR")
    if trait == "instances":
        copies = 2
        shift = accessor(np.array([[0, 0, 0], [64, 0, 0]], dtype="<f4"), 5126, "VEC3")
        node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": shift}}}
        extensions = ["EXT_mesh_gpu_instancing"]
    if trait == "mirrored":
        node["scale"] = [-1, 1, 1]
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [{"attributes": {"POSITION": position}, "indices": indices}]}],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    if extensions:
        document |= {"extensionsUsed": extensions, "extensionsRequired": extensions}
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks, copies
