//! Surfaces that commands read, in the unit that the user gives.

use crate::cli::args::UnitArgs;
use crate::cli::{term, units};
use crate::export::read::{ReadError, Surface, Unit, read_surface};
use std::path::Path;

/// Reads a surface. Its notes say which unit was assumed or overridden.
///
/// # Errors
/// As [`read_surface`].
pub(super) fn read(path: &Path, unit: UnitArgs) -> Result<Surface, ReadError> {
    let mut surface = read_surface(path)?;
    if let Some(note) = choose(&mut surface.unit, unit) {
        surface.notes.push(note);
    }
    Ok(surface)
}

/// As [`read`]; also prints the notes to stderr.
///
/// # Errors
/// As [`read`].
pub(super) fn read_aloud(path: &Path, unit: UnitArgs) -> Result<Surface, ReadError> {
    let surface = read(path, unit)?;
    for note in &surface.notes {
        term::note(&format!("note: {}: {note}", path.display()));
    }
    Ok(surface)
}

/// Replaces the unit of a file by the given one. Returns a note if a unit is assumed, or if the
/// given one contradicts the file.
fn choose(unit: &mut Unit, given: UnitArgs) -> Option<String> {
    let stated = *unit;
    let Some(given) = given.from_units else {
        let note = "the file does not state its unit, so metres are assumed; --from-units states another";
        return (stated == Unit::Assumed).then(|| note.to_owned());
    };
    *unit = Unit::Stated(given.metres);
    match stated {
        Unit::Stated(metres) if (metres / given.metres - 1.0).abs() > 1e-9 => {
            Some(format!("the file states {}, but --from-units {} applies", units::show_unit(metres), given.name))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_given_unit_wins_and_an_assumed_one_is_noted() {
        let found = |unit: Unit, name: Option<&str>| {
            let mut unit = unit;
            let from_units = name.map(|name| units::length_unit(name).unwrap());
            let note = choose(&mut unit, UnitArgs { from_units });
            (unit, note.unwrap_or_default())
        };
        let (unit, note) = found(Unit::Assumed, None);
        assert!(unit == Unit::Assumed && note.contains("metres are assumed"), "{note}");
        assert_eq!(found(Unit::Stated(0.001), None), (Unit::Stated(0.001), String::new()));
        assert_eq!(found(Unit::Assumed, Some("cm")), (Unit::Stated(0.01), String::new()));
        assert_eq!(found(Unit::Stated(0.001), Some("mm")), (Unit::Stated(0.001), String::new()));
        let (unit, note) = found(Unit::Stated(1.0), Some("um"));
        assert_eq!((unit, note.as_str()), (Unit::Stated(1e-6), "the file states m, but --from-units um applies"));
    }
}
