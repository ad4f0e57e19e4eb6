//! Traits of files of other programs, each in a file of a sound surface.

use super::cases::{assert_closed, volume};
use super::*;
use std::ops::Range;

/// Corners of a cube with edges of 2.
fn corner(v: usize) -> [f64; 3] {
    [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]].map(|[x, y]| [x, y, if v < 4 { 0.0 } else { 2.0 }])[v % 4]
}

const QUADS: [[usize; 4]; 6] = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];

fn assert_cube(bytes: &[u8], format: Format) -> Surface {
    let surface =
        parse(bytes, format, None).unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(bytes)));
    assert_eq!((surface.triangles.len(), volume(&surface)), (12, 8.0));
    assert_closed(&surface);
    surface
}

fn groups(surface: &Surface) -> Vec<(&str, Range<usize>)> {
    surface.groups.iter().map(|group| (&*group.name, group.triangles.clone())).collect()
}

/// A cube in OBJ, without any names.
fn obj() -> String {
    obj_after(0)
}

/// The same, if that many vertices precede it.
fn obj_after(before: usize) -> String {
    let vertices = (0..8).map(corner).map(|[x, y, z]| format!("v {x} {y} {z}\n"));
    let faces = QUADS.iter().map(|f| format!("f {}\n", f.map(|v| (v + 1 + before).to_string()).join(" ")));
    vertices.chain(faces).collect()
}

#[test]
fn obj_lines_end_in_any_way() {
    let text = obj();
    let continued = text.replace("f 1 4 3 2", "f 1 \\\n4\\  \n 3 \\\t\n2");
    for text in
        [text.clone(), format!("\u{feff}{text}"), continued, format!("# c:\\\n{text}# end \\"), text.clone() + "\0\0\0"]
    {
        for end in ["\n", "\r\n", "\r"] {
            let surface = assert_cube(text.replace('\n', end).as_bytes(), Format::Obj);
            assert_eq!(surface.notes, [""; 0]);
        }
    }
    assert_eq!(refusal(b"v 0 0 0\r\nv 1 \\", Format::Obj), "line 2: the file ends in the middle of a line");
}

#[test]
fn obj_names_may_end_in_a_backslash() {
    for name in ["mtllib C:\\models\\\n", "usemtl a\\\n", "g wall\\\n", "o C:\\x\\\r\n"] {
        assert_cube(obj().replacen("f ", &format!("{name}f "), 1).as_bytes(), Format::Obj);
    }
}

#[test]
fn obj_faces_may_come_before_their_vertices() {
    let text = obj();
    let at = text.find("f ").unwrap();
    assert_cube(format!("{}{}", &text[at..], &text[..at]).as_bytes(), Format::Obj);
}

#[test]
fn obj_elements_that_are_no_faces_are_passed_over_with_a_note() {
    let text =
        obj() + "f\nf 1\nf 1 2\nf 1 1 2 2\nl 1 2\np 1\np 2\ncstype bezier\nsurf 0 1 0 1 1 2\nend\nvt 1 2\ns off\n";
    assert_eq!(
        assert_cube(text.as_bytes(), Format::Obj).notes,
        [
            "4 faces have fewer than three different corners and are passed over (first: line 15)",
            "points (2) are passed over",
            "lines (1) are passed over",
            "free-form curves and surfaces (1) are passed over",
        ]
    );
}

#[test]
fn long_lines_of_numbers_that_are_none_are_read_in_linear_time() {
    let line = format!("{}x {}\n", " ".repeat(100_000), "1.#".repeat(100_000));
    assert_cube((line + &obj()).as_bytes(), Format::Obj);
    // Solids without line ends.
    let solids = "solid a facet normal 0 0 0 outer loop vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 endloop endfacet \
                  endsolid a ";
    assert_eq!(parse(solids.repeat(40_000).as_bytes(), Format::Stl, None).unwrap().triangles.len(), 40_000);
}

