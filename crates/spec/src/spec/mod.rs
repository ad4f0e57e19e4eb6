//! Specifications of models: every parameter in physical units, valid by construction.
//!
//! A [`ModelSpec`] results only from resolving a merge patch on a preset or from reading a whole
//! specification. Both check everything and report all faults, so no other code needs to check a
//! specification.
//!
//! | file | subject |
//! |---|---|
//! | `parameters` | the table: names, units, bounds, meaning |
//! | `table`, `bounds` | macros and types of the table |
//! | `reader`, `read` | reading requests from JSON; numbers, schedules and choices |
//! | `merge` | merge patches |
//! | `check`, `stability` | rules between parameters |
//! | `preset`, `preset_details` | data files with sources, and how clients see them |
//! | `schema`, `openapi` | JSON Schema, OpenAPI components |
//! | `canonical` | canonical text of a specification, for the digest |
//! | `shared_json` | a specification as JSON value and text |
//! | `outline` | outline of the containment region, speed of transverse folds |
//! | `course` | centre line, and room for the tube along it |
//! | `layers` | layers of a section, size of a label volume |
//! | `batch_key` | which models a GPU may grow together |
//! | `lever` | parameters that a fit changes |
//! | `study` | parameter studies: designs and their points |

mod batch_key;
mod bounds;
mod canonical;
mod check;
mod course;
mod fault;
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
mod layers;
mod lever;
mod merge;
#[cfg(feature = "schema")]
pub mod openapi;
mod outline;
mod parameters;
mod preset;
mod preset_details;
mod read;
mod reader;
mod schedule;
mod schema;
mod shared_json;
mod stability;
pub mod study;
mod table;

#[cfg(test)]
mod tests;

pub use batch_key::batch_key;
pub use canonical::canonical_json;
pub use course::{Across, Bent, TurningPoint};
pub use fault::{Fault, nearest, shorten};
pub use lever::{End, Lever, Setting};
pub use parameters::{
    Collision, Containment, Contortion, Contraction, Course, CourseShape, Folds, Histology, Integrator, Labels, Lean,
    MAX_PARTICLES, MAX_STEPS, MeshOptions, Outline, OutlineKind, Parameters, Particles, Piece, Regions, Regulatory,
    Search, Solver, Spring, Sway, Toward, Variation, Variety, Wall,
};
pub use preset::{DEFAULT_PRESET, Preset, preset, presets};
pub use preset_details::{PresetDetails, PresetParameter, PresetSummary};
pub use reader::{JsonReader, SEED_MAX, integer_in};
pub use schedule::{Ease, Fluctuation, Schedule};
pub use schema::schema;
pub use shared_json::SharedJson;

use serde_json::Value;
use sha2::{Digest, Sha256};
use std::f64::consts::PI;
use std::ops::RangeInclusive;
use std::sync::{Arc, OnceLock};
use table::Parameter;

/// A resolved, checked specification. Dereferences to its [`Parameters`].
#[derive(Clone, Debug)]
pub struct ModelSpec {
    parameters: Parameters,
    /// Result of [`ModelSpec::json`], once it was needed.
    json: OnceLock<SharedJson>,
    /// Part of the text of [`ModelSpec::digest`] that does not depend on the seed.
    identity: OnceLock<Arc<str>>,
}

impl From<Parameters> for ModelSpec {
    fn from(parameters: Parameters) -> Self {
        Self { parameters, json: OnceLock::new(), identity: OnceLock::new() }
    }
}

impl PartialEq for ModelSpec {
    fn eq(&self, other: &Self) -> bool {
        self.parameters == other.parameters
    }
}

impl std::ops::Deref for ModelSpec {
    type Target = Parameters;

    fn deref(&self) -> &Parameters {
        &self.parameters
    }
}

impl ModelSpec {
    /// Applies `patch` to the preset and checks the result.
    ///
    /// The patch is a JSON merge patch (RFC 7396), with three additions:
    /// - `null` restores the value of the preset.
    /// - A number replaces a whole schedule. An object replaces only the members of a schedule that
    ///   it names, for example `{"fluctuation": {"amplitude": 2, "period": 90}}`. If the schedule
    ///   is a number, it first becomes the keys `[[0, v], [1, v]]`.
    /// - A fluctuation of amplitude 0 removes the fluctuation.
    ///
    /// # Errors
    /// Returns all faults, sorted by pointer.
    pub fn resolve(preset: &Preset, patch: &Value) -> Result<Self, Vec<Fault>> {
        Self::resolve_all(preset, &[patch])
    }

    /// Applies several patches one after the other and checks the result. From the second patch on,
    /// `null` keeps the value that the earlier patches gave.
    ///
    /// # Errors
    /// Returns all faults, sorted by pointer.
    pub fn resolve_all(preset: &Preset, patches: &[&Value]) -> Result<Self, Vec<Fault>> {
        Self::build(&preset.spec, patches)
    }

    /// Reads a whole specification, such as the result of [`ModelSpec::to_json`], without a preset.
    ///
    /// # Errors
    /// Returns all faults. A missing parameter is a fault.
    pub fn from_json(whole: &Value) -> Result<Self, Vec<Fault>> {
        Self::build(&Value::Null, &[whole])
    }

    /// Reads a stored specification. Parameters that an older version did not have get the values
    /// of the default preset, which have no effect. `None` if the specification cannot be read.
    #[must_use]
    pub fn from_stored(spec: &Value) -> Option<Self> {
        spec.as_object()?;
        Self::resolve(preset(DEFAULT_PRESET)?, spec).ok()
    }

