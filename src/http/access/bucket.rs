//! Token buckets: requests a second of each key, with bursts. Each process counts for itself.

use crate::clock::Stopwatch;
use crate::http::wire::problem::{RATE_LIMIT, RATE_LIMIT_POLICY};
use crate::lock::Mutex;
use axum::http::{HeaderName, HeaderValue};
use std::collections::HashMap;
use std::time::Duration;

/// Seconds of the rate that may be used up at once.
const BURST_SECONDS: f64 = 5.0;
/// Buckets from which on full ones are dropped.
const MANY: usize = 1024;

/// What is left of a bucket.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Standing {
    /// Requests that fit into the bucket.
    most: f64,
    left: f64,
    rate: f64,
}

impl Standing {
    /// Time until there is room for a request.
    pub(super) fn wait(self) -> Duration {
        Duration::try_from_secs_f64(((1.0 - self.left) / self.rate).max(0.0)).unwrap_or(Duration::MAX)
    }

    /// The fields of the response.
    pub(super) fn headers(self) -> [(HeaderName, String); 2] {
        let until_full = ((self.most - self.left) / self.rate).ceil();
        let window = (self.most / self.rate).ceil();
        [
            (RATE_LIMIT_POLICY, format!("\"requests\";q={};w={window}", self.most)),
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
    /// Requests that fit into a bucket that fills at `rate`.
    fn most(rate: f64) -> f64 {
        (rate * BURST_SECONDS).ceil().max(1.0)
    }

    fn is_full(&self) -> bool {
        self.left + self.since.seconds() * self.rate >= Self::most(self.rate)
    }
}

/// A bucket for each key.
#[derive(Debug, Default)]
pub(super) struct Buckets(Mutex<HashMap<String, Bucket>>);

impl Buckets {
    /// Takes one request from the bucket of `key`, which fills at `rate` requests a second. An error if it is empty.
    pub(super) fn take(&self, key: &str, rate: f64) -> Result<Standing, Standing> {
        let most = Bucket::most(rate);
        let mut buckets = self.0.lock();
        if buckets.len() >= MANY && !buckets.contains_key(key) {
            buckets.retain(|_, bucket| !bucket.is_full());
        }
        let bucket =
            buckets.entry(key.to_owned()).or_insert_with(|| Bucket { rate, left: most, since: Stopwatch::start() });
        let left = (bucket.left + bucket.since.seconds() * rate).min(most);
        let fits = left >= 1.0;
        let left = if fits { left - 1.0 } else { left };
        *bucket = Bucket { rate, left, since: Stopwatch::start() };
        let standing = Standing { most, left, rate };
        if fits { Ok(standing) } else { Err(standing) }
    }
}

/// Adds the fields of a standing to those that the response has.
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
        for n in 0..MANY {
            assert!(buckets.take(&format!("fast {n}"), 1000.0).is_ok());
        }
        assert!(buckets.take("a", rate).is_err(), "the rates of other keys do not fill it");
        let burst = (0..100).filter(|_| buckets.take("c", 4.0).is_ok()).count();
        assert!((20..22).contains(&burst), "{burst}");
    }

    #[test]
    fn a_standing_is_written_as_the_draft_says() {
        let [policy, limit] = Standing { most: 50.0, left: 12.7, rate: 10.0 }.headers().map(|(_, text)| text);
        assert_eq!((policy.as_str(), limit.as_str()), ("\"requests\";q=50;w=5", "\"requests\";r=12;t=4"));
    }
}
