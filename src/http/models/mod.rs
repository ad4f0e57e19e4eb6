//! Models: requesting, reading, cancelling and deleting them, and downloading their files.
//!
//! | file | subject |
//! |---|---|
//! | `request`, `specs` | from a body to a well-formed request; specifications resolved recently |
//! | `model` | bodies of responses and events; the parameter `view`, references |
//! | `create`, `retry` | `POST /models`, `POST /models/validate`, `POST /models/{id}/retry` |
//! | `read` | `GET /models`; `GET`, `DELETE /models/{id}`, `POST /models/{id}/cancel` |
//! | `select` | query parameters that filter lists |
//! | `files` | downloads, report and manifest |

pub(in crate::http) mod create;
pub(in crate::http) mod files;
pub(in crate::http) mod model;
pub(in crate::http) mod read;
pub(in crate::http) mod request;
pub(in crate::http) mod retry;
pub(in crate::http) mod select;
pub(super) mod specs;
