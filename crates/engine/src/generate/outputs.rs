//! Files of a model: formats and, for formats that contain a surface, bodies and units.

use crate::export::{centreline, glb, labels, lod, obj, ply, stl, threemf, vtp};
use crate::model::{BodyKind, LengthUnit};
use serde::{Deserialize, Serialize};

/// A format of the model: one or several files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Output {
    /// Binary glTF.
    Glb,
    /// glTF as text, with its data in a second file.
    Gltf,
    /// Wavefront OBJ.
    Obj,
    /// Binary STL.
    Stl,
    /// STL as text, one solid for each patch.
    StlAscii,
    /// Binary PLY.
    Ply,
    /// VTK XML `PolyData`, for VTK, `ParaView` and `PyVista`.
    Vtp,
    /// 3MF for printing. `regions` is two closed objects, tissue and lumen.
    #[serde(rename = "3mf")]
    ThreeMf,
    /// The centre line with arc length and radii, as VTK XML and as CSV.
    Centreline,
    /// Levels of detail for viewers: three binary glTF files of the tissue with all, about 300,000
    /// and about 60,000 triangles, quantized and compressed.
    Lod,
    /// The tissue of every voxel of a piece of the tube (`/labels` of the spec) as OME-TIFF and
    /// NIfTI-1.
    Labels,
}

impl Output {
    /// All formats.
    pub const ALL: [Self; 11] = [
        Self::Glb,
        Self::Gltf,
        Self::Obj,
        Self::Stl,
        Self::StlAscii,
        Self::Ply,
        Self::Vtp,
        Self::ThreeMf,
        Self::Centreline,
        Self::Lod,
        Self::Labels,
    ];
    /// Formats of a request that names none.
    pub const DEFAULT: [Self; 2] = [Self::Glb, Self::Lod];

    /// Name in requests.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Glb => "glb",
            Self::Gltf => "gltf",
            Self::Obj => "obj",
            Self::Stl => "stl",
            Self::StlAscii => "stl-ascii",
            Self::Ply => "ply",
            Self::Vtp => "vtp",
            Self::ThreeMf => "3mf",
            Self::Centreline => "centreline",
            Self::Lod => "lod",
            Self::Labels => "labels",
        }
    }

    /// Endings of the files of a surface format, with their media types: one set of files per body.
    /// Empty for other formats.
    #[must_use]
    pub fn endings(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Self::Glb => &[("glb", glb::MEDIA_TYPE)],
            Self::Gltf => &[("gltf", glb::TEXT_MEDIA_TYPE), ("bin", glb::BUFFER_MEDIA_TYPE)],
            Self::Obj => &[("obj", obj::MEDIA_TYPE)],
            Self::Stl => &[("stl", stl::MEDIA_TYPE)],
            Self::StlAscii => &[("ascii.stl", stl::MEDIA_TYPE)],
            Self::Ply => &[("ply", ply::MEDIA_TYPE)],
            Self::Vtp => &[("vtp", vtp::MEDIA_TYPE)],
            Self::ThreeMf => &[("3mf", threemf::MEDIA_TYPE)],
            Self::Centreline | Self::Lod | Self::Labels => &[],
        }
    }

    /// Names of the files of a format that has one set of files for the whole model. Empty for
    /// other formats.
    #[must_use]
    pub fn files(self) -> &'static [&'static str] {
        match self {
            Self::Centreline => &centreline::FILES,
            Self::Lod => &lod::FILES,
            Self::Labels => &labels::FILES,
            _ => &[],
        }
    }

    /// Unit of lengths; `None` if the format has no unit.
    #[must_use]
    pub fn unit(self, asked: Option<LengthUnit>) -> Option<LengthUnit> {
        match self {
            Self::Glb | Self::Gltf | Self::Lod => Some(LengthUnit::Metre),
            Self::Obj => Some(asked.unwrap_or(LengthUnit::Metre)),
            Self::Stl | Self::StlAscii | Self::Ply | Self::Vtp | Self::ThreeMf | Self::Centreline => {
                Some(asked.unwrap_or(LengthUnit::Millimetre))
            }
            Self::Labels => None,
        }
    }
}

