//! Models: requested, read, cancelled, deleted, and downloaded.
//!
//! | file | subject |
//! |---|---|
//! | `request` | from a body to a specification and what is stored with it |
//! | `create`, `retry` | `POST /models`, `POST /models/validate`, `POST /models/{id}/retry` |
//! | `read`, `select`, `detail`, `links` | `GET /models`, `GET`, `DELETE /models/{id}`; its parameters and references |
//! | `bulk` | cancelling and deleting many models |
//! | `files`, `manifest` | `GET /models/{id}/files/{name}`, `GET /models/{id}/manifest` |

pub(in crate::http) mod bulk;
pub(in crate::http) mod create;
pub(in crate::http) mod detail;
pub(in crate::http) mod files;
pub(in crate::http) mod links;
pub(in crate::http) mod manifest;
pub(in crate::http) mod read;
pub(in crate::http) mod request;
pub(in crate::http) mod retry;
pub(in crate::http) mod select;
