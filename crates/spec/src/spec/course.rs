//! The course of a tube: the curve that a specification requests, and the room for the tube along
//! it.

use super::fault::Fault;
use super::parameters::{Course as Options, CourseShape, Parameters};
use super::schedule::Schedule;
use crate::geometry::course::{Course, RandomCourse, Relaxation, Room, Turn};
use crate::model::Plane;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Maximum ratio of the tube's radius to the radius of the centre line. At 0.8, the inner side of a
/// bend keeps a fifth of its length.
pub(super) const MAX_RADIUS_RATIO: f64 = 0.8;
/// Nodes of the centre line per radius of the tube along it, and bounds of their number.
const NODES_PER_RADIUS: f64 = 16.0;
const MIN_NODES: f64 = 256.0;
const MAX_NODES: f64 = 8192.0;
/// Number of places at which the radius of the tube is sampled.
const PLACES: u32 = 512;
/// Steps within which the wall reaches its scheduled radius.
const WALL_LAG_STEPS: f64 = 64.0;
/// Maximum radius of the wall divided by its scheduled radius.
const REACH_FACTOR: f64 = 1.01;
/// Minimum angle of a turn, and minimum fraction of the length that a turn takes.
const MIN_TURN_DEG: f64 = 1.0;
const MIN_TURN_SHARE: f64 = 1e-3;
/// Fraction of the length by which turns may overlap or leave the tube, for rounding.
const TOLERANCE: f64 = 1e-9;
/// Minimum clearance between walls, in units of the last place of single-precision positions.
const MIN_CLEARANCE_ULPS: f64 = 4.0;

impl Parameters {
    /// True if the tube is bent or twisted.
    #[must_use]
    pub fn bends(&self) -> bool {
        self.course.shape != CourseShape::Straight || self.course.twist_deg != 0.0
    }

    /// Course of the whole tube, µm. `None` if the tube is straight or there is no room along the
    /// course.
    #[must_use]
    pub fn centre_line(&self) -> Option<Course> {
        self.bent_course().map(|bent| bent.course)
    }

    /// Course with the room along it. `None` if the tube is straight or there is no room.
    #[must_use]
    pub fn bent_course(&self) -> Option<Bent> {
        if self.bends() { self.bent(&Reach::new(self)).ok() } else { None }
    }

    /// Turning points of a course of turns, from the isthmus end. Other courses have none.
    #[must_use]
    pub fn turning_points(&self) -> Vec<TurningPoint> {
        let Some(Bent { course, .. }) = self.bent_course().filter(|_| self.course.shape == CourseShape::Turns) else {
            return Vec::new();
        };
        let (count, regions) = (self.course.turns.len(), &self.regions);
        let landmark = |(i, &[at, turn_deg, ..]): (usize, &[f64; 4])| TurningPoint {
            number: (count - i) as u32,
            z_mm: at * self.length_mm,
            position_mm: (course.at(at * course.length()).origin / 1000.0).into(),
            turn_deg,
            region: match at {
                at if at < regions.junction_from => "isthmus",
                at if at <= regions.junction_to => "junction",
                _ => "ampulla",
            }
            .to_owned(),
        };
        self.course.turns.iter().enumerate().map(landmark).collect()
    }

    /// Fault of the course, if there is one.
    pub(super) fn course_fault(&self) -> Option<Fault> {
        if self.bends() { self.bent(&Reach::new(self)).err() } else { None }
    }

    fn bent(&self, reach: &Reach) -> Result<Bent, Fault> {
        let requested = self.requested_course(reach)?;
        let radius = |place: f64| reach.at(place);
        let room = requested.room(&radius);
        let Some(detail) = self.lack_of_room(&room) else {
            return self.check_precision(Bent { course: requested, room, relaxed: false }, reach);
        };
        let at = self.course.decisive_parameter();
        if !self.course.relax {
            return Err(Fault::new(at, format!("{detail} (use a gentler course, a longer tube, or /course/relax)")));
        }
        let to =
            Relaxation { radius: &radius, max_radius_ratio: MAX_RADIUS_RATIO, min_distance: self.course.clearance_um };
        let course = requested.relaxed(&to);
        let room = course.room(&radius);
        self.check_precision(Bent { course, room, relaxed: true }, reach)
    }

