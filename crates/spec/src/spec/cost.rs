//! Predicts the cost of growing a specification before anything is computed.
//!
//! Counts follow from the schedules. A section has one vertex per particle. A particle added
//! between two sections is also inserted into the earlier one, on the edge that it split. A closed
//! surface of Euler number 0 has twice as many triangles as vertices. The vertices of an even
//! surface follow from the area of the walls. Sections added by mending are not predicted. Sizes
//! and seconds follow from the constants below.

use super::parameters::{Integrator, Search};
use super::{ModelSpec, Parameters};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::f64::consts::PI;

// Seconds are measured on one thread of an AMD EPYC (family 25, model 1; AVX2) with version 0.3.0.
/// Seconds per pair of a particle and a segment, with neighbour lists. Together with
/// [`PARTICLE_SECONDS`] it predicts `paper`, `pig`, `human`, `cow` and small sections within 50 %.
const LIST_PAIR_SECONDS: f64 = 1.2e-9;
/// Seconds per particle and stage, without the pairs.
const PARTICLE_SECONDS: f64 = 70e-9;
/// Time with the grid, which is rebuilt in each stage, divided by the time with lists. Measured
/// with 2,000 particles.
const GRID_FACTOR: f64 = 1.6;
/// Seconds per pair with all pairs. Measured: 1.5e-9 with 2,000 particles, 2e-9 with 8,300.
const ALL_PAIRS_SECONDS: f64 = 1.8e-9;
/// Distance by which neighbour lists extend beyond the range of the force. The CPU chooses 5 to 30
/// µm, mostly 10.
const SKIN_UM: f64 = 10.0;
/// Time on two threads divided by the time on one.
const TWO_CORES: f64 = 0.6;
/// Seconds per triangle for slab tests, loft, certificate and files. Measured on `paper` with
/// `glb`.
const TRIANGLE_SECONDS: f64 = 0.65e-6;
/// Seconds per triangle for levels of detail on one core. Measured on the default model.
const LEVELS_SECONDS: f64 = 1.3e-6;
/// Seconds per triangle for morphometry. Measured on `paper`.
const MEASURE_SECONDS: f64 = 0.45e-6;
/// Memory that does not depend on the model. Assumed.
const BASE_BYTES: u64 = 32 << 20;
/// Memory per vertex and per triangle of the surface: position, indices.
const SURFACE_BYTES: u64 = 12;
/// Memory per vertex and per triangle for the certificate, without the surface. Per vertex:
/// section, component, list of triangles. Per triangle: entries in these lists, orientation,
/// hierarchy of the search. Counted. With the surface and [`BASE_BYTES`], 25 % more than measured on
/// `paper` with 1.6 and 15.8 million triangles.
const CERTIFY_BYTES: [u64; 2] = [28, 24];
/// Memory per triangle for levels of detail after the certificate, without the surface: numbers,
/// cells and normals. Measured on `paper`: 38 bytes; the rest is a margin.
const LEVELS_BYTES: u64 = 48;
/// Memory per particle and step since the last recorded section. These steps are kept to mend the
/// slab: the section and, on a GPU, the state of a checkpoint.
const HISTORY_BYTES: u64 = 64;
/// Triangles of an even surface, of the inner and of the outer wall, per area of a squared edge
/// length. This and the next five constants are measured on pieces of the presets `pig` and `human`
/// with edges of 20 to 80 µm.
const EVEN_TRIANGLES: [f64; 2] = [5.8, 3.7];
/// Edge length at folds divided by the root of tolerance times distance of particles.
const FOLD_EDGE: f64 = 6.0;
/// Memory per triangle for remeshing, without the sections.
const REMESH_BYTES: f64 = 100.0;
/// Seconds per triangle for remeshing on one core.
const REMESH_SECONDS: f64 = 18e-6;
/// Memory per point of a section.
const POINT_BYTES: f64 = 12.0;
/// Seconds per point for smoothing a section.
const SMOOTH_SECONDS: f64 = 0.15e-6;
/// Time of remeshing with smooth contours divided by the time without. Measured: 4 for `pig`, 8 for
/// `cow`.
const SMOOTH_FACTOR: f64 = 6.0;
/// Number of places at which the work is sampled.
const PLACES: u32 = 256;

