//! Predicts the cost of growing a specification before anything is computed.
//!
//! Counts follow from the schedules. A section has one vertex per particle. A particle added
//! between two sections is also inserted into the earlier one, on the edge that it split. A closed
//! surface of Euler number 0 has twice as many triangles as vertices. The vertices of an even
//! surface follow from the area of the walls. Bending splits edges in tight bends. Sections added
//! by mending are not predicted. Sizes
//! and seconds follow from the constants below.

use super::outputs::{Output, Outputs};
use crate::export::labels::SLICES_AT_A_TIME;
use crate::export::lod::LEVEL_TRIANGLES;
use crate::measure::morphometry::detailed_places;
use crate::mesh::bend::PART_OF_RADIUS;
use crate::model::BodyKind;
use crate::spec::{Integrator, ModelSpec, Search};
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
/// Seconds per triangle for slab tests and loft, for the certificate, and for files. Measured on
/// `paper` with `glb`.
const TRIANGLE_SECONDS: [f64; 3] = [0.08e-6, 0.37e-6, 0.20e-6];
/// Seconds per triangle for levels of detail on one core. Measured on the default model.
const LEVELS_SECONDS: f64 = 1.3e-6;
/// Seconds per triangle for morphometry. Measured on `paper`.
const MEASURE_SECONDS: f64 = 0.45e-6;
/// Time for morphometry if cuts are measured in addition to sections, divided by the time without.
/// Estimated from the times of the parts for sections of `pig`.
const CUTS_FACTOR: f64 = 1.35;
/// Seconds per section whose layers are measured, on one core: one of twelve, at most 16. Measured
/// on sections of `pig`.
const LAYER_SECONDS: f64 = 0.02;
/// Memory that does not depend on the model. Assumed.
const BASE_BYTES: u64 = 32 << 20;
/// Memory per vertex and per triangle of the surface: position, indices.
const SURFACE_BYTES: u64 = 12;
/// Memory per vertex and per triangle for the certificate, without the surface. Per vertex:
/// section, component, list of triangles. Per triangle: entries in these lists, orientation,
/// hierarchy of the search. Counted. With the surface and [`BASE_BYTES`], 25 % more than measured
/// on `paper` with 1.6 and 15.8 million triangles.
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

/// Bytes of `sections.bin` without sections, and per point of a section. Assumed.
const SECTIONS_FIXED: f64 = 4096.0;
const SECTIONS_POINT_BYTES: f64 = 9.0;
/// Bytes of the report without sections. Assumed.
const REPORT_FIXED: u64 = 131_072;
/// Bytes of both files of the centre line, without sections and per section.
const CENTRELINE_FIXED: f64 = 2600.0;
const CENTRELINE_SECTION_BYTES: f64 = 270.0;
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
/// Bytes of the measures of a planar cut in the report, which has half as many quantities more.
/// Assumed.
const REPORT_CUT_BYTES: u64 = 1300;
/// Bytes of the compressed text of 3MF per triangle, including vertices. Measured on pieces of
/// `pig`.
const THREEMF_TRIANGLE_BYTES: f64 = 13.1;
/// Seconds per triangle for the text of 3MF on one core, mostly its compression. Measured on `pig`.
const THREEMF_SECONDS: f64 = 1.1e-6;

/// Bytes per triangle of the finest level of detail, and of a simplified level, including vertices.
/// Measured on the default model.
const LEVEL_TRIANGLE_BYTES: [f64; 2] = [3.5, 4.7];
/// Bytes of the pictures of a textured glTF file. Measured on `pig`.
const TEXTURE_BYTES: f64 = 3e6;
/// Memory per vertex of a textured surface, counted: coordinates, and the neighbours that they are
/// computed from.
const COORDINATE_BYTES: u64 = 16;

/// Bytes of the JSON document of a level of detail.
const LEVEL_FIXED: f64 = 4096.0;

/// Bytes of both label files per voxel of 1 µm. They grow with the root of the side of a voxel.
/// This and the next two constants are measured on the default model with voxels of 2 to 20 µm.
const LABEL_VOXEL_BYTES: f64 = 0.036;
/// Seconds per voxel of a label volume on one core.
const LABEL_VOXEL_SECONDS: f64 = 65e-9;
/// Seconds per slice of a label volume on one core.
const LABEL_SLICE_SECONDS: f64 = 8e-3;
/// Bytes of the headers of both label files.
const LABEL_FIXED: f64 = 4096.0;
/// Bytes of the directories of a slice in both label files.
const LABEL_SLICE_BYTES: f64 = 300.0;

