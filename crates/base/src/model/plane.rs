//! Planes with coordinates.

use serde::Serialize;

/// A plane with coordinates u and v, in micrometres. Seen from the side to which the normal points,
/// v is 90° counter-clockwise from u.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "schema", schema(as = PlaneAnswer))]
pub struct Plane {
    /// Origin of u and v, micrometres.
    pub origin_um: [f64; 3],
    /// Unit normal.
    pub normal: [f64; 3],
    /// Unit vector of u.
    pub u: [f64; 3],
    /// Unit vector of v.
    pub v: [f64; 3],
    /// Radius around the origin, micrometres, within which the tube is cut. It excludes other parts
    /// of a bent tube; null if there is no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schema(required = false))]
    pub reach_um: Option<f64>,
}

impl Plane {
    /// Plane across a straight tube: u is x, v is y.
    #[must_use]
    pub fn across(z_um: f64) -> Self {
        Self {
            origin_um: [0.0, 0.0, z_um],
            normal: [0.0, 0.0, 1.0],
            u: [1.0, 0.0, 0.0],
            v: [0.0, 1.0, 0.0],
            reach_um: None,
        }
    }

    /// True if the plane cuts at this point of it, which is within `reach_um` of the origin.
    #[must_use]
    pub fn reaches(&self, p_um: [f64; 3]) -> bool {
        let square = |reach: f64| {
            let [u, v] = self.coordinates(p_um);
            u * u + v * v <= reach * reach
        };
        self.reach_um.is_none_or(square)
    }

    /// Plane through a point. u lies along x if the normal is within 45° of the z axis, otherwise
    /// along z, as far as the plane allows. `None` if the normal is zero or a number is not finite.
    #[must_use]
    pub fn through(origin_um: [f64; 3], normal: [f64; 3]) -> Option<Self> {
        // Scaled first, so that squares neither overflow nor vanish.
        let largest = normal.iter().fold(0.0f64, |largest, x| largest.max(x.abs()));
        if !(origin_um.iter().chain(&normal).all(|x| x.is_finite()) && largest > 0.0) {
            return None;
        }
        let normal = unit(normal.map(|x| x / largest));
        let along = if normal[2].abs() >= std::f64::consts::FRAC_1_SQRT_2 { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] };
        let part = dot(along, normal);
        let u = unit([0, 1, 2].map(|axis| along[axis] - part * normal[axis]));
        let v = [
            normal[1] * u[2] - normal[2] * u[1],
            normal[2] * u[0] - normal[0] * u[2],
            normal[0] * u[1] - normal[1] * u[0],
        ];
        Some(Self { origin_um, normal, u, v, reach_um: None })
    }

    /// Height of the plane along its normal.
    #[must_use]
    pub fn height_um(&self) -> f64 {
        self.height_of(self.origin_um)
    }

    /// Height of a point along the normal.
    #[inline]
    #[must_use]
    pub fn height_of(&self, p_um: [f64; 3]) -> f64 {
        dot(p_um, self.normal)
    }

    /// Hash of the plane; equal planes have equal hashes.
    #[must_use]
    pub fn digest(&self) -> u64 {
        let numbers = self.origin_um.iter().chain(&self.normal).chain(&self.reach_um);
        // Fowler–Noll–Vo hash of the bits. Adding zero turns −0 into 0.
        numbers.fold(0xcbf2_9ce4_8422_2325, |hash, x| {
            (x + 0.0)
                .to_bits()
                .to_le_bytes()
                .iter()
                .fold(hash, |hash, &byte| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3))
        })
    }

    /// Coordinates u and v of a point.
    #[must_use]
    pub fn coordinates(&self, p_um: [f64; 3]) -> [f64; 2] {
        let from_origin = [0, 1, 2].map(|axis| p_um[axis] - self.origin_um[axis]);
        [dot(from_origin, self.u), dot(from_origin, self.v)]
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn unit(a: [f64; 3]) -> [f64; 3] {
    let length = dot(a, a).sqrt();
    a.map(|x| x / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_have_right_handed_coordinates() {
        for normal in [[0.0, 0.0, 2.0], [0.0, 0.0, -1e-200], [1e200, 0.0, 0.0], [1.0, -2.0, 0.5], [0.1, 0.2, -1.0]] {
            let plane = Plane::through([1.0, 2.0, 3.0], normal).unwrap();
            let Plane { normal, u, v, .. } = plane;
            for (a, b, expected) in [(u, u, 1.0), (v, v, 1.0), (normal, normal, 1.0), (u, v, 0.0), (u, normal, 0.0)] {
                assert!((dot(a, b) - expected).abs() < 1e-12);
            }
            let cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
            assert!(dot(cross, normal) > 0.999_999);
            let p = [0, 1, 2].map(|axis| plane.origin_um[axis] + 2.0 * u[axis] - 3.0 * v[axis]);
            let [a, b] = plane.coordinates(p);
            assert!((a - 2.0).abs() < 1e-9 && (b + 3.0).abs() < 1e-9);
            assert!((dot(p, normal) - plane.height_um()).abs() < 1e-9);
        }
        assert_eq!(Plane::through([0.0, 0.0, 7.0], [0.0, 0.0, 3.0]), Some(Plane::across(7.0)));
        assert_eq!(Plane::through([0.0; 3], [0.0; 3]), None);
        assert_eq!(Plane::through([0.0; 3], [f64::NAN, 0.0, 1.0]), None);
        assert_eq!(Plane::through([f64::INFINITY, 0.0, 0.0], [0.0, 0.0, 1.0]), None);
    }
}
