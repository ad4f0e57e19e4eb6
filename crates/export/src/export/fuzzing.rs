//! Fuzz targets for the readers of surfaces.

use super::read::{Format, parse};

/// Parses bytes and checks the invariants of the surface.
///
/// Triangles name existing vertices, groups follow each other within the triangles, and the unit is
/// positive. An error message must be short.
pub fn surface(bytes: &[u8], format: Format) {
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
