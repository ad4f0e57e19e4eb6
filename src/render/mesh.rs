//! A mesh as a solid body: smooth shading, two lights, and flat cut faces where it is cut open.
//!
//! From outside, only the front of a closed surface is visible. If the back is visible after cutting, the line of sight
//! entered the body through a cut: that sample is drawn as cut tissue, on the plane of the cut.

use super::picture::{BACKGROUND, OUTLINE, RenderError, Rgb, TISSUE, encode, pixmap};
use super::raster::{NONE, Sample, rasterize};
use super::view::{Camera, View};
use crate::geometry::patch::patch_geometry;
use crate::model::{Mesh, PatchKind};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Samples per pixel in each direction.
const SAMPLES: u32 = 2;

/// Draws a mesh.
///
/// # Errors
/// [`RenderError::Size`] and [`RenderError::View`] if the view is out of bounds.
///
/// # Panics
/// If the mesh's indices or patch ranges are out of bounds.
pub fn mesh_png(mesh: &Mesh, view: &View) -> Result<Vec<u8>, RenderError> {
    view.check()?;
    let mut pixmap = pixmap(view.width, view.height)?;
    let scene = Scene::new(mesh, view);
    let [width, height] = [view.width, view.height].map(|side| (side * SAMPLES) as usize);
    let samples = rasterize(&scene.view, &scene.camera, &scene.positions, &mesh.triangles, [width, height]);
    let shades: Vec<Shade> =
        samples.par_iter().enumerate().map(|(i, s)| scene.shade(i % width, i / width, *s)).collect();
    let rim_color = linear(OUTLINE);
    let at = |x: usize, y: usize| &shades[y * width + x];
    let n = SAMPLES as usize;
    let pixels = pixmap.pixels_mut();
    pixels.par_chunks_mut(view.width as usize).enumerate().for_each(|(row, pixels)| {
        for (column, pixel) in pixels.iter_mut().enumerate() {
            let mut sum = Vec3::ZERO;
            for y in row * n..row * n + n {
                for x in column * n..column * n + n {
                    let rim = at(x, y).face && beside(x, y, [width, height]).any(|(x, y)| at(x, y).mucosa);
                    sum += if rim { rim_color } else { at(x, y).color };
                }
            }
            let [r, g, b] = srgb(sum / (n * n) as f32);
            *pixel = tiny_skia::ColorU8::from_rgba(r, g, b, 255).premultiply();
        }
    });
    encode(&pixmap)
}

/// Samples one and two steps away, in the four directions: a rim is as wide as a pixel.
fn beside(x: usize, y: usize, [width, height]: [usize; 2]) -> impl Iterator<Item = (usize, usize)> {
    (1..=2).flat_map(move |d| {
        let (right, below) = ((x + d).min(width - 1), (y + d).min(height - 1));
        [(x.saturating_sub(d), y), (right, y), (x, y.saturating_sub(d)), (x, below)]
    })
}

/// Appearance of a sample.
#[derive(Clone, Copy)]
struct Shade {
    /// Linear light.
    color: Vec3,
    /// On a cross section of the tissue: a cut face or an end.
    face: bool,
    /// On the boundary of the lumen.
    mucosa: bool,
}

struct Scene<'a> {
    mesh: &'a Mesh,
    /// The view with its planes in scaled space.
    view: View,
    camera: Camera,
    /// Scaled along the tube.
    positions: Vec<DVec3>,
    /// For each patch the normals of its triangles' corners, in scaled space.
    normals: Vec<Vec<[Vec3; 3]>>,
    /// Linear light of each patch.
    colors: Vec<Vec3>,
    background: Vec3,
    tissue: Vec3,
    /// Direction towards the key light.
    key: Vec3,
}

