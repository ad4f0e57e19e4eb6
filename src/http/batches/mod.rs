//! Batches: many models of one spec, or of the points of a study, requested, read and deleted together.
//!
//! A batch is accepted as a whole or not at all. Its models are ordinary models with ids of their own.
//!
//! | file | subject |
//! |---|---|
//! | `request`, `check` | from a body to the specs of all models |
//! | `create` | `POST /batches`, `POST /batches/validate` |
//! | `read` | `GET` and `DELETE /batches/{id}` |
//! | `table`, `figures` | `GET /batches/{id}/table` |
//! | `archive`, `pack` | `GET /batches/{id}/archive` |
//! | `models` | reading the models of a batch page by page |

pub(super) mod archive;
mod check;
pub(super) mod create;
mod figures;
#[cfg(feature = "fuzzing")]
pub mod fuzzing;
mod models;
mod pack;
pub(super) mod read;
mod request;
pub(in crate::http) mod study;
pub(super) mod table;

pub(super) use request::BatchRequest;
