//! Wire frames: the edges of the visible triangles, on a pale surface that hides what lies behind
//! it.
//!
//! An edge is not drawn as a line. A sample belongs to an edge if it lies near an edge of the
//! triangle that it shows. Edges therefore need no depth test, and each half of an edge is hidden
//! with its triangle.

use super::drawing::Drawing;
use super::mesh::patch_color;
use super::picture::{BACKGROUND, RenderError, Rgb};
use super::raster::Sample;
use super::staged::{SAMPLES, Staged};
use super::view::{Projected, View};
use crate::model::Mesh;
use glam::{DVec3, Vec2, Vec3};
use rayon::slice::ParallelSliceMut;

/// Colour of edges.
const WIRE: Rgb = [0x2c, 0x22, 0x38];
/// Share of the patch's colour in the colour of a surface; the rest is white.
const TINT: f32 = 0.55;
/// Brightness of a surface seen edge-on, and of a surface seen from the front.
const SHADES: [f32; 2] = [0.72, 1.0];

/// Draws the triangles of a mesh with their edges, `pen` pixels wide, on a transparent background.
///
/// The mesh may be open; both sides of a surface are visible. Faces of cuts have no triangles.
///
/// # Errors
/// [`RenderError::Size`] and [`RenderError::View`] if the view is out of bounds.
///
/// # Panics
/// If the mesh's indices are out of bounds.
pub fn wire_drawing(mesh: &Mesh, view: &View, pen: f32) -> Result<Drawing, RenderError> {
    let staged = Staged::new(mesh, view, 0.0)?;
    let wires = Wires { mesh, staged: &staged, reach: 0.5 * pen * SAMPLES as f32 };
    let encode = |color: Vec3| color.to_array().map(|value| value.round() as u8);
    staged.draw(encode, |sample, at, (): &mut ()| wires.color(sample, at))
}

/// Number of edges of the triangles of a mesh. An edge that triangles share counts once.
#[must_use]
pub fn edge_count(mesh: &Mesh) -> usize {
    let sides = mesh.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    let mut sides: Vec<[u32; 2]> = sides.map(|[a, b]| [a.min(b), a.max(b)]).collect();
    sides.par_sort_unstable();
    sides.dedup();
    sides.len()
}

struct Wires<'a> {
    mesh: &'a Mesh,
    staged: &'a Staged,
    /// Half the width of an edge, samples.
    reach: f32,
}

impl Wires<'_> {
    /// Colour of a sample, 0 to 255.
    fn color(&self, sample: Sample, [x, y]: [usize; 2]) -> Vec3 {
        if self.staged.cut(sample).is_some() {
            return rgb(BACKGROUND);
        }
        let t = sample.surface as usize;
        let (corners, normal) = self.staged.triangle(self.mesh.triangles[t]);
        let at = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
        if distance(at, corners.map(|corner| self.staged.camera.project(corner))) < self.reach {
            return rgb(WIRE);
        }
        let kind = self.mesh.patches.iter().find(|patch| patch.triangles.contains(&t)).map(|patch| patch.kind);
        let tint = rgb(BACKGROUND).lerp(kind.map_or(rgb(BACKGROUND), |kind| rgb(patch_color(kind))), TINT);
        let facing = normal.normalize_or(DVec3::Z).dot(self.staged.camera.forward).abs() as f32;
        tint * (SHADES[0] + (SHADES[1] - SHADES[0]) * facing)
    }
}

/// Distance of a point in a triangle to its nearest edge.
fn distance(at: Vec2, corners: [Projected; 3]) -> f32 {
    let [a, b, c] = corners.map(|corner| Vec2::new(corner.x, corner.y));
    let to = |p: Vec2, q: Vec2| (q - p).perp_dot(at - p).abs() / (q - p).length().max(f32::MIN_POSITIVE);
    to(a, b).min(to(b, c)).min(to(c, a))
}