/// Beginning of the names of the files of a body.
pub(super) fn stem(body: BodyKind) -> &'static str {
    match body {
        BodyKind::Tissue => "model",
        BodyKind::Lumen | BodyKind::Regions => body.name(),
    }
}

/// Format and body of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Kind {
    /// Format.
    pub(super) output: Output,
    /// Body; `None` if the whole model has one file.
    pub(super) body: Option<BodyKind>,
}

/// Finds the kind of a file; `None` for files that are always written.
pub(super) fn kind_of(name: &str) -> Option<Kind> {
    Output::ALL.into_iter().find_map(|output| {
        if output.files().contains(&name) {
            return Some(Kind { output, body: None });
        }
        let of = |body: &BodyKind| {
            let ending = name.strip_prefix(stem(*body)).and_then(|rest| rest.strip_prefix('.'));
            ending.is_some_and(|ending| output.endings().iter().any(|(known, _)| *known == ending))
        };
        BodyKind::ALL.into_iter().find(of).map(|body| Kind { output, body: Some(body) })
    })
}

/// Requested files of a model, besides those that are always written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outputs {
    /// Formats.
    pub formats: Vec<Output>,
    /// Bodies whose surfaces are written in each surface format.
    pub bodies: Vec<BodyKind>,
    /// Unit of formats with a choice; `None` for the default of each format.
    pub units: Option<LengthUnit>,
}

impl From<Vec<Output>> for Outputs {
    /// These formats of the tissue.
    fn from(formats: Vec<Output>) -> Self {
        Self { formats, bodies: vec![BodyKind::Tissue], units: None }
    }
}

impl Default for Outputs {
    fn default() -> Self {
        Output::DEFAULT.to_vec().into()
    }
}

impl Outputs {
    /// No files besides those that are always written.
    #[must_use]
    pub fn none() -> Self {
        Vec::new().into()
    }

    /// True if the format is requested.
    #[must_use]
    pub fn has(&self, output: Output) -> bool {
        self.formats.contains(&output)
    }

    /// True if all files of `others` are among these files.
    #[must_use]
    pub fn include(&self, others: &Self) -> bool {
        others.formats.iter().all(|format| {
            self.has(*format)
                && (format.endings().is_empty() || others.bodies.iter().all(|body| self.bodies.contains(body)))
                && format.unit(self.units) == format.unit(others.units)
        })
    }

    /// True if a file is among these files, or always written.
    #[must_use]
    pub fn want(&self, name: &str) -> bool {
        kind_of(name)
            .is_none_or(|Kind { output, body }| self.has(output) && body.is_none_or(|body| self.bodies.contains(&body)))
    }

    /// The requested unit, if all formats have a fixed unit or none, so that it has no effect.
    #[must_use]
    pub fn units_unused(&self) -> Option<LengthUnit> {
        let has_choice = |format: &Output| {
            let units = LengthUnit::ALL.map(|unit| format.unit(Some(unit)));
            units.iter().any(|unit| *unit != units[0])
        };
        self.units.filter(|_| !self.formats.iter().any(has_choice))
    }

    /// Names of the files.
    #[must_use]
    pub fn files(&self) -> Vec<String> {
        let of = |output: &Output| {
            let surfaces = self
                .bodies
                .iter()
                .flat_map(|&body| output.endings().iter().map(move |(ending, _)| format!("{}.{ending}", stem(body))));
            surfaces.chain(output.files().iter().map(|name| (*name).to_owned())).collect::<Vec<_>>()
        };
        self.formats.iter().flat_map(of).collect()
    }