/// Maximum number of triangles of the simplified levels of detail, the finer level first.
pub const LEVEL_TRIANGLES: [usize; 2] = [300_000, 60_000];

/// Size of a file in bytes: fixed, per vertex, per triangle, and per triangle if walls are strips.
struct Size {
    name: &'static str,
    fixed: f64,
    vertex: f64,
    triangle: f64,
    strip: f64,
}

impl Size {
    const fn new(name: &'static str, fixed: f64, vertex: f64, triangle: f64, strip: f64) -> Self {
        Self { name, fixed, vertex, triangle, strip }
    }
}

/// Sizes by output. Sizes of binary formats follow from their layout: positions and normals of
/// 4-byte floats, 4-byte indices, about one index per triangle of a strip. Sizes of text and
/// compressed formats are assumed.
const SIZES: [Size; 10] = [
    Size::new("glb", 4096.0, 24.0, 12.0, 4.1),
    Size::new("gltf", 8192.0, 24.0, 12.0, 4.1),
    Size::new("obj", 1024.0, 33.0, 24.0, 24.0),
    Size::new("stl", 84.0, 0.0, 50.0, 50.0),
    Size::new("stl-ascii", 512.0, 0.0, 195.0, 195.0),
    Size::new("ply", 1024.0, 12.0, 13.0, 13.0),
    Size::new("vtp", 4096.0, 24.0, 20.0, 20.0),
    Size::new("centreline", 2600.0, 0.0, 0.0, 0.0),
    Size::new("sections", 4096.0, 9.0, 0.0, 0.0),
    Size::new("report", 65_536.0, 0.0, 0.0, 0.0),
];

/// Formats with separate files for each body.
const OF_BODIES: [&str; 7] = ["glb", "gltf", "obj", "stl", "stl-ascii", "ply", "vtp"];

/// Bytes per section in both files of the centre line.
const CENTRELINE_SECTION_BYTES: u64 = 270;
/// Memory per vertex and per triangle of the lumen and of both bodies together, for positions and
/// indices.
const BODIES_BYTES: u64 = 40;
/// Seconds per triangle for the certificates of the lumen and of both bodies together, on one core.
/// Measured on the default model.
const BODIES_SECONDS: f64 = 0.9e-6;

/// Seconds per triangle for a lean, on one core: displacement, search of intersecting triangles,
/// measured cuts. Measured on the default model.
const LEAN_SECONDS: f64 = 1.7e-6;

/// Seconds per triangle for bending, on one core: displacement, search of intersecting triangles.
/// Measured on the default model.
const BEND_SECONDS: f64 = 1.7e-6;
/// Memory per vertex and per triangle of a bent surface: a copy of the straight surface.
const BEND_BYTES: u64 = 12;

/// Seconds per triangle of a frame of a contraction, which is created twice, searched, damped and
/// certified, on one core. Measured on the default model with 20 frames in the dev profile;
/// optimized builds are faster.
const FRAME_SECONDS: f64 = 5e-6;
/// Memory per vertex of a contraction, counted: tables of sections and their lean, two frames, the
/// hierarchy of the search.
const FRAME_VERTEX_BYTES: u64 = 260;
/// Bytes of a frame in the description of a contraction.
const FRAME_FIXED: f64 = 1024.0;
/// Bytes of the certificate of a frame in the report.
const FRAME_REPORT_BYTES: u64 = 2600;

