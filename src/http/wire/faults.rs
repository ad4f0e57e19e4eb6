//! Faults of a request: reading a body, and the faults that a response lists.
//!
//! A body of 1 MB can have 500,000 faults. All are counted, but only the first ones are kept,
//! because all of them would take hundreds of megabytes.

use crate::spec::{Fault, JsonReader};
use serde::Serialize;
use serde_json::Value;
use utoipa::ToSchema;

/// Maximum number of faults that a response lists.
const MAX_LISTED: usize = 100;
/// Maximum length of a pointer or parameter name in a response, in characters. Clients may send
/// names of any length.
const MAX_PLACE_CHARS: usize = 300;

/// A reader of request bodies.
pub(in crate::http) fn body_reader() -> JsonReader {
    JsonReader::new(MAX_LISTED, describe)
}

/// A short description of a JSON value.
fn describe(value: &Value) -> String {
    match value {
        Value::String(text) if text.chars().count() > 40 => "a long string".to_owned(),
        Value::Array(_) => "an array".to_owned(),
        Value::Object(_) => "an object".to_owned(),
        scalar => scalar.to_string(),
    }
}

/// The first 100 characters of a member name, escaped for a JSON pointer.
pub(in crate::http) fn escape(name: &str) -> String {
    let name: String = name.chars().take(100).collect();
    name.replace('~', "~0").replace('/', "~1")
}

/// One invalid value of a request. Exactly one of `pointer`, `parameter` and `header` is present.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = Fault)]
pub(in crate::http) struct RequestFault {
    /// JSON pointer into the body, such as `/spec/collision/gap_um`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub pointer: Option<String>,
    /// Name of a query parameter.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub parameter: Option<String>,
    /// Name of a request header.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub header: Option<String>,
    /// Description of the fault, and of the allowed values.
    pub detail: String,
}

impl RequestFault {
    /// A fault of a query parameter.
    pub(in crate::http) fn parameter(name: &str, detail: impl Into<String>) -> Self {
        Self { pointer: None, parameter: Some(shorten(name)), header: None, detail: detail.into() }
    }

    /// A fault of a request header.
    pub(in crate::http) fn header(name: &str, detail: impl Into<String>) -> Self {
        Self { pointer: None, parameter: None, header: Some(name.to_owned()), detail: detail.into() }
    }
}

impl From<Fault> for RequestFault {
    fn from(Fault { pointer, detail }: Fault) -> Self {
        Self { pointer: Some(shorten(&pointer)), parameter: None, header: None, detail }
    }
}

fn shorten(place: &str) -> String {
    place.chars().take(MAX_PLACE_CHARS).collect()
}

/// The first [`MAX_LISTED`] faults of a request, and the number of the others.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(in crate::http) struct Faults {
    pub(super) listed: Vec<RequestFault>,
    pub(super) left_out: usize,
}

impl Faults {
    pub(in crate::http) fn is_empty(&self) -> bool {
        self.listed.is_empty()
    }

    pub(in crate::http) fn push(&mut self, fault: impl Into<RequestFault>) {
        if self.listed.len() < MAX_LISTED {
            self.listed.push(fault.into());
        } else {
            self.left_out += 1;
        }
    }
}

impl From<JsonReader> for Faults {
    fn from(reader: JsonReader) -> Self {
        let (faults, left_out) = reader.into_parts();
        Self { listed: faults.into_iter().map(Into::into).collect(), left_out }
    }
}

impl From<Vec<Fault>> for Faults {
    fn from(faults: Vec<Fault>) -> Self {
        let mut all = Self::default();
        faults.into_iter().for_each(|fault| all.push(fault));
        all
    }
}

impl<F: Into<RequestFault>> From<[F; 1]> for Faults {
    fn from([fault]: [F; 1]) -> Self {
        Self { listed: vec![fault.into()], left_out: 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_faults_are_kept_and_all_are_counted() {
        let faults =
            Faults::from((0..250).map(|n| Fault::new(format!("/outputs/{n}"), "is wrong")).collect::<Vec<_>>());
        assert_eq!(faults.listed.last().and_then(|fault| fault.pointer.as_deref()), Some("/outputs/99"));
        assert_eq!((faults.listed.len(), faults.left_out), (100, 150));
        let mut faults = Faults::default();
        assert!(faults.is_empty());
        (0..250).for_each(|_| faults.push(RequestFault::parameter("label", "is wrong")));
        assert_eq!((faults.listed.len(), faults.left_out), (100, 150));
    }

    #[test]
    fn very_long_places_are_cut() {
        let fault = RequestFault::from(Fault::new("ä".repeat(1000), "is unknown"));
        assert_eq!(fault.pointer.map(|pointer| pointer.chars().count()), Some(MAX_PLACE_CHARS));
    }
}
