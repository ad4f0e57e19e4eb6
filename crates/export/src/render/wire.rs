//! Triangles as a wire frame: the edges of what is visible, on a pale surface that hides what lies behind it.
//!
//! An edge is not drawn as a line: a sample belongs to it if it lies near an edge of the triangle that it shows. So edges need
//! no depth test of their own, and each half of an edge is hidden with its triangle.

use super::drawing::Drawing;
use super::mesh::paint;
use super::picture::{BACKGROUND, RenderError, Rgb, pixmap};
use super::raster::{NONE, Sample, rasterize};
use super::staged::Staged;
use super::view::{Projected, View};
use crate::model::Mesh;
use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

/// Samples per pixel in each direction.
const SAMPLES: usize = 2;
/// Edges.
const WIRE: Rgb = [0x2c, 0x22, 0x38];
/// Share of a patch's colour in the surface; the rest is white.
const TINT: f32 = 0.55;
/// Brightness of a surface seen edge-on, of one seen from the front.
const SHADES: [f32; 2] = [0.72, 1.0];

/// Draws the triangles of a mesh with their edges, `pen` pixels wide, on a transparent background. The mesh may be open: of a
/// part of a surface, both sides are visible. Faces of cuts have no triangles.
///
/// # Errors
/// [`RenderError::Size`] and [`RenderError::View`] if the view is out of bounds.
///
/// # Panics
/// If the mesh's indices are out of bounds.
pub fn wire_drawing(mesh: &Mesh, view: &View, pen: f32) -> Result<Drawing, RenderError> {
    view.check()?;
    let mut pixmap = pixmap(view.width, view.height)?;
    pixmap.fill(tiny_skia::Color::TRANSPARENT);
    let staged = Staged::new(mesh, view, SAMPLES as u32, 0.0);
    let width = view.width as usize * SAMPLES;
    let size = [width, view.height as usize * SAMPLES];
    let samples = rasterize(&staged.view, &staged.camera, &staged.positions, &mesh.triangles, size);
    let wires = Wires { mesh, staged: &staged, reach: 0.5 * pen * SAMPLES as f32 };
    let rows = pixmap.pixels_mut().par_chunks_mut(view.width as usize).enumerate();
    rows.for_each(|(row, pixels)| {
        for (column, pixel) in pixels.iter_mut().enumerate() {
            let (mut sum, mut hits) = (Vec3::ZERO, 0_usize);
            for y in row * SAMPLES..(row + 1) * SAMPLES {
                for x in column * SAMPLES..(column + 1) * SAMPLES {
                    if let Some(color) = wires.color(samples[y * width + x], [x, y]) {
                        sum += color;
                        hits += 1;
                    }
                }
            }
            if hits > 0 {
                let [r, g, b] = (sum / hits as f32).to_array().map(|value| value.round() as u8);
                let alpha = (255 * hits).div_ceil(SAMPLES * SAMPLES) as u8;
                *pixel = tiny_skia::ColorU8::from_rgba(r, g, b, alpha).premultiply();
            }
        }
    });
    let scale = staged.camera.scale / SAMPLES as f64;
    Ok(Drawing { pixmap, scale, axial_scale: view.axial_scale })
}

/// The number of edges of the triangles of a mesh; an edge that triangles share counts once.
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
    /// The colour at a sample, 0 to 255; none where nothing is visible.
    fn color(&self, sample: Sample, [x, y]: [usize; 2]) -> Option<Vec3> {
        if sample.surface == NONE {
            return None;
        }
        if sample.cut(self.staged.view.cut.len()).is_some() {
            return Some(rgb(BACKGROUND));
        }
        let t = sample.surface as usize;
        let corners = self.mesh.triangles[t].map(|v| self.staged.positions[v as usize]);
        let at = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
        if distance(at, corners.map(|corner| self.staged.camera.project(corner))) < self.reach {
            return Some(rgb(WIRE));
        }
        let kind = self.mesh.patches.iter().find(|patch| patch.triangles.contains(&t)).map(|patch| patch.kind);
        let tint = rgb(BACKGROUND).lerp(kind.map_or(rgb(BACKGROUND), |kind| rgb(paint(kind))), TINT);
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or(DVec3::Z);
        let facing = normal.dot(self.staged.camera.forward).abs() as f32;
        Some(tint * (SHADES[0] + (SHADES[1] - SHADES[0]) * facing))
    }
}

/// Distance to the nearest edge of a triangle that contains the point.
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
    use super::super::view::tests::plain;
    use super::*;
    use crate::model::{BodyKind, Patch, PatchKind, sample};

    fn front(size: u32) -> View {
        View { azimuth_deg: 0.0, elevation_deg: 0.0, ..plain(size, size) }
    }

    /// The right-angled triangle below the diagonal of a square.
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
        // Its corners are at 7 and 193 pixels: in the middle of each side the edge is dark, 2 pixels wide within the triangle.
        for (edge, beyond, inner) in [((8, 120), (5, 120), (11, 120)), ((80, 191), (80, 195), (80, 188))] {
            assert_eq!(red(edge.0, edge.1), Some(WIRE[0]), "{edge:?}");
            assert_eq!(red(beyond.0, beyond.1), None, "{beyond:?}");
            assert!(red(inner.0, inner.1) > Some(200), "{inner:?}");
        }
        assert_eq!(red(99, 101), Some(WIRE[0]), "the hypotenuse");
        assert_eq!(red(110, 90), None);
        let dark = drawing.pixmap.pixels().iter().filter(|p| p.alpha() == 255 && p.red() < 100).count() as f64;
        // Less the pixels that the hypotenuse halves.
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
        // The walls are seen edge-on from the end, and the other cap lies behind this one.
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