/// Bytes of the measures of a section in the report. Measured on the default model.
const REPORT_SECTION_BYTES: u64 = 850;
/// Bytes per triangle of the finest level of detail, and of a simplified level, including vertices.
/// Measured on the default model.
const LEVEL_TRIANGLE_BYTES: [f64; 2] = [3.5, 4.7];
/// Bytes of the JSON document of a level of detail.
const LEVEL_FIXED: f64 = 4096.0;

/// Bytes of both label files per voxel of 1 µm. They grow with the root of the side of a voxel.
/// This and the next two constants are measured on the default model with voxels of 2 to 20 µm.
const LABEL_VOXEL_BYTES: f64 = 0.036;
/// Seconds per voxel of a label volume on one core.
const LABEL_VOXEL_SECONDS: f64 = 65e-9;
/// Seconds per slice of a label volume on one core.
const LABEL_SLICE_SECONDS: f64 = 8e-3;
/// Slices of a label volume in memory at a time (`export::labels::SLICES_AT_A_TIME`).
const LABEL_SLICES: f64 = 16.0;
/// Bytes of the headers of both label files.
const LABEL_FIXED: f64 = 4096.0;
/// Bytes of the directories of a slice in both label files.
const LABEL_SLICE_BYTES: f64 = 300.0;

/// Predicted cost of growing a specification.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Cost {
    /// Particles of both loops at the end.
    pub particles_end: u32,
    /// Recorded sections, without those added by mending.
    pub sections: u32,
    /// Vertices of the surface.
    pub vertices: u64,
    /// Triangles of the surface.
    pub triangles: u64,
    /// Size by output, including `sections` and `report`, which are always written.
    pub bytes: BTreeMap<String, u64>,
    /// Greatest memory in use.
    pub memory_bytes: u64,
    /// Seconds from start to end, by backend.
    pub seconds: BTreeMap<String, Estimate>,
}

/// A number of seconds and its basis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Estimate {
    /// Seconds.
    pub seconds: f64,
    /// Basis of the number.
    pub basis: String,
}

