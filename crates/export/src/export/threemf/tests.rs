//! Tests of 3MF files, read by a zip reader and an XML reader.

use super::*;
use crate::export::tests::{Sample, meta, samples};
use crate::model::{Mesh, Patch, sample};
use proptest::prelude::*;
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};
use std::io::{Cursor, Read};
use zip::ZipArchive;

fn written(shape: &Shape<'_>) -> Vec<u8> {
    let mut file = Vec::new();
    write_3mf(shape, &mut file).unwrap();
    file
}

fn part(file: &[u8], name: &str) -> String {
    let mut text = String::new();
    ZipArchive::new(Cursor::new(file)).unwrap().by_name(name).unwrap().read_to_string(&mut text).unwrap();
    text
}

#[derive(Debug, Default)]
struct Object {
    name: String,
    vertices: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    materials: Vec<usize>,
}

#[derive(Debug, Default)]
struct Model {
    unit: String,
    materials: Vec<(String, String)>,
    objects: Vec<Object>,
    items: Vec<String>,
}

fn attribute(element: &BytesStart<'_>, name: &str) -> String {
    element
        .try_get_attribute(name)
        .unwrap()
        .unwrap()
        .normalized_value(quick_xml::XmlVersion::default())
        .unwrap()
        .into_owned()
}

fn model(file: &[u8]) -> Model {
    let text = part(file, "3D/3dmodel.model");
    let (mut reader, mut model) = (Reader::from_str(&text), Model::default());
    loop {
        match reader.read_event().unwrap() {
            Event::Eof => return model,
            Event::Start(e) | Event::Empty(e) => {
                let numbers = |names: [&str; 3]| names.map(|name| attribute(&e, name));
                match e.name().as_ref() {
                    "model" => model.unit = attribute(&e, "unit"),
                    "base" => model.materials.push((attribute(&e, "name"), attribute(&e, "displaycolor"))),
                    "object" => model.objects.push(Object { name: attribute(&e, "name"), ..Object::default() }),
                    "item" => model.items.push(attribute(&e, "objectid")),
                    "vertex" => {
                        let at = numbers(["x", "y", "z"]).map(|x| x.parse().unwrap());
                        model.objects.last_mut().unwrap().vertices.push(at);
                    }
                    "triangle" => {
                        let object = model.objects.last_mut().unwrap();
                        object.triangles.push(numbers(["v1", "v2", "v3"]).map(|v| v.parse().unwrap()));
                        assert_eq!(attribute(&e, "pid"), "1");
                        object.materials.push(attribute(&e, "p1").parse().unwrap());
                    }
                    _ => {}
                }
            }
            _ => {}
        }
    }
}

fn volume(object: &Object) -> f64 {
    let corner = |v: u32| glam::Vec3::from(object.vertices[v as usize]).as_dvec3();
    object.triangles.iter().map(|t| corner(t[0]).dot(corner(t[1]).cross(corner(t[2]))) / 6.0).sum()
}

#[test]
fn the_package_is_as_agreed() {
    let mesh = sample::tube(12, 3, 0.2);
    let meta = meta();
    let file = written(&Shape::of(&mesh, &meta));
    assert_eq!(file, written(&Shape::of(&mesh, &meta)), "the same bytes again");
    let mut archive = ZipArchive::new(Cursor::new(&file)).unwrap();
    let names: Vec<_> = (0..archive.len()).map(|i| archive.by_index(i).unwrap().name().unwrap().into_owned()).collect();
    assert_eq!(names, ["[Content_Types].xml", "_rels/.rels", "3D/3dmodel.model"]);
    assert!(part(&file, "_rels/.rels").contains("Target=\"/3D/3dmodel.model\""));
    assert!(part(&file, "[Content_Types].xml").contains("3dmanufacturing-3dmodel+xml"));
    let text = part(&file, "3D/3dmodel.model");
    assert!(text.contains("<metadata name=\"Title\">tissue</metadata>"), "{}", &text[..1000]);
    assert!(text.contains("<metadata name=\"Application\">oviduct 0.1.0</metadata>"));
    assert!(text.contains("Preset pig, seed 7, digest 0f3a"));
    let found = model(&file);
    assert_eq!((found.unit.as_str(), found.items), ("meter", vec!["2".to_owned()]));
    let materials = ["inner_wall", "outer_wall", "cap_isthmus", "cap_ampulla"];
    assert_eq!(found.materials.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(), materials);
    assert_eq!(found.materials[0].1, "#D98AA0");
    let [tissue] = &found.objects[..] else { panic!("{} objects", found.objects.len()) };
    assert_eq!((tissue.vertices.len(), tissue.triangles.len()), (mesh.positions.len(), mesh.triangles.len()));
    assert_eq!(tissue.triangles, mesh.triangles);
    let first_of_second = mesh.patches[1].triangles.start;
    assert_eq!(tissue.materials[first_of_second - 1..=first_of_second], [0, 1]);
    // Polygons of 12 corners; the fold changes the inner radius.
    assert!(volume(tissue) > 0.0);
}

