//! Surfaces of a model to write: bodies, each in the units of its files.

use super::outputs::Outputs;
use super::types::{GenerateError, SurfaceCertificate, SurfaceFinding};
use crate::export::{Metadata, Shape};
use crate::geometry::course::Course;
use crate::measure::{certify_body, certify_regions};
use crate::mesh::bend::bend;
use crate::mesh::quality::Lids;
use crate::mesh::{self, LoftError};
use crate::model::{BodyKind, LengthUnit, Mesh, Section};
use std::borrow::Cow;

/// Bodies of a model, in metres.
pub(super) struct Surfaces<'a> {
    pub(super) tissue: &'a Mesh,
    /// The lumen, and both bodies together, if either is written.
    lumen: Option<(Mesh, Mesh)>,
    /// Written surfaces: each body in each of its units.
    written: Vec<(BodyKind, LengthUnit)>,
}

impl<'a> Surfaces<'a> {
    /// Closes the lumen of `straight` if it is requested, with `lids` if there are any, and bends
    /// it like `tissue`.
    pub(super) fn new(
        tissue: &'a Mesh,
        straight: &Mesh,
        course: Option<&Course>,
        lids: Option<&Lids>,
        outputs: &Outputs,
    ) -> Result<Self, LoftError> {
        let written = written(outputs);
        let lumen = need_lumen(outputs).then(|| {
            let mut regions = match lids {
                Some(lids) => lids.regions(straight),
                None => mesh::regions(straight)?,
            };
            if let Some(course) = course {
                regions = bend(&regions, course);
            }
            Ok((mesh::lumen(&regions), regions))
        });
        Ok(Self { tissue, lumen: lumen.transpose()?, written })
    }

    /// Surface of a body; `None` if it is not written.
    fn body(&self, body: BodyKind) -> Option<&Mesh> {
        match (body, &self.lumen) {
            (BodyKind::Tissue, _) => Some(self.tissue),
            (BodyKind::Lumen, Some((lumen, _))) => Some(lumen),
            (BodyKind::Regions, Some((_, regions))) => Some(regions),
            _ => None,
        }
    }

    /// Certifies all surfaces except the tissue in metres, whose volume is given. Each surface is
    /// certified in the coordinates that are written. Lumen and tissue are certified together in
    /// metres even if only one of them is written. Sums over the tissue are taken in batches of
    /// `sections` if they are given.
    pub(super) fn certify(
        &self,
        tissue_mm3: f64,
        sections: Option<&[Section]>,
    ) -> Result<Vec<SurfaceFinding>, GenerateError> {
        let mut found = Vec::new();
        for unit in LengthUnit::ALL {
            let is_written = |body| self.written.contains(&(body, unit));
            let together = is_written(BodyKind::Regions) || (unit == LengthUnit::Metre && self.lumen.is_some());
            let mut volumes = [tissue_mm3, 0.0];
            if unit != LengthUnit::Metre && (together || is_written(BodyKind::Tissue)) {
                let mut certificate = certify_body(self.tissue, unit);
                if let Some(sections) = sections {
                    certificate.sum_in_batches(self.tissue, unit, sections);
                }
                volumes[0] = certificate.volume_mm3;
                found.push(finding(BodyKind::Tissue, unit, SurfaceCertificate::Body(certificate))?);
            }
            let Some((lumen, regions)) = &self.lumen else { continue };
            if together || is_written(BodyKind::Lumen) {
                let certificate = certify_body(lumen, unit);
                volumes[1] = certificate.volume_mm3;
                found.push(finding(BodyKind::Lumen, unit, SurfaceCertificate::Body(certificate))?);
            }
            if together {
                let certificate = certify_regions(regions, lumen, volumes, unit);
                found.push(finding(BodyKind::Regions, unit, SurfaceCertificate::Regions(certificate))?);
            }
        }
        Ok(found)
    }

    /// Positions of all bodies in all units that are written.
    pub(super) fn placed(&self) -> Vec<Placed<'_>> {
        let place = |&(body, unit): &(BodyKind, LengthUnit)| {
            let mesh = self.body(body)?;
            Some(Placed { mesh, unit, positions: unit.of_metres(&mesh.positions) })
        };
        self.written.iter().filter_map(place).collect()
    }
}

/// Certificate of a body in a unit, as the report contains it. Fails with the first failure of the
/// certificate.
fn finding(body: BodyKind, unit: LengthUnit, certificate: SurfaceCertificate) -> Result<SurfaceFinding, GenerateError> {
    let failure = match &certificate {
        SurfaceCertificate::Body(body) => body.first_failure(),
        SurfaceCertificate::Regions(regions) => regions.first_failure(),
    };
    match failure {
        None => Ok(SurfaceFinding { body, unit, certificate }),
        Some(detail) => {
            Err(GenerateError::Certificate { detail: format!("{} in {}: {detail}", body.name(), unit.name()) })
        }
    }
}

/// Written surfaces: each body in each of its units.
fn written(outputs: &Outputs) -> Vec<(BodyKind, LengthUnit)> {
    let in_unit = |unit| outputs.bodies_in(unit).into_iter().map(move |body| (body, unit));
    LengthUnit::ALL.into_iter().flat_map(in_unit).collect()
}

/// True if the lumen must be closed.
pub(super) fn need_lumen(outputs: &Outputs) -> bool {
    written(outputs).iter().any(|(body, _)| *body != BodyKind::Tissue)
}

/// A body in a unit.
pub(super) struct Placed<'a> {
    mesh: &'a Mesh,
    unit: LengthUnit,
    positions: Cow<'a, [[f32; 3]]>,
}

impl<'a> Placed<'a> {
    /// Input of the writers, with the body and the unit.
    pub(super) fn shape(&'a self, meta: &'a Metadata) -> (BodyKind, LengthUnit, Shape<'a>) {
        let shape = Shape { positions: &self.positions, unit: self.unit, ..Shape::of(self.mesh, meta) };
        (self.mesh.body, self.unit, shape)
    }
}