/// Predicted cost of growing a specification.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Cost {
    /// Number of particles of both loops at the end.
    pub particles_end: u32,
    /// Number of recorded sections, without sections that mending adds.
    pub sections: u32,
    /// Number of vertices of the surface.
    pub vertices: u64,
    /// Number of triangles of the surface.
    pub triangles: u64,
    /// Size by output, bytes. Includes `sections` and `report`, which are always written.
    pub bytes: BTreeMap<String, u64>,
    /// Peak memory, bytes.
    pub memory_bytes: u64,
    /// Time from start to end, by backend.
    pub seconds: BTreeMap<String, Estimate>,
}

/// A predicted time and its basis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Estimate {
    /// Predicted time, seconds.
    pub seconds: f64,
    /// Basis of the prediction: counted work and reference machine.
    pub basis: String,
}

impl Cost {
    /// The longest of the predicted times, seconds.
    #[must_use]
    pub fn longest_seconds(&self) -> f64 {
        self.seconds.values().map(|estimate| estimate.seconds).fold(0.0, f64::max)
    }

    /// Predicts the cost of growing `spec` with these outputs.
    #[must_use]
    pub fn new(spec: &ModelSpec, outputs: &Outputs) -> Self {
        let counts = Counts::new(spec, outputs);
        let Counts { particles_end, sections, section_points, .. } = counts;
        let mut bytes: BTreeMap<String, u64> = outputs
            .formats
            .iter()
            .map(|output| (output.name().to_owned(), count(output.bytes(spec, &counts))))
            .collect();
        bytes.insert("sections".to_owned(), count(SECTIONS_FIXED + SECTIONS_POINT_BYTES * section_points));
        let frames = spec.contraction.frames;
        let measured = if has_cuts(spec) {
            u64::from(sections) * REPORT_SECTION_BYTES + detailed_places(sections as usize) as u64 * REPORT_CUT_BYTES
        } else {
            u64::from(sections) * REPORT_CUT_BYTES
        };
        let report = REPORT_FIXED + measured + u64::from(frames) * FRAME_REPORT_BYTES;
        bytes.insert("report".to_owned(), report);
        if spec.contracts() {
            bytes.insert("contraction".to_owned(), count(counts.frames_bytes(f64::from(frames))));
        }
        let (vertices, triangles) = (count(counts.vertices), count(counts.triangles));
        Self {
            particles_end,
            sections,
            vertices,
            triangles,
            bytes,
            memory_bytes: memory_bytes(spec, outputs, &counts),
            seconds: seconds(spec, outputs, &counts),
        }
    }
}

/// True if planar cuts of the surface are measured, because they differ from the sections.
fn has_cuts(spec: &ModelSpec) -> bool {
    spec.leans() || spec.mesh.resolution_um > 0.0
}

/// Peak memory, bytes.
fn memory_bytes(spec: &ModelSpec, outputs: &Outputs, counts: &Counts) -> u64 {
    let (vertices, triangles) = (count(counts.vertices), count(counts.triangles));
    let levels = if outputs.has(Output::Lod) { triangles * LEVELS_BYTES } else { 0 };
    let certify = vertices * CERTIFY_BYTES[0] + triangles * CERTIFY_BYTES[1];
    let every = spec.solver.record_every;
    let history = if spec.mesh.resolution_um > 0.0 {
        count(counts.section_points * f64::from(every) * POINT_BYTES + counts.triangles * REMESH_BYTES)
    } else {
        u64::from(counts.particles_end) * u64::from(every.min(spec.steps)) * HISTORY_BYTES
    };
    let mut memory = BASE_BYTES + (vertices + triangles) * SURFACE_BYTES + u64::max(certify, levels) + history;
    if spec.bends() {
        memory += (vertices + triangles) * BEND_BYTES;
    }
    if spec.mesh.textured {
        memory += vertices * COORDINATE_BYTES;
    }
    if spec.contracts() {
        // One frame at a time, and the animation.
        let level = triangles.min(LEVEL_TRIANGLES[1] as u64);
        let animation = u64::from(spec.contraction.frames) * level * 18;
        memory += vertices * FRAME_VERTEX_BYTES + animation + triangles * LEVELS_BYTES;
    }
    if counts.has_lumen {
        memory += (vertices + triangles) * BODIES_BYTES;
    }
    if outputs.has(Output::Labels) {
        let (slices, voxels) = label_voxels(spec);
        // The triangles of both walls are sorted.
        memory += count(slices.min(SLICES_AT_A_TIME as f64) * voxels * 1.25 + counts.triangles * 16.0);
    }
    memory
}

