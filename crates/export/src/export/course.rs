//! JSON document of the course of a tube: the centre line with its local frames.

use crate::geometry::course::Course;
use crate::spec::{CourseShape, ModelSpec, TurningPoint};
use serde::Serialize;
use serde_json::Value;

/// Maximum distance between the centre line and straight lines between its points, µm.
const TOLERANCE_UM: f64 = 1.0;
/// Maximum number of spans between points.
const MAX_SPANS: f64 = 16_384.0;
/// Maximum turn between two points, radians.
const TWIST_STEP: f64 = 0.02;

/// Centre line that a model follows.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CourseDocument {
    /// Kind of the curve.
    #[cfg_attr(feature = "schema", schema(value_type = String, example = "arc"))]
    pub shape: &'static str,
    /// Start of the model, mm from the isthmus end along the centre line of the whole tube.
    pub from_mm: f64,
    /// End, measured like `from_mm`.
    pub to_mm: f64,
    /// Distance between the ends of the centre line of the whole tube, mm.
    pub end_distance_mm: f64,
    /// Length of the centre line divided by the distance between its ends.
    pub tortuosity: f64,
    /// Twist of the tube around the centre line from end to end, degrees.
    pub twist_deg: f64,
    /// Minimum radius of curvature, mm; null if the course is straight.
    #[cfg_attr(feature = "schema", schema(required = true))]
    pub least_radius_mm: Option<f64>,
    /// True if the course was changed because it was too tight or approached itself too closely.
    pub relaxed: bool,
    /// Turning points of the whole tube from the isthmus end; empty unless the shape is `turns`.
    pub turns: Vec<TurningPoint>,
    /// Points at equal distances, from `from_mm` to `to_mm`.
    pub points: Vec<CoursePoint>,
}

/// Point of a centre line with its local frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CoursePoint {
    /// Place along the centre line of the whole tube, mm.
    pub s_mm: f64,
    /// Position, mm.
    pub position_mm: [f64; 3],
    /// Unit vector along the centre line.
    pub tangent: [f64; 3],
    /// Unit vector of the x axis of the section.
    pub u: [f64; 3],
    /// Unit vector of the y axis of the section.
    pub v: [f64; 3],
    /// Curvature of the centre line, 1/mm.
    pub curvature_per_mm: f64,
}

impl CourseDocument {
    /// Computes the course of a specification.
    #[must_use]
    pub fn of(spec: &ModelSpec) -> Self {
        let [from, to] = spec.piece_um();
        let bent = spec.bent_course();
        let document = |course: &Course| Self {
            shape: spec.course.shape.name(),
            from_mm: from / 1000.0,
            to_mm: to / 1000.0,
            end_distance_mm: course.end_distance() / 1000.0,
            tortuosity: course.tortuosity(),
            twist_deg: spec.course.twist_deg,
            least_radius_mm: least_radius(course).map(|radius| radius / 1000.0),
            relaxed: bent.as_ref().is_some_and(|bent| bent.relaxed),
            turns: spec.turning_points(),
            points: points(course, from, to),
        };
        match &bent {
            Some(bent) => document(&bent.course),
            None => {
                Self { shape: CourseShape::Straight.name(), ..document(&Course::straight(spec.length_mm * 1000.0)) }
            }
        }
    }

    /// Computes the course of a stored specification; `None` if it cannot be read.
    #[must_use]
    pub fn of_stored(spec: &Value) -> Option<Self> {
        ModelSpec::from_stored(spec).map(|spec| Self::of(&spec))
    }
}

fn least_radius(course: &Course) -> Option<f64> {
    let most = course.places().iter().map(|&at| course.curvature(at)).fold(0.0, f64::max);
    // Rounding leaves a small curvature on a straight line.
    Some(1.0 / most).filter(|radius| *radius < 1e6 * course.length())
}

fn points(course: &Course, from: f64, to: f64) -> Vec<CoursePoint> {
    let step = least_radius(course).map_or(f64::INFINITY, |radius| (8.0 * TOLERANCE_UM * radius).sqrt());
    // A twist turns the frames even where the line is straight.
    let step = step.min(course.length() * TWIST_STEP / course.twist().abs());
    let spans = ((to - from) / step).ceil().clamp(1.0, MAX_SPANS);
    let point = |k: u32| {
        let s = from + (to - from) * f64::from(k) / spans;
        let frame = course.at(s);
        CoursePoint {
            s_mm: s / 1000.0,
            position_mm: (frame.origin / 1000.0).into(),
            tangent: frame.tangent.into(),
            u: frame.u.into(),
            v: frame.v.into(),
            curvature_per_mm: course.curvature(s) * 1000.0,
        }
    };
    (0..=spans as u32).map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::preset;
    use glam::DVec3;
    use serde_json::json;

    fn course(patch: &Value) -> CourseDocument {
        CourseDocument::of(&ModelSpec::resolve(preset("pig").unwrap(), patch).unwrap())
    }

    #[test]
    fn a_straight_tube_has_two_points() {
        let found = course(&json!({}));
        assert_eq!((found.shape, found.points.len(), found.least_radius_mm), ("straight", 2, None));
        assert_eq!((found.tortuosity, found.end_distance_mm), (1.0, 60.0));
        assert_eq!((found.points[1].position_mm, found.points[1].u), ([0.0, 0.0, 60.0], [1.0, 0.0, 0.0]));
        assert!(course(&json!({ "course": { "twist_deg": 90 } })).points.len() > 50);
    }

    #[test]
    fn turning_points_are_counted_from_the_ovary() {
        let turns = json!([[0.2, 170, 0, 0.3], [0.8, 120, 90, 0.3]]);
        let found = course(&json!({ "length_mm": 60, "course": { "shape": "turns", "turns": turns } }));
        let numbers: Vec<_> = found.turns.iter().map(|turn| (turn.number, turn.z_mm, turn.region.as_str())).collect();
        assert_eq!(numbers, [(2, 12.0, "isthmus"), (1, 48.0, "ampulla")]);
        let nearest = found.points.iter().min_by(|a, b| (a.s_mm - 12.0).abs().total_cmp(&(b.s_mm - 12.0).abs()));
        let off = DVec3::from(nearest.unwrap().position_mm).distance(DVec3::from(found.turns[0].position_mm));
        assert!(off < 1.0, "{off}");
        assert_eq!(course(&json!({ "course": { "shape": "arc", "turns": [[0.2, 170, 0, 0.3]] } })).turns, []);
    }

    #[test]
    fn lines_between_points_are_near_the_centre_line() {
        for patch in [
            json!({ "course": { "shape": "arc", "turn_deg": 180 } }),
            json!({ "course": { "shape": "random", "seed": 3 }, "piece": { "from": 0.5 } }),
        ] {
            let spec = ModelSpec::resolve(preset("pig").unwrap(), &patch).unwrap();
            let exact = spec.centre_line().unwrap();
            let found = CourseDocument::of(&spec);
            assert_eq!((found.points[0].s_mm, found.points.last().unwrap().s_mm), (found.from_mm, found.to_mm));
            for pair in found.points.windows(2) {
                let middle = (DVec3::from(pair[0].position_mm) + DVec3::from(pair[1].position_mm)) * 500.0;
                let off = exact.at(500.0 * (pair[0].s_mm + pair[1].s_mm)).origin.distance(middle);
                assert!(off <= 1.05 * TOLERANCE_UM, "{off}");
            }
        }
    }
}
