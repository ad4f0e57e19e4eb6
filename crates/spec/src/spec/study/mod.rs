//! Parameter studies: a design over values of some parameters, and the merge patch of each of its
//! points.
//!
//! A study is a pure function of its JSON. Random numbers come from [`crate::random`], so the same
//! seed results in the same points everywhere. docs/studies.md describes the JSON.
//!
//! | file | subject |
//! |---|---|
//! | `target` | the value that a pointer addresses |
//! | `source` | the values of one parameter: a list, range or distribution |
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
use super::reader::{JsonReader, SEED_MAX};
use design::{Design, grid, latin_hypercube};
use serde_json::{Map, Value};
use source::{Requirements, Source};
use target::target;

/// Bounds of the number at a pointer, and true if it is an integer.
///
/// # Errors
/// Returns a sentence that says why the pointer does not address a number.
pub(super) fn number_at(pointer: &str) -> Result<([f64; 2], bool), String> {
    let target = target(pointer)?;
    let bounds = target.bounds().ok_or_else(|| "takes no numbers".to_owned())?;
    Ok((bounds, target.integer))
}

/// Maximum number of points, unless a caller sets another one.
pub const DEFAULT_MAX_POINTS: usize = 1000;

const MEMBERS: [&str; 4] = ["design", "samples", "seed", "values"];

/// A study: for each of its points, one value of every varied parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct Study {
    /// Pointers of the parameters, sorted.
    pointers: Vec<String>,
    /// Values of each parameter.
    levels: Vec<Vec<Value>>,
    /// For each parameter, true if its values are a list in the request.
    is_listed: Vec<bool>,
    /// For each point, the index of each parameter's value.
    points: Vec<Vec<usize>>,
}

impl Study {
    /// Reads a study of at most `max_points` points. To check the values, resolve each point with
    /// [`Study::patch`].
    ///
    /// # Errors
    /// Returns all faults, with pointers into `vary`, such as `/values/~1collision~1gap_um/to`.
    pub fn read(vary: &Value, max_points: usize) -> Result<Self, Vec<Fault>> {
        let mut reader = JsonReader::default();
        let study = read(&mut reader, vary, max_points);
        reader.finish(study)
    }

    /// Pointers of the varied parameters, sorted.
    #[must_use]
    pub fn pointers(&self) -> &[String] {
        &self.pointers
    }

    /// Number of points, at least 1.
    #[must_use]
    pub fn points(&self) -> usize {
        self.points.len()
    }

    /// Values of a point, in the order of [`Study::pointers`].
    pub fn values(&self, point: usize) -> impl Iterator<Item = &Value> {
        self.levels.iter().zip(&self.points[point]).map(|(levels, &level)| &levels[level])
    }

    /// Merge patch of a point. Apply it after the patch that all points share.
    #[must_use]
    pub fn patch(&self, point: usize) -> Value {
        let mut patch = Value::Object(Map::new());
        for (pointer, value) in self.pointers.iter().zip(self.values(point)) {
            // Parameter names need no escapes, and no pointer is a prefix of another.
            let place = pointer.split('/').skip(1).fold(&mut patch, |place, name| &mut place[name]);
            *place = value.clone();
        }
        patch
    }

    /// Place in `vary` that causes the fault at `pointer` of a point's specification. `None` if
    /// another parameter is the cause.
    #[must_use]
    pub fn place(&self, point: usize, pointer: &str) -> Option<String> {
        let within = |own: &str| pointer.strip_prefix(own).filter(|rest| rest.is_empty() || rest.starts_with('/'));
        let (i, rest) = self.pointers.iter().enumerate().find_map(|(i, own)| Some((i, within(own)?)))?;
        let at = child("/values", &self.pointers[i]);
        Some(if self.is_listed[i] { format!("{at}/{}{rest}", self.points[point][i]) } else { at })
    }

