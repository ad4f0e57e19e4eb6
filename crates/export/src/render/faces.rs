//! Stained faces of a picture of a mesh: the faces of cuts, and the ends of the tube.

use super::histology::{Slide, StainedFace};
use super::named::TubeEnds;
use super::raster::Sample;
use super::staged::{SAMPLES, Staged};
use crate::geometry::cut::Body;
use crate::model::{Mesh, PatchKind, Plane};
use crate::spec::{Across, ModelSpec};
use crate::tissue::Layers;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Size of a pixel of a face relative to a pixel of the picture.
const FINENESS: f64 = 0.7;
/// Distance of the stained section from an end of the tube, µm. It lies within the tissue.
const INSET_UM: f64 = 1.0;
/// Cosine between the normal of a face and the tube below which fibres along the tube lie in the
/// face.
const MAX_TILT: f64 = 0.4;
/// Minimum cosine between a face and the line of sight for which a sample is widened.
const MIN_COSINE: f64 = 0.05;

/// Tissue of a picture: stained layers on cut faces, and textures of the walls.
#[derive(Clone, Copy, Debug)]
pub struct Finish<'a> {
    /// Specification of the model, which determines the layers.
    pub spec: &'a ModelSpec,
    /// Seed of the model.
    pub seed: u64,
}

/// True if the sections of a tube lie across z. A bent specification may be shown straight.
pub(super) fn is_straight(mesh: &Mesh) -> bool {
    TubeEnds::of(mesh).is_none_or(|ends| ends.are_straight(mesh))
}

/// A stained face and its plane.
struct Face {
    plane: Plane,
    stained: StainedFace,
    /// Sides of a sample on the plane, µm.
    sides: [[f64; 2]; 2],
}

/// Part of the picture that shows one face.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Extent {
    low: [f64; 2],
    high: [f64; 2],
}

impl Extent {
    const NONE: Self = Self { low: [f64::INFINITY; 2], high: [f64::NEG_INFINITY; 2] };

    fn joined(self, other: Self) -> Self {
        let pair = |of: fn(f64, f64) -> f64, a: [f64; 2], b: [f64; 2]| [of(a[0], b[0]), of(a[1], b[1])];
        Self { low: pair(f64::min, self.low, other.low), high: pair(f64::max, self.high, other.high) }
    }
}

/// The stained faces of a picture: those of the cuts, and of both caps.
#[derive(Default)]
pub(super) struct Faces(Vec<Option<Face>>);

/// Number of the face that a sample shows: of a cut, or of a cap after all cuts.
fn index(mesh: &Mesh, staged: &Staged, sample: Sample) -> Option<usize> {
    if let Some(k) = staged.cut(sample) {
        return Some(k);
    }
    let is_shown = |patch: &&crate::model::Patch| patch.triangles.contains(&(sample.surface as usize));
    let kind = mesh.patches.iter().find(is_shown)?.kind;
    let cap = CAPS.into_iter().position(|cap| cap == kind)?;
    Some(staged.view.cut.len() + cap)
}

const CAPS: [PatchKind; 2] = [PatchKind::CapIsthmus, PatchKind::CapAmpulla];

impl Faces {
    /// Stains the faces that the picture shows. A face without known borders of the walls is not
    /// stained.
    pub(super) fn new(mesh: &Mesh, staged: &Staged, finish: &Finish<'_>) -> Self {
        let planes = planes(mesh, staged, finish);
        let extents = extents(mesh, staged, &planes);
        let body = Body::from(mesh);
        let face = |(plane, extent): (Option<(Plane, Layers)>, Extent)| {
            let (plane, layers) = plane?;
            if extent.low[0] > extent.high[0] {
                return None;
            }
            let borders = body.borders(&plane)?;
            if borders.iter().any(|border| border.lines.is_empty()) {
                return None;
            }
            let slide = Slide { borders, layers, seed: finish.seed, index: plane.digest() as u32 };
            let finest_um = FINENESS * SAMPLES as f64 * 1e6 / staged.camera.scale;
            let is_along = is_straight(mesh) && plane.normal[2].abs() < MAX_TILT;
            let stained = StainedFace::new(&slide, [extent.low, extent.high], finest_um, is_along);
            Some(Face { plane, stained, sides: sides(staged, &plane) })
        };
        Self(planes.into_iter().zip(extents).map(face).collect())
    }

    /// True if the face that a sample shows is stained.
    pub(super) fn has(&self, mesh: &Mesh, staged: &Staged, sample: Sample) -> bool {
        !self.0.is_empty() && index(mesh, staged, sample).is_some_and(|k| self.0[k].is_some())
    }

