//! The reference against closed forms, and the CPU backend against the reference.
//!
//! Both sides of a comparison start from the same `f32` numbers, so they differ only by the
//! rounding of the backend. The tolerance is the change of the reference's result when its inputs
//! change by a few units in the last place of `f32`.

use super::*;
use crate::random::{self, Stream};
use crate::sim::cpu::CpuSimulation;
use crate::sim::{Checkpoint, Plan};
use crate::spec::{ModelSpec, preset};
use proptest::prelude::*;
use serde_json::{Value, json};
use std::f64::consts::PI;
use std::sync::LazyLock;

/// Half a unit in the last place of 1 in `f32`: the relative error of one rounding.
const ROUNDING: f64 = f32::EPSILON as f64 / 2.0;

/// Greatest move of a particle in a step of a backend, µm; the velocity is shortened with the move.
const GREATEST_MOVE: f64 = 5.0;

fn at(x: f64, y: f64) -> DVec2 {
    DVec2::new(x, y)
}

fn particle(p: DVec2, v: DVec2) -> Particle {
    Particle { p, v, r: 8.0, anchor: DVec2::X, sign: 0.0, scale: 1.0, cleft: 0.0 }
}

fn assert_near(found: DVec2, expected: DVec2) {
    assert!(found.distance(expected) < 1e-12 * (1.0 + expected.length()), "{found} instead of {expected}");
}

#[test]
fn a_spring_follows_hooke_and_damps() {
    let (own, other) = (particle(at(3.0, 4.0), at(0.6, 0.8)), particle(DVec2::ZERO, DVec2::ZERO));
    // 5 µm long, 3 µm longer than at rest, and longer by 1 µm/step: −(0.5·3 + 0.1·1) away from the
    // other particle.
    assert_near(spring(&own, &other, 2.0, 0.5, 0.1), at(-0.96, -1.28));
    assert_near(spring(&other, &own, 2.0, 0.5, 0.1), at(0.96, 1.28));
    assert_near(spring(&own, &other, 5.0, 0.5, 0.0), DVec2::ZERO);
    let sideways = particle(own.p, at(-4.0, 3.0));
    assert_near(spring(&sideways, &other, 5.0, 0.5, 0.1), DVec2::ZERO);
}

#[test]
fn containment_pulls_particles_outside_the_ellipse_to_the_centre() {
    let ellipse = Ellipse { radius: 100.0, squash: 0.5 };
    for (p, expected) in [
        (at(99.0, 0.0), DVec2::ZERO),
        (at(0.0, -49.0), DVec2::ZERO),
        (at(105.0, 0.0), at(-1.0, 0.0)),
        (at(0.0, 52.5), at(0.0, -1.0)),
        (at(300.0, 400.0), at(-1.2, -1.6)),
    ] {
        assert_near(containment(p, &ellipse, 2.0, 10.0), expected);
    }
}

#[test]
fn the_regulatory_force_has_its_strength_beyond_the_softening_distance() {
    assert_near(regulatory(at(3.0, 4.0), at(33.0, 44.0), 0.5, 15.0), at(0.3, 0.4));
    assert_near(regulatory(at(3.0, 4.0), at(6.0, 8.0), 0.5, 10.0), at(0.15, 0.2));
    assert_near(regulatory(at(3.0, 4.0), at(3.0, 4.0), 0.5, 10.0), DVec2::ZERO);
}

#[test]
fn guidance_leads_to_the_ray_of_the_anchor() {
    // The ray runs along (0.6, 0.8); the particle is 10 µm to its right.
    let anchor = at(60.0, 80.0);
    assert_near(guidance(at(30.0 + 8.0, 40.0 - 6.0), anchor, 0.5, 4.0), at(-0.4, 0.3));
    assert_near(guidance(at(30.0 + 8.0, 40.0 - 6.0), anchor, 0.5, 20.0), at(-0.2, 0.15));
    assert_near(guidance(at(30.0, 40.0), anchor, 0.5, 20.0), DVec2::ZERO);
    // Behind the axis, the nearest point of the ray is the axis.
    assert_near(guidance(at(-6.0, -8.0), anchor, 0.5, 5.0), at(0.3, 0.4));
}

