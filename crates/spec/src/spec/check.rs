//! Rules between parameters: monotone growth, room for the walls, agreement of the options. For the
//! stability of the integration see [`super::stability`].

use super::canonical::number;
use super::fault::Fault;
use super::layers::{MAX_SIDE_VOXELS, MAX_SLICES};
use super::parameters::Parameters;
use super::schedule::Schedule;

pub(super) const MIN_INNER_PARTICLES: f64 = 16.0;
/// Minimum distance of recorded sections along the tube, because positions are exported in single
/// precision.
const MIN_SECTION_DISTANCE_UM: f64 = 0.05;
/// Minimum edge length in clearances. A split needs 40 clearances and halves the edge.
const EDGE_CLEARANCES: f64 = 80.0;
/// Minimum distance of recorded sections in units of the last place of the tube's length (metres,
/// single precision). Mending needs room for additional sections.
const MIN_SECTION_DISTANCE_ULPS: f64 = 64.0;
/// Minimum fraction of its scheduled particles that a loop must have at every step.
const MIN_SCHEDULED_FRACTION: f64 = 0.75;
/// Minimum edge length of an even surface: about half of the distance between particles.
const MIN_RESOLUTION_UM: f64 = 5.0;
/// Number of evenly spaced places at which schedules are compared.
const PLACES: u32 = 512;

/// Checks all rules between parameters. A rule that involves a pointer of `bad` is skipped: that
/// value could not be read and is the one of the preset.
pub(super) fn faults(p: &Parameters, bad: &[String]) -> Vec<Fault> {
    let mut checks = Checks { bad, faults: Vec::new() };
    checks.stability(p);
    checks.place(p);
    checks.growth(p);
    checks.solver(p);
    checks.room(p);
    checks.outline(p);
    checks.folds(p);
    checks.regions(p);
    checks.mesh(p);
    checks.piece(p);
    checks.labels(p);
    checks.course(p);
    checks.contraction(p);
    checks.faults
}

pub(super) struct Checks<'a> {
    bad: &'a [String],
    pub(super) faults: Vec<Fault>,
}

