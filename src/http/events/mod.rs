//! Streams of server-sent events of models, batches and fits.
//!
//! | file | subject |
//! |---|---|
//! | `routes` | the three routes |
//! | `stream` | the body of a response: events, comments, the end |
//! | `reader` | the position of a stream: initial states, later ones, resumption |
//! | `feed` | reading changed jobs from the job store |
//! | `published` | the latest state of each job, in the order of publication |
//! | `subscription` | the models that a stream of `/events` selects |
//! | `snapshot` | a state of a job as bytes of events |

mod feed;
mod published;
mod reader;
pub(super) mod routes;
#[cfg(test)]
mod samples;
mod snapshot;
mod stream;
mod subscription;

pub(super) use feed::Feed;
pub(super) use published::FeedTiming;
pub(super) use reader::Reader;