#[test]
fn text_stl_of_other_programs_keeps_its_digits() {
    let solid = |name: &str| {
        format!(
            "solid {name}\nfacet normal 0 0 1\nouter loop\nvertex 500000.1 0 0\nvertex 1 0 0\nvertex 0 1 0\n\
                 endloop\nendfacet\nendsolid\n"
        )
    };
    let first = |name: &str| parse(solid(name).as_bytes(), Format::Stl, None).unwrap().positions[0][0];
    assert_eq!(first("part"), 500_000.1);
    // A model of oviduct has single precision.
    assert_eq!(first("inner_wall"), f64::from(500_000.1_f32));
    assert_eq!(
        parse(format!("# made by hand\n{}", solid("a")).as_bytes(), Format::Stl, None).unwrap().triangles.len(),
        1
    );
    let page = format!("<!DOCTYPE html> {}", "a page ".repeat(20));
    let refused = parse(page.as_bytes(), Format::Stl, None).unwrap_err().to_string();
    assert_eq!(refused, "line 1: this is not STL: the text begins with \"<!DOCTYPE\" instead of `solid`");
}

#[test]
fn inches_and_feet_are_units() {
    for (comment, metres) in [("File units = inches", 0.0254), ("units: ft", 0.3048), ("unit nm", 1e-9)] {
        let surface = parse(format!("# {comment}\n{}", obj()).as_bytes(), Format::Obj, None).unwrap();
        assert_eq!(surface.unit, Unit::Stated(metres), "{comment}");
    }
}

#[test]
fn obj_vertices_may_have_colours_or_weights() {
    for more in ["1", "0.1 0.2 0.3", "1 0.1 0.2 0.3 1"] {
        let text: String = obj()
            .lines()
            .map(|l| if l.starts_with('v') { format!("{l} {more}\n") } else { format!("{l}\n") })
            .collect();
        assert_cube(text.as_bytes(), Format::Obj);
    }
}

#[test]
fn obj_groups_come_first_then_objects_then_materials() {
    let named = |names: &[&str]| {
        let mut text = obj();
        for (k, name) in names.iter().enumerate().rev() {
            let at = text.match_indices("f ").nth(2 * k).unwrap().0;
            text.insert_str(at, name);
        }
        let surface = assert_cube(text.as_bytes(), Format::Obj);
        groups(&surface).iter().map(|(name, range)| format!("{name} {}", range.len())).collect::<Vec<_>>()
    };
    assert_eq!(named(&["g a\nusemtl m\n", "usemtl n\n", "g b\n"]), ["a 8", "b 4"]);
    assert_eq!(named(&["o a\nusemtl m\n", "usemtl n\n", "o b\n"]), ["a 8", "b 4"]);
    assert_eq!(named(&["o a\ng default\nusemtl m\n", "usemtl n\n"]), ["m 4", "n 8"]);
    assert_eq!(named(&["usemtl m\n", "usemtl n\n", "usemtl m\n"]), ["m 4", "n 4", "m 4"]);
    assert_eq!(named(&["o a\nusemtl m\n"]), ["a 12"]);
    assert_eq!(named(&["g default\n"]), ["default 12"]);
    assert_eq!(named(&["g part#1 # the first\n"]), ["part#1 12"]);
}

#[test]
fn obj_faces_that_cross_themselves_are_refused_with_their_line() {
    let text = obj().replace("f 1 4 3 2", "f 1 4 2 3");
    let refused = refusal(text.as_bytes(), Format::Obj);
    assert!(
        refused.starts_with("line 9: the face of 4 corners crosses or touches itself on the edge that begins at (")
    );
}

#[test]
fn unused_vertices_that_are_not_finite_are_left_out() {
    let text = "v nan 0 0\nv 9 9 9\nv -nan(ind) 1.#QNAN -1.#INF\n".to_owned() + &obj_after(3);
    let surface = assert_cube(text.as_bytes(), Format::Obj);
    assert_eq!(surface.positions.len(), 9);
    let note = "2 vertices have a coordinate that is not finite, belong to no triangle and are left out";
    assert_eq!(surface.notes, [note]);
    // A vertex that a triangle uses stays.
    let used = read(b"v nan 0 0\nv nan 1 0\nv 0 1 0\nv 1 0 0\nf 1 3 4\n", Format::Obj);
    assert_eq!((used.positions.len(), used.triangles[0]), (3, [0, 1, 2]));
    assert!(used.positions[0][0].is_nan());
}

