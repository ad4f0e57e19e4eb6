//! Parts that all routes share: layers, parsing of requests, conditional responses, problems.
//!
//! | file | subject |
//! |---|---|
//! | `envelope`, `host`, `transfer`, `cors`, `compress` | layers around all routes |
//! | `extract`, `json`, `headers` | parameters, bodies and headers of a request |
//! | `faults`, `problem` | faults of a request; body of every error response (RFC 9457) |
//! | `conditional`, `range` | conditional requests and ranges of bytes (RFC 9110) |
//! | `responses` | error responses in the descriptions of routes |
//! | `blocking` | computations outside the async runtime |
//! | `shares` | limited resources, of which one owner can hold a share |

pub(in crate::http) mod blocking;
pub(in crate::http) mod compress;
pub(in crate::http) mod conditional;
pub(in crate::http) mod cors;
pub(in crate::http) mod envelope;
pub(in crate::http) mod extract;
pub(in crate::http) mod faults;
pub(in crate::http) mod headers;
pub(in crate::http) mod host;
pub(in crate::http) mod json;
pub(in crate::http) mod problem;
pub(in crate::http) mod range;
pub(in crate::http) mod responses;
pub(in crate::http) mod shares;
pub(in crate::http) mod transfer;
