//! A mesh in front of the camera: scaled along the tube, framed by what cuts leave of it,
//! rasterized, and drawn from several samples per pixel.

use super::drawing::Drawing;
use super::picture::{RenderError, Rgb, pixmap};
use super::raster::{NONE, Sample, face, rasterize};
use super::view::{Camera, View};
use crate::model::Mesh;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Samples per pixel in each direction.
pub(super) const SAMPLES: usize = 2;

/// A mesh in front of the camera.
pub(super) struct Staged {
    /// The view with its planes in scaled space.
    pub(super) view: View,
    /// Positions scaled along the tube.
    pub(super) positions: Vec<DVec3>,
    pub(super) camera: Camera,
    /// Width and height of the picture in samples.
    pub(super) size: [usize; 2],
    /// Samples in rows.
    pub(super) samples: Vec<Sample>,
}

impl Staged {
    /// Frames what the cuts leave; the lowest `strip` pixels stay free.
    ///
    /// # Errors
    /// [`RenderError::Size`] and [`RenderError::View`] if the view is out of bounds.
    pub(super) fn new(mesh: &Mesh, view: &View, strip: f32) -> Result<Self, RenderError> {
        view.check()?;
        let scale = view.axial_scale;
        let positions: Vec<DVec3> =
            mesh.positions.par_iter().map(|p| Vec3::from(*p).as_dvec3() * DVec3::new(1.0, 1.0, scale)).collect();
        let inverse = DVec3::new(1.0, 1.0, 1.0 / scale);
        let mut view = view.clone();
        for plane in &mut view.cut {
            plane.normal = (DVec3::from(plane.normal) * inverse).into();
        }
        let size = [view.width, view.height].map(|side| side * SAMPLES as u32);
        let strip = f64::from(strip) * SAMPLES as f64;
        let camera = Camera::framing(&view, &remaining_points(mesh, &view, &positions), size, strip);
        let size = size.map(|side| side as usize);
        let samples = rasterize(&view, &camera, &positions, &mesh.triangles, size);
        Ok(Self { view, positions, camera, size, samples })
    }

    /// Pixels per unit of length.
    pub(super) fn scale(&self) -> f64 {
        self.camera.scale / SAMPLES as f64
    }

    /// Index of the cut whose face a sample shows.
    pub(super) fn cut(&self, sample: Sample) -> Option<usize> {
        (0..self.view.cut.len()).find(|&k| sample.surface == face(k))
    }

    /// Corners of a triangle, scaled along the tube, and its normal, which is not of unit length.
    pub(super) fn triangle(&self, corners: [u32; 3]) -> ([DVec3; 3], DVec3) {
        let corners = corners.map(|v| self.positions[v as usize]);
        (corners, (corners[1] - corners[0]).cross(corners[2] - corners[0]))
    }

    /// Draws the picture on a transparent background. A pixel has the mean colour of its samples,
    /// encoded by `encode`.
    ///
    /// `color` gives the colour of a sample that shows something, at its column and row. `M` is a
    /// memo that is reset for each pixel.
    pub(super) fn draw<M: Default>(
        &self,
        encode: impl Fn(Vec3) -> Rgb + Sync,
        color: impl Fn(Sample, [usize; 2], &mut M) -> Vec3 + Sync,
    ) -> Result<Drawing, RenderError> {
        let View { width, height, axial_scale, .. } = self.view;
        let mut pixmap = pixmap(width, height)?;
        pixmap.fill(tiny_skia::Color::TRANSPARENT);
        let rows = pixmap.pixels_mut().par_chunks_mut(width as usize).enumerate();
        rows.for_each(|(row, pixels)| {
            for (column, pixel) in pixels.iter_mut().enumerate() {
                let (mut sum, mut hits, mut memo) = (Vec3::ZERO, 0_usize, M::default());
                for y in row * SAMPLES..(row + 1) * SAMPLES {
                    for x in column * SAMPLES..(column + 1) * SAMPLES {
                        let sample = self.samples[y * self.size[0] + x];
                        if sample.surface != NONE {
                            sum += color(sample, [x, y], &mut memo);
                            hits += 1;
                        }
                    }
                }
                if hits > 0 {
                    let [r, g, b] = encode(sum / hits as f32);
                    let alpha = (255 * hits).div_ceil(SAMPLES * SAMPLES) as u8;
                    *pixel = tiny_skia::ColorU8::from_rgba(r, g, b, alpha).premultiply();
                }
            }
        });
        Ok(Drawing { pixmap, scale: self.scale(), axial_scale })
    }
}

/// Points with the bounds of what remains after cutting: its vertices, and the crossings of its
/// edges with the cuts.
fn remaining_points(mesh: &Mesh, view: &View, positions: &[DVec3]) -> Vec<DVec3> {
    let removed: Vec<bool> = positions.par_iter().map(|p| view.is_cut(*p)).collect();
    let mut remains = vec![false; positions.len()];
    let mut points = Vec::new();
    for triangle in &mesh.triangles {
        triangle.iter().for_each(|&v| remains[v as usize] = !removed[v as usize]);
        let gone = triangle.map(|v| removed[v as usize]);
        // If a wedge removes only the middle of an edge, the ends bound what remains.
        for (k, next) in [(0, 1), (1, 2), (2, 0)] {
            if gone[k] != gone[next] {
                let [a, b] = [k, next].map(|k| positions[triangle[k] as usize]);
                points.extend(view.crossings(a, b));
            }
        }
    }
    points.extend(positions.iter().zip(remains).filter(|(_, remains)| *remains).map(|(p, _)| *p));
    points
}
