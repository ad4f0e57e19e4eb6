//! Commands that work on this machine without a service: they grow models and read files.

pub(super) mod check;
mod checklist;
pub(super) mod compare;
pub(super) mod convert;
pub(super) mod cut;
pub(super) mod fit;
pub(super) mod folder;
pub mod generate;
pub(super) mod measure;
mod measured;
pub mod render;
pub(super) mod report;
pub(super) mod section;
mod solid;
mod surface;
mod target;
