//! The camera, and the planes that cut parts of a model away.

use super::picture::{MAX_SIZE, RenderError};
use glam::{DVec2, DVec3};

/// A half-space: the points p with `normal · p > offset` lie in front. Metres, axes of the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Direction of the front side; need not have unit length.
    pub normal: [f64; 3],
    /// Distance along the normal.
    pub offset: f64,
}

impl Plane {
    pub(super) fn is_in_front(&self, point: DVec3) -> bool {
        DVec3::from(self.normal).dot(point) > self.offset
    }
}

/// A view of a mesh. The camera is outside of the model and frames the part that remains after cutting.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Width of the picture, pixels.
    pub width: u32,
    /// Height of the picture, pixels.
    pub height: u32,
    /// Degrees around the vertical axis; 0 looks at the ampulla end along the tube, 90 at its side (from +x).
    pub azimuth_deg: f64,
    /// Degrees above the horizontal plane.
    pub elevation_deg: f64,
    /// Vertical angle of view, degrees.
    pub field_of_view_deg: f64,
    /// Factor on lengths along the tube, to fit a long thin organ into a picture; 1 keeps the proportions.
    pub axial_scale: f64,
    /// The part in front of all of these is cut away: one plane halves the model, two remove a wedge.
    pub cut: Vec<Plane>,
}

impl View {
    /// The whole model, from the ampulla end and a little above.
    #[must_use]
    pub fn whole(width: u32, height: u32) -> Self {
        Self {
            width,
            height,
            azimuth_deg: 38.0,
            elevation_deg: 22.0,
            field_of_view_deg: 25.0,
            axial_scale: 1.0,
            cut: Vec::new(),
        }
    }

    /// As [`whole`](Self::whole), with the quarter towards the camera removed along the tube's axis (x = y = 0),
    /// so that the folds are visible in both directions.
    #[must_use]
    pub fn opened(width: u32, height: u32) -> Self {
        let plane = |normal| Plane { normal, offset: 0.0 };
        Self { cut: vec![plane([1.0, 0.0, 0.0]), plane([0.0, 1.0, 0.0])], ..Self::whole(width, height) }
    }

    pub(super) fn check(&self) -> Result<(), RenderError> {
        let sides = 1..=MAX_SIZE;
        if !sides.contains(&self.width) || !sides.contains(&self.height) {
            return Err(RenderError::Size { width: self.width, height: self.height });
        }
        if !(self.azimuth_deg.is_finite() && self.elevation_deg.abs() < 89.9) {
            return Err(RenderError::View("azimuth must be finite, elevation within ±89.9 degrees"));
        }
        if !(1.0..=120.0).contains(&self.field_of_view_deg) {
            return Err(RenderError::View("the angle of view must be from 1 to 120 degrees"));
        }
        if !(1e-3..=1e3).contains(&self.axial_scale) {
            return Err(RenderError::View("the axial scale must be from 0.001 to 1000"));
        }
        Ok(())
    }

    /// Whether a point is cut away.
    pub(super) fn is_cut(&self, point: DVec3) -> bool {
        !self.cut.is_empty() && self.cut.iter().all(|plane| plane.is_in_front(point))
    }
}

/// A camera that frames given points: perspective, looking along `forward`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Camera {
    pub eye: DVec3,
    pub right: DVec3,
    pub up: DVec3,
    pub forward: DVec3,
    /// Pixels per unit of x/depth and y/depth.
    focal: f64,
    centre: DVec2,
}

/// A point projected by the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Projected {
    pub x: f32,
    pub y: f32,
    /// 1/depth: linear across the picture, greater is nearer; not positive behind the camera.
    pub inverse_depth: f32,
}

