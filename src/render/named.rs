//! Views by name, fitted to the size and the proportions of a model.

use super::view::{Plane, View};
use crate::model::Mesh;
use glam::{DVec3, Vec3};
use std::str::FromStr;

/// Greatest length of a tube in a picture of all of it, in widths of the tube.
const MOST_WIDTHS: f64 = 3.0;
/// Factors on lengths along the tube, in descending order.
const AXIAL_SCALES: [f64; 10] = [1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001];
/// Part of the length, at either end, whose extent is taken as the width of that end.
const END: f64 = 0.02;
/// Length of tube in a picture of an end, in widths of that end.
pub const END_WIDTHS: f64 = 0.8;
/// Angle between the tube and the line of sight in a picture of an end.
const END_AZIMUTH_DEG: f64 = 24.0;

/// A view by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, utoipa::ToSchema)]
#[schema(rename_all = "lowercase")]
pub enum NamedView {
    /// The whole tube from outside, with the ampulla end in front; long tubes are shortened.
    Whole,
    /// As [`Whole`](Self::Whole), with a quarter cut away along the tube, so that the folds are visible in both directions.
    #[default]
    Opened,
    /// The isthmus end with a piece of tube nearly as long as wide, in true proportions.
    Isthmus,
    /// The ampulla end with a piece of tube nearly as long as wide, in true proportions.
    Ampulla,
}

impl NamedView {
    /// All views.
    pub const ALL: [Self; 4] = [Self::Whole, Self::Opened, Self::Isthmus, Self::Ampulla];

    /// The name in requests and on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Whole => "whole",
            Self::Opened => "opened",
            Self::Isthmus => "isthmus",
            Self::Ampulla => "ampulla",
        }
    }

    /// This view of a mesh in a picture whose longest side has `size` pixels.
    #[must_use]
    pub fn of(self, mesh: &Mesh, size: u32) -> View {
        let bounds = Bounds::of(mesh, |_| true);
        let length = bounds.max.z - bounds.min.z;
        let middle = (bounds.min + bounds.max) / 2.0;
        let whole = View {
            width: size,
            height: (size * 2).div_ceil(3),
            azimuth_deg: 50.0,
            elevation_deg: 24.0,
            axial_scale: axial_scale(bounds.width(), length),
            cut: Vec::new(),
        };
        let square = View { height: size, elevation_deg: 14.0, axial_scale: 1.0, ..whole.clone() };
        let plane = |normal: [f64; 3], through: DVec3| Plane { normal, offset: DVec3::from(normal).dot(through) };
        match self {
            Self::Whole => whole,
            Self::Opened => {
                let cut = vec![plane([1.0, 0.0, 0.0], middle), plane([0.0, 1.0, 0.0], middle)];
                View { cut, ..whole }
            }
            Self::Isthmus => {
                let end = Bounds::of(mesh, |z| z <= bounds.min.z + END * length);
                let cut = vec![plane([0.0, 0.0, 1.0], DVec3::Z * (bounds.min.z + END_WIDTHS * end.width()))];
                View { azimuth_deg: 180.0 + END_AZIMUTH_DEG, cut, ..square }
            }
            Self::Ampulla => {
                let end = Bounds::of(mesh, |z| z >= bounds.max.z - END * length);
                let cut = vec![plane([0.0, 0.0, -1.0], DVec3::Z * (bounds.max.z - END_WIDTHS * end.width()))];
                View { azimuth_deg: END_AZIMUTH_DEG, cut, ..square }
            }
        }
    }
}

impl FromStr for NamedView {
    type Err = UnknownView;

    fn from_str(name: &str) -> Result<Self, UnknownView> {
        Self::ALL.into_iter().find(|view| view.name() == name).ok_or(UnknownView)
    }
}

/// The name is not that of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("must be {}", NamedView::ALL.map(NamedView::name).join(", "))]
pub struct UnknownView;

/// The greatest round factor at which a tube of this size, in any unit, is at most [`MOST_WIDTHS`] long.
fn axial_scale(width: f64, length: f64) -> f64 {
    let fits = AXIAL_SCALES.into_iter().find(|factor| factor * length <= MOST_WIDTHS * width);
    fits.unwrap_or(AXIAL_SCALES[AXIAL_SCALES.len() - 1])
}

#[derive(Clone, Copy, Debug)]
struct Bounds {
    min: DVec3,
    max: DVec3,
}

impl Bounds {
    /// Bounds of the vertices whose z is chosen; zero if there are none.
    fn of(mesh: &Mesh, chosen: impl Fn(f64) -> bool) -> Self {
        let points = mesh.positions.iter().map(|p| Vec3::from(*p).as_dvec3()).filter(|p| chosen(p.z));
        let none = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };
        let bounds = points.fold(none, |b, p| Self { min: b.min.min(p), max: b.max.max(p) });
        if bounds.min.x <= bounds.max.x { bounds } else { Self { min: DVec3::ZERO, max: DVec3::ZERO } }
    }

    /// Greatest extent across the tube.
    fn width(&self) -> f64 {
        (self.max - self.min).truncate().max_element()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sample;

    #[test]
    fn names_are_read_back() {
        for view in NamedView::ALL {
            assert_eq!(view.name().parse(), Ok(view));
        }
        assert_eq!("Whole".parse::<NamedView>(), Err(UnknownView));
        assert_eq!(UnknownView.to_string(), "must be whole, opened, isthmus, ampulla");
    }

    #[test]
    fn long_tubes_are_shortened_by_a_round_factor() {
        for (length, factor) in [(1.0, 1.0), (3.0, 1.0), (4.0, 0.5), (60.0, 0.05), (29.0, 0.1), (1e9, 0.001)] {
            assert_eq!(axial_scale(1.0, length), factor, "{length}");
        }
        assert_eq!(axial_scale(0.0, 0.0), 1.0);
    }

    #[test]
    fn ends_are_shown_with_a_piece_of_tube_in_true_proportions() {
        // 2 mm wide, 4 mm long.
        let mesh = sample::tube(60, 12, 0.3);
        for (name, normal, kept) in [(NamedView::Isthmus, 1.0, 1.6e-3), (NamedView::Ampulla, -1.0, 2.4e-3)] {
            let view = name.of(&mesh, 100);
            assert_eq!((view.width, view.height, view.axial_scale), (100, 100, 1.0));
            assert_eq!(view.cut[0].normal, [0.0, 0.0, normal]);
            assert!((view.cut[0].offset.abs() - kept).abs() < 1e-5, "{view:?}");
        }
        let whole = NamedView::Whole.of(&mesh, 100);
        assert_eq!((whole.width, whole.height, whole.axial_scale), (100, 67, 1.0));
    }
}
