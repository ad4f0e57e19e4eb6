//! The targets of the fuzzers (`fuzz/README.md`): functions that take any bytes and panic if a property does not hold.
//!
//! The properties are stronger than "no panic": what is accepted is written and read again with the same result, what is
//! refused names a place, and indices lie within what they index. The functions are beside the code that they test, in
//! files named `fuzzing.rs`. Only builds with the feature `fuzzing` have them.

use crate::export::fuzzing::surface;
use crate::export::read::Format;
use crate::{export, fit, generate, http, measure, sim};

/// One target. Its corpus is `fuzz/corpus/<name>`, its program `fuzz/fuzz_targets/<name>.rs`.
#[derive(Debug)]
pub struct Target {
    /// Name.
    pub name: &'static str,
    /// Panics if a property does not hold for these bytes.
    pub run: fn(&[u8]),
    /// Most bytes that a run may allocate for an input of this length.
    pub memory: fn(usize) -> usize,
}

const MIB: usize = 1 << 20;

/// What is read into memory as it is takes a multiple of its length; 16 MiB are for tables that do not depend on the input.
fn in_proportion(length: usize) -> usize {
    16 * MIB + 1000 * length
}

/// A few bytes can place a mesh many times or be decompressed to much; fixed limits apply.
fn at_most(_length: usize) -> usize {
    1024 * MIB
}

/// The body of `POST /models`.
pub const REQUEST: Target = Target { name: "request", run: http::fuzzing::request, memory: in_proportion };
/// The body of `POST /batches`.
pub const BATCH: Target = Target { name: "batch", run: http::fuzzing::batch, memory: in_proportion };
/// Request headers, query and ids.
pub const HEADERS: Target = Target { name: "headers", run: http::fuzzing::headers, memory: in_proportion };
/// A merge patch on a specification.
pub const PATCH: Target = Target { name: "patch", run: generate::fuzzing::patch, memory: in_proportion };
/// glTF, binary or JSON.
pub const GLTF: Target = Target { name: "gltf", run: |bytes| surface(bytes, Format::Gltf), memory: at_most };
/// Wavefront OBJ.
pub const OBJ: Target = Target { name: "obj", run: |bytes| surface(bytes, Format::Obj), memory: in_proportion };
/// STL, binary or text.
pub const STL: Target = Target { name: "stl", run: |bytes| surface(bytes, Format::Stl), memory: in_proportion };
/// PLY, binary or text.
pub const PLY: Target = Target { name: "ply", run: |bytes| surface(bytes, Format::Ply), memory: in_proportion };
/// VTK XML.
pub const VTP: Target = Target { name: "vtp", run: |bytes| surface(bytes, Format::Vtp), memory: at_most };
/// `sections.bin`.
pub const SECTIONS: Target = Target { name: "sections", run: export::sections_bin::fuzzing::sections, memory: at_most };
/// Requests for fits, with their images.
pub const FIT: Target = Target { name: "fit", run: fit::fuzzing::fit, memory: at_most };
/// Images of sections.
pub const MICROGRAPH: Target =
    Target { name: "micrograph", run: measure::micrograph::fuzzing::micrograph, memory: at_most };
/// The state of a simulation.
pub const STATE: Target = Target { name: "state", run: sim::cpu::fuzzing::state, memory: in_proportion };
/// The checkpoint of a generation.
pub const CHECKPOINT: Target = Target { name: "checkpoint", run: generate::fuzzing::checkpoint, memory: at_most };

/// All targets.
pub const TARGETS: [&Target; 14] = [
    &REQUEST,
    &BATCH,
    &FIT,
    &HEADERS,
    &PATCH,
    &GLTF,
    &OBJ,
    &STL,
    &PLY,
    &VTP,
    &SECTIONS,
    &MICROGRAPH,
    &STATE,
    &CHECKPOINT,
];