impl Camera {
    /// Frames `points` (scaled already) in `width` × `height` samples.
    pub(super) fn framing(view: &View, points: &[DVec3], width: u32, height: u32) -> Self {
        let (sin_a, cos_a) = sin_cos_deg(view.azimuth_deg);
        let (sin_e, cos_e) = sin_cos_deg(view.elevation_deg);
        let forward = -DVec3::new(sin_a * cos_e, sin_e, cos_a * cos_e);
        let right = forward.cross(DVec3::Y).normalize();
        let up = right.cross(forward);
        let (width, height) = (f64::from(width), f64::from(height));
        let (sin_h, cos_h) = sin_cos_deg(view.field_of_view_deg / 2.0);
        let focal = height / 2.0 * cos_h / sin_h;
        // Slopes of the picture's sides, with a border of 4 %.
        let slope = DVec2::new(width, height) / (2.0 * focal) * 0.96;
        let local: Vec<DVec3> = points.iter().map(|p| DVec3::new(right.dot(*p), up.dot(*p), forward.dot(*p))).collect();
        let (min, max) =
            local.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(min, max), p| (min.min(*p), max.max(*p)));
        let mut eye = if local.is_empty() { DVec3::ZERO } else { (min + max) / 2.0 };
        for round in 0..5 {
            // Shift so that the margins on opposite sides are equal, and move back as far as needed.
            let seen = local.iter().map(|p| (p.truncate() - eye.truncate()) / (p.z - eye.z).max(1e-12));
            let (low, high) =
                seen.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), s| (low.min(s), high.max(s)));
            if round > 0 && low.x <= high.x {
                eye += ((low + high) / 2.0 * ((min.z + max.z) / 2.0 - eye.z)).extend(0.0);
            }
            let needed = |p: &DVec3| ((p.truncate() - eye.truncate()).abs() / slope).max_element() - p.z;
            eye.z = if local.is_empty() { -1.0 } else { -local.iter().map(needed).fold(1e-9 - min.z, f64::max) };
        }
        Self {
            eye: right * eye.x + up * eye.y + forward * eye.z,
            right,
            up,
            forward,
            focal,
            centre: DVec2::new(width, height) / 2.0,
        }
    }

    /// Projects a point.
    pub(super) fn project(&self, point: DVec3) -> Projected {
        let p = point - self.eye;
        let depth = self.forward.dot(p);
        Projected {
            x: (self.centre.x + self.focal * self.right.dot(p) / depth) as f32,
            y: (self.centre.y - self.focal * self.up.dot(p) / depth) as f32,
            inverse_depth: (1.0 / depth) as f32,
        }
    }

    /// Direction through a point of the picture, of depth 1.
    pub(super) fn ray(&self, x: f64, y: f64) -> DVec3 {
        self.forward + self.right * ((x - self.centre.x) / self.focal) - self.up * ((y - self.centre.y) / self.focal)
    }
}

/// Sine and cosine by a library that gives the same bits on every machine.
fn sin_cos_deg(degrees: f64) -> (f64, f64) {
    libm::sincos(degrees.to_radians())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn framed_points_are_in_the_picture_and_rays_hit_them(
            points in prop::collection::vec(prop::array::uniform3(-1.0f64..1.0), 1..20),
            azimuth_deg in -180.0f64..180.0, elevation_deg in -80.0f64..80.0,
        ) {
            let view = View { azimuth_deg, elevation_deg, ..View::whole(200, 100) };
            let points: Vec<DVec3> = points.into_iter().map(DVec3::from).collect();
            let camera = Camera::framing(&view, &points, 200, 100);
            for &point in &points {
                let seen = camera.project(point);
                prop_assert!(seen.inverse_depth > 0.0);
                prop_assert!((0.0..=200.0).contains(&seen.x) && (0.0..=100.0).contains(&seen.y), "{:?}", seen);
                let back = camera.eye + camera.ray(f64::from(seen.x), f64::from(seen.y)) / f64::from(seen.inverse_depth);
                prop_assert!(back.distance(point) < 1e-3 / f64::from(seen.inverse_depth).min(1.0));
            }
        }
    }

    #[test]
    fn azimuth_zero_looks_at_the_ampulla_end_with_x_to_the_right() {
        let view = View { azimuth_deg: 0.0, elevation_deg: 0.0, ..View::whole(100, 100) };
        let camera = Camera::framing(&view, &[DVec3::ZERO, DVec3::ONE], 100, 100);
        assert!(camera.eye.z > 1.0);
        assert_eq!((camera.right, camera.up), (DVec3::X, DVec3::Y));
    }

    #[test]
    fn a_wedge_is_the_part_in_front_of_all_planes() {
        let view = View::opened(10, 10);
        assert!(view.is_cut(DVec3::new(1.0, 1.0, 5.0)));
        assert!(!view.is_cut(DVec3::new(1.0, -1.0, 5.0)));
        assert!(!View::whole(10, 10).is_cut(DVec3::ONE));
    }

    #[test]
    fn views_out_of_bounds_are_named() {
        let whole = || View::whole(10, 10);
        for bad in [
            View { width: 0, ..whole() },
            View { elevation_deg: 90.0, ..whole() },
            View { azimuth_deg: f64::NAN, ..whole() },
            View { field_of_view_deg: 0.0, ..whole() },
            View { axial_scale: 0.0, ..whole() },
        ] {
            assert!(bad.check().is_err(), "{bad:?}");
        }
        assert!(View::opened(10, 10).check().is_ok());
    }
}