impl Output {
    /// Predicted size of its files. Sizes of binary formats follow from their layout: positions and
    /// normals of 4-byte floats, 4-byte indices, about one index per triangle of a strip. Sizes of
    /// text and compressed formats are assumed.
    fn bytes(self, spec: &ModelSpec, counts: &Counts) -> f64 {
        let &Counts { vertices, triangles, bodies, .. } = counts;
        let surface =
            |fixed: f64, vertex: f64, triangle: f64| bodies * (fixed + vertex * vertices + triangle * triangles);
        let gltf_triangle = if spec.mesh.strips { 4.1 } else { 12.0 };
        // Only the tissue has textures, so a request for the lumen gets less than predicted.
        let [textures, coordinates] = if spec.mesh.textured { [TEXTURE_BYTES, 8.0] } else { [0.0; 2] };
        match self {
            Self::Glb => surface(4096.0 + textures, 24.0 + coordinates, gltf_triangle),
            Self::Gltf => surface(8192.0 + textures, 24.0 + coordinates, gltf_triangle),
            Self::Obj => surface(1024.0, 33.0, 24.0),
            Self::Stl => surface(84.0, 0.0, 50.0),
            Self::StlAscii => surface(512.0, 0.0, 195.0),
            Self::Ply => surface(1024.0, 12.0, 13.0),
            Self::Vtp => surface(4096.0, 24.0, 24.0),
            Self::ThreeMf => bodies * 1024.0 + THREEMF_TRIANGLE_BYTES * triangles * counts.solids,
            Self::Centreline => CENTRELINE_FIXED + CENTRELINE_SECTION_BYTES * f64::from(counts.sections),
            Self::Lod => {
                let simplified: f64 = LEVEL_TRIANGLES.iter().map(|&most| triangles.min(most as f64)).sum();
                3.0 * LEVEL_FIXED + triangles * LEVEL_TRIANGLE_BYTES[0] + simplified * LEVEL_TRIANGLE_BYTES[1]
            }
            Self::Labels => {
                let (slices, voxels) = label_voxels(spec);
                let all = slices * voxels;
                LABEL_FIXED + slices * LABEL_SLICE_BYTES + all * LABEL_VOXEL_BYTES * spec.labels.voxel_um.sqrt()
            }
        }
    }
}

/// Slices of a label volume, and voxels per slice.
fn label_voxels(spec: &ModelSpec) -> (f64, f64) {
    (spec.fitting_label_slices().max(1.0), spec.label_voxels().1)
}

/// Counts that determine the cost.
struct Counts {
    particles_end: u32,
    sections: u32,
    /// Points of all recorded sections.
    section_points: f64,
    /// Vertices of the surface of the tissue.
    vertices: f64,
    /// Triangles of the surface of the tissue.
    triangles: f64,
    /// Vertices of the surfaces of all written bodies, divided by those of the tissue.
    bodies: f64,
    /// Like `bodies`, if the regions are written as tissue and lumen.
    solids: f64,
    /// True if another body than the tissue is written.
    has_lumen: bool,
}

impl Counts {
    fn new(spec: &ModelSpec, outputs: &Outputs) -> Self {
        let particles = |step: u32| spec.particles.total.at(f64::from(step) / f64::from(spec.steps)).round();
        let piece = spec.recorded();
        // A smooth contour has two points per particle.
        let points = if spec.mesh.smooth_um > 0.0 { 2.0 } else { 1.0 };
        let (mut sections, mut section_points) = (0_u32, 0.0);
        for step in spec.stations() {
            sections += 1;
            section_points += points * particles(step);
        }
        let vertices = if spec.mesh.resolution_um > 0.0 {
            0.5 * even_triangles(spec)
        } else {
            section_points
                + points * (particles(*piece.end()) - particles(*piece.start()))
                + points * split_edges(spec, particles)
        };
        let particles_end = u32::try_from(count(particles(*piece.end()))).unwrap_or(u32::MAX);
        let body = |body: BodyKind| f64::from(u8::from(outputs.bodies.contains(&body)));
        // The lumen has only the vertices of the inner loop.
        let inner = 1.0 - spec.particles.outer.at(1.0) / spec.particles.total.at(1.0);
        let has_lumen = outputs.bodies.iter().any(|body| *body != BodyKind::Tissue);
        let bodies = body(BodyKind::Tissue) + body(BodyKind::Regions) + inner * body(BodyKind::Lumen);
        let solids = bodies + inner * body(BodyKind::Regions);
        Self { particles_end, sections, section_points, vertices, triangles: 2.0 * vertices, bodies, solids, has_lumen }
    }