/// A cube in text STL with the words of `case`.
fn stl(map: impl Fn(&str) -> String) -> String {
    let mut text = map("solid a cube\n");
    for [a, b, c, d] in QUADS {
        for t in [[a, b, c], [a, c, d]] {
            text += &map("facet normal 0 0 0\n outer loop\n");
            for [x, y, z] in t.map(corner) {
                text += &map(&format!("  vertex {x} {y} {z}\n"));
            }
            text += &map(" endloop\nendfacet\n");
        }
    }
    text + &map("endsolid a cube\n")
}

#[test]
fn stl_words_have_any_case_and_spacing() {
    let plain = stl(str::to_owned);
    for text in [
        plain.to_uppercase(),
        plain.replace("solid", "Solid").replace("endsolid", "EndSolid"),
        plain.replace("endsolid", "end solid").replace("endloop", "end loop").replace("endfacet", "end facet"),
        plain.replace("outer loop", "outerloop"),
        plain.replace(" outer", "color 1 0 0\n outer"),
        plain.replace("endfacet", "color 1 0 0\nendfacet"),
        plain.replacen("facet normal", "color 0.1 0.2 0.3\nfacet normal", 1),
        plain.replace("normal 0 0 0", "normal -1.#IND00 nan(ind) -nan"),
        plain.replace("normal 0 0 0", "normal 1.#QNAN inf -1.#INF"),
        plain.replace('\n', " \t "),
        plain.replace('\n', "\r\n"),
        plain.replace('\n', "\r"),
        format!("\u{feff}\n\n{plain}"),
        plain.clone() + "\0\0\0",
        plain.clone() + "\x1a",
    ] {
        let surface = assert_cube(text.as_bytes(), Format::Stl);
        assert_eq!(surface.notes, [""; 0]);
        assert!(surface.groups[0].name.eq_ignore_ascii_case("a cube"), "{:?}", surface.groups);
    }
    let surface = assert_cube((plain.clone() + "created by hand").as_bytes(), Format::Stl);
    assert_eq!(surface.notes, ["text after the last solid is passed over"]);
    // A name in another encoding.
    let mut bytes = plain.clone().into_bytes();
    bytes[6] = 0xfc;
    assert_eq!(&*assert_cube(&bytes, Format::Stl).groups[0].name, "\u{fffd} cube");
}

#[test]
fn stl_text_that_is_wrong_is_refused_by_what_is_wrong() {
    let plain = stl(str::to_owned);
    for (from, to, message) in [
        ("normal 0 0 0", "normal 0 0", "line 3: a component of the normal is missing"),
        (
            "vertex 0 0 0",
            "vertex 0 0 0,0",
            "line 4: \"0,0\" is not a number: it has a decimal comma; write a decimal point",
        ),
        ("vertex 0 0 0", "vertex 0 0 \u{1}", "line 4: a word that is not text in UTF-8 is not a number"),
        ("  vertex 0 0 0\n", "", "line 2: a facet has 2 vertices instead of three"),
        ("facet normal", "polygon normal", "line 2: \"polygon\" instead of a facet or the end of the solid"),
        ("endsolid a cube\n", "", "line 85: the end is missing: the file stops after facet 12, before `endsolid`"),
        ("endfacet\nendsolid a cube\n", "", "line 84: the end is missing: the file stops before \"endfacet\""),
    ] {
        assert!(plain.contains(from), "{from}");
        assert_eq!(refusal(plain.replacen(from, to, 1).as_bytes(), Format::Stl), message);
    }
    // A vertex may be what is not a number; the certificate names it.
    assert!(
        read(plain.replace("vertex 2 2 2", "vertex nan 2 2").as_bytes(), Format::Stl)
            .positions
            .iter()
            .any(|p| p[0].is_nan())
    );
    assert_eq!(read(b"solid Empty\nendsolid Empty", Format::Stl), Surface::default());
    assert_eq!(read(b" \n", Format::Stl), Surface::default());
}