    fn build(base: &Value, patches: &[&Value]) -> Result<Self, Vec<Fault>> {
        let mut reader = JsonReader::default();
        let mut values = base.clone();
        for patch in patches {
            values = merge::merge(parameters::table(), &values, patch, "", &mut reader);
        }
        let mut parameters = read(&mut reader, &values);
        if parameters.is_none() {
            // Unreadable values are replaced by those of the base, so that the rules between the
            // other parameters are checked, too.
            for pointer in &reader.bad {
                if let (Some(value), Some(own)) = (values.pointer_mut(pointer), base.pointer(pointer)) {
                    *value = own.clone();
                }
            }
            parameters = read(&mut JsonReader::default(), &values);
        }
        if let Some(parameters) = &parameters {
            let faults = check::faults(parameters, &reader.bad);
            reader.extend("", faults);
        }
        reader.finish(parameters).map(Self::from).map_err(|mut faults| {
            faults.sort_by(|a, b| a.pointer.cmp(&b.pointer));
            faults
        })
    }

    /// The whole specification as canonical JSON: every field, sorted keys, a plain number for each
    /// constant, integers without `.0`. Resolved on any preset, it results in the same
    /// specification.
    #[must_use]
    pub fn to_json(&self) -> Value {
        self.parameters.write()
    }

    /// The same as [`ModelSpec::to_json`], shared by all callers.
    #[must_use]
    pub fn json(&self) -> SharedJson {
        self.json.get_or_init(|| self.to_json().into()).clone()
    }

    /// SHA-256, in lower-case hex, of all inputs that determine the bytes of the model: the
    /// canonical specification without `solver.search` (which affects only speed), the seed and the
    /// engine version.
    #[must_use]
    pub fn digest(&self, seed: u64) -> String {
        let identity = self.identity.get_or_init(|| {
            let mut spec = self.to_json();
            if let Some(solver) = spec.get_mut("solver").and_then(Value::as_object_mut) {
                solver.remove("search");
            }
            canonical_json(&spec).into()
        });
        let engine = crate::ENGINE_VERSION;
        // Canonical JSON of an object with these members.
        let whole = format!("{{\"engine\":\"{engine}\",\"seed\":{seed},\"spec\":{identity}}}");
        hex::encode(Sha256::digest(whole))
    }
}

impl Parameters {
    /// Steps at which sections of the piece are recorded: 0, every multiple of
    /// `solver.record_every`, and the last step.
    pub fn stations(&self) -> impl Iterator<Item = u32> + '_ {
        let piece = self.recorded();
        self.all_stations().filter(move |step| piece.contains(step))
    }

    /// True if the surface leans. Even surfaces do not: the displacement would stretch their
    /// triangles.
    #[must_use]
    pub fn leans(&self) -> bool {
        self.asks_to_lean() && self.mesh.resolution_um == 0.0
    }

    /// True if the specification requests a lean, even if the surface ignores it.
    #[must_use]
    pub fn asks_to_lean(&self) -> bool {
        self.lean.strength_um.range().1 > 0.0
    }

    /// True if the model has frames of a contraction.
    #[must_use]
    pub fn contracts(&self) -> bool {
        self.contraction.frames > 0
    }

    /// Steps of the first and the last section of the piece. The simulation ends at the last one.
    #[must_use]
    pub fn recorded(&self) -> RangeInclusive<u32> {
        let place = |step: u32| self.z.at(f64::from(step) / f64::from(self.steps));
        let (mut first, mut last) = (0, self.steps);
        for step in self.all_stations() {
            if place(step) <= self.piece.from {
                first = step;
            }
            if place(step) >= self.piece.to {
                last = step;
                break;
            }
        }
        first.min(last)..=last
    }

    /// Steps between the sections of the surface. An even surface uses the sections of every step.
    #[must_use]
    pub fn interval(&self) -> u32 {
        if self.mesh.resolution_um > 0.0 { 1 } else { self.solver.record_every }
    }

    /// Ends of the piece, µm from the isthmus end.
    #[must_use]
    pub fn piece_um(&self) -> [f64; 2] {
        let piece = self.recorded();
        [*piece.start(), *piece.end()]
            .map(|step| self.length_mm * 1000.0 * self.z.at(f64::from(step) / f64::from(self.steps)))
    }

    /// x radius of the inner ellipse of the containment region, µm in the simulation, at the
    /// fraction `u` of the steps.
    #[must_use]
    pub fn inner_radius_um(&self, u: f64) -> f64 {
        let (c, particles) = (&self.containment, &self.particles);
        let inner = (particles.total.at(u) - particles.outer.at(u)).max(0.0);
        (inner * particles.edge_um.at(u) * c.spacing_um.at(u) / (PI * c.squash.at(u))).sqrt()
    }

    fn all_stations(&self) -> impl Iterator<Item = u32> + '_ {
        let every = self.solver.record_every as usize;
        let last = (!self.steps.is_multiple_of(self.solver.record_every)).then_some(self.steps);
        (0..=self.steps).step_by(every).chain(last)
    }
}

/// Reads all parameters.
fn read(reader: &mut JsonReader, values: &Value) -> Option<Parameters> {
    Parameters::read(reader, reader::Site { at: "", unit: "" }, values, ())
}