#[test]
fn contortion_is_proportional_to_the_angle() {
    // The lumen of a loop that runs in the direction of x is above.
    let corner = |y: f64| [at(-2.0, y), DVec2::ZERO, at(2.0, y)];
    for (y, share) in [(0.0, 1.0), (2.0, 0.5), (-2.0, 0.5), (2.0 * 3f64.sqrt(), 1.0 / 3.0)] {
        assert_near(contortion(corner(y), 1.0, 0.7), at(0.0, 0.7 * share));
        assert_near(contortion(corner(y), -1.0, 0.7), at(0.0, -0.7 * share));
    }
    assert_near(contortion(corner(1.0), 0.0, 0.7), DVec2::ZERO);
}

#[test]
fn bending_and_friction_by_hand() {
    assert_near(bending([at(-2.0, 1.0), DVec2::ZERO, at(2.0, 1.0)], 0.15), at(0.0, 0.3));
    assert_near(bending([at(-2.0, 0.0), at(1.0, 0.0), at(2.0, 0.0)], 0.15), DVec2::ZERO);
    assert_near(friction(at(3.0, -4.0), 0.3), at(-0.9, 1.2));
}

#[test]
fn the_range_of_self_intersection_depends_on_the_side() {
    let with = Coefficients {
        repulsion: 20.0,
        gap: 40.0,
        tissue: 100.0,
        barrier: 3.0,
        barrier_distance: 5.0,
        ..Coefficients::default()
    };
    let own = particle(DVec2::ZERO, DVec2::ZERO);
    let force = |own: &Particle, a: DVec2, b: DVec2| self_intersection(own, DVec2::Y, a, b, &with);
    for (y, expected) in [
        // Across the lumen D is 40 µm, across tissue 100 µm.
        (40.0, 0.0),
        (30.0, -20.0 / 40.0 * 0.25),
        (-100.0, 0.0),
        (-30.0, 20.0 / 100.0 * 0.7),
        // Within 5 µm, the barrier adds to it.
        (2.0, -20.0 / 40.0 * 0.95 - 3.0 * 1.5),
    ] {
        assert_near(force(&own, at(-5.0, y), at(5.0, y)), at(0.0, expected));
    }
    // Beside the normal D is the mean, 70 µm; the nearest point of this edge is its end.
    assert_near(force(&own, at(35.0, 0.0), at(50.0, 9.0)), at(-20.0 / 70.0 * 0.5, 0.0));
    let wide = Particle { scale: 2.0, ..own };
    assert_near(force(&wide, at(70.0, 0.0), at(90.0, 9.0)), at(-20.0 / 140.0 * 0.5, 0.0));
}

/// Lengths of all forces, without their strengths.
fn lengths() -> Coefficients {
    Coefficients {
        ellipse: Ellipse { radius: 50.0, squash: 1.0 },
        ramp: 20.0,
        softening: 15.0,
        reach: 15.0,
        gap: 30.0,
        tissue: 80.0,
        ..Coefficients::default()
    }
}

/// A regular polygon with its anchors on the ellipse, all particles moving outward.
fn ring(n: usize, radius: f64, speed: f64) -> Loop {
    let particle = |i: usize| {
        let angle = TAU * i as f64 / n as f64;
        let unit = at(angle.cos(), angle.sin());
        Particle { p: radius * unit, v: speed * unit, r: 8.0, anchor: unit, sign: 1.0, scale: 1.0, cleft: 0.0 }
    };
    Loop { particles: (0..n).map(particle).collect() }
}

#[test]
fn forces_on_a_regular_polygon_are_radial_and_equal() {
    let (n, radius, speed) = (40, 60.0, 0.5);
    let with = lengths();
    let half = PI / n as f64;
    let edge = 2.0 * radius * half.sin();
    let inward = 2.0 * half.sin();
    for (name, with, m_c, outward) in [
        ("spring", Coefficients { stiffness: 0.5, ..with }, 0.0, Some(-0.5 * (edge - 8.0) * inward)),
        ("damping", Coefficients { damping: 0.1, ..with }, 0.0, Some(-0.1 * speed * inward * inward)),
        ("containment", Coefficients { containment: 2.0, ..with }, 0.0, Some(-1.0)),
        ("regulatory", Coefficients { regulatory: 0.3, ..with }, 0.0, Some(-0.3 * 10.0 / 15.0)),
        // The angle of a regular polygon is 180° − 360°/n; the lumen is inside.
        ("contortion", with, 0.7, Some(-0.7 * (1.0 - 2.0 / n as f64))),
        ("friction", Coefficients { friction: 0.3, ..with }, 0.0, Some(-0.3 * speed)),
        (
            "bending",
            Coefficients { bending: 0.15, ..with },
            0.0,
            Some(-0.15 * 2.0 * radius * (1.0 - (2.0 * half).cos())),
        ),
        ("self-intersection", Coefficients { repulsion: 20.0, ..with }, 0.0, None),
    ] {
        let ring = ring(n, radius, speed);
        let first = ring.force(0, &with, m_c);
        assert!(first.y.abs() < 1e-12 && first.x.abs() > 1e-4, "{name}: {first}");
        if let Some(outward) = outward {
            assert!((first.x - outward).abs() < 1e-12 * (1.0 + radius), "{name}: {} instead of {outward}", first.x);
        }
        for (i, own) in ring.particles.iter().enumerate() {
            let force = ring.force(i, &with, m_c);
            assert!(force.distance(first.x * own.anchor) < 1e-12 * (1.0 + radius), "{name}: particle {i}");
        }
    }
}

