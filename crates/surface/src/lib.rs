//! Closed surfaces from cross sections, their certificate and their morphometry.

use oviduct_base::{geometry, model, random, tissue, vectorize};

pub mod measure;
pub mod mesh;
