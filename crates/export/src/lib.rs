//! Readers, writers and pictures of surfaces and sections.

use oviduct_base::{ENGINE_VERSION, geometry, model, random, tissue};
use oviduct_spec::spec;

pub mod export;
pub mod render;
