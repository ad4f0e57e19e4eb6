//! Tests of courses: length, local frames, shapes, room and relaxation.

use super::*;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

const NODES: usize = 512;

fn courses() -> Vec<(&'static str, Course)> {
    let knee = [[0.0, 0.0, 0.0], [0.0, 0.0, 20.0], [8.0, 3.0, 30.0], [20.0, 0.0, 32.0]].map(DVec3::from);
    let random = RandomCourse { seed: 3, wavelength: 25.0, tortuosity: 1.5 };
    vec![
        ("arc", Course::arc(PI, 60.0, NODES, 0.0)),
        ("sigmoid", Course::sigmoid(2.0, 60.0, NODES, 1.0)),
        ("coil", Course::coil(3.0, 5.0, 60.0, NODES, 0.0).unwrap()),
        ("random", Course::random(&random, 60.0, NODES, -2.0).unwrap()),
        ("points", Course::through(&knee, 60.0, NODES, 0.0).unwrap()),
        ("turns", Course::turns(&turns(), 60.0, NODES, 0.0)),
    ]
}

/// Two hairpins of unequal length in planes across each other.
fn turns() -> [Turn; 2] {
    [Turn { at: 0.25, angle: PI, toward: 0.0, share: 0.3 }, Turn { at: 0.7, angle: 2.5, toward: FRAC_PI_2, share: 0.4 }]
}

#[test]
fn places_are_arc_lengths_and_frames_are_orthonormal() {
    for (name, course) in courses() {
        let steps = 6000;
        let at = |k: u32| course.at(60.0 * f64::from(k) / f64::from(steps));
        let length: f64 = (0..steps).map(|k| at(k).origin.distance(at(k + 1).origin)).sum();
        assert!((length - 60.0).abs() < 2e-4, "{name}: {length}");
        for k in 0..=600 {
            let Frame { u, v, tangent, .. } = at(10 * k);
            let skew = [u.dot(v), u.dot(tangent), v.dot(tangent), u.length() - 1.0, u.cross(v).distance(tangent)];
            assert!(skew.iter().all(|x| x.abs() < 1e-9), "{name}: {skew:?}");
        }
        // The speed differs from 1 only by the error of the spline.
        assert!((0..600).all(|k| (course.line.at(0.1 * f64::from(k)).first.length() - 1.0).abs() < 1e-4), "{name}");
    }
}

#[test]
fn frames_turn_no_more_than_they_must() {
    for (name, course) in courses() {
        let step = 0.01;
        for k in 0..5999 {
            let (a, b) = (course.at(step * f64::from(k)), course.at(step * f64::from(k + 1)));
            let about = (a.v - b.v).dot(a.u + b.u) / (2.0 * step);
            assert!((about - course.twist / 60.0).abs() < 4e-3, "{name} at {k}: {about}");
        }
    }
}

#[test]
fn named_courses_have_the_form_of_their_name() {
    let arc = Course::arc(PI, 60.0, NODES, 0.0);
    assert!((arc.end_distance() - 120.0 / PI).abs() < 1e-6, "{}", arc.end_distance());
    assert!(arc.places().iter().all(|&s| (arc.curvature(s) * 60.0 / PI - 1.0).abs() < 1e-4));
    assert!(arc.at(30.0).origin.distance(DVec3::new(60.0 / PI, 0.0, 60.0 / PI)) < 1e-6);
    let sigmoid = Course::sigmoid(FRAC_PI_2, 60.0, NODES, 0.0);
    assert!(sigmoid.at(60.0).tangent.distance(DVec3::Z) < 1e-4 && sigmoid.at(30.0).tangent.distance(DVec3::X) < 1e-6);
    let coil = Course::coil(3.0, 5.0, 60.0, NODES, 0.0).unwrap();
    for s in [0.0, 7.0, 39.9] {
        assert!((coil.at(s).origin.distance(coil.at(s + 20.0).origin) - 5.0).abs() < 1e-6);
    }
    assert_eq!(Course::coil(3.0, 20.0, 60.0, NODES, 0.0), None);
    for seed in 0..10 {
        let of = RandomCourse { seed, wavelength: 25.0, tortuosity: 1.5 };
        let course = Course::random(&of, 60.0, NODES, 0.0).unwrap();
        assert!((course.tortuosity() - 1.5).abs() < 0.01, "{seed}: {}", course.tortuosity());
        assert!(course.at(0.0).tangent.distance(DVec3::Z) < 1e-4 && course.at(0.0).u.distance(DVec3::X) < 1e-4);
        assert_ne!(course, Course::random(&RandomCourse { seed: seed + 10, ..of }, 60.0, NODES, 0.0).unwrap());
    }
    assert_eq!(Course::random(&RandomCourse { seed: 1, wavelength: 1e6, tortuosity: 3.0 }, 60.0, NODES, 0.0), None);
}

