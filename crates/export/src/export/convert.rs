//! A surface that was read, made ready to be written in another format or unit.

use super::read::Surface;
use super::shape::{NamedPatch, Shape};
use crate::geometry::cut::Body;
use crate::model::{BodyKind, LengthUnit, PatchKind};
use std::collections::HashMap;
use std::ops::Range;

/// A surface with shared vertices and named patches.
#[derive(Clone, Debug, PartialEq)]
pub struct Converted {
    name: String,
    positions: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    patches: Vec<(String, Range<usize>)>,
    unit: LengthUnit,
    /// Farthest that rounding to single precision moved a coordinate, in units of the result.
    pub rounded: f64,
    /// Triangles that were left out because two of their corners are the same, as where strips are joined.
    pub collapsed: usize,
}

impl Converted {
    /// Takes a surface over into `unit`. Vertices at exactly the same position become one, and each name of a group becomes one
    /// patch; triangles in no group are the patch `surface`. The body is called `name` unless its patches tell which it is.
    #[must_use]
    pub fn new(surface: &Surface, unit: LengthUnit, name: &str) -> Self {
        let (from, to) = (surface.unit.metres(), unit.metres());
        // Multiplied or divided by a number that is exact for all decimal units.
        let scaled =
            |x: f64| if from >= to { x * (from / to).round_if_close() } else { x / (to / from).round_if_close() };
        let (mut positions, mut rounded, mut seen) = (Vec::new(), 0.0_f64, HashMap::new());
        let index: Vec<u32> = (surface.positions.iter())
            .map(|p| {
                // Adding zero turns −0 into 0.
                *seen.entry(p.map(|x| (x + 0.0).to_bits())).or_insert_with(|| {
                    let exact = p.map(scaled);
                    let single = exact.map(|x| x as f32);
                    for (exact, single) in exact.iter().zip(single) {
                        rounded = rounded.max((exact - f64::from(single)).abs());
                    }
                    positions.push(single);
                    positions.len() as u32 - 1
                })
            })
            .collect();
        let mut triangles = Vec::with_capacity(surface.triangles.len());
        let mut patches: Vec<(String, Range<usize>)> = Vec::new();
        for (name, ranges) in parts(surface) {
            let start = triangles.len();
            let of_part = ranges.into_iter().flat_map(|range| &surface.triangles[range]);
            let corners = of_part.map(|t| t.map(|v| index[v as usize]));
            triangles.extend(corners.filter(|[a, b, c]| a != b && b != c && c != a));
            patches.push((name, start..triangles.len()));
        }
        patches.retain(|(_, triangles)| !triangles.is_empty());
        Self {
            name: body(&patches).map_or_else(|| name.to_owned(), |body| body.name().to_owned()),
            collapsed: surface.triangles.len() - triangles.len(),
            positions,
            triangles,
            patches,
            unit,
            rounded,
        }
    }

    /// Takes a surface over in the unit of its file.
    #[must_use]
    pub fn in_its_unit(surface: &Surface) -> Self {
        let metres = surface.unit.metres();
        let is_unit = |unit: &LengthUnit| (unit.metres() / metres - 1.0).abs() < 1e-9;
        let unit = LengthUnit::ALL.into_iter().find(is_unit).unwrap_or(LengthUnit::Metre);
        Self::new(surface, unit, "surface")
    }

    /// As a body that can be cut.
    #[must_use]
    pub fn into_body(self) -> Body<'static> {
        let patches: Vec<(PatchKind, Range<usize>)> =
            self.patches.into_iter().filter_map(|(name, range)| Some((PatchKind::named(&name)?, range))).collect();
        Body::new(self.positions, self.triangles, &patches, 1e6 * self.unit.metres())
    }

    /// As the writers take it.
    #[must_use]
    pub fn shape(&self) -> Shape<'_> {
        Shape {
            name: &self.name,
            positions: &self.positions,
            triangles: &self.triangles,
            patches: (self.patches.iter())
                .map(|(name, triangles)| NamedPatch { name, triangles: triangles.clone() })
                .collect(),
            unit: self.unit,
            meta: None,
        }
    }
}

trait RoundIfClose {
    /// The nearest integer if the number is within rounding of it.
    fn round_if_close(self) -> Self;
}