    /// Linear light of the stain that a sample shows.
    pub(super) fn at(&self, mesh: &Mesh, staged: &Staged, sample: Sample, [x, y]: [usize; 2]) -> Option<Vec3> {
        if self.0.is_empty() {
            return None;
        }
        let face = self.0[index(mesh, staged, sample)?].as_ref()?;
        let p = face.plane.coordinates(point_um(staged, sample, x, y));
        face.stained.at(p, face.sides)
    }
}

/// Planes of all cuts and of both caps with the layers of their sections, if there are any.
fn planes(mesh: &Mesh, staged: &Staged, finish: &Finish<'_>) -> Vec<Option<(Plane, Layers)>> {
    let Finish { spec, seed } = *finish;
    let is_straight = is_straight(mesh);
    let across = (!is_straight).then(|| Across::of(spec));
    let layers = |z_um| spec.layers_at_um(z_um, seed);
    let cut = |plane: &super::view::Plane| {
        // Planes of the view are scaled along the tube.
        let normal = DVec3::from(plane.normal) * DVec3::new(1.0, 1.0, staged.view.axial_scale);
        let through = normal * (plane.offset * 1e6 / normal.length_squared());
        let is_across = normal.x == 0.0 && normal.y == 0.0;
        if !is_straight {
            // A plane may cut several parts of a bent tube, so there are no angles around it.
            let around = Layers { vessels: 0.0, longitudinal_cover: 1.0, ..layers(spec.middle_um()) };
            return Some((Plane::through(through.into(), normal.into())?, around));
        }
        match is_across {
            true => Some((Plane::across(through.z), layers(through.z))),
            false => Some((Plane::through(through.into(), normal.into())?, layers(spec.middle_um()))),
        }
    };
    let cap = |k: usize| {
        let inward = if k == 0 { INSET_UM } else { -INSET_UM };
        let first = mesh.patch(CAPS[k]).first()?[0];
        let (z_um, plane) = match &across {
            Some(across) => {
                let z_um = across.ends_um()[k] + inward;
                (z_um, across.at(z_um)?)
            }
            None => {
                let z_um = f64::from(mesh.positions[first as usize][2]) * 1e6 + inward;
                (z_um, Plane::across(z_um))
            }
        };
        Some((plane, layers(z_um)))
    };
    staged.view.cut.iter().map(cut).chain((0..CAPS.len()).map(cap)).collect()
}

/// Parts of the planes that the picture shows.
fn extents(mesh: &Mesh, staged: &Staged, planes: &[Option<(Plane, Layers)>]) -> Vec<Extent> {
    let width = staged.size[0];
    let none = || vec![Extent::NONE; planes.len()];
    let joined = |mut all: Vec<Extent>, others: Vec<Extent>| {
        all.iter_mut().zip(others).for_each(|(extent, other)| *extent = extent.joined(other));
        all
    };
    let rows = staged.samples.par_chunks(width).enumerate();
    rows.fold(none, |mut found, (y, samples)| {
        for (x, &sample) in samples.iter().enumerate().filter(|(_, sample)| sample.depth.is_finite()) {
            let shown = index(mesh, staged, sample).and_then(|k| Some((k, planes[k].as_ref()?.0)));
            if let Some((k, plane)) = shown {
                let p = plane.coordinates(point_um(staged, sample, x, y));
                found[k] = found[k].joined(Extent { low: p, high: p });
            }
        }
        found
    })
    .reduce(none, joined)
}

/// Point that a sample shows, in the axes of the mesh, µm.
pub(super) fn point_um(staged: &Staged, sample: Sample, x: usize, y: usize) -> [f64; 3] {
    let camera = &staged.camera;
    let point = camera.at(x as f64 + 0.5, y as f64 + 0.5) + camera.forward * f64::from(sample.depth);
    (point * unscaled_um(staged)).into()
}

/// Factors from the scaled space to the axes of the mesh in µm.
fn unscaled_um(staged: &Staged) -> DVec3 {
    DVec3::new(1e6, 1e6, 1e6 / staged.view.axial_scale)
}

/// Sides of a sample on a plane, in the coordinates of the plane, µm.
fn sides(staged: &Staged, plane: &Plane) -> [[f64; 2]; 2] {
    let camera = &staged.camera;
    let normal = (DVec3::from(plane.normal) * unscaled_um(staged)).normalize_or(DVec3::Z);
    let cosine = normal.dot(camera.forward);
    let cosine = if cosine.abs() < MIN_COSINE { MIN_COSINE.copysign(cosine) } else { cosine };
    [camera.right, camera.up].map(|side| {
        let along = side - camera.forward * (normal.dot(side) / cosine);
        let moved = along * unscaled_um(staged) / camera.scale;
        [plane.u, plane.v].map(|axis| DVec3::from(axis).dot(moved))
    })
}

#[cfg(test)]
mod tests;
