//! Pictures of a mesh as a solid body: smooth shading, occlusion, and faces where it is cut open.
//!
//! With a [`Finish`], faces and ends show the stained layers of the wall, and the walls have a
//! texture and a relief that bends the normals. Otherwise every surface has one colour.
//!
//! From outside, only the front of a closed surface is visible. If the back is visible, the line of
//! sight entered the body through a cut. Such a sample is drawn as cut tissue on the plane of the
//! cut.

use super::bar::Bar;
use super::drawing::Drawing;
use super::faces::{Faces, Finish, is_straight, point_um};
use super::occlusion::AmbientLight;
use super::picture::{OUTLINE, RenderError, Rgb, TISSUE, encode, linear, srgb};
use super::raster::{NONE, Sample};
use super::staged::{SAMPLES, Staged};
use super::view::View;
use crate::geometry::patch::{PatchGeometry, patch_geometry};
use crate::model::{Mesh, PatchKind};
use crate::tissue::{Relief, Sampling, WallTexture};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Width of the rim of the lumen on cut faces, as a fraction of the longest side of the picture.
const RIM: f32 = 0.0016;
/// Light that leaves a hollow relative to the light that enters it: deep tissue is dark red, not
/// black.
const DEEP: Vec3 = Vec3::new(0.30, 0.10, 0.16);
/// Light on a surface in shadow; shadows on tissue are warm.
const SHADOW: Vec3 = Vec3::new(0.56, 0.42, 0.42);
/// Light on a surface that faces all lamps.
const LIT: Vec3 = Vec3::new(1.08, 1.08, 1.06);
/// Minimum cosine between normal and line of sight for which the texture is widened.
const MIN_FACING: f32 = 0.2;
/// Size of a pixel at which a moist surface no longer glints, because its relief is not resolved,
/// µm.
const DULL_UM: f32 = 14.0;

/// Draws a mesh on a transparent background as PNG, with a scale bar if the longest side has at
/// least 256 pixels.
///
/// The bar is valid at any depth for lengths in the plane of the picture across the tube. Its text
/// states the factor on lengths along the tube.
///
/// # Errors
/// [`RenderError::Size`] and [`RenderError::View`] if the view is out of bounds.
///
/// # Panics
/// If the mesh's indices or patch ranges are out of bounds.
pub fn mesh_png(mesh: &Mesh, view: &View, finish: Option<&Finish<'_>>) -> Result<Vec<u8>, RenderError> {
    let bar = Bar::new([view.width, view.height]);
    let Drawing { mut pixmap, scale, axial_scale } = draw(mesh, view, finish, bar.as_ref().map_or(0.0, Bar::strip))?;
    if let Some(bar) = bar
        && !mesh.positions.is_empty()
    {
        bar.draw(&mut pixmap, scale, axial_scale);
    }
    encode(&pixmap)
}

/// Draws a mesh as [`mesh_png`] does, without the bar.
///
/// # Errors
/// As [`mesh_png`].
///
/// # Panics
/// As [`mesh_png`].
pub fn mesh_drawing(mesh: &Mesh, view: &View, finish: Option<&Finish<'_>>) -> Result<Drawing, RenderError> {
    draw(mesh, view, finish, 0.0)
}

/// Draws a mesh; the lowest `strip` pixels stay free.
fn draw(mesh: &Mesh, view: &View, finish: Option<&Finish<'_>>, strip: f32) -> Result<Drawing, RenderError> {
    let scene = Scene::new(mesh, Staged::new(mesh, view, strip)?, finish);
    let Staged { samples, size, .. } = &scene.staged;
    let depth_scale = scene.staged.scale() as f32;
    let light = AmbientLight::new(depths(samples, size[0], depth_scale), view.width as usize);
    let tissues: Vec<TissuePart> = samples.par_iter().map(|sample| scene.tissue_part(*sample)).collect();
    let reach = (RIM * view.width.max(view.height) as f32 * SAMPLES as f32).round();
    let rim = Rim { tissues: &tissues, size: *size, reach: (reach as usize).max(1) };
    // Samples of one triangle share their colour within a pixel, except on stained faces.
    scene.staged.draw(srgb, |sample, [x, y], last: &mut Option<((u32, bool), Vec3)>| {
        let (u, v) = ((x as f32 + 0.5) / SAMPLES as f32, (y as f32 + 0.5) / SAMPLES as f32);
        let ambient = || light.at(u, v, sample.depth * depth_scale);
        if tissues[y * size[0] + x] == TissuePart::Stained {
            return scene.shade_face(sample, [x, y], ambient());
        }
        let key = (sample.surface, rim.covers(x, y));
        let color = match *last {
            Some((known, color)) if known == key => color,
            _ => scene.shade(sample, [x, y], key.1, ambient()),
        };
        *last = Some((key, color));
        color
    })
}

