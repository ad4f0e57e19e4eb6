//! Spec → everything, synchronous: simulate, loft, certify, export; with a progress sink and a cancel token.
//!
//! Knows nothing of jobs or HTTP; the worker and the command line both call [`generate`].

mod types;

pub use types::{
    Backend, CancelToken, FileOutput, GenerateError, Outcome, Output, Progress, Request, Seconds, Sink, Stage,
};