#[test]
fn stl_facets_with_more_vertices_are_split() {
    let mut text = "solid\n".to_owned();
    for quad in QUADS {
        let vertices: String = quad.map(corner).iter().map(|[x, y, z]| format!("vertex {x} {y} {z}\n")).collect();
        text += &format!("facet normal 0 0 0\nouter loop\n{vertices}endloop\nendfacet\n");
    }
    let surface = assert_cube((text + "endsolid").as_bytes(), Format::Stl);
    assert_eq!(surface.notes, ["facets with more than three vertices are split into triangles"]);
}

#[test]
fn binary_stl_is_known_by_its_length_or_contents() {
    let header = |start: &str, fill: u8| {
        let mut bytes = start.as_bytes().to_vec();
        bytes.resize(80, fill);
        bytes
    };
    let body: Vec<u8> = (QUADS.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]))
        .flat_map(|t| {
            let mut record = vec![0xff; 12];
            record.extend(t.map(corner).as_flattened().iter().flat_map(|&x| (x as f32).to_le_bytes()));
            record.extend([7, 0]);
            record
        })
        .collect();
    let file = |start: &str, fill: u8, stated: u32, rest: &[u8]| {
        [&header(start, fill)[..], &stated.to_le_bytes(), &body, rest].concat()
    };
    for (start, fill) in [("made by hand", 0), ("solid a cube", 0), ("SOLID facet normal", b' '), ("\u{feff}", 0)] {
        assert_eq!(assert_cube(&file(start, fill, 12, b""), Format::Stl).notes, [""; 0]);
        let surface = assert_cube(&file(start, fill, 12, &[0; 84]), Format::Stl);
        assert_eq!(surface.notes, ["84 bytes after the last of 12 triangles are passed over"]);
        let refused = refusal(&file(start, fill, 13, b""), Format::Stl);
        assert!(refused.ends_with("it states 13 triangles and has the bytes of 12"), "{refused}");
        let refused = refusal(&file(start, fill, 0, b""), Format::Stl);
        assert!(refused.contains("its number of triangles was never written"), "{refused}");
        assert!(refused.ends_with("it states 0 triangles and has the bytes of 12"), "{refused}");
    }
    assert_eq!(read(&[&header("x", 0)[..], &[0; 4]].concat(), Format::Stl), Surface::default());
}

/// A cube in PLY.
fn ply(format: &str, end: &str, faces_first: bool) -> Vec<u8> {
    let big = format == "binary_big_endian";
    let number = |bytes: &[u8]| if big { bytes.iter().rev().copied().collect::<Vec<_>>() } else { bytes.to_vec() };
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    for p in (0..8).map(corner) {
        if format == "ascii" {
            vertices.extend(format!("{} {} {}{end}", p[0], p[1], p[2]).bytes());
        }
        p.iter().filter(|_| format != "ascii").for_each(|x| vertices.extend(number(&x.to_le_bytes())));
    }
    for f in QUADS {
        if format == "ascii" {
            faces.extend(format!("4 {}{end}", f.map(|v| v.to_string()).join(" ")).bytes());
            continue;
        }
        faces.extend(number(&4_u16.to_le_bytes()));
        f.iter().for_each(|&v| faces.extend(number(&(v as f32).to_le_bytes())));
    }
    let of_vertices = "element vertex 8\nproperty double X\nproperty double y\nproperty double z\n";
    let of_faces = "element face 6\nproperty list ushort float32 vertex_index\n";
    let (elements, body) = if faces_first {
        ([of_faces, of_vertices], [faces, vertices])
    } else {
        ([of_vertices, of_faces], [vertices, faces])
    };
    let header =
        format!("ply\nformat {format} 1.0\ncomment a\nobj_info b\n{}comment c\nend_header\n", elements.concat());
    [header.replace('\n', end).into_bytes(), body.concat()].concat()
}