#[test]
fn turns_are_at_their_turning_points_between_straight_parts() {
    let course = Course::turns(&turns(), 60.0, 2048, 0.0);
    let curvature = |at: f64| course.curvature(60.0 * at);
    for Turn { at, angle, share, .. } in turns() {
        let [before, after] = [at - 0.5 * share, at + 0.5 * share];
        let [from, to] = [before, after].map(|at| course.at(60.0 * at).tangent);
        // The angle between tangents is at most π.
        assert!((from.angle_between(to) - angle).abs() < 2e-3, "{at}: {}", from.angle_between(to));
        // As much of the turn lies before the turning point as after it.
        let middle = course.at(60.0 * at).tangent;
        assert!((middle.angle_between(from) - middle.angle_between(to)).abs() < 2e-3);
        let flat = angle / (60.0 * share * 0.8);
        assert!([-0.25, 0.0, 0.25].iter().all(|k| (curvature(at + k * share) / flat - 1.0).abs() < 1e-2), "{at}");
        assert!(curvature(before - 0.01) < 1e-3 * flat && curvature(after + 0.01) < 1e-3 * flat, "{at}");
    }
    // The first turn is toward x, the second toward y of the section.
    assert!(course.at(15.0).tangent.distance(DVec3::X) < 2e-3, "{}", course.at(15.0).tangent);
    assert!(course.at(58.0).tangent.y > 0.5 && course.at(30.0).tangent.distance(-DVec3::Z) < 2e-3);
    let turned = course.turned();
    assert!((turned[turned.len() - 1] - (PI + 2.5)).abs() < 2e-3 && turned.is_sorted());
}

#[test]
fn a_course_passes_through_its_points() {
    let points =
        [[5.0, 1.0, 2.0], [5.0, 1.0, 12.0], [9.0, 5.0, 20.0], [20.0, 5.0, 22.0], [22.0, 9.0, 30.0]].map(DVec3::from);
    let own = Course::through(&points, 1.0, NODES, 0.0).unwrap();
    let length = points[0].distance(points[4]) / own.end_distance();
    let course = Course::through(&points, length, NODES, 0.0).unwrap();
    for point in points {
        let nearest = (0..=20_000).map(|k| course.at(length * f64::from(k) / 20_000.0).origin.distance(point));
        assert!(nearest.fold(f64::INFINITY, f64::min) < 2e-3);
    }
    assert_eq!(Course::through(&[points[0], points[0]], 1.0, NODES, 0.0), None);
    assert_eq!(Course::through(&points[..1], 1.0, NODES, 0.0), None);
    let straight = Course::through(&points[..2], 10.0, NODES, 0.0).unwrap();
    assert!(straight.place([1.0, 2.0, 3.0]).distance(DVec3::new(6.0, 3.0, 5.0)) < 1e-12);
}