impl ModelSpec {
    /// Predicts the cost of growing this model with the given outputs. `outputs` are names of
    /// formats (such as `glb`) and of bodies (`tissue` if none is named). Unknown names are
    /// ignored.
    #[must_use]
    pub fn cost(&self, outputs: &[&str]) -> Cost {
        let Counts { particles_end, sections, section_points, vertices } = self.counts();
        let triangles = 2.0 * vertices;
        let has = |name: &str| outputs.contains(&name);
        let needs_lumen = has("lumen") || has("regions");
        // The lumen has only the vertices of the inner loop.
        let inner = 1.0 - self.particles.outer.at(1.0) / self.particles.total.at(1.0);
        let tissues = f64::from(u8::from(has("tissue") || !needs_lumen));
        let bodies = tissues + f64::from(u8::from(has("regions"))) + inner * f64::from(u8::from(has("lumen")));
        let size = |size: &Size| {
            let triangle = if self.mesh.strips { size.strip } else { size.triangle };
            let of = if OF_BODIES.contains(&size.name) { bodies } else { 1.0 };
            let vertices = if size.name == "sections" { section_points } else { vertices };
            (size.name.to_owned(), count(of * (size.fixed + size.vertex * vertices + triangle * triangles)))
        };
        let kept = |s: &&Size| outputs.contains(&s.name) || ["sections", "report"].contains(&s.name);
        let mut bytes: BTreeMap<String, u64> = SIZES.iter().filter(kept).map(size).collect();
        bytes.entry("report".to_owned()).and_modify(|bytes| *bytes += u64::from(sections) * REPORT_SECTION_BYTES);
        bytes
            .entry("centreline".to_owned())
            .and_modify(|bytes| *bytes += u64::from(sections) * CENTRELINE_SECTION_BYTES);
        if outputs.contains(&"lod") {
            bytes.insert("lod".to_owned(), count(levels_bytes(triangles)));
        }
        if self.contracts() {
            bytes.insert("contraction".to_owned(), count(self.frames_bytes(vertices, triangles)));
            let reports = u64::from(self.contraction.frames) * FRAME_REPORT_BYTES;
            bytes.entry("report".to_owned()).and_modify(|bytes| *bytes += reports);
        }
        let labels = outputs.contains(&"labels").then(|| self.label_cost(triangles));
        if let Some(labels) = &labels {
            bytes.insert("labels".to_owned(), count(labels.bytes));
        }
        let remeshed = if self.mesh.resolution_um > 0.0 { triangles } else { 0.0 };
        let (vertices, triangles) = (count(vertices), count(triangles));
        let levels = if outputs.contains(&"lod") { triangles * LEVELS_BYTES } else { 0 };
        let certify = vertices * CERTIFY_BYTES[0] + triangles * CERTIFY_BYTES[1];
        let surface = (vertices + triangles) * SURFACE_BYTES + u64::max(certify, levels);
        let history = if remeshed > 0.0 {
            count(section_points * f64::from(self.solver.record_every) * POINT_BYTES + remeshed * REMESH_BYTES)
        } else {
            u64::from(particles_end) * u64::from(self.solver.record_every.min(self.steps)) * HISTORY_BYTES
        };
        Cost {
            particles_end,
            sections,
            vertices,
            triangles,
            bytes,
            memory_bytes: BASE_BYTES
                + surface
                + history
                + if self.bends() { (vertices + triangles) * BEND_BYTES } else { 0 }
                + if self.contracts() { self.frames_memory(vertices, triangles) } else { 0 }
                + if needs_lumen { (vertices + triangles) * BODIES_BYTES } else { 0 }
                + labels.as_ref().map_or(0, |labels| count(labels.memory)),
            seconds: {
                #[expect(clippy::cast_precision_loss, reason = "an estimate")]
                let lumen = if needs_lumen { triangles as f64 * BODIES_SECONDS } else { 0.0 };
                let lean = if self.leans() { triangles as f64 * LEAN_SECONDS } else { 0.0 };
                let bend = if self.bends() { triangles as f64 * BEND_SECONDS } else { 0.0 };
                let frames = f64::from(self.contraction.frames) * triangles as f64 * FRAME_SECONDS;
                let more = lumen
                    + lean
                    + bend
                    + frames
                    + remeshed * self.remesh_seconds()
                    + section_points * self.smooth_seconds();
                self.seconds(triangles, has("lod"), more + labels.map_or(0.0, |labels| labels.seconds))
            },
        }
    }

    /// Bytes of the files of a contraction.
    fn frames_bytes(&self, vertices: f64, triangles: f64) -> f64 {
        let frames = f64::from(self.contraction.frames);
        let level = triangles.min(LEVEL_TRIANGLES[1] as f64);
        13.0 * triangles + 24.0 * level + frames * (12.0 * vertices + 16.0 * level + FRAME_FIXED)
    }

    /// Memory of a contraction: one frame at a time, and the animation.
    fn frames_memory(&self, vertices: u64, triangles: u64) -> u64 {
        let level = triangles.min(LEVEL_TRIANGLES[1] as u64);
        vertices * FRAME_VERTEX_BYTES + u64::from(self.contraction.frames) * level * 18 + triangles * LEVELS_BYTES
    }

    fn counts(&self) -> Counts {
        let particles = |step: u32| self.particles.total.at(f64::from(step) / f64::from(self.steps)).round();
        let piece = self.recorded();
        // A smooth contour has two points per particle.
        let points = if self.mesh.smooth_um > 0.0 { 2.0 } else { 1.0 };
        let (mut sections, mut section_points) = (0_u32, 0.0);
        for step in self.stations() {
            sections += 1;
            section_points += points * particles(step);
        }
        let vertices = if self.mesh.resolution_um > 0.0 {
            0.5 * self.even_triangles()
        } else {
            section_points + points * (particles(*piece.end()) - particles(*piece.start()))
        };
        let particles_end = u32::try_from(count(particles(*piece.end()))).unwrap_or(u32::MAX);
        Counts { particles_end, sections, section_points, vertices }
    }