/// Part of the tissue that a sample shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TissuePart {
    /// A cross section of the tissue: the face of a cut, or an end.
    Face,
    /// A cross section whose layers are stained.
    Stained,
    /// The boundary of the lumen.
    Mucosa,
    Other,
}

/// The rim of the lumen on faces.
struct Rim<'a> {
    tissues: &'a [TissuePart],
    size: [usize; 2],
    /// Width of the rim in samples.
    reach: usize,
}

impl Rim<'_> {
    /// True if a sample lies on a face next to the lumen.
    fn covers(&self, x: usize, y: usize) -> bool {
        let [width, height] = self.size;
        let is = |x: usize, y: usize, part| self.tissues[y * width + x] == part;
        is(x, y, TissuePart::Face)
            && (1..=self.reach).any(|d| {
                let (right, below) = ((x + d).min(width - 1), (y + d).min(height - 1));
                [(x.saturating_sub(d), y), (right, y), (x, y.saturating_sub(d)), (x, below)]
                    .into_iter()
                    .any(|(x, y)| is(x, y, TissuePart::Mucosa))
            })
    }
}

struct Scene<'a> {
    mesh: &'a Mesh,
    staged: Staged,
    /// Each patch with its normals, which are not scaled.
    patches: Vec<PatchGeometry>,
    /// Factors that make normals perpendicular to the scaled surface.
    inverse: Vec3,
    /// Linear light of each patch.
    colors: Vec<Vec3>,
    tissue: Vec3,
    rim: Vec3,
    /// Direction towards the key light.
    key: Vec3,
    faces: Faces,
    /// Extent of a pixel in the axes of the mesh, µm, if the walls have a texture.
    texture: Option<Sampling>,
}

