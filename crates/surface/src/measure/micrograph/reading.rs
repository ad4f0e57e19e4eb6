//! The meaning of an image: the side of a pixel, and which pixels are tissue.

use super::error::MicrographError;
use super::limits::PIXEL_UM;
use super::read::{Image, Kind, Stated};
use serde::{Deserialize, Serialize};

/// Meaning of an image of a section, as far as its file does not state it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reading {
    /// Side of a pixel, µm; `None` for the one that the file states.
    pub pixel_um: Option<f64>,
    /// Pixels that are tissue; `None` for all values except 0, if 0 and at most one other occur.
    pub tissue: Option<Tissue>,
    /// Least value that is not zero in the sense of [`Tissue`]; `None` for 1, and for 128 in a
    /// JPEG.
    pub threshold: Option<u16>,
}

/// Choice of the pixels that are tissue.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tissue {
    /// All values except 0, or those from a threshold on.
    #[serde(alias = "bright")]
    Nonzero,
    /// The value 0, or those below a threshold.
    #[serde(alias = "dark")]
    Zero,
    /// These values.
    #[serde(untagged)]
    Values(Vec<u16>),
}

impl std::str::FromStr for Tissue {
    type Err = String;

    /// Parses `2`, `1,2`, `nonzero` (or `bright`) and `zero` (or `dark`).
    fn from_str(text: &str) -> Result<Self, String> {
        match text.trim() {
            "nonzero" | "bright" => Ok(Self::Nonzero),
            "zero" | "dark" => Ok(Self::Zero),
            list => {
                let value = |value: &str| value.trim().parse::<u16>().map_err(|_| value.trim().to_owned());
                list.split(',')
                    .map(value)
                    .collect::<Result<_, _>>()
                    .map(Self::Values)
                    .map_err(|wrong| format!("`{wrong}` is no value from 0 to 65535; write 2, 1,2, nonzero or zero"))
            }
        }
    }
}

/// Threshold of a JPEG without a stated one.
const BLURRED: u16 = 128;
/// Number of values that a message lists.
const LISTED: usize = 8;
/// Relative difference of sides above which pixels are not square, and above which a given side
/// contradicts the stated one.
const SQUARE: f64 = 1e-3;
const CONTRADICTS: f64 = 0.01;

impl Reading {
    /// Returns for each value whether it is tissue.
    pub(super) fn classes(&self, image: &mut Image) -> Result<Vec<bool>, MicrographError> {
        if image.kind == Kind::Polygons && (self.tissue.is_some() || self.threshold.is_some()) {
            return Err(MicrographError::Polygons);
        }
        if let Some(Tissue::Values(values)) = &self.tissue {
            if self.threshold.is_some() {
                return Err(MicrographError::Exclusive);
            }
            if image.kind == Kind::Blurred {
                return Err(MicrographError::Blurred);
            }
            let mut classes = vec![false; 1 << 16];
            values.iter().for_each(|value| classes[usize::from(*value)] = true);
            return Ok(classes);
        }
        let blurred = image.kind == Kind::Blurred && self.threshold.is_none();
        if blurred {
            image.notes.push(format!("no threshold was given: values from {BLURRED} on are taken as bright"));
        } else if self.tissue.is_none() && self.threshold.is_none() {
            unambiguous(&image.values)?;
        }
        let least = usize::from(self.threshold.unwrap_or(if blurred { BLURRED } else { 1 }));
        let bright = self.tissue != Some(Tissue::Zero);
        Ok((0..1 << 16).map(|value| (value >= least) == bright).collect())
    }

    /// Returns the side of a pixel in µm.
    pub(super) fn side_um(&self, image: &mut Image) -> Result<f64, MicrographError> {
        match (self.pixel_um, &image.stated) {
            (Some(given), stated) => {
                if let Stated::Sides(sides, source) = stated
                    && sides.iter().any(|side| (side / given - 1.0).abs() > CONTRADICTS)
                {
                    let [x, y] = sides.map(short);
                    image.notes.push(format!(
                        "the file states pixels of {x} × {y} µm ({source}); the given side, {given} µm, is used"
                    ));
                }
                if PIXEL_UM.contains(&given) { Ok(given) } else { Err(MicrographError::PixelSize(given)) }
            }
            (None, Stated::Sides([x, y], source)) => {
                if (x / y - 1.0).abs() > SQUARE {
                    return Err(MicrographError::NotSquare(short(*x), short(*y)));
                }
                let side = short(*x);
                if !PIXEL_UM.contains(x) {
                    return Err(MicrographError::PixelSize(side));
                }
                let note = format!("the side of a pixel is {side} µm, as the file states ({source})");
                image.notes.push(note);
                Ok(*x)
            }
            (None, Stated::Print(text)) => {
                let why = format!("the file states {text}, which is a resolution for printing");
                Err(MicrographError::NoPixelSize(why))
            }
            (None, Stated::Nothing) => Err(MicrographError::NoPixelSize("the file does not state it".into())),
        }
    }
}

/// Checks that the values are 0 and one other, or all the same.
fn unambiguous(values: &[u16]) -> Result<(), MicrographError> {
    let mut seen = vec![false; 1 << 16];
    values.iter().for_each(|value| seen[usize::from(*value)] = true);
    let found: Vec<usize> = seen.iter().enumerate().filter_map(|(value, seen)| seen.then_some(value)).collect();
    match found.as_slice() {
        [] | [_] | [0, _] => Ok(()),
        [listed @ .., last] => {
            let more = if found.len() > LISTED { " …" } else { "" };
            let listed: Vec<String> = listed.iter().take(LISTED - 1).map(usize::to_string).collect();
            Err(MicrographError::Values(format!("{}{more} and {last}", listed.join(", "))))
        }
    }
}

/// A number with five significant digits.
fn short(value: f64) -> f64 {
    format!("{value:.4e}").parse().unwrap_or(value)
}