    /// Triangles of an even surface: areas of the walls divided by the areas of their triangles.
    fn even_triangles(&self) -> f64 {
        let [begin, end] = self.piece_um();
        let (edge, tolerance) = (self.mesh.resolution_um, self.mesh.tolerance_um);
        // One place next to the piece on either side counts, because a short piece may contain
        // none.
        let beside = self.length_mm * 1000.0 / f64::from(PLACES);
        let (mut sum, mut places) = (0.0, 0.0);
        for u in (0..=PLACES).map(|k| f64::from(k) / f64::from(PLACES)) {
            let place = self.z.at(u) * self.length_mm * 1000.0;
            if place < begin - beside || place > end + beside {
                continue;
            }
            let particle = self.scale * self.particles.edge_um.at(u);
            let inner = (self.particles.total.at(u) - self.particles.outer.at(u)) * particle;
            let squash = self.containment.squash.at(u);
            let radius = self.inner_radius_um(u);
            let outer = self.scale * PI * (radius * (1.0 + squash) + 2.0 * self.containment.wall_um.at(u));
            let at_folds = edge.min(FOLD_EDGE * (tolerance * particle).sqrt());
            sum += EVEN_TRIANGLES[0] * inner / (at_folds * at_folds) + EVEN_TRIANGLES[1] * outer / (4.0 * edge * edge);
            places += 1.0;
        }
        (end - begin) * sum / f64::max(places, 1.0)
    }

    /// Seconds per triangle for remeshing.
    fn remesh_seconds(&self) -> f64 {
        if self.mesh.smooth_um > 0.0 { SMOOTH_FACTOR * REMESH_SECONDS } else { REMESH_SECONDS }
    }

    /// Seconds for smoothing all sections, per point of a recorded section.
    fn smooth_seconds(&self) -> f64 {
        let sections = if self.mesh.resolution_um > 0.0 { f64::from(self.solver.record_every) } else { 1.0 };
        if self.mesh.smooth_um > 0.0 { sections * SMOOTH_SECONDS } else { 0.0 }
    }

    /// Cost of a label volume.
    fn label_cost(&self, triangles: f64) -> LabelCost {
        let (slices, (_, voxels)) = (self.fitting_label_slices().max(1.0), self.label_voxels());
        let all = slices * voxels;
        LabelCost {
            bytes: LABEL_FIXED + slices * LABEL_SLICE_BYTES + all * LABEL_VOXEL_BYTES * self.labels.voxel_um.sqrt(),
            // The triangles of both walls are sorted.
            memory: slices.min(LABEL_SLICES) * voxels * 1.25 + triangles * 16.0,
            seconds: slices * LABEL_SLICE_SECONDS + all * LABEL_VOXEL_SECONDS,
        }
    }

    /// Seconds by backend. `more` are the seconds of optional work.
    fn seconds(&self, triangles: u64, levels: bool, more: f64) -> BTreeMap<String, Estimate> {
        #[expect(clippy::cast_precision_loss, reason = "an estimate")]
        let surface =
            more + triangles as f64 * (TRIANGLE_SECONDS + MEASURE_SECONDS + if levels { LEVELS_SECONDS } else { 0.0 });
        let one = self.simulation_seconds() + surface;
        let work = match self.solver.search {
            Search::Lists => "pairs within reach of neighbour lists",
            Search::Grid => "pairs within reach of a grid",
            Search::AllPairs => "all pairs",
        };
        let basis =
            |threads: &str| format!("{work} and triangles, at the speed of {threads} of an AMD EPYC (family 25, AVX2)");
        BTreeMap::from([
            ("cpu-single".to_owned(), Estimate { seconds: one, basis: basis("one thread") }),
            ("cpu".to_owned(), Estimate { seconds: one * TWO_CORES, basis: basis("two threads") }),
        ])
    }