impl<'a> Scene<'a> {
    fn new(mesh: &'a Mesh, staged: Staged, finish: Option<&Finish<'_>>) -> Self {
        let camera = &staged.camera;
        let key = (camera.up * 0.75 - camera.right * 0.55 - camera.forward * 0.6).as_vec3().normalize();
        let pixel_um = (1e6 / staged.scale()) as f32;
        let axial_scale = staged.view.axial_scale as f32;
        let sampling = |_: &Finish<'_>| Sampling {
            pixel_um: Vec3::new(pixel_um, pixel_um, pixel_um / axial_scale),
            repeat_um: None,
            is_straight: is_straight(mesh),
        };
        Self {
            faces: finish.map(|finish| Faces::new(mesh, &staged, finish)).unwrap_or_default(),
            texture: finish.map(sampling),
            mesh,
            patches: mesh.patches.par_iter().map(|patch| patch_geometry(mesh, patch)).collect(),
            inverse: Vec3::new(1.0, 1.0, (1.0 / staged.view.axial_scale) as f32),
            colors: mesh.patches.iter().map(|patch| linear(patch_color(patch.kind))).collect(),
            tissue: linear(TISSUE),
            rim: linear(OUTLINE),
            key,
            staged,
        }
    }

    /// Index of the patch of a triangle.
    fn patch(&self, triangle: usize) -> Option<usize> {
        self.mesh.patches.iter().position(|patch| patch.triangles.contains(&triangle))
    }

    fn tissue_part(&self, sample: Sample) -> TissuePart {
        if sample.surface == NONE {
            return TissuePart::Other;
        }
        if self.faces.has(self.mesh, &self.staged, sample) {
            return TissuePart::Stained;
        }
        if self.staged.cut(sample).is_some() {
            return TissuePart::Face;
        }
        match self.patch(sample.surface as usize).map(|p| self.mesh.patches[p].kind) {
            Some(PatchKind::CapIsthmus | PatchKind::CapAmpulla) => TissuePart::Face,
            Some(PatchKind::InnerWall | PatchKind::Wall) => TissuePart::Mucosa,
            _ => TissuePart::Other,
        }
    }

    /// Linear light of a sample that shows something.
    fn shade(&self, sample: Sample, [x, y]: [usize; 2], rim: bool, ambient: f32) -> Vec3 {
        let Shading { color, normal, gloss } = match self.staged.cut(sample) {
            Some(k) => Shading::plain(self.tissue, self.cut_normal(k)),
            None => self.surface(sample, x, y),
        };
        self.light(if rim { self.rim } else { color }, normal, ambient) + self.glint(normal, gloss * ambient)
    }

    /// Linear light of a sample that shows a stained face.
    fn shade_face(&self, sample: Sample, [x, y]: [usize; 2], ambient: f32) -> Vec3 {
        let color = self.faces.at(self.mesh, &self.staged, sample, [x, y]).unwrap_or(self.tissue);
        let normal = match self.staged.cut(sample) {
            Some(k) => self.cut_normal(k),
            None => {
                self.staged.triangle(self.mesh.triangles[sample.surface as usize]).1.normalize_or(DVec3::Z).as_vec3()
            }
        };
        self.light(color, normal, ambient)
    }

    fn cut_normal(&self, k: usize) -> Vec3 {
        DVec3::from(self.staged.view.cut[k].normal).normalize_or(DVec3::Z).as_vec3()
    }

    /// Colour and normal of a triangle at a sample. Normals are interpolated within a patch.
    fn surface(&self, sample: Sample, x: usize, y: usize) -> Shading {
        let t = sample.surface as usize;
        let (corners, facet) = self.staged.triangle(self.mesh.triangles[t]);
        let Some(p) = self.patch(t) else {
            return Shading::plain(self.tissue, facet.normalize_or(DVec3::Z).as_vec3());
        };
        let camera = &self.staged.camera;
        let point = camera.at(x as f64 + 0.5, y as f64 + 0.5) + camera.forward * f64::from(sample.depth);
        let weights = barycentric(corners, point, facet);
        let patch = &self.patches[p];
        let [a, b, c] = patch.triangles[t - self.mesh.patches[p].triangles.start]
            .map(|v| (Vec3::from(patch.normals[v as usize]) * self.inverse).normalize_or(Vec3::Z));
        let normal = (a * weights[0] + b * weights[1] + c * weights[2]).normalize_or(Vec3::Z);
        let plain = Shading::plain(self.colors[p], normal);
        let texture = wall_texture(self.mesh.patches[p].kind);
        match (texture, &self.texture) {
            (Some(texture), Some(sampling)) => self.textured(plain, texture, sampling, sample, [x, y]),
            _ => plain,
        }
    }

    /// Adds the texture of a wall, whose relief bends the normal.
    fn textured(
        &self,
        plain: Shading,
        texture: WallTexture,
        sampling: &Sampling,
        sample: Sample,
        [x, y]: [usize; 2],
    ) -> Shading {
        // A pixel covers more of a surface that is seen at an angle.
        let facing = plain.normal.dot(self.staged.camera.forward.as_vec3()).abs().max(MIN_FACING);
        let sampling = Sampling { pixel_um: sampling.pixel_um / facing, ..*sampling };
        let point = DVec3::from(point_um(&self.staged, sample, x, y)).as_vec3();
        let relief = Relief::of(texture, point, &sampling);
        // Slopes are those of the surface that is not scaled.
        let normal = (plain.normal / self.inverse).normalize_or(Vec3::Z);
        let tangential = relief.slope - normal * relief.slope.dot(normal);
        let bent = (normal - tangential) * self.inverse;
        Shading {
            color: plain.color * relief.tint.max(Vec3::ZERO),
            normal: bent.normalize_or(plain.normal),
            gloss: gloss(texture) * (1.0 - (sampling.pixel_um.x / DULL_UM)).max(0.0),
        }
    }

    /// Light of a surface from all sides, from a key light at the upper left, and from a light at
    /// the camera. Both sides of a surface have the same light.
    fn light(&self, color: Vec3, normal: Vec3, ambient: f32) -> Vec3 {
        let toward = -self.staged.camera.forward.as_vec3();
        let normal = if normal.dot(toward) < 0.0 { -normal } else { normal };
        let light = 0.55 * normal.dot(self.key).max(0.0) + 0.45 * normal.dot(toward);
        color * SHADOW.lerp(LIT, light) * DEEP.lerp(Vec3::ONE, ambient)
    }

    /// Light that a moist surface reflects from the key light (Blinn 1977).
    fn glint(&self, normal: Vec3, gloss: f32) -> Vec3 {
        if gloss <= 0.0 {
            return Vec3::ZERO;
        }
        let toward = -self.staged.camera.forward.as_vec3();
        let normal = if normal.dot(toward) < 0.0 { -normal } else { normal };
        let cosine = normal.dot((self.key + toward).normalize_or(toward)).max(0.0);
        // The power 32.
        let powered = (0..5).fold(cosine, |power, _| power * power);
        Vec3::splat(gloss * powered)
    }
}