#[test]
fn integrators_by_hand() {
    // With friction k alone, Runge–Kutta of fourth order gives the Taylor polynomial of exp(−k).
    let k = 0.3f64;
    let with = Coefficients { friction: k, edge: 10.0, relaxation: 0.25, ..lengths() };
    let taylor = 1.0 - k + k.powi(2) / 2.0 - k.powi(3) / 6.0 + k.powi(4) / 24.0;
    let moved = 1.0 - k / 2.0 + k.powi(2) / 6.0 - k.powi(3) / 24.0;
    for (integrator, speed, moved) in [(Integrator::Rk4, taylor, moved), (Integrator::Euler, 1.0 - k, 1.0 - k)] {
        let (mut after, before) = (ring(12, 60.0, 2.0), ring(12, 60.0, 2.0));
        after.step(&with, integrator);
        for (after, before) in after.particles.iter().zip(&before.particles) {
            assert_near(after.v, speed * before.v);
            assert_near(after.p, before.p + moved * before.v);
            assert!((after.r - 8.5).abs() < 1e-12);
        }
    }
}

#[test]
fn runge_kutta_is_of_fourth_order() {
    // A ring oscillates on its springs. A step that is shorter by h has a stiffness lower by h².
    let after = |steps: u32| {
        let h = 1.0 / f64::from(steps);
        let mut ring = ring(12, 60.0, 0.0);
        let with = Coefficients { stiffness: 0.5 * h * h, ..lengths() };
        for _ in 0..4 * steps {
            ring.step(&with, Integrator::Rk4);
        }
        ring.particles[0].p.x
    };
    let [one, two, four, exact] = [1, 2, 4, 64].map(after);
    let orders = [(one - exact) / (two - exact), (two - exact) / (four - exact)].map(f64::log2);
    assert!(orders.iter().all(|order| (order - 4.0).abs() < 0.3), "{orders:?}");
}

#[test]
fn the_nearest_point_of_the_ellipse_lies_along_its_normal() {
    let ellipse = Ellipse { radius: 500.0, squash: 0.7 };
    for i in 0..60 {
        let angle = 0.1 + 0.37 * f64::from(i);
        let t = at(angle.cos(), angle.sin());
        let normal = at(0.7 * t.x, t.y).normalize();
        // From beyond the centre of curvature to the outside.
        let p = ellipse.point(t) + (10.0 * f64::from(i % 30) - 200.0) * normal;
        assert!(ellipse.nearest(p).distance(t) < 1e-6, "{p}");
    }
}

#[test]
fn a_split_changes_neither_the_contour_nor_the_rest_length() {
    let whole = ring(12, 60.0, 2.0);
    for edge in [0, 5, 11] {
        let mut grown = whole.clone();
        grown.split(edge, &Ellipse { radius: 50.0, squash: 1.0 }, -1.0);
        let new = grown.particles.remove(edge + 1);
        let (a, b) = (whole.particles[edge], whole.particles[(edge + 1) % 12]);
        assert_near(new.p, 0.5 * (a.p + b.p));
        assert_near(new.v, 0.5 * (a.v + b.v));
        assert!(new.anchor.distance((a.p + b.p).normalize()) < 1e-6);
        assert_eq!((new.r, grown.particles[edge].r, new.sign), (4.0, 4.0, -1.0));
        grown.particles[edge].r = 8.0;
        assert_eq!(grown, whole);
    }
}

/// A plan of the paper's preset without growth between steps 1 and 9, and without a limit of moves
/// below 5 µm.
fn plan(patch: &Value) -> Plan {
    let mut whole = json!({
        "steps": 10, "burn_in": 0,
        "particles": { "total": { "keys": [[0, 260], [1, 300]] }, "outer": { "keys": [[0, 60], [1, 60]] } },
    });
    json_patch::merge(&mut whole, patch);
    let spec = ModelSpec::resolve(preset("paper").unwrap(), &whole).unwrap();
    Plan { clearance: -1e3, ..Plan::new(&spec, 5) }
}

