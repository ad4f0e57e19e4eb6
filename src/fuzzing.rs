//! The targets of the fuzzers (`fuzz/README.md`): functions that take any bytes and panic if a
//! property does not hold.
//!
//! The properties are stronger than "no panic": accepted input is written and read again with the
//! same result, refusals name a place in the input, and indices are in bounds. The functions are
//! next to the code that they test, in files named `fuzzing.rs`. Only builds with the feature
//! `fuzzing` have them.

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
    /// Maximum number of bytes that a run may allocate for an input of this length.
    pub memory: fn(usize) -> usize,
}

const MIB: usize = 1 << 20;

/// Limit for input that is read into memory as it is: a multiple of its length, and 16 MiB for
/// tables that do not depend on the input.
fn proportional(length: usize) -> usize {
    16 * MIB + 1000 * length
}

/// Limit for input of which a few bytes can place a mesh many times or be decompressed to many.
fn fixed(_length: usize) -> usize {
    1024 * MIB
}

/// The body of `POST /models`.
pub const REQUEST: Target = Target { name: "request", run: http::fuzzing::request, memory: proportional };
/// The body of `POST /batches`.
pub const BATCH: Target = Target { name: "batch", run: http::fuzzing::batch, memory: proportional };
/// Request headers, query and ids.
pub const HEADERS: Target = Target { name: "headers", run: http::fuzzing::headers, memory: proportional };
/// A merge patch on a specification.
pub const PATCH: Target = Target { name: "patch", run: generate::fuzzing::patch, memory: proportional };
/// glTF, binary or JSON.
pub const GLTF: Target = Target { name: "gltf", run: |bytes| surface(bytes, Format::Gltf), memory: fixed };
/// Wavefront OBJ.
pub const OBJ: Target = Target { name: "obj", run: |bytes| surface(bytes, Format::Obj), memory: proportional };
/// STL, binary or text.
pub const STL: Target = Target { name: "stl", run: |bytes| surface(bytes, Format::Stl), memory: proportional };
/// PLY, binary or text.
pub const PLY: Target = Target { name: "ply", run: |bytes| surface(bytes, Format::Ply), memory: proportional };
/// VTK XML.
pub const VTP: Target = Target { name: "vtp", run: |bytes| surface(bytes, Format::Vtp), memory: fixed };
/// `sections.bin`.
pub const SECTIONS: Target = Target { name: "sections", run: export::sections_bin::fuzzing::sections, memory: fixed };
/// Requests for fits, with their images.
pub const FIT: Target = Target { name: "fit", run: fit::fuzzing::fit, memory: fixed };
/// Images of sections.
pub const MICROGRAPH: Target =
    Target { name: "micrograph", run: measure::micrograph::fuzzing::micrograph, memory: fixed };
/// The state of a simulation.
pub const STATE: Target = Target { name: "state", run: sim::cpu::fuzzing::state, memory: proportional };
/// The checkpoint of a generation.
pub const CHECKPOINT: Target = Target { name: "checkpoint", run: generate::fuzzing::checkpoint, memory: fixed };

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