/// Colour and normal of a sample.
#[derive(Clone, Copy, Debug)]
struct Shading {
    /// Linear light that the surface reflects in all directions.
    color: Vec3,
    normal: Vec3,
    /// Light that the surface reflects like a mirror.
    gloss: f32,
}

impl Shading {
    fn plain(color: Vec3, normal: Vec3) -> Self {
        Self { color, normal, gloss: 0.0 }
    }
}

/// Texture of a patch.
fn wall_texture(kind: PatchKind) -> Option<WallTexture> {
    match kind {
        PatchKind::InnerWall | PatchKind::Wall => Some(WallTexture::Mucosa),
        PatchKind::OuterWall => Some(WallTexture::Serosa),
        PatchKind::CapIsthmus | PatchKind::CapAmpulla | PatchKind::Inlet | PatchKind::Outlet => None,
    }
}

fn gloss(texture: WallTexture) -> f32 {
    match texture {
        WallTexture::Mucosa => 0.30,
        WallTexture::Serosa => 0.22,
    }
}

/// Depth of the first sample of each pixel, pixels. `scale` is in pixels per unit of length.
fn depths(samples: &[Sample], width: usize, scale: f32) -> Vec<f32> {
    let rows = samples.chunks_exact(width).step_by(SAMPLES);
    rows.flat_map(|row| row.iter().step_by(SAMPLES)).map(|sample| sample.depth * scale).collect()
}

/// Barycentric weights of a point in the plane of a triangle, clamped to the triangle.
fn barycentric([a, b, c]: [DVec3; 3], point: DVec3, facet: DVec3) -> [f32; 3] {
    let area = facet.length_squared();
    if area == 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let u = ((c - b).cross(point - b).dot(facet) / area).clamp(0.0, 1.0);
    let v = ((a - c).cross(point - c).dot(facet) / area).clamp(0.0, 1.0 - u);
    [u as f32, v as f32, (1.0 - u - v) as f32]
}

pub(super) fn patch_color(kind: PatchKind) -> Rgb {
    match kind {
        PatchKind::InnerWall | PatchKind::Wall => [0xc8, 0x6a, 0x86],
        PatchKind::OuterWall => [0xf0, 0xcf, 0xc4],
        PatchKind::CapIsthmus | PatchKind::CapAmpulla => TISSUE,
        PatchKind::Inlet | PatchKind::Outlet => [0xf2, 0xe6, 0xd8],
    }
}

#[cfg(test)]
mod tests {
    use super::super::NamedView;
    use super::super::view::{Plane, plain};
    use super::*;
    use crate::model::sample;
    use tiny_skia::Pixmap;

    fn picture(view: &View) -> Pixmap {
        Pixmap::decode_png(&mesh_png(&sample::tube(96, 12, 0.4), view, None).unwrap()).unwrap()
    }

    fn end_on() -> View {
        View { azimuth_deg: 0.0, elevation_deg: 0.0, ..plain(120, 120) }
    }

    /// Red minus green, which distinguishes tissue.
    fn redness(picture: &Pixmap, x: u32, y: u32) -> i32 {
        let p = picture.pixel(x, y).unwrap();
        i32::from(p.red()) - i32::from(p.green())
    }

    #[test]
    fn the_end_shows_a_cap_around_an_open_lumen() {
        let picture = picture(&end_on());
        assert_eq!(picture.pixel(2, 2).unwrap().alpha(), 0);
        assert_eq!(picture.pixel(60, 60).unwrap().alpha(), 0, "one sees through the tube");
        assert!(redness(&picture, 60, 12) > 20 && picture.pixel(60, 12).unwrap().alpha() == 255);
    }

