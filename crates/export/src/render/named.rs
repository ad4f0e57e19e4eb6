//! Named views, fitted to the size and the proportions of a model, which may be bent.

use super::view::{Plane, View};
use crate::model::{Mesh, PatchKind};
use glam::{DVec3, Vec3};
use std::str::FromStr;

/// Maximum length of a tube in a picture of the whole tube, in widths of the tube.
const MAX_WIDTHS: f64 = 3.0;
/// Factors on lengths along the tube, in descending order.
const AXIAL_SCALES: [f64; 10] = [1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001];
/// Fraction of the length at either end whose extent is the width of that end.
const END: f64 = 0.02;
/// Length of the tube in a picture of an end, in widths of that end.
pub const END_WIDTHS: f64 = 0.8;
/// Maximum elevation of the camera in a picture of a bent tube, whose plane may be horizontal,
/// degrees.
const HIGHEST_DEG: f64 = 70.0;
/// Angle between the tube and the line of sight in a picture of an end, degrees.
const END_AZIMUTH_DEG: f64 = 24.0;

/// A view by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "schema", schema(rename_all = "lowercase"))]
pub enum NamedView {
    /// The whole tube from outside, with the ampulla end in front; long tubes are shortened. A bent
    /// tube is seen from its broadest side, in true proportions.
    Whole,
    /// As [`Whole`](Self::Whole), with a quarter cut away along the tube, so that the folds are
    /// visible in both directions. A bent tube lacks the half in front of the plane nearest to it.
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