    /// Seconds of the simulation on one core: burn-in, and the mean over sampled places along the
    /// tube.
    fn simulation_seconds(&self) -> f64 {
        let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(PLACES);
        let last = *self.recorded().end();
        let end = f64::from(last) / f64::from(self.steps);
        let mean = (0..PLACES).map(|i| self.step_seconds(end * middle(i))).sum::<f64>() / f64::from(PLACES);
        mean * f64::from(last) + self.step_seconds(0.0) * f64::from(self.burn_in)
    }

    /// Seconds of a step at `u` on one core. A segment occupies an area of edge length times
    /// spacing, which determines the number of segments within reach.
    fn step_seconds(&self, u: f64) -> f64 {
        let p: &Parameters = self;
        let inner = p.particles.total.at(u) - p.particles.outer.at(u);
        let stages = match p.solver.integrator {
            Integrator::Rk4 => 4.0,
            Integrator::Euler => 1.0,
        };
        let spread = p.variation.amplitude.at(u).hypot(p.variety.thickness.at(u));
        let range = p.collision.tissue_um.at(u).max(p.collision.gap_um.at(u)) * spread.exp();
        let reach = range + SKIN_UM;
        let near = (PI * reach * reach / (p.particles.edge_um.at(u) * p.containment.spacing_um.at(u))).min(inner);
        let pairs = match p.solver.search {
            Search::Lists => near * LIST_PAIR_SECONDS,
            Search::Grid => near * LIST_PAIR_SECONDS * GRID_FACTOR,
            Search::AllPairs => inner * ALL_PAIRS_SECONDS,
        };
        stages * inner * (pairs + PARTICLE_SECONDS)
    }
}

/// Counts that determine the cost.
struct Counts {
    particles_end: u32,
    sections: u32,
    /// Points of all recorded sections.
    section_points: f64,
    vertices: f64,
}

struct LabelCost {
    bytes: f64,
    memory: f64,
    seconds: f64,
}

/// Bytes of the files of all levels of detail of a model with this number of triangles.
fn levels_bytes(triangles: f64) -> f64 {
    let simplified: f64 = LEVEL_TRIANGLES.iter().map(|&most| triangles.min(most as f64)).sum();
    3.0 * LEVEL_FIXED + triangles * LEVEL_TRIANGLE_BYTES[0] + simplified * LEVEL_TRIANGLE_BYTES[1]
}

