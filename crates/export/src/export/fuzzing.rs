//! Targets of the fuzzers: readers of surfaces.

use super::read::{Format, parse};

/// glTF, binary or JSON.
pub fn gltf(bytes: &[u8]) {
    surface(bytes, Format::Gltf);
}

/// Wavefront OBJ.
pub fn obj(bytes: &[u8]) {
    surface(bytes, Format::Obj);
}

/// STL, binary or text.
pub fn stl(bytes: &[u8]) {
    surface(bytes, Format::Stl);
}

/// PLY, binary or text.
pub fn ply(bytes: &[u8]) {
    surface(bytes, Format::Ply);
}

/// VTK XML.
pub fn vtp(bytes: &[u8]) {
    surface(bytes, Format::Vtp);
}

/// Triangles name vertices that exist, and groups triangles; groups follow each other. A refusal is short.
fn surface(bytes: &[u8], format: Format) {
    match parse(bytes, format, None) {
        Ok(surface) => {
            let vertices = surface.positions.len();
            assert!(surface.triangles.iter().flatten().all(|&v| (v as usize) < vertices), "an index is out of range");
            let mut end = 0;
            for group in &surface.groups {
                assert!(end <= group.triangles.start && group.triangles.start <= group.triangles.end);
                end = group.triangles.end;
            }
            assert!(end <= surface.triangles.len());
            let metres = surface.unit.metres();
            assert!(metres > 0.0 && metres.is_finite());
        }
        Err(error) => {
            let text = error.to_string();
            assert!((1..=1000).contains(&text.chars().count()), "{text}");
        }
    }
}