    /// Name in requests and on the command line.
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
        match TubeEnds::of(mesh) {
            Some(ends) if !ends.are_straight(mesh) => self.bent(mesh, &ends, size),
            _ => self.straight(mesh, size),
        }
    }

    fn bent(self, mesh: &Mesh, ends: &TubeEnds, size: u32) -> View {
        let plane = |normal: DVec3, through: DVec3| Plane { normal: normal.into(), offset: normal.dot(through) };
        let toward = |d: DVec3, highest: f64, cut: Vec<Plane>, height: u32| View {
            width: size,
            height,
            azimuth_deg: libm::atan2(d.x, d.z).to_degrees(),
            elevation_deg: libm::asin(d.y.clamp(-1.0, 1.0)).to_degrees().clamp(-highest, highest),
            axial_scale: 1.0,
            cut,
        };
        let end = |end: &TubeEnd, far: &TubeEnd| {
            // Slightly from the side and from above.
            let side = end.normal.cross(DVec3::Y).normalize_or(DVec3::X);
            let tilt = side * END_AZIMUTH_DEG.to_radians() + DVec3::Y * (END_AZIMUTH_DEG / 2.0).to_radians();
            // A tube that is not longer than the piece is not cut.
            let kept = END_WIDTHS * end.width;
            let is_long = (end.middle - far.middle).length() > kept;
            let cut = if is_long { vec![plane(-end.normal, end.middle - end.normal * kept)] } else { Vec::new() };
            toward((end.normal + tilt).normalize(), HIGHEST_DEG, cut, size)
        };
        let (middle, normal) = nearest_plane(mesh);
        // From above; for a vertical plane, from the side that the ampulla end faces.
        let normal = if normal.y < 0.0 || (normal.y == 0.0 && normal.z < 0.0) { -normal } else { normal };
        let height = (size * 3).div_ceil(4);
        match self {
            Self::Whole => toward(normal, HIGHEST_DEG, Vec::new(), height),
            Self::Opened => toward(normal, HIGHEST_DEG, vec![plane(normal, middle)], height),
            Self::Isthmus => end(&ends.isthmus, &ends.ampulla),
            Self::Ampulla => end(&ends.ampulla, &ends.isthmus),
        }
    }

    fn straight(self, mesh: &Mesh, size: u32) -> View {
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

/// Error of parsing a name that no view has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("must be {}", NamedView::ALL.map(NamedView::name).join(", "))]
pub struct UnknownView;

/// Largest factor of [`AXIAL_SCALES`] at which a tube is at most [`MAX_WIDTHS`] widths long.
/// `width` and `length` are in any common unit.
fn axial_scale(width: f64, length: f64) -> f64 {
    let fits = AXIAL_SCALES.into_iter().find(|factor| factor * length <= MAX_WIDTHS * width);
    fits.unwrap_or(AXIAL_SCALES[AXIAL_SCALES.len() - 1])
}

/// The cap at an end of a tube.
struct TubeEnd {
    middle: DVec3,
    /// Unit normal that points out of the tube.
    normal: DVec3,
    width: f64,
}

/// Both ends of a tube.
pub(super) struct TubeEnds {
    isthmus: TubeEnd,
    ampulla: TubeEnd,
}

impl TubeEnds {
    /// Finds both ends; `None` if the mesh has no caps.
    pub(super) fn of(mesh: &Mesh) -> Option<Self> {
        let end = |kinds: [PatchKind; 2]| {
            let cap = kinds.into_iter().map(|kind| mesh.patch(kind)).find(|cap| !cap.is_empty())?;
            let at = |v: u32| Vec3::from(mesh.positions[v as usize]).as_dvec3();
            let middle = cap.iter().flatten().map(|&v| at(v)).sum::<DVec3>() / (3 * cap.len()) as f64;
            let normal: DVec3 = cap.iter().map(|&[a, b, c]| (at(b) - at(a)).cross(at(c) - at(a))).sum();
            let reach = cap.iter().flatten().map(|&v| at(v).distance(middle)).fold(0.0, f64::max);
            Some(TubeEnd { middle, normal: normal.normalize_or(DVec3::Z), width: 2.0 * reach })
        };
        let isthmus = end([PatchKind::CapIsthmus, PatchKind::Inlet])?;
        Some(Self { isthmus, ampulla: end([PatchKind::CapAmpulla, PatchKind::Outlet])? })
    }

    /// True if the ends face away from each other along z and the whole mesh lies between them.
    pub(super) fn are_straight(&self, mesh: &Mesh) -> bool {
        let [low, high] = [self.isthmus.middle.z, self.ampulla.middle.z];
        let slack = 1e-3 * (high - low).abs();
        let is_between = |p: &[f32; 3]| (low - slack..=high + slack).contains(&f64::from(p[2]));
        let across = (self.isthmus.middle - self.ampulla.middle).truncate().length();
        self.isthmus.normal.z < -0.999
            && self.ampulla.normal.z > 0.999
            && across <= self.isthmus.width.max(self.ampulla.width)
            && mesh.positions.iter().all(is_between)
    }
}

/// Point and normal of the plane with the minimum sum of squared distances to the vertices.
fn nearest_plane(mesh: &Mesh) -> (DVec3, DVec3) {
    let points = || mesh.positions.iter().map(|p| Vec3::from(*p).as_dvec3());
    let middle = points().sum::<DVec3>() / mesh.positions.len().max(1) as f64;
    let (mut squares, mut products) = (DVec3::ZERO, DVec3::ZERO);
    for p in points() {
        let d = p - middle;
        squares += d * d;
        products += DVec3::new(d.y * d.z, d.z * d.x, d.x * d.y);
    }
    let ([xx, yy, zz], [yz, zx, xy]) = (squares.to_array(), products.to_array());
    // The longest column of the adjugate of the moment matrix has the direction of the smallest
    // moment.
    let columns = [
        DVec3::new(yy * zz - yz * yz, zx * yz - xy * zz, xy * yz - zx * yy),
        DVec3::new(zx * yz - xy * zz, xx * zz - zx * zx, xy * zx - yz * xx),
        DVec3::new(xy * yz - zx * yy, xy * zx - yz * xx, xx * yy - xy * xy),
    ];
    let longest = columns.into_iter().max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
    (middle, longest.unwrap_or(DVec3::Y).normalize_or(DVec3::Y))
}

#[derive(Clone, Copy, Debug)]
struct Bounds {
    min: DVec3,
    max: DVec3,
}

impl Bounds {
    /// Bounds of the vertices for whose z `chosen` is true; zero if there are none.
    fn of(mesh: &Mesh, chosen: impl Fn(f64) -> bool) -> Self {
        let points = mesh.positions.iter().map(|p| Vec3::from(*p).as_dvec3()).filter(|p| chosen(p.z));
        let none = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };
        let bounds = points.fold(none, |b, p| Self { min: b.min.min(p), max: b.max.max(p) });
        if bounds.min.x <= bounds.max.x { bounds } else { Self { min: DVec3::ZERO, max: DVec3::ZERO } }
    }

    /// Maximum extent across the tube.
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
    fn a_bent_tube_is_seen_from_where_it_is_broadest() {
        let straight = sample::tube(60, 40, 0.3);
        for (plane, normal) in [(0, DVec3::Y), (1, DVec3::X)] {
            // A quarter turn towards x or y.
            let mut mesh = straight.clone();
            for p in &mut mesh.positions {
                let (sin, cos) = (p[2] / 4e-3 * std::f32::consts::FRAC_PI_2).sin_cos();
                let radius = 2.55e-3 - p[plane];
                let (x, z) = (2.55e-3 - radius * cos, radius * sin);
                let other = p[1 - plane];
                *p = if plane == 0 { [x, other, z] } else { [other, x, z] };
            }
            assert!(nearest_plane(&mesh).1.dot(normal).abs() > 0.99);
            let view = NamedView::Opened.of(&mesh, 100);
            assert_eq!((view.width, view.height, view.axial_scale, view.cut.len()), (100, 75, 1.0, 1));
            assert!(DVec3::from(view.cut[0].normal).dot(normal).abs() > 0.99);
            assert!(NamedView::Whole.of(&mesh, 100).cut.is_empty());
            let ends = TubeEnds::of(&mesh).unwrap();
            assert!(ends.isthmus.normal.distance(DVec3::NEG_Z) < 1e-3);
            assert!(ends.ampulla.normal.distance(if plane == 0 { DVec3::X } else { DVec3::Y }) < 1e-3);
            assert!((ends.ampulla.width - 2e-3).abs() < 1e-5);
        }
        assert!(TubeEnds::of(&straight).unwrap().are_straight(&straight));
    }

    #[test]
    fn ends_are_shown_with_a_piece_of_tube_in_true_proportions() {
        // The tube is 2 mm wide and 4 mm long.
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
