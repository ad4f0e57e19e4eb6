//! Remeshing of shapes of known size: distances, angles, and folds that nearly touch.

use super::*;
use crate::geometry::distance::Triangles;
use crate::geometry::vector;
use std::collections::HashMap;
use std::f64::consts::TAU;

const DEFAULT: Quality = Quality { resolution_um: 40.0, outer_um: 80.0, tolerance_um: 4.0, lids: false };

/// A ring of points, µm, with ids from 0.
fn ring(points: Vec<[f64; 2]>) -> Ring {
    Ring { ids: (0..points.len() as u32).collect(), points: points.into_iter().map(|p| p.map(|x| x as f32)).collect() }
}

fn circle(n: usize, radius: impl Fn(f64) -> f64) -> Ring {
    let at = |i: usize| {
        let angle = TAU * i as f64 / n as f64;
        [radius(angle) * angle.cos(), radius(angle) * angle.sin()]
    };
    ring((0..n).map(at).collect())
}

fn section(k: usize, dz: f64, inner: Ring, outer: Ring) -> Section {
    Section { step: k as f64, z_um: 1000.0 + dz * k as f64, added: false, inner, outer }
}

fn cylinder() -> Vec<Section> {
    (0..13).map(|k| section(k, 25.0, circle(80, |_| 100.0), circle(40, |_| 260.0))).collect()
}

/// Folds that deepen and turn along the tube.
fn folded() -> Vec<Section> {
    let inner = |k: usize| {
        let depth = 0.3 + 0.01 * k as f64;
        circle(240, move |angle| 160.0 * (1.0 + depth * (7.0 * angle + 0.004 * k as f64).cos()))
    };
    (0..13).map(|k| section(k, 25.0, inner(k), circle(60, |_| 400.0))).collect()
}

/// A collapsed lumen: two wavy walls at a distance of `gap`.
fn slit(gap: f64) -> Vec<Section> {
    let wall = |k: usize| {
        let wave = |x: f64| 10.0 * (x / 20.0 + 0.01 * k as f64).sin();
        let way = |x: f64, side: f64| [x, wave(x) + side * 0.5 * gap];
        let forth = (0..50).map(|i| way(-198.0 + 8.0 * f64::from(i), -1.0));
        let back = (0..50).map(|i| way(198.0 - 8.0 * f64::from(i) - 3.0, 1.0));
        ring(forth.chain(back).collect())
    };
    (0..9).map(|k| section(k, 25.0, wall(k), circle(60, |_| 400.0))).collect()
}

#[test]
fn division_of_a_flat_triangle_ends() {
    // The midpoint of the edge 1–2 is as far from 0 as 1 from 2, and so on.
    let wall = circle(400, |_| 1000.0);
    let sheet = sheet::Sheet::new(&[(&wall, 0.0), (&wall, 60.0)]).unwrap();
    let limits = RemeshLimits { length: 40.0, tolerance: 4.0 };
    let field = field::LengthField::new(&sheet, limits, &[]);
    let places = vec![[0.0, 10.0], [96.0, 10.0], [32.0, 10.01], [64.0, 30.0]];
    let points = places.iter().map(|&place| sheet.point(place)).collect();
    let web = web::Web::new(points, places, vec![[0, 1, 2], [2, 1, 3]], 4);
    let mut weave = weave::Weave::new(&sheet, &field, web);
    weave.even_out(1);
    assert!(weave.web.triangles.len() < 100, "{}", weave.web.triangles.len());
}

fn made(sections: &[Section], lids: bool) -> Remeshed {
    let quality = Quality { lids, ..DEFAULT };
    remesh(sections, &quality, &|_| false).unwrap()
}

/// Asserts that every edge occurs once in each direction and no triangles intersect.
fn check(mesh: &Mesh) {
    let mut edges: HashMap<[u32; 2], u32> = HashMap::new();
    for t in &mesh.triangles {
        for k in 0..3 {
            *edges.entry([t[k], t[(k + 1) % 3]]).or_default() += 1;
        }
    }
    assert!(edges.iter().all(|(&[a, b], &count)| count == 1 && edges.contains_key(&[b, a])));
    let mut used: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    assert_eq!(used.len(), mesh.positions.len());
    let euler = used.len() as i64 - edges.len() as i64 / 2 + mesh.triangles.len() as i64;
    assert_eq!(euler, mesh.body.euler());
    assert_eq!(intersection::all_pairs(mesh), Vec::<[u32; 2]>::new());
}