/// Forces by name, each as the part of a row that it needs.
type Keep = fn(&StepRow, StepRow) -> StepRow;
const FORCES: [(&str, Keep); 11] = [
    ("spring", |row, bare| StepRow { stiffness: row.stiffness, damping: row.damping, ..bare }),
    ("containment", |row, bare| StepRow { containment: row.containment, ..bare }),
    ("regulatory", |row, bare| StepRow { regulatory: row.regulatory, ..bare }),
    ("hold of clefts", |row, bare| StepRow { hold: row.hold, ..bare }),
    ("guidance", |row, bare| StepRow { guide: row.guide, ..bare }),
    ("contortion", |row, bare| StepRow { contortion: row.contortion, ..bare }),
    ("friction", |row, bare| StepRow { friction: row.friction, ..bare }),
    ("self-intersection", |row, bare| StepRow { repulsion: row.repulsion, ..bare }),
    ("barrier", |row, bare| StepRow { barrier: row.barrier, ..bare }),
    ("bending", |row, bare| StepRow { bending: row.bending, ..bare }),
    ("all", |row, _| *row),
];

/// The row without forces; lengths and distances stay.
fn bare(row: &StepRow) -> StepRow {
    StepRow {
        stiffness: 0.0,
        damping: 0.0,
        containment: 0.0,
        regulatory: 0.0,
        hold: 0.0,
        guide: 0.0,
        contortion: [0.0; 3],
        friction: 0.0,
        repulsion: 0.0,
        barrier: 0.0,
        bending: 0.0,
        ..*row
    }
}

/// A loop of 12 to 50 particles anywhere within 150 µm: edges of many lengths cross, and folds have
/// all angles.
fn any_loop() -> impl Strategy<Value = InnerLoop> {
    let number = |bound: f32| -bound..bound;
    let particle = (
        number(150.0),
        number(150.0),
        number(3.0),
        number(3.0),
        1f32..60.0,
        0f32..6.3,
        -1i8..=1,
        0.4f32..2.5,
        0f32..1.0,
    );
    prop::collection::vec(particle, 12..50).prop_map(|particles| {
        let mut s = InnerLoop { id: (0..particles.len() as u32).collect(), ..InnerLoop::default() };
        s.next_id = s.id.len() as u32;
        for (x, y, vx, vy, rest, angle, sign, scale, cleft) in particles {
            for (numbers, number) in [
                (&mut s.x, x),
                (&mut s.y, y),
                (&mut s.vx, vx),
                (&mut s.vy, vy),
                (&mut s.rest, rest),
                (&mut s.anchor_x, libm::cosf(angle)),
                (&mut s.anchor_y, libm::sinf(angle)),
                (&mut s.sign, f32::from(sign)),
                (&mut s.scale, scale),
                (&mut s.cleft, cleft),
            ] {
                numbers.push(number);
            }
        }
        s
    })
}

/// Number of roundings that a tolerance allows for: about the operations from a position to a
/// direction.
const ROUNDINGS: f64 = 8.0;

/// The loop with all its numbers off by [`ROUNDINGS`] of the largest number of their kind, up or
/// down at random.
fn blurred(of: &Loop, trial: u32) -> Loop {
    let size = |kind: fn(&Particle) -> f64| of.particles.iter().map(kind).fold(0.0, f64::max) * ROUNDINGS * ROUNDING;
    let [p, v, r] = [size(|own| own.p.length()), size(|own| own.v.length()), size(|own| own.r)];
    let blurred = |(i, own): (u32, &Particle)| {
        let word = random::word(1, Stream::Start, i, trial);
        let sign = |bit: u32| if word >> bit & 1 == 0 { 1.0 } else { -1.0 };
        Particle {
            p: own.p + p * at(sign(0), sign(1)),
            v: own.v + v * at(sign(2), sign(3)),
            r: own.r + r * sign(4),
            anchor: own.anchor + ROUNDINGS * ROUNDING * at(sign(5), sign(6)),
            ..*own
        }
    };
    Loop { particles: (0..).zip(&of.particles).map(blurred).collect() }
}

