//! The faults of a request. While it is read all are counted, and the first ones kept: a body of a megabyte can have half a
//! million faults, which would take hundreds of megabytes.

use serde::Serialize;
use utoipa::ToSchema;

/// Most faults that a response lists.
const KEPT: usize = 100;
/// Longest name of a place, in characters; a client may send names of any length.
const PLACE_MAX: usize = 300;

/// One fault of a request: where, and what.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(in crate::http) struct Fault {
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
    /// What is wrong, and what is allowed.
    pub detail: String,
}

impl Fault {
    /// A fault of the body.
    pub(in crate::http) fn at(pointer: impl Into<String>, detail: impl Into<String>) -> Self {
        Self { pointer: Some(pointer.into()), parameter: None, header: None, detail: detail.into() }
    }

    /// A fault of a query parameter.
    pub(in crate::http) fn parameter(name: impl Into<String>, detail: impl Into<String>) -> Self {
        Self { pointer: None, parameter: Some(name.into()), header: None, detail: detail.into() }
    }

    /// A fault of a request header.
    pub(in crate::http) fn header(name: impl Into<String>, detail: impl Into<String>) -> Self {
        Self { pointer: None, parameter: None, header: Some(name.into()), detail: detail.into() }
    }
}

/// Faults found so far.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(in crate::http) struct Faults {
    kept: Vec<Fault>,
    left_out: usize,
}

impl Faults {
    /// Whether there are none.
    pub(in crate::http) fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// Adds a fault.
    pub(in crate::http) fn push(&mut self, fault: Fault) {
        if self.kept.len() < KEPT {
            let shorten = |place: Option<String>| {
                place.map(|text| match text.char_indices().nth(PLACE_MAX) {
                    Some((end, _)) => text[..end].to_owned(),
                    None => text,
                })
            };
            self.kept.push(Fault { pointer: shorten(fault.pointer), parameter: shorten(fault.parameter), ..fault });
        } else {
            self.left_out += 1;
        }
    }

    /// Whether a fault at this place of the body is among those kept.
    pub(in crate::http) fn names(&self, pointer: &str) -> bool {
        self.kept.iter().any(|fault| fault.pointer.as_deref() == Some(pointer))
    }

    /// Those kept, and the number of the others.
    pub(in crate::http) fn into_parts(self) -> (Vec<Fault>, usize) {
        (self.kept, self.left_out)
    }
}

impl Extend<Fault> for Faults {
    fn extend<I: IntoIterator<Item = Fault>>(&mut self, faults: I) {
        faults.into_iter().for_each(|fault| self.push(fault));
    }
}

impl From<Fault> for Faults {
    fn from(fault: Fault) -> Self {
        let mut faults = Self::default();
        faults.push(fault);
        faults
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_faults_are_kept_and_all_are_counted() {
        let mut faults = Faults::default();
        assert!(faults.is_empty());
        faults.extend((0..250).map(|n| Fault::at(format!("/outputs/{n}"), "is wrong")));
        assert!(faults.names("/outputs/99") && !faults.names("/outputs/100"));
        let (kept, left_out) = faults.into_parts();
        assert_eq!((kept.len(), left_out), (100, 150));
    }

    #[test]
    fn very_long_places_are_cut() {
        let (kept, _) = Faults::from(Fault::at("ä".repeat(1000), "is unknown")).into_parts();
        assert_eq!(kept[0].pointer.as_ref().map(|p| p.chars().count()), Some(PLACE_MAX));
    }
}