    #[test]
    fn cutting_shows_flat_tissue_and_a_rim() {
        let half = |cut| View { azimuth_deg: 90.0, elevation_deg: 0.0, cut, ..plain(200, 120) };
        let opened = picture(&half(vec![Plane { normal: [1.0, 0.0, 0.0], offset: 0.0 }]));
        let whole = picture(&half(Vec::new()));
        // Near the upper edge, the cut wall has one colour throughout; the closed tube is paler.
        let wall: Vec<_> = (60..140).map(|x| opened.pixel(x, 20).unwrap()).collect();
        assert!(wall.iter().all(|p| p.red().abs_diff(wall[0].red()) <= 6), "{wall:?}");
        assert!(redness(&opened, 100, 20) > redness(&whole, 100, 20) + 10);
        // Only the rim is bluish.
        let column = (0..120).map(|y| opened.pixel(100, y).unwrap());
        assert!(column.filter(|p| p.alpha() == 255 && p.blue() > p.green().saturating_add(20)).count() >= 2);
    }

    #[test]
    fn hollows_are_darker_than_faces() {
        let view = View { cut: vec![Plane { normal: [1.0, 0.0, 0.0], offset: 0.0 }], ..end_on() };
        let picture = picture(&View { azimuth_deg: 50.0, elevation_deg: 25.0, ..view });
        let brightness = |p: &tiny_skia::PremultipliedColorU8| u32::from(p.red()) + u32::from(p.green());
        let solid = || picture.pixels().iter().filter(|p| p.alpha() == 255).map(brightness);
        assert!(solid().min().unwrap() * 2 < solid().max().unwrap());
    }

    #[test]
    fn the_scale_bar_has_its_length() {
        // The end is 2 mm wide and fills 0.93 of 400 pixels minus the strip of the bar.
        let png = mesh_png(&sample::tube(96, 12, 0.4), &View { width: 400, height: 400, ..end_on() }, None).unwrap();
        let picture = Pixmap::decode_png(&png).unwrap();
        // Distance between the first and the last opaque pixel of a row.
        let span = |y: u32, end: u32| {
            let full: Vec<u32> = (0..end).filter(|&x| picture.pixel(x, y).unwrap().alpha() == 255).collect();
            full.last().map_or(0, |last| last - full[0] + 1)
        };
        let tube = (0..350).map(|y| span(y, 400)).max().unwrap();
        // The text begins at column 57.
        let row = (378..400).map(|y| span(y, 55)).max().unwrap();
        // 0.2 of 400 pixels is 0.44 mm, so the bar is 200 µm long, a tenth of the width of the
        // tube.
        assert!((f64::from(row) - f64::from(tube) / 10.0).abs() <= 1.5, "{row} of {tube}");
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bytes() {
        let mesh = sample::tube(48, 6, 0.3);
        let view = View { axial_scale: 0.5, ..NamedView::Opened.of(&mesh, 300) };
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| mesh_png(&mesh, &view, None).unwrap())
        };
        assert_eq!(on(1), on(4));
    }

    #[test]
    fn each_named_view_is_another_picture() {
        let mesh = sample::tube(96, 12, 0.4);
        let pictures = NamedView::ALL.map(|view| mesh_png(&mesh, &view.of(&mesh, 64), None).unwrap());
        for (i, one) in pictures.iter().enumerate() {
            assert!(!pictures[..i].contains(one), "{:?}", NamedView::ALL[i]);
        }
    }

    #[test]
    fn an_empty_mesh_is_an_empty_picture() {
        let mesh = Mesh { positions: vec![], triangles: vec![], patches: vec![], ..sample::tube(4, 1, 0.0) };
        for view in [plain(8, 8), NamedView::Ampulla.of(&mesh, 300)] {
            let picture = Pixmap::decode_png(&mesh_png(&mesh, &view, None).unwrap()).unwrap();
            assert!(picture.data().iter().all(|&b| b == 0));
        }
    }

    #[test]
    fn colours_survive_linear_light() {
        for c in 0..=255 {
            assert_eq!(srgb(linear([c, 255 - c, 0])), [c, 255 - c, 0]);
        }
    }
}