impl<'a> Scene<'a> {
    fn new(mesh: &'a Mesh, view: &View) -> Self {
        let scale = view.axial_scale;
        let positions: Vec<DVec3> =
            mesh.positions.par_iter().map(|p| Vec3::from(*p).as_dvec3() * DVec3::new(1.0, 1.0, scale)).collect();
        // Normals are scaled by the inverse factor to stay perpendicular to the surface.
        let inverse = DVec3::new(1.0, 1.0, 1.0 / scale);
        let mut view = view.clone();
        for plane in &mut view.cut {
            plane.normal = (DVec3::from(plane.normal) * inverse).into();
        }
        let left: Vec<DVec3> = positions.iter().copied().filter(|p| !view.is_cut(*p)).collect();
        let camera = Camera::framing(&view, &left, view.width * SAMPLES, view.height * SAMPLES);
        let of_patch = |patch| {
            let geometry = patch_geometry(mesh, patch);
            let normal = |v: u32| (Vec3::from(geometry.normals[v as usize]) * inverse.as_vec3()).normalize_or(Vec3::Z);
            geometry.triangles.iter().map(|t| t.map(normal)).collect()
        };
        let normals = mesh.patches.iter().map(of_patch).collect();
        let key = (camera.up * 0.8 - camera.right * 0.5 - camera.forward * 0.6).as_vec3().normalize();
        Self {
            mesh,
            view,
            camera,
            positions,
            normals,
            colors: mesh.patches.iter().map(|patch| linear(paint(patch.kind))).collect(),
            background: linear(BACKGROUND),
            tissue: linear(TISSUE),
            key,
        }
    }

    fn shade(&self, x: usize, y: usize, sample: Sample) -> Shade {
        if sample.triangle == NONE {
            return Shade { color: self.background, face: false, mucosa: false };
        }
        let t = sample.triangle as usize;
        let ray = self.camera.ray(x as f64 + 0.5, y as f64 + 0.5);
        let depth = 1.0 / f64::from(sample.inverse_depth);
        let corners = self.mesh.triangles[t].map(|v| self.positions[v as usize]);
        let facet = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        if facet.dot(ray) > 0.0
            && let Some(normal) = self.cut_normal(ray, depth)
        {
            return Shade {
                color: self.light(self.tissue, normal.normalize_or(DVec3::Z).as_vec3(), ray),
                face: true,
                mucosa: false,
            };
        }
        let Some(p) = self.mesh.patches.iter().position(|patch| patch.triangles.contains(&t)) else {
            return Shade {
                color: self.light(self.tissue, facet.normalize_or(DVec3::Z).as_vec3(), ray),
                face: false,
                mucosa: false,
            };
        };
        let patch = &self.mesh.patches[p];
        let weights = barycentric(corners, self.camera.eye + ray * depth, facet);
        let [a, b, c] = self.normals[p][t - patch.triangles.start];
        let normal = (a * weights[0] + b * weights[1] + c * weights[2]).normalize_or(Vec3::Z);
        Shade {
            color: self.light(self.colors[p], normal, ray),
            face: matches!(patch.kind, PatchKind::CapIsthmus | PatchKind::CapAmpulla),
            mucosa: matches!(patch.kind, PatchKind::InnerWall | PatchKind::Wall),
        }
    }

    /// Normal of the cut that the line of sight passes last before `depth`, where it leaves the removed part.
    fn cut_normal(&self, ray: DVec3, depth: f64) -> Option<DVec3> {
        let passes = self.view.cut.iter().filter_map(|plane| {
            let normal = DVec3::from(plane.normal);
            // Out of the removed part, into the body: from the plane's front to its back.
            let at = (plane.offset - normal.dot(self.camera.eye)) / normal.dot(ray);
            let leaves = normal.dot(ray) < 0.0 && at > 0.0 && at <= depth * (1.0 + 1e-6);
            leaves.then_some((at, normal))
        });
        // The removed part is in front of all planes, so it ends at the first plane that is passed.
        passes.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, normal)| normal)
    }

    /// Ambient light, a key light from the upper left, and a light at the camera; the same for both sides.
    fn light(&self, color: Vec3, normal: Vec3, ray: DVec3) -> Vec3 {
        let toward = -ray.as_vec3().normalize();
        let normal = if normal.dot(toward) < 0.0 { -normal } else { normal };
        let lambert = 0.28 + 0.50 * normal.dot(self.key).max(0.0) + 0.42 * normal.dot(toward).max(0.0);
        color * lambert
    }
}

/// Weights of the corners at a point of the triangle's plane, clamped to the triangle.
fn barycentric([a, b, c]: [DVec3; 3], point: DVec3, facet: DVec3) -> [f32; 3] {
    let area = facet.length_squared();
    if area == 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let u = ((c - b).cross(point - b).dot(facet) / area).clamp(0.0, 1.0);
    let v = ((a - c).cross(point - c).dot(facet) / area).clamp(0.0, 1.0 - u);
    [u as f32, v as f32, (1.0 - u - v) as f32]
}