/// Greatest change of each result when the loop is blurred.
fn sensitivity(exact: &Loop, results: impl Fn(&Loop) -> Vec<DVec2>) -> Vec<f64> {
    let expected = results(exact);
    let mut greatest = vec![0f64; expected.len()];
    for trial in 0..8 {
        let changed = results(&blurred(exact, trial));
        for ((greatest, changed), expected) in greatest.iter_mut().zip(changed).zip(&expected) {
            *greatest = greatest.max(changed.distance(*expected));
        }
    }
    greatest
}

fn forces(of: &Loop, with: &Coefficients) -> Vec<DVec2> {
    (0..of.particles.len()).map(|i| of.force(i, with, with.contortion[0])).collect()
}

/// Error of the self-intersection forces on particle `i` if the nearest point of each edge is off
/// by [`ROUNDINGS`] along the edge: the force turns. No change of the inputs has this effect.
fn turned(of: &Loop, i: usize, with: &Coefficients) -> f64 {
    let (all, n) = (&of.particles, of.particles.len());
    let (own, previous) = (&all[i], (i + n - 1) % n);
    let error = |j: usize| {
        let (a, b) = (all[j].p, all[(j + 1) % n].p);
        let force = self_intersection(own, normal(all[previous].p, all[(i + 1) % n].p), a, b, with).length();
        force * ROUNDINGS * ROUNDING * (own.p.distance(a) + a.distance(b))
            / own.p.distance(nearest_on_edge(own.p, a, b))
    };
    (0..n).filter(|&j| j != i && j != previous).map(error).sum()
}

/// The state of the CPU backend after one Euler step from `start`, with all rows of `plan` replaced
/// by `row`.
fn cpu_step(plan: &Plan, row: &StepRow, start: &InnerLoop) -> InnerLoop {
    let mut plan = Plan { integrator: Integrator::Euler, ..plan.clone() };
    plan.rows.fill(*row);
    let outer = CpuSimulation::new(plan.clone(), 1).checkpoint().outer;
    let start = Checkpoint { time: 1, inner: start.clone(), outer, clearance: Vec::new() };
    let mut simulation = CpuSimulation::resume(plan, &start, 1);
    simulation.step().unwrap();
    simulation.inner().clone()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// An Euler step adds the force to the velocity. The tolerance is the change of the force when
    /// its inputs are blurred.
    #[test]
    fn forces_of_the_cpu_are_those_of_the_reference(start in any_loop()) {
        static PLAN: LazyLock<Plan> = LazyLock::new(|| plan(&json!({})));
        let exact = Loop::from(&start);
        for (name, keep) in FORCES {
            let primary = StepRow { hold: 0.6, guide: 0.2, reach: 70.0, ..*PLAN.at(1) };
            let row = StepRow { contortion: [0.8; 3], repulsion: 10.0, r_in: 100.0, ..primary };
            let row = keep(&row, bare(&row));
            let with = Coefficients::from(&row);
            let found = Loop::from(&cpu_step(&PLAN, &row, &start));
            let sensitivity = sensitivity(&exact, |of| forces(of, &with));
            for (i, (own, force)) in exact.particles.iter().zip(forces(&exact, &with)).enumerate() {
                let velocity = own.v + force;
                // The arc cosine of a number that is rounded next to −1 is off by the root of two
                // roundings.
                let arc = with.contortion[0] * (4.0 * ROUNDING).sqrt() / PI;
                let sum = ROUNDINGS * ROUNDING * (own.v.length() + velocity.length());
                let tolerance = sensitivity[i] + turned(&exact, i, &with) + arc + sum;
                let off = found.particles[i].v.distance(velocity.clamp_length_max(GREATEST_MOVE));
                prop_assert!(off <= tolerance, "{}: particle {} is off by {}, {} allowed", name, i, off, tolerance);
            }
        }
    }
}

/// A plan of 200 steps in which 150 particles become 400.
fn folding(integrator: Integrator) -> Plan {
    let mut patch = json!({ "steps": 200, "particles": { "total": { "keys": [[0, 210], [1, 460]] } } });
    if integrator == Integrator::Euler {
        // Stable if 4·stiffness + 16·bending + 2·(friction + 4·damping) < 4.
        json_patch::merge(&mut patch, &json!({ "spring": { "stiffness": 0.4 }, "bending": 0.02 }));
    }
    Plan { integrator, ..plan(&patch) }
}

fn positions_and_velocities(of: &Loop) -> Vec<DVec2> {
    of.particles.iter().flat_map(|own| [own.p, own.v]).collect()
}