    /// The requested curve, without a check of the room.
    fn requested_course(&self, reach: &Reach) -> Result<Course, Fault> {
        let Options {
            shape, turn_deg, windings, pitch_mm, tortuosity, wavelength_mm, seed, points_mm, twist_deg, ..
        } = &self.course;
        let length = 1000.0 * self.length_mm;
        let nodes = (NODES_PER_RADIUS * length / reach.minimum()).ceil().clamp(MIN_NODES, MAX_NODES) as usize;
        let (turn, twist) = (turn_deg.to_radians(), twist_deg.to_radians());
        let fault = |detail: &str| Fault::new(self.course.decisive_parameter(), detail);
        match shape {
            CourseShape::Straight => {
                Course::through(&[DVec3::ZERO, DVec3::Z], length, nodes, twist).ok_or_else(|| fault("is not a curve"))
            }
            CourseShape::Arc => Ok(Course::arc(turn, length, nodes, twist)),
            CourseShape::Sigmoid => Ok(Course::sigmoid(turn, length, nodes, twist)),
            CourseShape::Coil => Course::coil(*windings, 1000.0 * pitch_mm, length, nodes, twist).ok_or_else(|| {
                fault(&format!("times /course/pitch_mm {pitch_mm} is not less than /length_mm {}", self.length_mm))
            }),
            CourseShape::Random => {
                let of = RandomCourse {
                    seed: u64::from(*seed),
                    wavelength: 1000.0 * wavelength_mm,
                    tortuosity: *tortuosity,
                };
                Course::random(&of, length, nodes, twist).ok_or_else(|| {
                    fault(&format!(
                        "is not reached with waves of /course/wavelength_mm {wavelength_mm}; use shorter ones"
                    ))
                })
            }
            CourseShape::Points => {
                let points: Vec<DVec3> = points_mm.iter().map(|p| 1000.0 * DVec3::from(*p)).collect();
                if points.len() < 2 {
                    return Err(fault(&format!("has {} points; a course of points needs at least 2", points.len())));
                }
                if let Some(i) = (1..points.len()).find(|&i| points[i] == points[i - 1]) {
                    return Err(Fault::new(format!("/course/points_mm/{i}"), "is the point before it"));
                }
                Course::through(&points, length, nodes, twist).ok_or_else(|| fault("is not a curve"))
            }
            CourseShape::Turns => Ok(Course::turns(&self.course.checked_turns()?, length, nodes, twist)),
        }
    }

    /// Describes where there is no room for the tube. `None` if there is room.
    fn lack_of_room(&self, room: &Room) -> Option<String> {
        let mm = |um: f64| um / 1000.0;
        let bend = room.bend;
        if bend.radius_ratio() > MAX_RADIUS_RATIO {
            return Some(format!(
                "is too tight at {:.2} mm from the isthmus end: there the centre line has a radius of curvature of {:.2} mm, and the \
                 wall reaches up to {:.2} mm from it; the radius must be at least {:.2} mm",
                mm(bend.at),
                mm(bend.curve),
                mm(bend.tube),
                mm(bend.tube / MAX_RADIUS_RATIO)
            ));
        }
        let near = room.near.filter(|near| near.distance < self.course.clearance_um)?;
        Some(format!(
            "brings the parts at {:.2} mm and {:.2} mm from the isthmus end too near to each other: their walls may {}; \
             /course/clearance_um is {}",
            mm(near.at[0]),
            mm(near.at[1]),
            if near.distance > 0.0 {
                format!("be only {:.0} µm apart", near.distance)
            } else {
                "intersect".to_owned()
            },
            self.course.clearance_um
        ))
    }