/// The tube with lids on its lumen.
fn regions() -> Mesh {
    let mut mesh = sample::tube(12, 3, 0.0);
    mesh.body = BodyKind::Regions;
    for (ring, kind) in [(0, PatchKind::Inlet), (3, PatchKind::Outlet)] {
        let start = mesh.triangles.len();
        let first = ring * 12;
        let fan = (1..11).map(|i| [first, first + i, first + i + 1]);
        mesh.triangles.extend(fan.map(|[a, b, c]| if ring == 0 { [a, c, b] } else { [a, b, c] }));
        mesh.patches.push(Patch { kind, triangles: start..mesh.triangles.len() });
    }
    mesh
}

#[test]
fn regions_are_two_closed_objects() {
    let (mesh, meta) = (regions(), meta());
    let found = model(&written(&Shape::of(&mesh, &meta)));
    let [tissue, lumen] = &found.objects[..] else { panic!("{} objects", found.objects.len()) };
    assert_eq!((tissue.name.as_str(), lumen.name.as_str(), found.items.len()), ("tissue", "lumen", 2));
    assert_eq!(lumen.vertices.len(), mesh.positions.len() / 2, "those of the outer wall are left out");
    // Regular polygons of 12 corners, radii 0.5 and 1 mm, length 4 mm.
    let polygon = 6.0 * (std::f64::consts::TAU / 12.0).sin() * 1e-6 * 4e-3;
    assert!((volume(lumen) / (polygon / 4.0) - 1.0).abs() < 1e-3, "{}", volume(lumen));
    assert!((volume(tissue) / (polygon * 0.75) - 1.0).abs() < 1e-3, "{}", volume(tissue));
    for object in [tissue, lumen] {
        let edges: std::collections::HashSet<_> =
            object.triangles.iter().flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]]).collect();
        assert_eq!(edges.len(), 3 * object.triangles.len());
        assert!(edges.iter().all(|&[a, b]| edges.contains(&[b, a])), "{} is closed", object.name);
    }
}

#[test]
fn names_need_no_care() {
    let mut sample = Sample::new(7);
    sample.patches[0].0 = "a <b> & \"c\"\n\0 größe_".to_owned();
    assert_eq!(model(&written(&sample.shape())).materials[0].0, "a <b> & \"c\"   größe_");
}

#[test]
fn a_failing_writer_ends_the_file_with_its_error() {
    struct Full(usize);
    impl Write for Full {
        fn write(&mut self, data: &[u8]) -> io::Result<usize> {
            self.0 = self.0.checked_sub(data.len()).ok_or_else(|| io::Error::other("full"))?;
            Ok(data.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    let sample = Sample::new(20_000);
    for room in [0, 100, 600, 5000, 100_000] {
        assert_eq!(write_3mf(&sample.shape(), &mut Full(room)).unwrap_err().to_string(), "full", "{room}");
    }
}

proptest! {
    #[test]
    fn a_file_read_back_is_the_same_surface(sample in samples(12)) {
        let found = model(&written(&sample.shape()));
        let [object] = &found.objects[..] else { panic!("{} objects", found.objects.len()) };
        let bits = |p: [f32; 3]| p.map(f32::to_bits);
        let corners = |positions: &[[f32; 3]], triangles: &[[u32; 3]]| -> Vec<_> {
            triangles.iter().flatten().map(|&v| bits(positions[v as usize])).collect()
        };
        prop_assert_eq!(
            corners(&object.vertices, &object.triangles),
            corners(&sample.positions, &sample.triangles)
        );
        prop_assert_eq!(found.unit, if sample.unit == LengthUnit::Metre { "meter" } else { "micron" });
    }
}
