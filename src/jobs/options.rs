//! Settings of a job store.

use crate::clock::Clock;
use std::time::Duration;

/// Settings of a job store on either database.
#[derive(Clone, Debug)]
pub struct StoreOptions {
    /// Clock of leases and records. With [`Clock::System`], PostgreSQL uses its own clock.
    pub clock: Clock,
    /// Number of counted attempts after which a job fails; at least 1.
    pub max_attempts: u32,
    /// Maximum number of queued jobs.
    pub queue_limit: u64,
    /// Maximum number of connections to PostgreSQL, besides the one that receives notifications; at
    /// least 2.
    pub connections: u32,
    /// Maximum time for the answer of PostgreSQL to a statement. After it, the connection is
    /// discarded and the outcome counts as unknown.
    pub answer_within: Duration,
    /// Maximum number of connections that read a SQLite file; at least 1.
    pub readers: u32,
}

impl Default for StoreOptions {
    fn default() -> Self {
        Self {
            clock: Clock::System,
            max_attempts: 5,
            queue_limit: 10_000,
            connections: 12,
            answer_within: Duration::from_secs(10),
            readers: 4,
        }
    }
}