    /// Returns a fault if the course is so far from the origin that the spacing of single-precision
    /// positions exceeds the clearance.
    fn check_precision(&self, bent: Bent, reach: &Reach) -> Result<Bent, Fault> {
        let metres = ((bent.course.extent() + reach.maximum()) * 1e-6) as f32;
        let ulp_um = f64::from(metres.next_up() - metres) * 1e6;
        let least = MIN_CLEARANCE_ULPS * ulp_um;
        if self.scale * self.collision.clearance_um >= least {
            return Ok(bent);
        }
        Err(Fault::new(
            self.course.decisive_parameter(),
            format!(
                "reaches {:.0} mm from the origin, where positions in single precision are {ulp_um:.3} µm apart; that needs a \
                 /collision/clearance_um of at least {:.3}",
                f64::from(metres) * 1e3,
                least / self.scale
            ),
        ))
    }
}

/// A course with room for its tube.
#[derive(Clone, Debug, PartialEq)]
pub struct Bent {
    /// The course, µm.
    pub course: Course,
    /// Room along the course.
    pub room: Room,
    /// True if `course.relax` changed the requested course to make room for the tube.
    pub relaxed: bool,
}

/// Turning point of a course of turns: the middle of a turn, which is a landmark of the organ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct TurningPoint {
    /// Number, counted from the ovary, as in publications: 1 is nearest to the ovary.
    pub number: u32,
    /// Place along the centre line, mm from the isthmus end.
    pub z_mm: f64,
    /// Position on the centre line, mm.
    pub position_mm: [f64; 3],
    /// Angle by which the tube turns, degrees.
    pub turn_deg: f64,
    /// Region of the tube: `isthmus`, `junction` or `ampulla`.
    pub region: String,
}

/// Planes across the tube of a model, straight or bent.
#[derive(Clone, Debug)]
pub struct Across {
    bent: Option<Course>,
    reach: Reach,
    ends_um: [f64; 2],
}

impl Across {
    /// Prepares the planes of a model with these parameters.
    #[must_use]
    pub fn of(p: &Parameters) -> Self {
        Self { bent: p.centre_line(), reach: Reach::new(p), ends_um: p.piece_um() }
    }

    /// Ends of the model along its centre line, µm.
    #[must_use]
    pub fn ends_um(&self) -> [f64; 2] {
        self.ends_um
    }

    /// True if the tube is bent or twisted.
    #[must_use]
    pub fn bends(&self) -> bool {
        self.bent.is_some()
    }

    /// Plane at a place along the centre line. `None` if the model is bent and the place is beyond
    /// its ends.
    #[must_use]
    pub fn at(&self, place_um: f64) -> Option<Plane> {
        match &self.bent {
            Some(course) => course.plane_across(place_um, self.ends_um, self.reach.at(place_um)),
            None => Some(Plane::across(place_um)),
        }
    }
}

