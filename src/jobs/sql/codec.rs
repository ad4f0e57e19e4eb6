//! Rust values to and from columns.

use super::error::{SqlError, broken};
use crate::jobs::{BatchId, JobId};
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
    Bytes(Vec<u8>),
    Texts(Vec<String>),
    Flag(bool),
}

macro_rules! value_from {
    ($($from:ty: $value:ident => $to:expr;)+) => {
        $(impl From<$from> for Value {
            fn from($value: $from) -> Self {
                $to
            }
        })+
    };
}

value_from! {
    i64: n => Self::Int(Some(n));
    Option<i64>: n => Self::Int(n);
    u32: n => Self::Int(Some(n.into()));
    Option<u32>: n => Self::Int(n.map(i64::from));
    // Saturates at the largest integer of the database, which no count reaches.
    u64: n => Self::Int(Some(i64::try_from(n).unwrap_or(i64::MAX)));
    Option<u64>: n => n.map_or(Self::Int(None), Self::from);
    Timestamp: at => Self::Int(Some(at.as_microsecond()));
    Option<Timestamp>: at => Self::Int(at.map(Timestamp::as_microsecond));
    // Microseconds.
    Duration: time => Self::Int(Some(i64::try_from(time.as_micros()).unwrap_or(i64::MAX)));
    bool: flag => Self::Flag(flag);
    JobId: id => Self::Text(Some(id.to_string()));
    BatchId: id => Self::Text(Some(id.to_string()));
    uuid::Uuid: id => Self::Text(Some(id.hyphenated().to_string()));
    &str: text => Self::Text(Some(text.to_owned()));
    String: text => Self::Text(Some(text));
    &String: text => Self::Text(Some(text.clone()));
    Option<String>: text => Self::Text(text);
    &Option<String>: text => Self::Text(text.clone());
    Vec<u8>: bytes => Self::Bytes(bytes);
    Vec<String>: texts => Self::Texts(texts);
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