    /// Bytes of the files of a contraction.
    fn frames_bytes(&self, frames: f64) -> f64 {
        let level = self.triangles.min(LEVEL_TRIANGLES[1] as f64);
        13.0 * self.triangles + 24.0 * level + frames * (12.0 * self.vertices + 16.0 * level + FRAME_FIXED)
    }
}

/// Edges between sections that bending splits, since they are too far from their images. Edges on
/// the outer side of a bend are farthest; their neighbours are split with them.
fn split_edges(spec: &ModelSpec, particles: impl Fn(u32) -> f64) -> f64 {
    let Some(course) = spec.centre_line() else { return 0.0 };
    let (turned, node_um) = (course.turned(), course.places()[1]);
    let stations: Vec<(f64, f64, u32)> = spec
        .stations()
        .map(|step| {
            let z_um = 1000.0 * spec.length_mm * spec.z.at(f64::from(step) / f64::from(spec.steps));
            (z_um, turned[((z_um / node_um) as usize).min(turned.len() - 1)], step)
        })
        .collect();
    let edges = stations.windows(2).map(|pair| {
        let (z_um, angle, step) = pair[1];
        let u = f64::from(step) / f64::from(spec.steps);
        let (along, turn) = (z_um - pair[0].0, angle - pair[0].1);
        let radius = spec.scale * (spec.inner_radius_um(u) + spec.containment.wall_um.at(u));
        let off = turn * (along + turn * radius) / 8.0;
        // Each split brings an edge four times closer and doubles the edges.
        2.0 * particles(step) * ((off / (PART_OF_RADIUS * radius)).sqrt() - 1.0).max(0.0)
    });
    edges.sum()
}

/// Triangles of an even surface: areas of the walls divided by the areas of their triangles.
fn even_triangles(spec: &ModelSpec) -> f64 {
    let [begin, end] = spec.piece_um();
    let (edge, tolerance) = (spec.mesh.resolution_um, spec.mesh.tolerance_um);
    // One place next to the piece on either side counts, because a short piece may contain none.
    let beside = spec.length_mm * 1000.0 / f64::from(PLACES);
    let (mut sum, mut places) = (0.0, 0.0);
    for u in (0..=PLACES).map(|k| f64::from(k) / f64::from(PLACES)) {
        let place = spec.z.at(u) * spec.length_mm * 1000.0;
        if place < begin - beside || place > end + beside {
            continue;
        }
        let particle = spec.scale * spec.particles.edge_um.at(u);
        let inner = (spec.particles.total.at(u) - spec.particles.outer.at(u)) * particle;
        let squash = spec.containment.squash.at(u);
        let radius = spec.inner_radius_um(u);
        let outer = spec.scale * PI * (radius * (1.0 + squash) + 2.0 * spec.containment.wall_um.at(u));
        let at_folds = edge.min(FOLD_EDGE * (tolerance * particle).sqrt());
        sum += EVEN_TRIANGLES[0] * inner / (at_folds * at_folds) + EVEN_TRIANGLES[1] * outer / (4.0 * edge * edge);
        places += 1.0;
    }
    (end - begin) * sum / f64::max(places, 1.0)
}

/// Predicted seconds of the stages of a generation, on one core.
#[derive(Clone, Copy, Debug)]
pub(super) struct StageSeconds {
    pub(super) simulate: f64,
    pub(super) mesh: f64,
    pub(super) certify: f64,
    pub(super) measure: f64,
    /// Files except label volumes.
    pub(super) export: f64,
    pub(super) labels: f64,
}

impl StageSeconds {
    pub(super) fn new(spec: &ModelSpec, outputs: &Outputs) -> Self {
        Self::of(spec, outputs, &Counts::new(spec, outputs))
    }