impl Options {
    /// Pointer of the parameter with the largest effect on the course, for faults.
    fn decisive_parameter(&self) -> &'static str {
        match self.shape {
            CourseShape::Straight => "/course/twist_deg",
            CourseShape::Arc | CourseShape::Sigmoid => "/course/turn_deg",
            CourseShape::Coil => "/course/windings",
            CourseShape::Random => "/course/tortuosity",
            CourseShape::Points => "/course/points_mm",
            CourseShape::Turns => "/course/turns",
        }
    }

    /// The turns of a course of turns, in order and within the tube.
    fn checked_turns(&self) -> Result<Vec<Turn>, Fault> {
        if self.turns.is_empty() {
            return Err(Fault::new("/course/turns", "has 0 turns; a course of turns needs at least 1"));
        }
        let mut turns: Vec<Turn> = Vec::with_capacity(self.turns.len());
        for (i, &[at, turn_deg, toward_deg, share]) in self.turns.iter().enumerate() {
            let fault = |k: usize, detail: String| Err(Fault::new(format!("/course/turns/{i}/{k}"), detail));
            if turn_deg < MIN_TURN_DEG {
                return fault(1, format!("is {turn_deg}; a turn needs an angle of at least {MIN_TURN_DEG}°"));
            }
            if !(MIN_TURN_SHARE..=1.0).contains(&share) {
                return fault(3, format!("is {share}; a turn takes from {MIN_TURN_SHARE} to 1 of the length"));
            }
            let turn = Turn { at, angle: turn_deg.to_radians(), toward: toward_deg.to_radians(), share };
            let [from, to] = turn.ends();
            if from < -TOLERANCE || to > 1.0 + TOLERANCE {
                return fault(0, format!("is {at}; the turn takes {share} of the length and would leave the tube"));
            }
            let before = turns.last().map_or(0.0, |turn| turn.ends()[1]);
            if from < before - TOLERANCE {
                return fault(
                    0,
                    format!(
                        "is {at}; the turn would begin at {from:.4}, before the turn before it ends at {before:.4}"
                    ),
                );
            }
            turns.push(turn);
        }
        Ok(turns)
    }
}

/// Maximum distance of the outer wall from the centre line, by the place along the tube, µm.
#[derive(Clone, Debug)]
struct Reach {
    places: Vec<f64>,
    radii: Vec<f64>,
}

impl Reach {
    fn new(p: &Parameters) -> Self {
        let widest = p.widest();
        let fractions: Vec<f64> = (0..=PLACES).map(|i| f64::from(i) / f64::from(PLACES)).collect();
        let scheduled: Vec<f64> = fractions.iter().map(|&u| scheduled_reach_um(p, widest, u)).collect();
        let window = (WALL_LAG_STEPS / f64::from(p.steps) * f64::from(PLACES)).ceil() as usize + 1;
        let around = |i: usize| scheduled[i.saturating_sub(window)..(i + window + 1).min(scheduled.len())].iter();
        Self {
            places: fractions.iter().map(|&u| 1000.0 * p.length_mm * p.z.at(u)).collect(),
            radii: (0..scheduled.len()).map(|i| REACH_FACTOR * around(i).copied().fold(0.0, f64::max)).collect(),
        }
    }

    fn at(&self, place: f64) -> f64 {
        let after = self.places.partition_point(|&at| at <= place).clamp(1, self.places.len() - 1);
        self.radii[after - 1].max(self.radii[after])
    }

    fn minimum(&self) -> f64 {
        self.radii.iter().copied().fold(f64::INFINITY, f64::min)
    }

    fn maximum(&self) -> f64 {
        self.radii.iter().copied().fold(0.0, f64::max)
    }
}

/// Maximum distance of the lobed wall's target from the centre at the fraction `u` of the steps,
/// including all fluctuations. `widest` is the maximum radius of the outline in units of `R_in`.
fn scheduled_reach_um(p: &Parameters, widest: f64, u: f64) -> f64 {
    let swing = |s: &Schedule| s.fluctuation.map_or(0.0, |f| f.amplitude.abs());
    let [most, least] = [1.0, -1.0].map(|sign| move |s: &Schedule| s.at(u) + sign * swing(s));
    let c = &p.containment;
    let inner = (p.particles.total.at(u) - p.particles.outer.at(u)).max(0.0) + 1.0;
    let squash = least(&c.squash).max(1e-3);
    let radius = (inner * most(&p.particles.edge_um) * most(&c.spacing_um) / (std::f64::consts::PI * squash)).sqrt();
    // The weights of the lobes have a root-sum-square of 1.
    let lobes = f64::from(p.wall.lobes.saturating_sub(1)).sqrt();
    (widest * radius + most(&c.wall_um)) * (1.0 + most(&p.wall.lobing) * lobes) * most(&c.squash).max(1.0) * p.scale
}
