//! The faults of a request, gathered while it is read: all are counted, the first ones kept.
//!
//! A body of a megabyte can hold half a million faults; nobody reads them, and they would take hundreds of megabytes.

use super::problem::Fault;

/// Most faults that an answer names.
const KEPT: usize = 100;
/// Longest name of a place, in characters; what comes from outside may be of any length.
const PLACE_MAX: usize = 300;

/// Faults found so far.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Faults {
    kept: Vec<Fault>,
    left_out: usize,
}

impl Faults {
    /// Whether none was found.
    pub(super) fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// Adds a fault.
    pub(super) fn push(&mut self, fault: Fault) {
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

    /// Whether a fault of this place of the body is among those kept.
    pub(super) fn names(&self, pointer: &str) -> bool {
        self.kept.iter().any(|fault| fault.pointer.as_deref() == Some(pointer))
    }

    /// Those kept, and how many there are besides.
    pub(super) fn into_parts(self) -> (Vec<Fault>, usize) {
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
    fn the_first_are_kept_and_all_are_counted() {
        let mut faults = Faults::default();
        assert!(faults.is_empty());
        faults.extend((0..250).map(|n| Fault::at(format!("/outputs/{n}"), "is wrong")));
        assert!(faults.names("/outputs/99") && !faults.names("/outputs/100"));
        let (kept, left_out) = faults.into_parts();
        assert_eq!((kept.len(), left_out), (100, 150));
    }

    #[test]
    fn places_are_cut_where_they_are_very_long() {
        let (kept, _) = Faults::from(Fault::at("ä".repeat(1000), "is unknown")).into_parts();
        assert_eq!(kept[0].pointer.as_ref().map(|p| p.chars().count()), Some(PLACE_MAX));
    }
}