/// Fraction of triangles without an angle below 20 degrees, and fraction of triangles whose longest
/// edge is at most 4 times the shortest.
fn share_of_good(mesh: &Mesh) -> f64 {
    let is_good = |t: &&[u32; 3]| {
        let corners = t.map(|v| mesh.positions[v as usize].map(f64::from));
        let sides = [0, 1, 2].map(|k| vector::distance(corners[k], corners[(k + 1) % 3]));
        let wide = (0..3).all(|k| {
            let [a, b, c] = [0, 1, 2].map(|i| sides[(k + i) % 3]);
            (b * b + c * c - a * a) / (2.0 * b * c) <= 20_f64.to_radians().cos()
        });
        wide && sides.into_iter().fold(0.0, f64::max) <= 4.0 * sides.into_iter().fold(f64::INFINITY, f64::min)
    };
    mesh.triangles.iter().filter(is_good).count() as f64 / mesh.triangles.len() as f64
}

/// Surface of quads between sections with equal ids, as triangles, µm.
fn reference(sections: &[Section], wall: usize) -> Vec<[[f64; 3]; 3]> {
    let mut triangles = Vec::new();
    for pair in sections.windows(2) {
        let point = |s: &Section, i: usize| {
            let ring = [&s.inner, &s.outer][wall];
            let [x, y] = ring.points[i % ring.len()].map(f64::from);
            [x, y, s.z_um]
        };
        for i in 0..[&pair[0].inner, &pair[0].outer][wall].len() {
            let [a, b, c, d] = [(0, i), (0, i + 1), (1, i + 1), (1, i)].map(|(k, i)| point(&pair[k], i));
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    triangles
}

/// Maximum distance between a wall and the lofted surface, in both directions, µm.
fn distance(mesh: &Mesh, sections: &[Section], wall: usize) -> f64 {
    let result: Vec<[[f64; 3]; 3]> = mesh.triangles[mesh.patches[wall].triangles.clone()]
        .iter()
        .map(|t| t.map(|v| mesh.positions[v as usize].map(|x| f64::from(x) * 1e6)))
        .collect();
    let reference = reference(sections, wall);
    let one_way = |from: &[[[f64; 3]; 3]], to: &[[[f64; 3]; 3]]| {
        Triangles::new(to.len(), |i| to[i]).farthest(0.0, from.len(), |i, visit| {
            let [a, b, c] = from[i];
            for j in 0..=8 {
                for k in 0..=8 - j {
                    let (v, w) = (f64::from(j) / 8.0, f64::from(k) / 8.0);
                    visit([0, 1, 2].map(|k| a[k] + (b[k] - a[k]) * v + (c[k] - a[k]) * w));
                }
            }
        })
    };
    one_way(&result, &reference).max(one_way(&reference, &result))
}

#[test]
fn surfaces_are_sound_even_and_near() {
    for sections in [cylinder(), folded()] {
        let mesh = made(&sections, false).tissue;
        check(&mesh);
        let share = share_of_good(&mesh);
        assert!(share > 0.99, "{share}");
        for wall in 0..2 {
            let distance = distance(&mesh, &sections, wall);
            assert!(distance <= 4.0, "wall {wall}: {distance} µm");
        }
    }
}

/// An outer wall with edges of 240 µm. A particle is added at the midpoint of each, in sections that
/// differ, and moves out to the circle, by 8 µm, until the next section.
fn sparse() -> Vec<Section> {
    let (n, radius) = (24, 900.0);
    let outer = |k: usize| {
        let middle_radius = |i: usize| {
            let added = (7 * i) % 21 + 2;
            let flat = radius * (TAU / (2 * n) as f64).cos();
            if k > added { radius } else { flat }
        };
        let at = |j: usize| {
            let angle = TAU * j as f64 / (2 * n) as f64;
            let r = if j.is_multiple_of(2) { radius } else { middle_radius(j / 2) };
            [r * angle.cos(), r * angle.sin()]
        };
        ring((0..2 * n).map(at).collect())
    };
    (0..33).map(|k| section(k, 12.5, circle(80, |_| 300.0), outer(k))).collect()
}

#[test]
fn sparse_walls_that_bulge_between_two_sections_are_followed_within_the_tolerance() {
    let sections = sparse();
    let mesh = made(&sections, false).tissue;
    check(&mesh);
    let distance = distance(&mesh, &sections, 1);
    assert!(distance <= 4.0, "{distance} µm");
}

#[test]
fn ends_lie_in_their_planes() {
    let sections = folded();
    let mesh = made(&sections, false).tissue;
    let names: Vec<&str> = mesh.patches.iter().map(|patch| patch.kind.name()).collect();
    assert_eq!(names, ["inner_wall", "outer_wall", "cap_isthmus", "cap_ampulla"]);
    let planes = [&sections[0], &sections[sections.len() - 1]].map(|s| (s.z_um * 1e-6) as f32);
    for (patch, z) in mesh.patches[2..].iter().zip(planes) {
        let vertices = mesh.triangles[patch.triangles.clone()].iter().flatten();
        assert!(vertices.clone().count() > 0);
        assert!(vertices.clone().all(|&v| mesh.positions[v as usize][2].to_bits() == z.to_bits()));
    }
}

#[test]
fn lids_share_the_rims_of_the_inner_wall() {
    let Remeshed { tissue, lids } = made(&folded(), true);
    let lids = lids.unwrap();
    let wall = &tissue.triangles[tissue.patches[0].triangles.clone()];
    let triangles: Vec<[u32; 3]> =
        wall.iter().map(|&[a, b, c]| [a, c, b]).chain(lids.inlet.clone()).chain(lids.outlet.clone()).collect();
    // The lumen alone, with only the vertices that it uses.
    let all = [&tissue.positions[..], &lids.positions].concat();
    let mut number = HashMap::new();
    let mut positions = Vec::new();
    let triangles: Vec<[u32; 3]> = triangles
        .iter()
        .map(|t| {
            t.map(|v| {
                *number.entry(v).or_insert_with(|| {
                    positions.push(all[v as usize]);
                    positions.len() as u32 - 1
                })
            })
        })
        .collect();
    let patches = vec![Patch { kind: PatchKind::Wall, triangles: 0..triangles.len() }];
    check(&Mesh { body: BodyKind::Lumen, positions, triangles, patches });
}

#[test]
fn walls_that_nearly_touch_stay_apart() {
    for gap in [2.0, 0.6] {
        let mesh = made(&slit(gap), false).tissue;
        check(&mesh);
    }
}

#[test]
fn walls_that_meet_are_meshed_again_with_less_tolerance() {
    // If the tolerance ignored gaps, the two sides would intersect.
    let sections = slit(0.6);
    let mut plan = Plan::new(&sections, 900.0, &DEFAULT).unwrap();
    let coarse = Spot { centre: [0.0, 0.0, 1100.0], radius: 500.0, tolerance: 1.0, fresh: true };
    plan.update(&[coarse], &|_| false).unwrap();
    let before = plan.assemble().unwrap().mesh.triangles.len();
    let spots = plan.tightened(&plan.assemble().unwrap().mesh, &[[0, 1]], &[coarse]);
    assert!((spots[1].tolerance - 0.4).abs() < 1e-12 && spots[1].fresh && !spots[0].fresh);
    plan.update(&spots, &|_| false).unwrap();
    assert!(plan.assemble().unwrap().mesh.triangles.len() >= before);
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let sections = folded();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        // Short sheets, so that there are several of them.
        let quality = Quality { resolution_um: 10.0, outer_um: 20.0, lids: true, ..DEFAULT };
        pool.install(|| remesh(&sections, &quality, &|_| false)).unwrap()
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn it_stops_when_asked() {
    assert_eq!(remesh(&cylinder(), &DEFAULT, &|_| true), Err(RemeshError::Stopped));
}

#[test]
fn sections_that_form_no_surface_are_refused() {
    let mut sections = cylinder();
    assert_eq!(remesh(&sections[..1], &DEFAULT, &|_| false), Err(RemeshError::Sections));
    sections[4].inner.ids[7] = 999;
    assert_eq!(remesh(&sections, &DEFAULT, &|_| false), Err(RemeshError::Sections));
    let turned: Vec<Section> = cylinder().into_iter().rev().collect();
    assert_eq!(remesh(&turned, &DEFAULT, &|_| false), Err(RemeshError::Sections));
}

/// Sections of 10 steps: rows are much farther apart than the edges are long.
#[test]
fn sections_may_be_far_apart() {
    let sections: Vec<Section> =
        folded().into_iter().step_by(12).map(|s| Section { z_um: 10.0 * s.z_um, ..s }).collect();
    let mesh = made(&sections, false).tissue;
    check(&mesh);
    assert!(share_of_good(&mesh) > 0.99);
}
