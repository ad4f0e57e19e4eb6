//! Specifications of models: parameters, presets, schedules, limits, predicted cost and studies.

use oviduct_base::{ENGINE_VERSION, geometry, model, random, tissue};

pub mod spec;