/// Converts a sum of counts to an integer.
fn count(value: f64) -> u64 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturating, and never negative")]
    let count = value.round() as u64;
    count
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::{Limits, preset};
    use serde_json::{Value, json};

    fn spec(patch: &Value) -> ModelSpec {
        ModelSpec::resolve(preset("paper").unwrap(), patch).unwrap()
    }

    #[test]
    fn the_papers_model_has_the_papers_size() {
        let cost = spec(&json!({})).cost(&["glb", "lod", "obj"]);
        assert_eq!((cost.particles_end, cost.sections), (8300, 201));
        assert!(cost.vertices.abs_diff(790_211) < 790_211 / 50, "{}", cost.vertices);
        assert_eq!(cost.triangles, 2 * cost.vertices);
        assert_eq!(cost.bytes.keys().collect::<Vec<_>>(), ["glb", "lod", "obj", "report", "sections"]);
        assert!(cost.seconds["cpu"].seconds < cost.seconds["cpu-single"].seconds);
        let without = spec(&json!({})).cost(&["glb", "obj"]);
        assert!(without.seconds["cpu"].seconds + 0.5 < cost.seconds["cpu"].seconds);
        assert!(without.memory_bytes < cost.memory_bytes);
    }

    #[test]
    fn the_papers_simulation_takes_what_was_measured() {
        let seconds = spec(&json!({})).simulation_seconds();
        assert!((3.5..5.5).contains(&seconds), "lists: {seconds} s");
        let seconds = spec(&json!({ "solver": { "search": "all_pairs" } })).simulation_seconds();
        assert!((240.0..340.0).contains(&seconds), "all pairs: {seconds} s");
    }

    #[test]
    fn a_last_step_beside_the_raster_is_recorded_too() {
        let s = spec(&json!({ "steps": 25, "particles": { "total": 900 } }));
        assert_eq!(s.stations().collect::<Vec<_>>(), [0, 10, 20, 25]);
        assert_eq!(s.cost(&[]).sections, 4);
        let s = spec(&json!({ "steps": 20, "particles": { "total": 900 } }));
        assert_eq!(s.stations().collect::<Vec<_>>(), [0, 10, 20]);
        let s = spec(&json!({ "steps": 1, "particles": { "total": 900, "outer": 100 } }));
        assert_eq!(s.stations().collect::<Vec<_>>(), [0, 1]);
    }

    #[test]
    fn the_steps_between_two_sections_take_memory() {
        let memory = |every: u32| spec(&json!({ "solver": { "record_every": every } })).cost(&[]).memory_bytes;
        assert!(memory(1000) > 500 << 20, "{}", memory(1000));
        assert!(memory(10) < 400 << 20, "{}", memory(10));
        let sparse = json!({
            "solver": { "record_every": 1000 }, "particles": { "total": 200_000, "outer": 1000 }, "wall": { "lobing": 0 },
        });
        let over = Limits::default().check(&spec(&sparse).cost(&[])).unwrap_err();
        assert!(over.iter().any(|o| o.quantity == "memory"), "{over:?}");
    }

    /// Peaks of the engine in MB, on two threads.
    #[test]
    fn memory_is_what_was_measured_and_some_to_spare() {
        let tenfold = json!({ "solver": { "record_every": 1 } });
        for (patch, outputs, measured) in
            [(&json!({}), &["glb"][..], 84.0), (&json!({}), &["glb", "lod"], 102.0), (&tenfold, &["glb"], 723.0)]
        {
            let predicted = spec(patch).cost(outputs).memory_bytes as f64 / 1e6;
            assert!((1.0..1.6).contains(&(predicted / measured)), "{outputs:?}: {predicted} MB");
        }
    }

    #[test]
    fn a_finer_label_volume_costs_more_up_to_the_limits() {
        let cost = |patch: &Value| spec(patch).cost(&["labels"]);
        let (coarse, fine) = (cost(&json!({})), cost(&json!({ "labels": { "voxel_um": 5, "slice_um": 25 } })));
        assert!(fine.bytes["labels"] > 5 * coarse.bytes["labels"], "{coarse:?} {fine:?}");
        assert!(fine.memory_bytes > coarse.memory_bytes && fine.seconds["cpu"].seconds > coarse.seconds["cpu"].seconds);
        assert!(!spec(&json!({})).cost(&["glb"]).bytes.contains_key("labels"));
        let piece = cost(&json!({ "labels": { "from": 0.9 } }));
        assert!(piece.bytes["labels"] < coarse.bytes["labels"] / 4, "{piece:?}");
        let over =
            Limits::default().check(&cost(&json!({ "labels": { "voxel_um": 0.5, "slice_um": 3 } }))).unwrap_err();
        let quantities: Vec<&str> = over.iter().map(|o| o.quantity.as_str()).collect();
        assert!(quantities.contains(&"seconds") && quantities.contains(&"output"), "{over:?}");
        assert!(over.iter().all(|o| o.to_string().contains("/labels")), "{over:?}");
    }

    #[test]
    fn strips_make_smaller_files_and_euler_less_work() {
        let full = spec(&json!({}));
        let strips = spec(&json!({ "mesh": { "strips": true } }));
        assert!(strips.cost(&["glb"]).bytes["glb"] < full.cost(&["glb"]).bytes["glb"]);
        let euler = spec(&json!({ "solver": { "integrator": "euler" } }));
        assert!(euler.simulation_seconds() < full.simulation_seconds() / 3.0);
    }
}
