//! Surfaces with faults of all kinds, in any chunks.

use super::super::super::samples::tetrahedron;
use super::*;
use proptest::prelude::*;

/// A fault put into a mesh; places are fractions of the lists.
#[derive(Clone, Debug)]
enum Fault {
    Remove(u16),
    Flip(u16),
    Copy { triangle: u16, before: u16, turned: bool },
    Move { vertex: u16, by: [i8; 3] },
    Weld(u16, u16),
    Coincide(u16, u16),
    Degenerate(u16),
    Bridge([u16; 3], u16),
    Body { at: u16, size: u8, before: u16 },
}

fn fault() -> impl Strategy<Value = Fault> {
    let place = any::<u16>;
    prop_oneof![
        place().prop_map(Fault::Remove),
        place().prop_map(Fault::Flip),
        (place(), place(), any::<bool>()).prop_map(|(triangle, before, turned)| Fault::Copy {
            triangle,
            before,
            turned
        }),
        (place(), any::<[i8; 3]>()).prop_map(|(vertex, by)| Fault::Move { vertex, by }),
        (place(), place()).prop_map(|(a, b)| Fault::Weld(a, b)),
        (place(), place()).prop_map(|(a, b)| Fault::Coincide(a, b)),
        place().prop_map(Fault::Degenerate),
        (any::<[u16; 3]>(), place()).prop_map(|(vertices, before)| Fault::Bridge(vertices, before)),
        (place(), any::<u8>(), place()).prop_map(|(at, size, before)| Fault::Body { at, size, before }),
    ]
}

fn apply(fault: &Fault, mesh: &mut Mesh) {
    let of = |place: u16, count: usize| usize::from(place) * count / 65_536;
    let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
    match *fault {
        Fault::Remove(t) => drop(mesh.triangles.remove(of(t, triangles))),
        Fault::Flip(t) => mesh.triangles[of(t, triangles)].swap(0, 1),
        Fault::Copy { triangle, before, turned } => {
            let [a, b, c] = mesh.triangles[of(triangle, triangles)];
            mesh.triangles.insert(of(before, triangles), if turned { [b, a, c] } else { [b, c, a] });
        }
        Fault::Move { vertex, by } => {
            let p = &mut mesh.positions[of(vertex, vertices)];
            (0..3).for_each(|axis| p[axis] += f32::from(by[axis]) * 1e-6);
        }
        Fault::Weld(a, b) => {
            let (a, b) = (of(a, vertices) as u32, of(b, vertices) as u32);
            mesh.triangles.iter_mut().flatten().filter(|v| **v == a).for_each(|v| *v = b);
        }
        Fault::Coincide(a, b) => mesh.positions[of(a, vertices)] = mesh.positions[of(b, vertices)],
        Fault::Degenerate(t) => {
            let t = &mut mesh.triangles[of(t, triangles)];
            t[0] = t[1];
        }
        Fault::Bridge(corners, before) => {
            let corners = corners.map(|v| of(v, vertices) as u32);
            mesh.triangles.insert(of(before, triangles), corners);
        }
        Fault::Body { at, size, before } => {
            let at = mesh.positions[of(at, vertices)].map(f64::from);
            add(mesh, tetrahedron(f64::from(size) * 1e-6 + 1e-7, at), of(before, triangles));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn faulty_surfaces_are_judged_as_the_whole_is(
        faults in prop::collection::vec(fault(), 1..4),
        ends in prop_oneof![
            (1..6usize).prop_map(slabs),
            prop::collection::vec(0..1_200usize, 0..12),
        ],
        in_order: bool,
    ) {
        let mut mesh = tube();
        faults.iter().for_each(|fault| apply(fault, &mut mesh));
        if in_order {
            mesh = along_the_tube(&mesh);
        }
        assert_same(&mesh, &ends);
        let run = |threads| in_pool(threads, || stream(mesh.body, &chunks(&mesh, &ends)));
        prop_assert_eq!(run(1), run(3));
    }

    #[test]
    fn any_chunks_are_judged(
        given in prop::collection::vec(
            (
                prop::collection::vec(prop::array::uniform3(-2i8..3), 0..6),
                -1i32..2,
                prop::collection::vec(prop::array::uniform3(-6i32..2), 0..9),
                -8i32..3,
                prop_oneof![(-3i8..4).prop_map(f32::from), Just(f32::NAN), Just(f32::INFINITY)],
            ),
            0..8,
        ),
    ) {
        let mut certifier = StreamCertifier::new(BodyKind::Lumen, LengthUnit::Millimetre);
        let mut come = 0;
        for (positions, shift, triangles, retired, retired_z) in given {
            let positions: Vec<_> = positions.iter().map(|p| p.map(f32::from)).collect();
            let first = come;
            come += positions.len() as i32;
            let number = |v: i32| (come + v).max(0) as u32;
            let triangles: Vec<_> = triangles.iter().map(|t| t.map(number)).collect();
            // One chunk in three is out of order.
            let first_vertex = (first + shift / 2).max(0) as u32;
            let retired_vertices = number(retired);
            let triangles = vec![&triangles[..]];
            let chunk = Chunk { positions: &positions, first_vertex, triangles, retired_vertices, retired_z };
            certifier.push(&chunk);
        }
        let found = certifier.finish();
        prop_assert_eq!(found.passed, found.failures.is_empty());
    }
}
