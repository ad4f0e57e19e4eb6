//! Batches: many models of one spec, or of the points of a study, that are requested, read and
//! deleted together.
//!
//! A batch is accepted as a whole or not at all. Its models are ordinary models with their own ids.
//!
//! | file | subject |
//! |---|---|
//! | `request`, `check` | from a body to the specs of all models |
//! | `batch`, `study` | bodies of responses; the stored study |
//! | `create` | `POST /batches`, `POST /batches/validate` |
//! | `read` | `GET /batches`; `GET` and `DELETE /batches/{id}` |
//! | `table` | `GET /batches/{id}/table` |
//! | `archive`, `pack` | `GET /batches/{id}/archive` |

pub(super) mod archive;
pub(in crate::http) mod batch;
mod check;
pub(super) mod create;
mod pack;
pub(super) mod read;
pub(in crate::http) mod request;
pub(in crate::http) mod study;
pub(super) mod table;
