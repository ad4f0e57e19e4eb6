//! Errors of a load test by kind.

use crate::cli::exit::Failure;
use crate::cli::remote::client::ErrorKind;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;

/// A call without a valid response.
#[derive(Clone, Debug, PartialEq)]
pub struct Lost {
    pub(super) kind: ErrorKind,
    /// Description of the error.
    pub message: String,
}

impl From<Failure> for Lost {
    fn from(failure: Failure) -> Self {
        Self { kind: ErrorKind::of(&failure), message: failure.report().1.join("; ") }
    }
}

/// Numbers of errors.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Errors {
    pub(super) total: u64,
    /// Responses with an error status, by status.
    status: BTreeMap<u16, u64>,
    /// Connections that failed or were lost.
    connection: u64,
    /// Requests without a response in time.
    timeout: u64,
    /// Anything else, such as a response that does not match the description of the interface.
    other: u64,
    /// The first message of each kind.
    #[serde(serialize_with = "messages")]
    examples: BTreeMap<ErrorKind, String>,
}

fn messages<S: Serializer>(examples: &BTreeMap<ErrorKind, String>, to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq(examples.values())
}

impl Errors {
    pub(super) fn add(&mut self, lost: Lost) {
        self.total += 1;
        match lost.kind {
            ErrorKind::Status(status) => *self.status.entry(status).or_default() += 1,
            ErrorKind::Connection => self.connection += 1,
            ErrorKind::Timeout => self.timeout += 1,
            ErrorKind::Other => self.other += 1,
        }
        self.examples.entry(lost.kind).or_insert(lost.message);
    }

    /// Adds the errors of another call.
    pub(super) fn merge(&mut self, other: &Self) {
        self.total += other.total;
        self.connection += other.connection;
        self.timeout += other.timeout;
        self.other += other.other;
        for (status, count) in &other.status {
            *self.status.entry(*status).or_default() += count;
        }
        for (kind, message) in &other.examples {
            self.examples.entry(*kind).or_insert_with(|| message.clone());
        }
    }

    /// Returns each kind with its number, such as `status 503 2, timeout 1`; empty without errors.
    pub(super) fn counts(&self) -> String {
        let statuses = self.status.iter().map(|(status, count)| (format!("status {status}"), *count));
        let others = [("connection", self.connection), ("timeout", self.timeout), ("other", self.other)];
        let all = statuses.chain(others.map(|(kind, count)| (kind.to_owned(), count)));
        let counts: Vec<String> =
            all.filter(|(_, count)| *count > 0).map(|(kind, count)| format!("{kind} {count}")).collect();
        counts.join(", ")
    }

    /// The first message of each kind.
    pub(super) fn examples(&self) -> impl Iterator<Item = &str> {
        self.examples.values().map(String::as_str)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn errors_are_counted_by_kind_and_keep_the_first_message() {
        let mut errors = Errors::default();
        for (kind, message) in [
            (ErrorKind::Status(503), "first 503"),
            (ErrorKind::Timeout, "late"),
            (ErrorKind::Status(503), "second 503"),
            (ErrorKind::Status(500), "500"),
            (ErrorKind::Connection, "refused"),
        ] {
            errors.add(Lost { kind, message: message.to_owned() });
        }
        let mut all = Errors::default();
        all.add(Lost { kind: ErrorKind::Other, message: "odd".to_owned() });
        all.add(Lost { kind: ErrorKind::Timeout, message: "later".to_owned() });
        all.merge(&errors);
        let expected = json!({ "total": 7, "status": { "500": 1, "503": 2 }, "connection": 1, "timeout": 2, "other": 1,
                               "examples": ["500", "first 503", "refused", "later", "odd"] });
        assert_eq!(serde_json::to_value(&all).expect("JSON"), expected);
        assert_eq!(all.counts(), "status 500 1, status 503 2, connection 1, timeout 2, other 1");
        assert_eq!(Errors::default().counts(), "");
    }
}
