//! Specifications of models: what to grow, checked before anything is computed.
//!
//! A [`ModelSpec`](spec::ModelSpec) contains every parameter in physical units. It starts from a
//! [`Preset`](spec::Preset), the parameters of an organ with their sources, and a JSON merge patch.
//! Many parameters are a [`Schedule`](spec::Schedule), a value that changes along the tube. An
//! invalid patch results in a list of [`Fault`](spec::Fault)s, each with a JSON pointer. A valid
//! specification has a digest. A [`Study`](spec::study::Study) varies parameters over many models.
//!
//! ```
//! use oviduct_spec::spec::{ModelSpec, preset};
//! use serde_json::json;
//!
//! let pig = preset("pig").ok_or("no such preset")?;
//! let gap_um = json!({ "keys": [[0, 30], [1, 45]] });
//! let patch = json!({ "length_mm": 40, "collision": { "gap_um": gap_um } });
//! let spec = ModelSpec::resolve(pig, &patch).map_err(|faults| faults[0].to_string())?;
//! assert_eq!(spec.length_mm, 40.0);
//! assert_eq!(spec.collision.gap_um.at(0.5), 37.5);
//! assert_ne!(spec.digest(1), spec.digest(2)); // another seed, another model
//!
//! let faults = ModelSpec::resolve(pig, &json!({ "length_mm": -1 })).unwrap_err();
//! assert_eq!(faults[0].to_string(), "/length_mm: is -1, below the least allowed 0.1 mm");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use oviduct_base::{ENGINE_VERSION, geometry, model, random, tissue};

pub mod spec;