fn rgb(color: Rgb) -> Vec3 {
    Vec3::from(color.map(f32::from))
}

#[cfg(test)]
mod tests {
    use super::super::view::plain;
    use super::*;
    use crate::model::{BodyKind, Patch, PatchKind, sample};

    fn front(size: u32) -> View {
        View { azimuth_deg: 0.0, elevation_deg: 0.0, ..plain(size, size) }
    }

    /// Right-angled triangle below the diagonal of a square.
    fn triangle() -> Mesh {
        Mesh {
            body: BodyKind::Tissue,
            positions: vec![[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0], [0.0, 1e-3, 0.0]],
            triangles: vec![[0, 1, 2]],
            patches: vec![Patch { kind: PatchKind::CapAmpulla, triangles: 0..1 }],
        }
    }

    #[test]
    fn a_triangle_has_dark_edges_around_a_pale_middle() {
        let drawing = wire_drawing(&triangle(), &front(200), 4.0).unwrap();
        let side = 1e-3 * drawing.scale;
        assert!((side - 186.0).abs() < 1e-4, "0.93 of 200 pixels: {side}");
        let red = |x: u32, y: u32| {
            drawing.pixmap.pixel(x, y).filter(|p| p.alpha() == 255).map(tiny_skia::PremultipliedColorU8::red)
        };
        // The corners are at 7 and 193 pixels. In the middle of each side, the edge is dark and 2
        // pixels wide within the triangle.
        for (edge, beyond, inner) in [((8, 120), (5, 120), (11, 120)), ((80, 191), (80, 195), (80, 188))] {
            assert_eq!(red(edge.0, edge.1), Some(WIRE[0]), "{edge:?}");
            assert_eq!(red(beyond.0, beyond.1), None, "{beyond:?}");
            assert!(red(inner.0, inner.1) > Some(200), "{inner:?}");
        }
        assert_eq!(red(99, 101), Some(WIRE[0]), "the hypotenuse");
        assert_eq!(red(110, 90), None);
        let dark = drawing.pixmap.pixels().iter().filter(|p| p.alpha() == 255 && p.red() < 100).count() as f64;
        // Pixels that the hypotenuse halves are not counted.
        let edges = 2.0 * side * (2.0 + 2.0_f64.sqrt());
        assert!((dark / edges - 0.93).abs() < 0.07, "{dark} of {edges}");
        assert_eq!(edge_count(&triangle()), 3);
    }

    #[test]
    fn what_lies_behind_a_surface_is_hidden() {
        let tube = sample::tube(24, 2, 0.3);
        let mut cap = tube.clone();
        cap.patches.retain(|patch| patch.kind == PatchKind::CapAmpulla);
        let kept = cap.patches[0].triangles.clone();
        cap.triangles = cap.triangles[kept].to_vec();
        cap.patches[0].triangles = 0..cap.triangles.len();
        let [tube, cap] = [&tube, &cap].map(|mesh| wire_drawing(mesh, &front(120), 1.0).unwrap());
        // From the end, the walls are seen edge-on, and this cap hides the other.
        let differ = tube.pixmap.pixels().iter().zip(cap.pixmap.pixels()).filter(|(a, b)| a != b).count();
        assert!(differ < 60, "{differ}");
    }

    #[test]
    fn a_closed_surface_has_three_edges_for_two_triangles() {
        let tube = sample::tube(12, 3, 0.2);
        assert_eq!(2 * edge_count(&tube), 3 * tube.triangles.len());
    }

    #[test]
    fn cuts_leave_plain_faces() {
        let cut = vec![super::super::Plane { normal: [0.0, 0.0, 1.0], offset: 2e-3 }];
        let drawing = wire_drawing(&sample::tube(24, 2, 0.0), &View { cut, ..front(120) }, 1.0).unwrap();
        let p = drawing.pixmap.pixel(60, 12).unwrap();
        assert_eq!([p.red(), p.green(), p.blue(), p.alpha()], [255; 4]);
    }
}