    /// Bodies that are written in a unit.
    #[must_use]
    pub fn bodies_in(&self, unit: LengthUnit) -> Vec<BodyKind> {
        let is_written = |format: &Output| !format.endings().is_empty() && format.unit(self.units) == Some(unit);
        if self.formats.iter().any(is_written) { self.bodies.clone() } else { Vec::new() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outputs(formats: &[Output], bodies: &[BodyKind], units: Option<LengthUnit>) -> Outputs {
        Outputs { formats: formats.to_vec(), bodies: bodies.to_vec(), units }
    }

    #[test]
    fn names_in_requests_are_those_of_the_formats() {
        for output in Output::ALL {
            assert_eq!(serde_json::to_value(output).unwrap(), output.name());
            assert_ne!(output.endings().is_empty(), output.files().is_empty(), "{output:?}");
        }
        for body in BodyKind::ALL {
            assert_eq!(serde_json::to_value(body).unwrap(), body.name());
        }
        for unit in LengthUnit::ALL {
            assert_eq!(serde_json::to_value(unit).unwrap(), unit.name());
        }
    }

    #[test]
    fn every_file_has_one_kind() {
        let all = outputs(&Output::ALL, &BodyKind::ALL, None);
        let names = all.files();
        let distinct: std::collections::BTreeSet<&String> = names.iter().collect();
        assert_eq!((names.len(), distinct.len()), (3 * 9 + 2 + 3 + 2, names.len()));
        for name in &names {
            let kind = kind_of(name).unwrap();
            let one = outputs(&[kind.output], &[kind.body.unwrap_or(BodyKind::Tissue)], None);
            assert!(one.want(name) && one.files().contains(name), "{name}");
            assert!(!outputs(&[], &BodyKind::ALL, None).want(name));
        }
        assert_eq!(kind_of("model.ascii.stl").map(|kind| kind.output), Some(Output::StlAscii));
        for other in ["report.json", "sections.bin", "model", "lumen.", "other.glb", "model.glb.glb"] {
            assert_eq!(kind_of(other), None, "{other}");
            assert!(outputs(&[], &[], None).want(other));
        }
    }

    #[test]
    fn a_unit_is_unused_if_no_format_has_a_choice() {
        let unused = |formats: &[Output], units| outputs(formats, &[BodyKind::Tissue], units).units_unused();
        let mm = Some(LengthUnit::Millimetre);
        assert_eq!(unused(&[Output::Glb, Output::Gltf, Output::Lod, Output::Labels], mm), mm);
        assert_eq!(unused(&[], mm), mm);
        assert_eq!(unused(&[Output::Glb], None), None);
        for format in [Output::Obj, Output::Stl, Output::StlAscii, Output::Ply, Output::Vtp, Output::Centreline] {
            assert_eq!(unused(&[Output::Glb, format], mm), None, "{format:?}");
        }
    }

    #[test]
    fn files_are_included_if_format_body_and_unit_are() {
        use BodyKind::{Lumen, Tissue};
        let both = outputs(&[Output::Glb, Output::Stl], &[Tissue, Lumen], None);
        assert!(both.include(&both) && both.include(&outputs(&[Output::Stl], &[Lumen], None)));
        assert!(both.include(&outputs(&[Output::Stl], &[Lumen], Some(LengthUnit::Millimetre))), "the habit of STL");
        assert!(!both.include(&outputs(&[Output::Stl], &[Lumen], Some(LengthUnit::Metre))));
        assert!(both.include(&outputs(&[Output::Glb], &[Lumen], Some(LengthUnit::Micrometre))), "always metres");
        assert!(!both.include(&outputs(&[Output::Ply], &[Lumen], None)));
        assert!(!outputs(&[Output::Glb], &[Tissue], None).include(&outputs(&[Output::Glb], &[Lumen], None)));
        assert!(outputs(&[Output::Lod], &[Tissue], None).include(&outputs(&[Output::Lod], &[Lumen], None)));
    }
}
