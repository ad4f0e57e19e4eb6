//! Token buckets: limits the requests per second of each API key, with bursts. Each process counts
//! its own requests.

use crate::clock::Stopwatch;
use crate::http::wire::problem::{RATE_LIMIT, RATE_LIMIT_POLICY};
use crate::lock::Mutex;
use axum::http::{HeaderName, HeaderValue};
use std::collections::HashMap;
use std::time::Duration;

/// Capacity of a bucket: this many seconds at its rate.
const BURST_SECONDS: f64 = 5.0;
/// Number of buckets at which full buckets are removed, because a full bucket equals a new one.
const CLEANUP_BUCKETS: usize = 1024;

/// State of a bucket after a request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Standing {
    /// Requests that a full bucket allows.
    capacity: f64,
    /// Requests that are left.
    left: f64,
    /// Requests per second by which the bucket refills.
    rate: f64,
}

impl Standing {
    /// Time until the bucket allows a request.
    pub(super) fn wait(self) -> Duration {
        Duration::try_from_secs_f64(((1.0 - self.left) / self.rate).max(0.0)).unwrap_or(Duration::MAX)
    }

    /// Header fields that report the bucket to the client.
    pub(super) fn headers(self) -> [(HeaderName, String); 2] {
        let until_full = ((self.capacity - self.left) / self.rate).ceil();
        let window = (self.capacity / self.rate).ceil();
        [
            (RATE_LIMIT_POLICY, format!("\"requests\";q={};w={window}", self.capacity)),
            (RATE_LIMIT, format!("\"requests\";r={};t={until_full}", self.left.floor().max(0.0))),
        ]
    }
}

#[derive(Debug)]
struct Bucket {
    rate: f64,
    left: f64,
    since: Stopwatch,
}

impl Bucket {
    /// Requests that a full bucket allows if it refills at `rate` requests per second.
    fn capacity(rate: f64) -> f64 {
        (rate * BURST_SECONDS).ceil().max(1.0)
    }

    fn is_full(&self) -> bool {
        self.left + self.since.seconds() * self.rate >= Self::capacity(self.rate)
    }
}

/// Buckets by the prefix of the API key.
#[derive(Debug, Default)]
pub(super) struct Buckets(Mutex<HashMap<String, Bucket>>);

impl Buckets {
    /// Takes one request from the bucket of `key`, which refills at `rate` requests per second.
    ///
    /// # Errors
    /// Returns the state of the bucket if it is empty.
    pub(super) fn take(&self, key: &str, rate: f64) -> Result<Standing, Standing> {
        let capacity = Bucket::capacity(rate);
        let mut buckets = self.0.lock();
        if buckets.len() >= CLEANUP_BUCKETS && !buckets.contains_key(key) {
            buckets.retain(|_, bucket| !bucket.is_full());
        }
        let bucket =
            buckets.entry(key.to_owned()).or_insert_with(|| Bucket { rate, left: capacity, since: Stopwatch::start() });
        let left = (bucket.left + bucket.since.seconds() * rate).min(capacity);
        let fits = left >= 1.0;
        let left = if fits { left - 1.0 } else { left };
        *bucket = Bucket { rate, left, since: Stopwatch::start() };
        let standing = Standing { capacity, left, rate };
        if fits { Ok(standing) } else { Err(standing) }
    }
}

/// Appends the fields of a bucket to the headers of a response.
pub(super) fn add_headers(headers: &mut axum::http::HeaderMap, standing: Standing) {
    for (name, value) in standing.headers() {
        if let Ok(value) = HeaderValue::try_from(value) {
            headers.append(name, value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bucket_gives_a_burst_and_then_its_rate() {
        let buckets = Buckets::default();
        let rate = 0.001;
        assert!(buckets.take("a", rate).is_ok(), "at least one request fits");
        let empty = buckets.take("a", rate).expect_err("empty");
        assert!((990.0..=1000.0).contains(&empty.wait().as_secs_f64()), "{empty:?}");
        assert!(buckets.take("b", rate).is_ok(), "each key has its own");
        for n in 0..CLEANUP_BUCKETS {
            assert!(buckets.take(&format!("fast {n}"), 1000.0).is_ok());
        }
        assert!(buckets.take("a", rate).is_err(), "the rates of other keys do not fill it");
        let burst = (0..100).filter(|_| buckets.take("c", 4.0).is_ok()).count();
        assert!((20..22).contains(&burst), "{burst}");
    }

    #[test]
    fn a_standing_is_written_as_the_draft_says() {
        let [policy, limit] = Standing { capacity: 50.0, left: 12.7, rate: 10.0 }.headers().map(|(_, text)| text);
        assert_eq!((policy.as_str(), limit.as_str()), ("\"requests\";q=50;w=5", "\"requests\";r=12;t=4"));
    }
}