#[test]
fn ply_of_every_form_and_line_end() {
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        for end in ["\n", "\r\n", "\r"] {
            for faces_first in [false, true] {
                let bytes = ply(format, end, faces_first);
                assert_eq!(assert_cube(&bytes, Format::Ply).notes, [""; 0], "{format} {end:?}");
                let surface = assert_cube(&[&b"\xef\xbb\xbf"[..], &bytes, b"xyz"].concat(), Format::Ply);
                assert_eq!(surface.notes, ["3 bytes after the last element are passed over"]);
            }
        }
    }
    let text = String::from_utf8(ply("ascii", "\n", false)).unwrap();
    assert_cube(text.trim_end().as_bytes(), Format::Ply);
    assert_cube(text.replace("\n0 0 0\n", "\ncomment within\n0 0 0\n").as_bytes(), Format::Ply);
    let empty = text.replace("face 6", "face 9") + "0\n1 0\n2 0 1\n";
    let note = "3 faces have fewer than three different corners and are passed over (first: face 6 (from 0))";
    assert_eq!(assert_cube(empty.as_bytes(), Format::Ply).notes, [note]);
    let unused = text.replace("vertex 8", "vertex 9").replacen("\n4 0", "\nnan(ind) inf 1.#QNAN\n4 0", 1);
    assert_eq!(assert_cube(unused.as_bytes(), Format::Ply).positions.len(), 8);
    let refused = refusal(text.replace("4 0 3 2 1", "4 0 3 1 2").as_bytes(), Format::Ply);
    assert!(refused.starts_with("face 0 (from 0): the face of 4 corners crosses or touches itself"), "{refused}");
    let refused = refusal(text.replace("4 0 3 2 1", "4 0 3 -1 1").as_bytes(), Format::Ply);
    assert!(refused.ends_with("there is no vertex -1"), "{refused}");
}

#[test]
fn ply_strips_end_with_minus_one() {
    let text = |list: &[i32]| {
        let words: Vec<String> = list.iter().map(i32::to_string).collect();
        format!(
            "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
             element tristrips 1\nproperty list int int vertex_indices\nend_header\n\
             0 0 0\n1 0 0\n0 1 0\n0 0 1\n{} {}\n",
            list.len(),
            words.join(" ")
        )
    };
    let surface = read(text(&[0, 1, 2, 3, -1, 3, 1, 0, 2]).as_bytes(), Format::Ply);
    assert_eq!(surface.triangles, [[0, 1, 2], [2, 1, 3], [3, 1, 0], [0, 1, 2]]);
    assert!(refusal(text(&[0, 1, 4]).as_bytes(), Format::Ply).ends_with("there is no vertex 4"));
    assert!(refusal(text(&[0, 1, -2]).as_bytes(), Format::Ply).ends_with("there is no vertex -2"));
}

#[test]
fn packed_files_and_other_encodings_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let utf16: Vec<u8> = "\u{feff}solid v 1\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
    let legacy = b"# vtk DataFile Version 3.0\nx\nASCII\n".to_vec();
    for (name, bytes, message) in [
        ("a.obj", utf16.clone(), "this is text in UTF-16, which is not read; save it as UTF-8"),
        ("a.stl", utf16.clone(), "this is text in UTF-16, which is not read; save it as UTF-8"),
        ("a.ply", utf16.clone(), "this is text in UTF-16, which is not read; save it as UTF-8"),
        ("a.vtp", utf16, "this is text in UTF-16, which is not read; save it as UTF-8"),
        ("a.obj", b"\x1f\x8b\x08".to_vec(), "this is a file compressed by gzip, which is not read; unpack it first"),
        ("a.stl", b"\x1f\x8b\x08".repeat(99), "this is a file compressed by gzip, which is not read; unpack it first"),
        ("a.stl.gz", b"\x1f\x8b\x08".to_vec(), "this is a file compressed by gzip, which is not read; unpack it first"),
        ("a.ply", b"PK\x03\x04".to_vec(), "this is a ZIP archive, which is not read; unpack it first"),
        (
            "a.vtk",
            legacy,
            "this is a file in the legacy format of VTK, which is not read; save the surface as XML PolyData, with the \
             extension .vtp",
        ),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        assert_eq!(read_surface(&path).unwrap_err().to_string(), message, "{name}");
    }
}
