//! A mesh in front of the camera: scaled along the tube, and framed by what cuts leave of it.

use super::view::{Camera, View};
use crate::model::Mesh;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// A mesh in front of the camera.
pub(super) struct Staged {
    /// The view with its planes in scaled space.
    pub(super) view: View,
    /// Scaled along the tube.
    pub(super) positions: Vec<DVec3>,
    pub(super) camera: Camera,
}

impl Staged {
    /// Frames what the cuts leave, at `samples` samples per pixel in each direction; the lowest `strip` pixels stay free.
    pub(super) fn new(mesh: &Mesh, view: &View, samples: u32, strip: f32) -> Self {
        let scale = view.axial_scale;
        let positions: Vec<DVec3> =
            mesh.positions.par_iter().map(|p| Vec3::from(*p).as_dvec3() * DVec3::new(1.0, 1.0, scale)).collect();
        let inverse = DVec3::new(1.0, 1.0, 1.0 / scale);
        let mut view = view.clone();
        for plane in &mut view.cut {
            plane.normal = (DVec3::from(plane.normal) * inverse).into();
        }
        let size = [view.width, view.height].map(|side| side * samples);
        let strip = f64::from(strip) * f64::from(samples);
        let camera = Camera::framing(&view, &left(mesh, &view, &positions), size, strip);
        Self { view, positions, camera }
    }
}

/// Points whose bounds are those of what remains after cutting: its vertices, and where its edges are cut.
fn left(mesh: &Mesh, view: &View, positions: &[DVec3]) -> Vec<DVec3> {
    let removed: Vec<bool> = positions.par_iter().map(|p| view.is_cut(*p)).collect();
    let mut is_left = vec![false; positions.len()];
    let mut points = Vec::new();
    for triangle in &mesh.triangles {
        triangle.iter().for_each(|&v| is_left[v as usize] = !removed[v as usize]);
        let gone = triangle.map(|v| removed[v as usize]);
        // Where a wedge takes the middle of an edge, the ends bound what remains.
        for (k, next) in [(0, 1), (1, 2), (2, 0)] {
            if gone[k] != gone[next] {
                let [a, b] = [k, next].map(|k| positions[triangle[k] as usize]);
                points.extend(view.crossings(a, b));
            }
        }
    }
    points.extend(positions.iter().zip(is_left).filter(|(_, is_left)| *is_left).map(|(p, _)| *p));
    points
}