impl RoundIfClose for f64 {
    fn round_if_close(self) -> Self {
        let whole = self.round();
        if (self - whole).abs() <= 1e-12 * whole { whole } else { self }
    }
}

/// The triangles of each name, in the order of the names' first appearance.
fn parts(surface: &Surface) -> Vec<(String, Vec<Range<usize>>)> {
    let mut parts: Vec<(String, Vec<Range<usize>>)> = Vec::new();
    let mut place: HashMap<String, usize> = HashMap::new();
    let mut add = |name: &str, triangles: Range<usize>| {
        if triangles.is_empty() {
            return;
        }
        let at = *place.entry(name.to_owned()).or_insert_with(|| {
            parts.push((name.to_owned(), Vec::new()));
            parts.len() - 1
        });
        parts[at].1.push(triangles);
    };
    let mut done = 0;
    for group in &surface.groups {
        let start = group.triangles.start.max(done);
        add("surface", done..start);
        add(&group.name, start..group.triangles.end.max(start));
        done = group.triangles.end.max(start);
    }
    add("surface", done..surface.triangles.len());
    parts
}

/// The body that has these patches and no others.
fn body(patches: &[(String, Range<usize>)]) -> Option<BodyKind> {
    BodyKind::ALL.into_iter().find(|body| {
        let of_body = body.patches();
        of_body.len() == patches.len()
            && patches.iter().all(|(name, _)| PatchKind::named(name).is_some_and(|kind| of_body.contains(&kind)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::read::{Group, Unit};

    fn surface(unit: Unit, names: &[(&str, Range<usize>)]) -> Surface {
        Surface {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-0.0, 0.0, 0.0], [0.1; 3]],
            triangles: vec![[0, 2, 1], [4, 1, 3], [1, 2, 3], [0, 3, 2], [0, 4, 3]],
            groups: names.iter().map(|(n, t)| Group { name: (*n).into(), triangles: t.clone() }).collect(),
            unit,
        }
    }

    #[test]
    fn equal_vertices_are_merged_and_names_become_patches() {
        let groups = [("b", 1..2), ("a", 2..3), ("b", 3..5)];
        let found = Converted::new(&surface(Unit::Assumed, &groups), LengthUnit::Metre, "x");
        assert_eq!(found.positions.len(), 5);
        assert_eq!(found.triangles, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]);
        assert_eq!(found.patches, [("surface".into(), 0..1), ("b".into(), 1..3), ("a".into(), 3..4)]);
        assert_eq!((found.collapsed, found.name.as_str()), (1, "x"));
        assert!(found.rounded > 0.0 && found.rounded < 1e-8, "0.1 is no single-precision number");
    }

    #[test]
    fn decimal_units_are_exact_as_far_as_single_precision_goes() {
        let single = f64::from(0.001_234_567_f32);
        for unit in LengthUnit::ALL {
            let mut of = surface(Unit::Stated(1.0), &[]);
            of.positions[5] = [single; 3];
            let there = Converted::new(&of, unit, "x");
            assert_eq!(there.positions[4], [(single * unit.per_metre()) as f32; 3]);
            let mut back = surface(Unit::Stated(unit.metres()), &[]);
            back.positions[5] = there.positions[4].map(f64::from);
            let back = Converted::new(&back, LengthUnit::Metre, "x");
            assert!((f64::from(back.positions[4][0]) / single - 1.0).abs() < 2e-7);
        }
        let inches = Converted::new(&surface(Unit::Stated(0.0254), &[]), LengthUnit::Millimetre, "x");
        assert_eq!(inches.positions[1], [25.4, 0.0, 0.0]);
    }

    #[test]
    fn a_body_is_known_by_its_patches() {
        let lumen = [("wall", 0..2), ("inlet", 2..3), ("outlet", 3..4)];
        let found = Converted::new(&surface(Unit::Assumed, &lumen), LengthUnit::Metre, "x");
        assert_eq!(found.name, "lumen");
        let shape = found.shape();
        assert_eq!(shape.patches.iter().map(|patch| patch.name).collect::<Vec<_>>(), ["wall", "inlet", "outlet"]);
    }
}
