//! What all routes have in common: reading requests, and the parts of responses.
//!
//! | file | subject |
//! |---|---|
//! | `envelope`, `host`, `cors`, `compress` | layers around all routes |
//! | `extract`, `json`, `headers` | parameters, bodies and headers of a request |
//! | `faults`, `problem` | faults of a request, and the body of every error response (RFC 9457) |
//! | `conditional`, `range` | conditional requests and ranges of bytes (RFC 9110) |
//! | `responses` | what descriptions of routes have in common |
//! | `blocking` | work that takes longer than a request handler may |

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