impl Checks<'_> {
    /// Records a fault at `at` if `ok` is false, unless a value in `about` could not be read.
    pub(super) fn require(&mut self, ok: bool, at: &str, about: &[&str], detail: impl FnOnce() -> String) {
        if !ok && !self.bad.iter().any(|bad| about.contains(&bad.as_str())) {
            self.faults.push(Fault::new(at, detail()));
        }
    }

    fn place(&mut self, p: &Parameters) {
        let before = self.faults.len();
        for (at, u, due) in [("/z/keys/0/1", 0.0, 0.0), ("/z", 1.0, 1.0)] {
            self.require(p.z.at(u) == due, at, &["/z"], || {
                format!(
                    "is {} at {u} of the steps and must be {due} there: the sections span the whole length",
                    p.z.at(u)
                )
            });
        }
        for (i, pair) in p.z.keys.windows(2).enumerate() {
            let (a, b) = (pair[0][1], pair[1][1]);
            self.require(b > a, &format!("/z/keys/{}/1", i + 1), &["/z"], || {
                format!("is {b}, not above {a} of the key before it; the place along the tube must increase strictly")
            });
        }
        if self.faults.len() > before {
            return;
        }
        let place = |step: u32| p.z.at(f64::from(step) / f64::from(p.steps)) * p.length_mm * 1000.0;
        let stations: Vec<u32> = p.stations().collect();
        let thinnest =
            stations.windows(2).map(|s| (place(s[1]) - place(s[0]), s[0])).min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((distance, step)) = thinnest {
            let about = ["/z", "/length_mm", "/steps", "/solver/record_every"];
            let least = MIN_SECTION_DISTANCE_UM.max(MIN_SECTION_DISTANCE_ULPS * ulp_um(p.length_mm));
            self.require(distance >= least, "/z", &about, || {
                format!(
                    "puts the sections after step {step} only {distance:.2e} µm apart; at least {least:.3} µm are needed, because \
                     positions are exported in single precision (use another /length_mm, a greater /solver/record_every, or a \
                     steeper schedule)"
                )
            });
        }
    }

    fn regions(&mut self, p: &Parameters) {
        let (from, to) = (p.regions.junction_from, p.regions.junction_to);
        let pointers = ["/regions/junction_to", "/regions/junction_from"];
        self.require(from <= to, pointers[0], &pointers, || {
            format!("is {to}, before the junction's start at {from} (/regions/junction_from)")
        });
    }

    fn mesh(&mut self, p: &Parameters) {
        let (at, resolution) = ("/mesh/resolution_um", p.mesh.resolution_um);
        self.require(resolution == 0.0 || resolution >= MIN_RESOLUTION_UM, at, &[at], || {
            format!(
                "is {}; use at least {MIN_RESOLUTION_UM} µm, or 0 for the surface of the recorded sections",
                number(resolution)
            )
        });
        let textured = "/mesh/textured";
        self.require(!p.mesh.textured || resolution == 0.0, textured, &[textured, at], || {
            format!(
                "is true, and {at} is {}: an even surface has no texture coordinates, since its vertices do not lie in sections \
                 (use {at} 0)",
                number(resolution)
            )
        });
    }

    fn contraction(&mut self, p: &Parameters) {
        if !p.contracts() {
            return;
        }
        let (at, resolution) = ("/contraction/frames", "/mesh/resolution_um");
        let (of, frames) = (&p.contraction, p.contraction.frames);
        self.require(frames != 1, at, &[at], || "is 1; use at least 2 frames, or 0 for none".to_owned());
        self.require(p.mesh.resolution_um == 0.0, at, &[at, resolution], || {
            format!(
                "is {frames}, and /mesh/resolution_um is {}: an even surface does not contract, since its vertices do not lie in \
                 sections (use /mesh/resolution_um 0)",
                number(p.mesh.resolution_um)
            )
        });
        let [closure, shortening] = ["/contraction/closure", "/contraction/shortening"];
        let moves = of.closure.range().1 > 0.0 || of.shortening.range().1 > 0.0;
        self.require(moves, at, &[at, closure, shortening], || {
            format!("is {frames}, and {closure} and {shortening} are 0: nothing would move")
        });
        let ends = "/contraction/ends_mm";
        let [from, to] = p.piece_um();
        let length_mm = (to - from) / 1000.0;
        self.require(2.0 * of.ends_mm <= length_mm, ends, &[at, ends, "/length_mm", "/piece", "/z", "/steps"], || {
            format!(
                "is {}, more than half of the {length_mm:.3} mm that are modelled: the wave would not reach its height (use a shorter \
                 distance)",
                number(of.ends_mm)
            )
        });
    }

    fn piece(&mut self, p: &Parameters) {
        let (from, to) = ("/piece/from", "/piece/to");
        let piece = &p.piece;
        self.require(piece.from < piece.to, to, &[from, to], || {
            format!("is {}, not above /piece/from {}", number(piece.to), number(piece.from))
        });
    }

    fn growth(&mut self, p: &Parameters) {
        let (total, outer) = (&p.particles.total, &p.particles.outer);
        let (at_total, at_outer) = ("/particles/total", "/particles/outer");
        let before = self.faults.len();
        for (at, schedule) in [(at_total, total), (at_outer, outer)] {
            for (i, pair) in schedule.keys.windows(2).enumerate() {
                let (a, b) = (pair[0][1], pair[1][1]);
                self.require(b >= a, &format!("{at}/keys/{}/1", i + 1), &[at], || {
                    format!("is {b}, below {a} of the key before it; particles are never taken away")
                });
            }
        }
        let both = [at_total, at_outer];
        let inner = |u: f64| total.at(u) - outer.at(u);
        let first = inner(0.0);
        self.require(first >= MIN_INNER_PARTICLES, at_total, &both, || {
            format!(
                "leaves {} particles to the inner loop at the start; it needs at least {MIN_INNER_PARTICLES}",
                number(first)
            )
        });
        if self.faults.len() > before {
            return;
        }
        // A tolerance of one particle, because counts are rounded.
        let shrinks = comparison_fractions(&[total, outer])
            .windows(2)
            .map(|u| (u[0], inner(u[0]), inner(u[1])))
            .find(|(_, a, b)| *b < a - 1.0);
        if let Some((u, a, b)) = shrinks {
            self.require(false, at_outer, &both, || {
                format!(
                    "grows faster than /particles/total near {u:.3} of the steps, so that the inner loop would shrink \
                     from {a:.0} to {b:.0} particles"
                )
            });
            return;
        }
        if let Some(slow) = growth_lag(p) {
            let at = "/particles/every";
            self.require(false, at, &[at, at_total, at_outer, "/steps"], || slow);
        }
    }

    fn solver(&mut self, p: &Parameters) {
        let (at, clearance, edge) =
            ("/collision/clearance_um", p.collision.clearance_um, p.particles.edge_um.range().0);
        self.require(clearance * EDGE_CLEARANCES <= edge, at, &[at, "/particles/edge_um"], || {
            format!(
                "is {clearance} µm, above {:.4} µm, a {EDGE_CLEARANCES:.0}th of the least edge length {edge} µm: \
                 every split would be refused",
                edge / EDGE_CLEARANCES
            )
        });
    }

    fn room(&mut self, p: &Parameters) {
        let c = &p.containment;
        let schedules =
            [&p.particles.total, &p.particles.outer, &p.particles.edge_um, &c.squash, &c.spacing_um, &c.wall_um];
        let swing = p.wall.lobing.fluctuation.map_or(0.0, |f| f.amplitude);
        let tight = comparison_fractions(&schedules).into_iter().find_map(|u| {
            let r_in = p.inner_radius_um(u);
            let wall = c.wall_um.at(u);
            let lobe = (p.wall.lobing.at(u) + swing) * (r_in + wall);
            (lobe > 0.5 * wall).then_some((u, lobe, wall))
        });
        if let Some((u, lobe, wall)) = tight {
            let about = [
                "/wall/lobing",
                "/containment/wall_um",
                "/containment/squash",
                "/containment/spacing_um",
                "/particles/total",
                "/particles/outer",
                "/particles/edge_um",
            ];
            self.require(false, "/wall/lobing", &about, || {
                format!(
                    "makes lobes of {lobe:.0} µm at {u:.3} of the steps, more than half of the wall's {wall:.0} µm \
                     (/containment/wall_um): the outer wall would meet the inner one"
                )
            });
        }
    }
}

