//! Parameter studies: a design over values of some parameters, and the merge patch of each of its points.
//!
//! A study is a pure function of its JSON. Random numbers come from [`crate::random`], so that the same seed gives the same
//! points everywhere. docs/studies.md describes the JSON.
//!
//! | file | subject |
//! |---|---|
//! | `target` | what a pointer addresses |
//! | `source` | a list, range or distribution: the values of one parameter |
//! | `distribution` | quantiles |
//! | `design` | grid, zip, Latin hypercube |
//! | `schema` | JSON Schema |

mod design;
mod distribution;
mod schema;
mod source;
mod target;

#[cfg(test)]
mod tests;

pub use schema::schema;

use super::fault::{Fault, child, describe};
use super::reader::Reader;
use design::{Design, SEED_MAX, grid, latin_hypercube};
use serde_json::{Map, Value};
use source::{Need, Source};
use target::target;

/// Bounds of the number at a pointer, and whether it is an integer.
///
/// # Errors
/// A sentence on what is wrong.
pub(super) fn number_at(pointer: &str) -> Result<([f64; 2], bool), String> {
    let target = target(pointer)?;
    let bounds = target.bounds().ok_or_else(|| "takes no numbers".to_owned())?;
    Ok((bounds, target.integer))
}

const MEMBERS: [&str; 4] = ["design", "samples", "seed", "values"];

/// A study: for each of its points, one value of every parameter that is varied.
#[derive(Clone, Debug, PartialEq)]
pub struct Study {
    /// Pointers of the parameters, sorted.
    pointers: Vec<String>,
    /// The values of each parameter.
    levels: Vec<Vec<Value>>,
    /// Whether the values of a parameter are a list in the request.
    listed: Vec<bool>,
    /// For each point, the index of each parameter's value.
    points: Vec<Vec<usize>>,
}

impl Study {
    /// Reads a study of at most `most` points. Values are checked by resolving each point; see [`Study::patch`].
    ///
    /// # Errors
    /// All faults, with pointers into `vary`, such as `/values/~1collision~1gap_um/to`.
    pub fn read(vary: &Value, most: usize) -> Result<Self, Vec<Fault>> {
        let mut reader = Reader::default();
        match read(&mut reader, vary, most) {
            Some(study) if reader.faults.is_empty() => Ok(study),
            _ => Err(reader.faults),
        }
    }

    /// Pointers of the parameters that are varied, sorted.
    #[must_use]
    pub fn pointers(&self) -> &[String] {
        &self.pointers
    }

    /// Number of points; at least 1.
    #[must_use]
    pub fn points(&self) -> usize {
        self.points.len()
    }

    /// The values of a point, in the order of [`Study::pointers`].
    pub fn values(&self, point: usize) -> impl Iterator<Item = &Value> {
        self.levels.iter().zip(&self.points[point]).map(|(levels, &level)| &levels[level])
    }

    /// The merge patch of a point, to be applied after the one that all points have in common.
    #[must_use]
    pub fn patch(&self, point: usize) -> Value {
        let mut patch = Value::Object(Map::new());
        for (pointer, value) in self.pointers.iter().zip(self.values(point)) {
            // Names of parameters need no escapes, and no pointer is within another one.
            let place = pointer.split('/').skip(1).fold(&mut patch, |place, name| &mut place[name]);
            *place = value.clone();
        }
        patch
    }

    /// Where in `vary` a fault at `pointer` of a point's specification comes from; `None` if from another parameter.
    #[must_use]
    pub fn place(&self, point: usize, pointer: &str) -> Option<String> {
        let within = |own: &str| pointer.strip_prefix(own).filter(|rest| rest.is_empty() || rest.starts_with('/'));
        let (i, rest) = self.pointers.iter().enumerate().find_map(|(i, own)| Some((i, within(own)?)))?;
        let at = child("/values", &self.pointers[i]);
        Some(if self.listed[i] { format!("{at}/{}{rest}", self.points[point][i]) } else { at })
    }

    /// The point in words: its index and values, each shortened.
    #[must_use]
    pub fn describe(&self, point: usize) -> String {
        let value = |value: &Value| match value {
            Value::Array(_) | Value::Object(_) => describe(value),
            simple => super::fault::shorten(&simple.to_string()),
        };
        let values: Vec<String> =
            self.pointers.iter().zip(self.values(point)).map(|(at, v)| format!("{at}: {}", value(v))).collect();
        format!("point {point} ({})", values.join(", "))
    }
}