fn paint(kind: PatchKind) -> Rgb {
    match kind {
        PatchKind::InnerWall | PatchKind::Wall => [0xc8, 0x6a, 0x86],
        PatchKind::OuterWall => [0xf0, 0xcf, 0xc4],
        PatchKind::CapIsthmus | PatchKind::CapAmpulla => TISSUE,
        PatchKind::Inlet | PatchKind::Outlet => [0xf2, 0xe6, 0xd8],
    }
}

/// Linear light of an sRGB colour.
fn linear(color: Rgb) -> Vec3 {
    Vec3::from(color.map(|c| {
        let c = f32::from(c) / 255.0;
        if c <= 0.040_45 { c / 12.92 } else { libm::powf((c + 0.055) / 1.055, 2.4) }
    }))
}

/// sRGB of linear light.
fn srgb(color: Vec3) -> Rgb {
    color.to_array().map(|c| {
        let c = c.clamp(0.0, 1.0);
        let encoded = if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * libm::powf(c, 1.0 / 2.4) - 0.055 };
        (encoded * 255.0).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sample;
    use tiny_skia::Pixmap;

    fn picture(view: &View) -> Pixmap {
        Pixmap::decode_png(&mesh_png(&sample::tube(96, 12, 0.4), view).unwrap()).unwrap()
    }

    fn end_on() -> View {
        View { azimuth_deg: 0.0, elevation_deg: 0.0, field_of_view_deg: 5.0, ..View::whole(120, 120) }
    }

    /// Red minus green, which distinguishes tissue from the white background.
    fn redness(picture: &Pixmap, x: u32, y: u32) -> i32 {
        let p = picture.pixel(x, y).unwrap();
        i32::from(p.red()) - i32::from(p.green())
    }

    #[test]
    fn the_end_shows_a_cap_around_an_open_lumen() {
        let picture = picture(&end_on());
        assert_eq!(redness(&picture, 2, 2), 0);
        assert_eq!(redness(&picture, 60, 60), 0, "one sees through the tube");
        assert!(redness(&picture, 60, 12) > 20);
    }

    #[test]
    fn cutting_shows_flat_tissue_and_a_rim() {
        let half = |cut| View { azimuth_deg: 90.0, elevation_deg: 0.0, cut, ..View::whole(200, 120) };
        let opened = picture(&half(vec![super::super::Plane { normal: [1.0, 0.0, 0.0], offset: 0.0 }]));
        let whole = picture(&half(Vec::new()));
        // Near the upper edge, the cut wall has one colour throughout; the closed tube is paler.
        let wall: Vec<_> = (60..140).map(|x| opened.pixel(x, 30).unwrap()).collect();
        assert!(wall.iter().all(|p| p.red().abs_diff(wall[0].red()) <= 6), "{wall:?}");
        assert!(redness(&opened, 100, 30) > redness(&whole, 100, 30) + 10);
        let column = (0..120).map(|y| opened.pixel(100, y).unwrap());
        let rim = column.filter(|p| p.red().abs_diff(OUTLINE[0]) < 40 && p.green().abs_diff(OUTLINE[1]) < 40);
        assert!(rim.count() >= 2);
    }

    #[test]
    fn the_same_model_gives_the_same_bytes() {
        let mesh = sample::tube(48, 6, 0.3);
        let view = View { axial_scale: 0.5, ..View::opened(90, 60) };
        assert_eq!(mesh_png(&mesh, &view).unwrap(), mesh_png(&mesh, &view).unwrap());
    }

    #[test]
    fn an_empty_mesh_is_a_white_picture() {
        let mesh = Mesh { positions: vec![], triangles: vec![], patches: vec![], ..sample::tube(4, 1, 0.0) };
        let picture = Pixmap::decode_png(&mesh_png(&mesh, &View::whole(8, 8)).unwrap()).unwrap();
        assert!(picture.data().iter().all(|&b| b == 255));
    }

    #[test]
    fn colours_survive_linear_light() {
        for c in 0..=255 {
            assert_eq!(srgb(linear([c, 255 - c, 0])), [c, 255 - c, 0]);
        }
    }
}
