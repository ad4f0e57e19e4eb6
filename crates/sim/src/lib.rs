//! The particle simulation that grows the folds, on CPUs and GPUs.

use oviduct_base::{clock, geometry, lock, model, random, vectorize};
use oviduct_spec::spec;

pub mod sim;