    /// Describes a point: its index and its values, each shortened.
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

fn read(reader: &mut JsonReader, vary: &Value, max_points: usize) -> Option<Study> {
    let Some(members) = vary.as_object() else {
        return reader.unexpected("", "an object with design and values", vary);
    };
    reader.only("", members, &MEMBERS);
    let design = match members.get("design") {
        None => reader.fault("/design", "is missing; the designs are grid, zip and lhs"),
        Some(name) => match Design::NAMES.iter().find(|(known, _)| name.as_str() == Some(known)) {
            Some((_, design)) => Some(*design),
            None => reader.not_a_choice("/design", name, &Design::NAMES.map(|(name, _)| name)),
        },
    };
    let hypercube = design == Some(Design::LatinHypercube);
    let samples = match members.get("samples") {
        None if hypercube => reader.fault("/samples", "is missing; give the number of points"),
        Some(value) if hypercube => reader.integer("/samples", value, 1..=max_points),
        _ => None,
    };
    let seed = match members.get("seed") {
        Some(value) if hypercube => reader.integer("/seed", value, 0..=SEED_MAX),
        _ => Some(0),
    };
    if design.is_some() && !hypercube {
        for name in ["samples", "seed"].into_iter().filter(|name| members.contains_key(*name)) {
            reader.fault::<()>(child("", name), "is valid only in the design lhs; remove it");
        }
    }
    let requirements = Requirements { max_values: max_points, requires_count: !hypercube };
    let varied = match members.get("values") {
        None => reader.fault("/values", "is missing; give the parameters to vary, each with its values"),
        Some(Value::Object(values)) if !values.is_empty() => {
            read_sources(reader, values, requirements, design.is_some())
        }
        Some(Value::Object(_)) => reader.fault("/values", "is empty; give at least one parameter to vary"),
        Some(other) => reader.unexpected("/values", "an object", other),
    };
    let (design, seed, varied) = (design?, seed?, varied?);
    let (pointers, sources): (Vec<String>, Vec<Source>) = varied.into_iter().unzip();
    let is_listed = sources.iter().map(Source::is_list).collect();
    let (levels, points) = match design {
        Design::LatinHypercube => hypercube_points(&sources, samples?, seed),
        Design::Grid => {
            let levels: Vec<Vec<Value>> = sources.iter().map(Source::levels).collect();
            let lengths: Vec<usize> = levels.iter().map(Vec::len).collect();
            let points = lengths.iter().fold(1_usize, |all, length| all.saturating_mul(*length));
            if points > max_points {
                let product = lengths.iter().map(usize::to_string).collect::<Vec<_>>().join(" × ");
                return reader.fault("/values", format!("gives {product} points; at most {max_points} are allowed"));
            }
            (levels, grid(&lengths))
        }
        Design::Zip => {
            let levels: Vec<Vec<Value>> = sources.iter().map(Source::levels).collect();
            let length = levels.first().map_or(0, Vec::len);
            for (pointer, other) in pointers.iter().zip(&levels).filter(|(_, other)| other.len() != length) {
                let detail = format!(
                    "has {} values, but {} has {length}; a zip needs equally many values of every parameter",
                    other.len(),
                    pointers[0]
                );
                reader.fault::<()>(child("/values", pointer), detail);
            }
            let dimensions = levels.len();
            (levels, (0..length).map(|i| vec![i; dimensions]).collect())
        }
    };
    Some(Study { pointers, levels, is_listed, points })
}

/// Reads the parameters to vary and the sources of their values, sorted by pointer.
fn read_sources(
    reader: &mut JsonReader,
    values: &Map<String, Value>,
    requirements: Requirements,
    has_design: bool,
) -> Option<Vec<(String, Source)>> {
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
        // The design determines which members are required.
        if has_design {
            let source = Source::read(reader, &at, value, addressed, requirements);
            found.extend(source.map(|source| ((*pointer).clone(), source)));
        }
    }
    (found.len() == named.len()).then_some(found)
}

/// True if `pointer` addresses a part of the value that `outer` addresses.
fn is_part(pointer: &str, outer: &str) -> bool {
    pointer.strip_prefix(outer).is_some_and(|rest| rest.starts_with('/'))
}

fn hypercube_points(sources: &[Source], samples: usize, seed: u64) -> (Vec<Vec<Value>>, Vec<Vec<usize>>) {
    let (mut levels, mut points) = (Vec::new(), vec![Vec::new(); samples]);
    for (dimension, source) in (0..).zip(sources) {
        let (values, indices) = source.values_at(&latin_hypercube(samples, seed, dimension));
        levels.push(values);
        points.iter_mut().zip(indices).for_each(|(point, index)| point.push(index));
    }
    (levels, points)
}
