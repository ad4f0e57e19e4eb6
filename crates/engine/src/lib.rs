//! Grows certified 3D models of folded tubular organs from a specification and a seed.
//!
//! ```
//! use oviduct_engine::generate::{Backend, CancelToken, Output, Request, generate};
//! use oviduct_engine::spec::{ModelSpec, preset};
//!
//! let dir = tempfile::tempdir()?;
//! # let small = r#"{ "steps": 60, "burn_in": 30,
//! #   "particles": { "total": { "keys": [[0, 160], [1, 260]] }, "outer": { "keys": [[0, 60], [1, 90]] } } }"#;
//! # let patch: serde_json::Value = serde_json::from_str(small)?;
//! # /*
//! let patch = serde_json::json!({ "collision": { "gap_um": 30 } });
//! # */
//! let preset = preset("pig").ok_or("no such preset")?;
//! let spec = ModelSpec::resolve(preset, &patch).map_err(|faults| format!("{faults:?}"))?;
//! let request = Request {
//!     preset: "pig".into(), spec, seed: 7, backend: Backend::Cpu, outputs: vec![Output::Glb].into(),
//!     dir: dir.path().into(), memory_limit_bytes: None,
//! };
//! let model = generate(&request, &(), &CancelToken::default())?; // an error unless certified
//! assert_eq!(model.files[0].name, "model.glb");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The engine is synchronous and does not depend on the service. It consists of these crates. None
//! of them re-exports another one, except this crate, which re-exports all of them.
//!
//! | crate | modules |
//! |---|---|
//! | `oviduct-base` | [`model`] (sections and meshes as data), [`geometry`], [`tissue`], [`random`], [`clock`], [`lock`] |
//! | `oviduct-spec` | [`spec`]: parameters, presets, studies |
//! | `oviduct-sim` | [`sim`]: the particle simulation on CPU and GPU |
//! | `oviduct-surface` | [`mesh`]: loft, lean, bend; [`measure`]: certificate, morphometry |
//! | `oviduct-export` | [`export`]: writers and readers of files; [`render`]: pictures |
//! | `oviduct-engine` | [`generate`]: specification to files; [`fit`], [`preview`], [`report`], [`way`] |

pub use oviduct_base::{ENGINE_VERSION, clock, geometry, lock, model, random, tissue};
pub use oviduct_export::{export, render};
pub use oviduct_sim::sim;
pub use oviduct_spec::spec;
pub use oviduct_surface::{measure, mesh};

pub mod fit;
pub mod generate;
pub mod preview;
pub mod report;
pub mod way;
