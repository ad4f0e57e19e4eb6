//! Views of a mesh: the camera, and the planes that cut parts of the mesh away.

use super::picture::{MAX_SIZE, RenderError};
use glam::{DVec2, DVec3};

/// Margin of a picture, as a fraction of its longest side.
const MARGIN: f64 = 0.035;

/// A plane in the axes of the mesh, metres. The points p with `normal · p > offset` lie in front of
/// it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Direction of the front side, of any length.
    pub normal: [f64; 3],
    /// Value of `normal · p` on the plane.
    pub offset: f64,
}

/// A view of a mesh: an orthographic projection that frames the part that remains after cutting.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Width of the picture, pixels.
    pub width: u32,
    /// Height of the picture, pixels.
    pub height: u32,
    /// Angle around the vertical axis, degrees. 0 looks at the ampulla end along the tube, 90 at
    /// the side of the tube from +x.
    pub azimuth_deg: f64,
    /// Angle above the horizontal plane, degrees.
    pub elevation_deg: f64,
    /// Factor on lengths along the tube, to fit a long thin tube into a picture. 1 keeps the
    /// proportions.
    pub axial_scale: f64,
    /// Planes of the cut. The part in front of all planes is removed: one plane halves the model,
    /// two remove a wedge.
    pub cut: Vec<Plane>,
}

impl View {
    pub(super) fn check(&self) -> Result<(), RenderError> {
        let sides = 1..=MAX_SIZE;
        if !sides.contains(&self.width) || !sides.contains(&self.height) {
            return Err(RenderError::Size { width: self.width, height: self.height });
        }
        if !(self.azimuth_deg.is_finite() && self.elevation_deg.abs() < 89.9) {
            return Err(RenderError::View("azimuth must be finite, elevation within ±89.9 degrees"));
        }
        if !(1e-3..=1e3).contains(&self.axial_scale) {
            return Err(RenderError::View("the axial scale must be from 0.001 to 1000"));
        }
        Ok(())
    }

    /// Points where the segment from `a` to `b` enters and leaves the part that is cut away.
    pub(super) fn crossings(&self, a: DVec3, b: DVec3) -> impl Iterator<Item = DVec3> {
        let (mut enters, mut leaves) = (f64::NEG_INFINITY, f64::INFINITY);
        for plane in &self.cut {
            let normal = DVec3::from(plane.normal);
            let (along, before) = (normal.dot(b - a), plane.offset - normal.dot(a));
            if along > 0.0 {
                enters = enters.max(before / along);
            } else if along < 0.0 {
                leaves = leaves.min(before / along);
            } else if before >= 0.0 {
                leaves = f64::NEG_INFINITY;
            }
        }
        let crosses = !self.cut.is_empty() && enters < leaves;
        [enters, leaves].into_iter().filter(move |at| crosses && (0.0..=1.0).contains(at)).map(move |at| a.lerp(b, at))
    }

    /// True if a point is cut away.
    pub(super) fn is_cut(&self, point: DVec3) -> bool {
        !self.cut.is_empty() && self.cut.iter().all(|plane| DVec3::from(plane.normal).dot(point) > plane.offset)
    }
}

/// An orthographic camera that frames given points.
#[derive(Clone, Copy, Debug)]
pub(super) struct Camera {
    pub right: DVec3,
    pub up: DVec3,
    pub forward: DVec3,
    /// Samples per unit of length.
    pub scale: f64,
    /// Point of depth 0 that is shown at `middle`.
    centre: DVec3,
    /// Position of `centre` in the picture, samples.
    middle: DVec2,
}

/// A point projected by the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Projected {
    pub x: f32,
    pub y: f32,
    /// Distance along the line of sight, in units of length.
    pub depth: f32,
}

impl Camera {
    /// Frames `points`, which are scaled already, in `width` × `height` samples. The lowest `strip`
    /// rows stay free.
    pub(super) fn framing(view: &View, points: &[DVec3], [width, height]: [u32; 2], strip: f64) -> Self {
        let (sin_a, cos_a) = sin_cos_deg(view.azimuth_deg);
        let (sin_e, cos_e) = sin_cos_deg(view.elevation_deg);
        let forward = -DVec3::new(sin_a * cos_e, sin_e, cos_a * cos_e);
        let right = forward.cross(DVec3::Y).normalize();
        let up = right.cross(forward);
        let local = points.iter().map(|p| DVec3::new(right.dot(*p), up.dot(*p), forward.dot(*p)));
        let (min, max) = local.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(min, max), p| (min.min(p), max.max(p)));
        let framed = min.x <= max.x;
        let centre = if framed { (min + max) / 2.0 } else { DVec3::ZERO };
        let margin = 2.0 * MARGIN * f64::from(width.max(height));
        let room = (DVec2::new(f64::from(width), f64::from(height) - strip) - margin).max(DVec2::ONE);
        let scale = (room / (max - min).truncate()).min_element();
        Self {
            right,
            up,
            forward,
            scale: if framed && scale.is_finite() { scale } else { 1.0 },
            centre: right * centre.x + up * centre.y + forward * centre.z,
            middle: DVec2::new(f64::from(width), f64::from(height) - strip) / 2.0,
        }
    }

    /// Projects a point.
    pub(super) fn project(&self, point: DVec3) -> Projected {
        let p = point - self.centre;
        Projected {
            x: (self.middle.x + self.scale * self.right.dot(p)) as f32,
            y: (self.middle.y - self.scale * self.up.dot(p)) as f32,
            depth: self.forward.dot(p) as f32,
        }
    }

    /// Point of depth 0 at a position in the picture.
    pub(super) fn at(&self, x: f64, y: f64) -> DVec3 {
        let [x, y] = [(x - self.middle.x) / self.scale, (self.middle.y - y) / self.scale];
        self.centre + self.right * x + self.up * y
    }
}