fn read(reader: &mut Reader, vary: &Value, most: usize) -> Option<Study> {
    let Some(members) = vary.as_object() else {
        return reader.fault("", format!("must be an object with design and values, not {}", describe(vary)));
    };
    reader.only("", members, &MEMBERS);
    let design = match members.get("design") {
        None => reader.fault("/design", "is missing; the designs are grid, zip and lhs"),
        Some(name) => match Design::NAMES.iter().find(|(known, _)| name.as_str() == Some(known)) {
            Some((_, design)) => Some(*design),
            None => reader.not_a_choice_of("/design", name, &Design::NAMES.map(|(name, _)| name)),
        },
    };
    let hypercube = design == Some(Design::LatinHypercube);
    let samples = match members.get("samples") {
        None if hypercube => reader.fault("/samples", "is missing; it is the number of points"),
        Some(value) if hypercube => reader.size("/samples", value, 1, most),
        _ => None,
    };
    let seed = match members.get("seed") {
        #[expect(clippy::cast_possible_truncation, reason = "64 bits, and checked")]
        Some(value) if hypercube => reader.size("/seed", value, 0, SEED_MAX as usize).map(|seed| seed as u64),
        _ => Some(0),
    };
    if design.is_some() && !hypercube {
        for name in ["samples", "seed"].into_iter().filter(|name| members.contains_key(*name)) {
            reader.fault::<()>(child("", name), "belongs to the design lhs alone");
        }
    }
    let need = Need { most, counted: !hypercube };
    let varied = match members.get("values") {
        None => reader.fault("/values", "is missing; it names the parameters to vary, each with its values"),
        Some(Value::Object(values)) if !values.is_empty() => sources(reader, values, need, design.is_some()),
        Some(Value::Object(_)) => reader.fault("/values", "is empty; it names the parameters to vary"),
        Some(other) => reader.fault("/values", format!("must be an object, not {}", describe(other))),
    };
    let (design, seed, varied) = (design?, seed?, varied?);
    let (pointers, sources): (Vec<String>, Vec<Source>) = varied.into_iter().unzip();
    let listed = sources.iter().map(Source::is_list).collect();
    let (levels, points) = match design {
        Design::LatinHypercube => hypercube_points(&sources, samples?, seed),
        Design::Grid => {
            let levels: Vec<Vec<Value>> = sources.iter().map(Source::levels).collect();
            let lengths: Vec<usize> = levels.iter().map(Vec::len).collect();
            let points = lengths.iter().fold(1_usize, |all, length| all.saturating_mul(*length));
            if points > most {
                let product = lengths.iter().map(usize::to_string).collect::<Vec<_>>().join(" × ");
                return reader.fault("/values", format!("gives {product} points; at most {most} are allowed"));
            }
            (levels, grid(&lengths))
        }
        Design::Zip => {
            let levels: Vec<Vec<Value>> = sources.iter().map(Source::levels).collect();
            let length = levels.first().map_or(0, Vec::len);
            for (pointer, other) in pointers.iter().zip(&levels).filter(|(_, other)| other.len() != length) {
                let detail = format!(
                    "has {} values, but {} has {length}; a zip needs as many of each",
                    other.len(),
                    pointers[0]
                );
                reader.fault::<()>(child("/values", pointer), detail);
            }
            let dimensions = levels.len();
            (levels, (0..length).map(|i| vec![i; dimensions]).collect())
        }
    };
    Some(Study { pointers, levels, listed, points })
}

/// The parameters to vary and where their values come from, sorted by pointer.
fn sources(reader: &mut Reader, values: &Map<String, Value>, need: Need, known: bool) -> Option<Vec<(String, Source)>> {
    let mut named: Vec<(&String, &Value)> = values.iter().collect();
    named.sort_by_key(|(pointer, _)| *pointer);
    let mut found = Vec::new();
    for (pointer, value) in &named {
        let at = child("/values", pointer);
        let addressed = match target(pointer) {
            Ok(addressed) => addressed,
            Err(detail) => {
                reader.fault::<()>(at, detail);
                continue;
            }
        };
        let outer = named.iter().find(|(outer, _)| is_part(pointer, outer) && target(outer).is_ok());
        if let Some((outer, _)) = outer {
            reader.fault::<()>(&at, format!("is a part of {outer}, which is varied too"));
        }
        // Without a design, it is not known which members are needed.
        if known {
            let source = Source::read(reader, &at, value, addressed, need);
            found.extend(source.map(|source| ((*pointer).clone(), source)));
        }
    }
    (found.len() == named.len()).then_some(found)
}

/// Whether a pointer addresses a part of what `outer` addresses.
fn is_part(pointer: &str, outer: &str) -> bool {
    pointer.strip_prefix(outer).is_some_and(|rest| rest.starts_with('/'))
}

fn hypercube_points(sources: &[Source], samples: usize, seed: u64) -> (Vec<Vec<Value>>, Vec<Vec<usize>>) {
    let (mut levels, mut points) = (Vec::new(), vec![Vec::new(); samples]);
    for (dimension, source) in (0..).zip(sources) {
        let (values, indices) = source.at(&latin_hypercube(samples, seed, dimension));
        levels.push(values);
        points.iter_mut().zip(indices).for_each(|(point, index)| point.push(index));
    }
    (levels, points)
}
