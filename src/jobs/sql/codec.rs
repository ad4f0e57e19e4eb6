//! Rust values to and from columns.

use super::tx::SqlError;
use crate::jobs::store::StoreError;
use jiff::Timestamp;
use std::time::Duration;

/// The values of the parameters of a query, in order.
macro_rules! values {
    ($($value:expr),* $(,)?) => { vec![$($crate::jobs::sql::tx::Value::from($value)),*] };
}
pub(super) use values;

/// The error of a column whose content this version cannot read.
pub(super) fn broken(error: &dyn std::error::Error) -> SqlError {
    SqlError::Store(StoreError::Database(format!("a broken record: {error}")))
}

pub(super) fn json<T: serde::Serialize>(value: &T) -> String {
    serde_json::to_string(value).expect("records have string keys and finite numbers only")
}

pub(super) fn parse<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, SqlError> {
    serde_json::from_str(text).map_err(|error| broken(&error))
}

/// A unit variant as the string that serde names it by.
pub(super) fn enum_to_sql<T: serde::Serialize>(value: T) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(name)) => name,
        _ => unreachable!("only unit variants are stored by name"),
    }
}

/// The unit variant that serde names so.
pub(super) fn enum_from_sql<T: serde::de::DeserializeOwned>(name: &str) -> Result<T, SqlError> {
    serde_json::from_value(serde_json::Value::String(name.to_owned())).map_err(|error| broken(&error))
}

/// The time `wait` after `now`.
pub(super) fn until(now: Timestamp, wait: Duration) -> Timestamp {
    now.saturating_add(wait).unwrap_or(Timestamp::MAX)
}