    fn of(spec: &ModelSpec, outputs: &Outputs, counts: &Counts) -> Self {
        let is_even = spec.mesh.resolution_um > 0.0;
        let is_smooth = spec.mesh.smooth_um > 0.0;
        let triangles = count(counts.triangles) as f64;
        let if_so = |is_so: bool, seconds: f64| if is_so { seconds } else { 0.0 };
        let remesh =
            if_so(is_even, counts.triangles) * if is_smooth { SMOOTH_FACTOR * REMESH_SECONDS } else { REMESH_SECONDS };
        // All sections of an even surface are smoothed.
        let smoothed = if is_even { f64::from(spec.solver.record_every) } else { 1.0 };
        let [loft, certificate, files] = TRIANGLE_SECONDS.map(|seconds| triangles * seconds);
        let layers = LAYER_SECONDS * f64::from(counts.sections.min(192)) / 12.0;
        let labels = if outputs.has(Output::Labels) {
            let (slices, voxels) = label_voxels(spec);
            slices * LABEL_SLICE_SECONDS + slices * voxels * LABEL_VOXEL_SECONDS
        } else {
            0.0
        };
        Self {
            simulate: simulation_seconds(spec),
            mesh: loft
                + remesh
                + counts.section_points * if_so(is_smooth, smoothed * SMOOTH_SECONDS)
                + if_so(spec.leans(), triangles * LEAN_SECONDS)
                + if_so(spec.bends(), triangles * BEND_SECONDS),
            certify: certificate
                + if_so(counts.has_lumen, triangles * BODIES_SECONDS)
                + f64::from(spec.contraction.frames) * triangles * FRAME_SECONDS,
            measure: layers + triangles * MEASURE_SECONDS * if has_cuts(spec) { CUTS_FACTOR } else { 1.0 },
            export: files
                + if_so(outputs.has(Output::ThreeMf), counts.solids * triangles * THREEMF_SECONDS)
                + if_so(outputs.has(Output::Lod), triangles * LEVELS_SECONDS),
            labels,
        }
    }

    fn sum(&self) -> f64 {
        let Self { simulate, mesh, certify, measure, export, labels } = self;
        simulate + mesh + certify + measure + export + labels
    }
}

/// Time from start to end, by backend.
fn seconds(spec: &ModelSpec, outputs: &Outputs, counts: &Counts) -> BTreeMap<String, Estimate> {
    let one = StageSeconds::of(spec, outputs, counts).sum();
    let work = match spec.solver.search {
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

/// Seconds of the simulation on one core: burn-in, and the mean over sampled places along the tube.
fn simulation_seconds(spec: &ModelSpec) -> f64 {
    let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(PLACES);
    let last = *spec.recorded().end();
    let end = f64::from(last) / f64::from(spec.steps);
    let mean = (0..PLACES).map(|i| step_seconds(spec, end * middle(i))).sum::<f64>() / f64::from(PLACES);
    mean * f64::from(last) + step_seconds(spec, 0.0) * f64::from(spec.burn_in)
}

/// Seconds of a step at `u` on one core. A segment occupies an area of edge length times spacing,
/// which determines the number of segments within reach.
fn step_seconds(spec: &ModelSpec, u: f64) -> f64 {
    let inner = spec.particles.total.at(u) - spec.particles.outer.at(u);
    let stages = match spec.solver.integrator {
        Integrator::Rk4 => 4.0,
        Integrator::Euler => 1.0,
    };
    let spread = spec.variation.amplitude.at(u).hypot(spec.variety.thickness.at(u));
    let range = spec.collision.tissue_um.at(u).max(spec.collision.gap_um.at(u)) * spread.exp();
    let reach = range + SKIN_UM;
    let near = (PI * reach * reach / (spec.particles.edge_um.at(u) * spec.containment.spacing_um.at(u))).min(inner);
    let pairs = match spec.solver.search {
        Search::Lists => near * LIST_PAIR_SECONDS,
        Search::Grid => near * LIST_PAIR_SECONDS * GRID_FACTOR,
        Search::AllPairs => inner * ALL_PAIRS_SECONDS,
    };
    stages * inner * (pairs + PARTICLE_SECONDS)
}

/// Converts a sum of counts to an integer; saturates.
fn count(value: f64) -> u64 {
    value.round() as u64
}

#[cfg(test)]
mod tests;
