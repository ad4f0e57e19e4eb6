//! Rust values to and from columns.

use super::error::{SqlError, broken};
use crate::jobs::JobId;
use jiff::Timestamp;
use std::time::Duration;

/// Values of the parameters of a query, in order.
macro_rules! values {
    ($($value:expr),* $(,)?) => { vec![$($crate::jobs::sql::codec::Value::from($value)),*] };
}
pub(super) use values;

/// Value of a parameter.
#[derive(Clone, Debug)]
pub(in crate::jobs) enum Value {
    Int(Option<i64>),
    Text(Option<String>),
    Texts(Vec<String>),
    Flag(bool),
}

impl From<i64> for Value {
    fn from(value: i64) -> Self {
        Self::Int(Some(value))
    }
}

impl From<u32> for Value {
    fn from(value: u32) -> Self {
        Self::Int(Some(value.into()))
    }
}

impl From<Option<u32>> for Value {
    fn from(value: Option<u32>) -> Self {
        Self::Int(value.map(i64::from))
    }
}

/// Saturates at the largest integer of the database, which no count reaches.
impl From<u64> for Value {
    fn from(value: u64) -> Self {
        Self::Int(Some(i64::try_from(value).unwrap_or(i64::MAX)))
    }
}

impl From<Timestamp> for Value {
    fn from(at: Timestamp) -> Self {
        Self::Int(Some(at.as_microsecond()))
    }
}

impl From<Option<Timestamp>> for Value {
    fn from(at: Option<Timestamp>) -> Self {
        Self::Int(at.map(Timestamp::as_microsecond))
    }
}

impl From<bool> for Value {
    fn from(value: bool) -> Self {
        Self::Flag(value)
    }
}

impl From<JobId> for Value {
    fn from(id: JobId) -> Self {
        Self::Text(Some(id.to_string()))
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(Some(text.to_owned()))
    }
}

impl From<String> for Value {
    fn from(text: String) -> Self {
        Self::Text(Some(text))
    }
}

impl From<&String> for Value {
    fn from(text: &String) -> Self {
        Self::Text(Some(text.clone()))
    }
}

impl From<Option<String>> for Value {
    fn from(text: Option<String>) -> Self {
        Self::Text(text)
    }
}

impl From<&Option<String>> for Value {
    fn from(text: &Option<String>) -> Self {
        Self::Text(text.clone())
    }
}

impl From<Vec<String>> for Value {
    fn from(texts: Vec<String>) -> Self {
        Self::Texts(texts)
    }
}

pub(super) fn json<T: serde::Serialize>(value: &T) -> String {
    serde_json::to_string(value).expect("records have string keys and finite numbers only")
}

pub(super) fn parse<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, SqlError> {
    serde_json::from_str(text).map_err(broken)
}

/// The serde name of a unit variant.
pub(super) fn enum_to_sql<T: serde::Serialize>(value: T) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(name)) => name,
        _ => unreachable!("only unit variants are stored by name"),
    }
}

/// The unit variant with this serde name.
pub(super) fn enum_from_sql<T: serde::de::DeserializeOwned>(name: &str) -> Result<T, SqlError> {
    serde_json::from_value(serde_json::Value::String(name.to_owned())).map_err(broken)
}

/// The time `wait` after `now`.
pub(super) fn until(now: Timestamp, wait: Duration) -> Timestamp {
    now.saturating_add(wait).unwrap_or(Timestamp::MAX)
}