impl Checks<'_> {
    /// Checks the course. It depends on the size of the tube, so it is skipped if a parameter of
    /// the size is faulty.
    fn course(&mut self, p: &Parameters) {
        const ABOUT: [&str; 10] = [
            "/course",
            "/length_mm",
            "/scale",
            "/steps",
            "/z",
            "/particles",
            "/containment",
            "/outline",
            "/wall",
            "/collision/clearance_um",
        ];
        let is_about = |at: &str| ABOUT.iter().any(|about| at.starts_with(about));
        if !self.faults.iter().any(|fault| is_about(&fault.pointer)) && !self.bad.iter().any(|at| is_about(at)) {
            self.faults.extend(p.course_fault());
        }
    }

    fn labels(&mut self, p: &Parameters) {
        let (from, to) = ("/labels/from", "/labels/to");
        let labels = &p.labels;
        self.require(labels.from < labels.to, to, &[from, to], || {
            format!("is {}, not above /labels/from {}", number(labels.to), number(labels.from))
        });
        let slices = p.fitting_label_slices();
        let at = "/labels/slice_um";
        self.require(slices <= MAX_SLICES, at, &[at, from, to, "/length_mm", "/piece/from", "/piece/to"], || {
            format!("makes {slices} slices; a NIfTI file has at most {MAX_SLICES}; use a larger distance or a shorter volume")
        });
        let at = "/labels/voxel_um";
        let (side, _) = p.label_voxels();
        self.require(
            side <= MAX_SIDE_VOXELS,
            at,
            &[
                at,
                from,
                to,
                "/z",
                "/particles/total",
                "/particles/outer",
                "/particles/edge_um",
                "/containment/squash",
                "/containment/spacing_um",
                "/containment/wall_um",
                "/wall/lobing",
            ],
            || format!("makes slices about {side:.0} voxels wide; the limit is {MAX_SIDE_VOXELS}; use a larger voxel"),
        );
    }
}

/// Describes where a loop cannot follow its scheduled counts; `None` if both loops can. A growth
/// event at every `particles.every`-th step splits each edge at most once. A loop may lag slightly
/// and catch up at later events.
fn growth_lag(p: &Parameters) -> Option<String> {
    let count = |step: u32| {
        let u = f64::from(step) / f64::from(p.steps);
        let outer = p.particles.outer.at(u).round();
        [p.particles.total.at(u).round() - outer, outer]
    };
    let every = p.particles.every;
    let mut has = count(0);
    for step in (0..p.steps).step_by(every as usize) {
        let end = step.saturating_add(every).min(p.steps);
        let wanted = count(end);
        for (has, wanted) in has.iter_mut().zip(wanted) {
            *has = (2.0 * *has).min(wanted).max(*has);
        }
        let least = if end == p.steps { 1.0 } else { MIN_SCHEDULED_FRACTION };
        if let Some(k) = (0..2).find(|&k| has[k] < least * wanted[k]) {
            let (which, schedule) = [("inner", "/particles/total"), ("outer", "/particles/outer")][k];
            let more = if every > 1 { "more /steps, a smaller /particles/every" } else { "more /steps" };
            return Some(format!(
                "cannot follow the scheduled counts: each growth event can at most double a loop, so at step {end} of {} the {which} loop \
                 would have {:.0} of its {:.0} particles (use {more} or a flatter {schedule})",
                p.steps, has[k], wanted[k]
            ));
        }
    }
    None
}

/// Distance from this length in metres to the next single-precision number, µm.
fn ulp_um(length_mm: f64) -> f64 {
    let metres = (length_mm * 1e-3) as f32;
    f64::from(metres.next_up() - metres) * 1e6
}

/// Ascending fractions of the steps at which to compare schedules: evenly spaced, and at all keys.
fn comparison_fractions(schedules: &[&Schedule]) -> Vec<f64> {
    let even = (0..=PLACES).map(|i| f64::from(i) / f64::from(PLACES));
    let mut places: Vec<f64> = even.chain(schedules.iter().flat_map(|s| s.fractions())).collect();
    places.sort_by(f64::total_cmp);
    places.dedup();
    places
}