#[test]
fn room_is_that_of_circle_and_helix() {
    let arc = Course::arc(PI, 60.0, NODES, 0.0);
    let room = arc.room(&|_| 2.0);
    assert!((room.bend.radius_ratio() - 2.0 * PI / 60.0).abs() < 1e-4, "{room:?}");
    assert!(room.near.is_none_or(|near| near.distance > 30.0), "{room:?}");
    // A full circle returns to its start.
    let near = Course::arc(TAU, 60.0, NODES, 0.0).room(&|_| 2.0).near.unwrap();
    assert!(near.distance < -4.0 && near.at[0] < 0.5 && near.at[1] > 59.5, "{near:?}");
    // Windings 5 apart, each 2 × 1.5 wide. Two sampling steps are subtracted.
    let near = Course::coil(3.0, 5.0, 60.0, NODES, 0.0).unwrap().room(&|_| 1.5).near.unwrap();
    assert!(near.distance > 1.5 && near.distance < 2.0, "{near:?}");
    // The wide place counts, not the tightest curve.
    let knee = Course::sigmoid(2.0, 60.0, NODES, 0.0).room(&|s| if s > 40.0 && s < 50.0 { 3.0 } else { 0.1 });
    assert!((knee.bend.at - 45.0).abs() < 0.2 && knee.bend.tube == 3.0, "{knee:?}");
}

#[test]
fn sections_do_not_meet_where_there_is_room() {
    for (name, course) in courses() {
        let radius = 1.2;
        let room = course.room(&|_| radius);
        assert!(room.bend.radius_ratio() < 1.0 && room.near.is_none_or(|near| near.distance > 0.0), "{name}: {room:?}");
        // No point of a section lies inside another section.
        for i in 0..120 {
            for k in 0..12 {
                let (sin, cos) = (TAU * f64::from(k) / 12.0).sin_cos();
                let point = course.place([radius * cos, radius * sin, 0.5 * f64::from(i)]);
                for j in (0..=120).filter(|&j| j != i) {
                    let frame = course.at(0.5 * f64::from(j));
                    let off = point - frame.origin;
                    let is_within = off.dot(frame.tangent).abs() < 0.02 && off.length() < radius;
                    assert!(!is_within, "{name}: {i} {k} {j}");
                }
            }
        }
    }
}

#[test]
fn a_relaxed_course_has_room_and_its_length() {
    let (max_radius_ratio, min_distance) = (0.8, 0.2);
    for seed in 0..6 {
        let of = RandomCourse { seed, wavelength: 12.0, tortuosity: 2.0 };
        let tight = Course::random(&of, 60.0, NODES, 0.0).unwrap();
        let radius = |s: f64| 0.9 + 0.01 * s;
        assert!(tight.room(&radius).bend.radius_ratio() > max_radius_ratio);
        let relaxed = tight.relaxed(&Relaxation { radius: &radius, max_radius_ratio, min_distance });
        let room = relaxed.room(&radius);
        assert!(
            room.bend.radius_ratio() <= max_radius_ratio && room.near.is_none_or(|near| near.distance >= min_distance)
        );
        assert!(relaxed.length() == 60.0 && relaxed.tortuosity() > 1.2, "{}", relaxed.tortuosity());
    }
    // A bend that is too tight keeps its angle if the tube is long enough.
    let knee = [[0.0, 0.0, 0.0], [0.0, 0.0, 30.0], [30.0, 0.0, 30.0]].map(DVec3::from);
    let knee = Course::through(
        &[
            knee[0],
            (knee[0] + knee[1]) / 2.0,
            knee[1] * 0.99,
            knee[1],
            (knee[1] * 99.0 + knee[2]) / 100.0,
            (knee[1] + knee[2]) / 2.0,
            knee[2],
        ],
        60.0,
        NODES,
        0.0,
    );
    let knee = knee.unwrap();
    let to = Relaxation { radius: &|_| 2.0, max_radius_ratio, min_distance };
    assert!(knee.room(to.radius).bend.radius_ratio() > 1.0);
    let relaxed = knee.relaxed(&to);
    let angle = |course: &Course| course.at(0.0).tangent.angle_between(course.at(60.0).tangent);
    assert!((angle(&relaxed) - angle(&knee)).abs() < 0.05, "{} {}", angle(&relaxed), angle(&knee));
    // A knot is untied.
    let knot = Course::arc(40.0 * PI, 60.0, NODES, 0.0).relaxed(&Relaxation { radius: &|_| 20.0, ..to });
    assert!(knot.room(&|_| 20.0).near.is_none_or(|near| near.distance >= min_distance) && knot.tortuosity() > 1.0);
}