/// Sine and cosine, with the same bits on every machine.
fn sin_cos_deg(degrees: f64) -> (f64, f64) {
    libm::sincos(degrees.to_radians())
}

/// A view without cuts.
#[cfg(test)]
pub(super) fn plain(width: u32, height: u32) -> View {
    View { width, height, azimuth_deg: 38.0, elevation_deg: 22.0, axial_scale: 1.0, cut: Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn framed_points_are_in_the_picture_and_lines_of_sight_hit_them(
            points in prop::collection::vec(prop::array::uniform3(-1.0f64..1.0), 1..20),
            azimuth_deg in -180.0f64..180.0, elevation_deg in -80.0f64..80.0,
        ) {
            let view = View { azimuth_deg, elevation_deg, ..plain(200, 100) };
            let points: Vec<DVec3> = points.into_iter().map(DVec3::from).collect();
            let camera = Camera::framing(&view, &points, [200, 100], 10.0);
            for &point in &points {
                let seen = camera.project(point);
                prop_assert!((0.0..=200.0).contains(&seen.x) && (0.0..=90.0).contains(&seen.y), "{:?}", seen);
                let back = camera.at(f64::from(seen.x), f64::from(seen.y)) + camera.forward * f64::from(seen.depth);
                prop_assert!(back.distance(point) < 1e-4);
            }
        }
    }

    #[test]
    fn azimuth_zero_looks_at_the_ampulla_end_with_x_to_the_right() {
        let view = View { azimuth_deg: 0.0, elevation_deg: 0.0, ..plain(100, 100) };
        let camera = Camera::framing(&view, &[DVec3::ZERO, DVec3::ONE], [100, 100], 0.0);
        assert_eq!((camera.right, camera.up, camera.forward), (DVec3::X, DVec3::Y, DVec3::NEG_Z));
        assert!(camera.project(DVec3::ONE).depth < camera.project(DVec3::ZERO).depth);
    }

    #[test]
    fn a_wedge_is_the_part_in_front_of_all_planes() {
        let plane = |normal| Plane { normal, offset: 0.0 };
        let wedge = View { cut: vec![plane([1.0, 0.0, 0.0]), plane([0.0, 1.0, 0.0])], ..plain(10, 10) };
        assert!(wedge.is_cut(DVec3::new(1.0, 1.0, 5.0)));
        assert!(!wedge.is_cut(DVec3::new(1.0, -1.0, 5.0)));
        assert!(!plain(10, 10).is_cut(DVec3::ONE));
    }

    #[test]
    fn a_segment_crosses_the_surface_of_the_part_that_is_cut_away() {
        let plane = |normal, offset| Plane { normal, offset };
        let wedge = View { cut: vec![plane([1.0, 0.0, 0.0], 1.0), plane([0.0, 1.0, 0.0], 0.0)], ..plain(10, 10) };
        let found = |a: [f64; 2], b: [f64; 2]| -> Vec<[f64; 2]> {
            let [a, b] = [a, b].map(|[x, y]| DVec3::new(x, y, 3.0));
            wedge.crossings(a, b).map(|p| [p.x, p.y]).collect()
        };
        assert_eq!(found([0.0, 1.0], [4.0, 1.0]), [[1.0, 1.0]]);
        assert_eq!(found([2.0, 2.0], [2.0, -2.0]), [[2.0, 0.0]]);
        assert_eq!(found([0.0, 3.0], [4.0, -1.0]), [[1.0, 2.0], [3.0, 0.0]], "through the wedge");
        assert!(found([0.0, 1.0], [0.5, 9.0]).is_empty() && found([0.0, -1.0], [4.0, -1.0]).is_empty());
        assert!(found([2.0, 1.0], [3.0, 2.0]).is_empty(), "within");
        assert_eq!(plain(10, 10).crossings(DVec3::ZERO, DVec3::ONE).count(), 0);
    }

    #[test]
    fn views_out_of_bounds_are_named() {
        let plain = || plain(10, 10);
        for bad in [
            View { width: 0, ..plain() },
            View { elevation_deg: 90.0, ..plain() },
            View { azimuth_deg: f64::NAN, ..plain() },
            View { axial_scale: 0.0, ..plain() },
        ] {
            assert!(bad.check().is_err(), "{bad:?}");
        }
        assert!(plain().check().is_ok());
    }
}