/// The tolerance of a step is the change of its result when its inputs are blurred.
#[test]
fn a_step_of_the_cpu_is_that_of_the_reference() {
    for integrator in [Integrator::Rk4, Integrator::Euler] {
        let plan = folding(integrator);
        let mut simulation = CpuSimulation::new(plan.clone(), 1);
        // Step 199 does not begin with growth.
        while simulation.time() < 199 {
            simulation.step().unwrap();
        }
        let start = Loop::from(simulation.inner());
        let with = Coefficients::from(plan.at(simulation.time()));
        let shortened = simulation.statistics().moves_shortened;
        simulation.step().unwrap();
        assert_eq!(simulation.statistics().moves_shortened, shortened, "the limit of moves acts");
        let after = |of: &Loop| {
            let mut after = of.clone();
            after.step(&with, integrator);
            after
        };
        let expected = after(&start);
        let sensitivity = sensitivity(&start, |of| positions_and_velocities(&after(of)));
        let found = Loop::from(simulation.inner());
        let pairs = positions_and_velocities(&found).into_iter().zip(positions_and_velocities(&expected));
        for (i, ((found, expected), tolerance)) in pairs.zip(sensitivity).enumerate() {
            let off = found.distance(expected);
            assert!(off <= tolerance, "{integrator:?}: particle {} is off by {off}, {tolerance} allowed", i / 2);
        }
        for (found, expected) in found.particles.iter().zip(&expected.particles) {
            assert!((found.r - expected.r).abs() <= 4.0 * ROUNDING * expected.r);
        }
    }
}

fn greatest_distance(a: &Loop, b: &Loop) -> f64 {
    assert_eq!(a.particles.len(), b.particles.len());
    a.particles.iter().zip(&b.particles).map(|(a, b)| a.p.distance(b.p)).fold(0.0, f64::max)
}

/// Folding is unstable, so errors grow. A second reference, which is blurred after each step, shows
/// how much; the CPU backend has to stay closer to the reference than it. Growth is replayed: the
/// reference splits the edges that the CPU backend chose.
#[test]
fn a_run_of_the_cpu_is_that_of_the_reference() {
    for integrator in [Integrator::Rk4, Integrator::Euler] {
        let plan = folding(integrator);
        let mut simulation = CpuSimulation::new(plan.clone(), 1);
        let mut reference = Loop::from(simulation.inner());
        let mut second = reference.clone();
        let (mut allowed, mut worst) = (0f64, 0f64);
        while simulation.time() < i64::from(plan.steps) {
            let with = Coefficients::from(plan.at(simulation.time()));
            let first_new = simulation.inner().next_id;
            simulation.step().unwrap();
            let found = simulation.inner();
            for i in (0..found.len()).filter(|&i| found.id[i] >= first_new) {
                reference.split(i - 1, &with.ellipse, found.sign[i].into());
                second.split(i - 1, &with.ellipse, found.sign[i].into());
            }
            reference.step(&with, integrator);
            second.step(&with, integrator);
            second = blurred(&second, simulation.time() as u32);
            allowed = allowed.max(greatest_distance(&reference, &second));
            let off = greatest_distance(&Loop::from(found), &reference);
            worst = worst.max(off / allowed);
            assert!(off <= allowed, "{integrator:?}: {off} µm at step {}, {allowed} allowed", simulation.time());
        }
        assert_eq!(simulation.statistics().moves_shortened, 0, "the limit of moves acts");
        for (found, expected) in Loop::from(simulation.inner()).particles.iter().zip(&reference.particles) {
            // The backend finds anchors by an iteration. Rest lengths relax by 2 % per step, which
            // forgets all but the last 50 roundings.
            assert!(found.anchor.distance(expected.anchor) < 1e-3, "{integrator:?}");
            assert!((found.r - expected.r).abs() <= 100.0 * ROUNDING * expected.r, "{integrator:?}");
        }
        println!("{integrator:?}: at most {worst:.2} of the tolerance, which ends at {allowed:.2} µm");
        // A quarter of an edge.
        assert!(allowed < 2.0, "{integrator:?}: {allowed} µm allow too much");
        // Nothing is tested if the loop has neither grown nor folded.
        let ellipse = Coefficients::from(plan.at(simulation.time())).ellipse;
        let radii = reference.particles.iter().map(|own| ellipse.elliptic_radius(own.p) / ellipse.radius);
        let innermost = radii.fold(1.0, f64::min);
        assert!(reference.particles.len() > 390 && innermost < 0.7, "{innermost}");
    }
}
