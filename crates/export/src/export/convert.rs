//! Conversion of a surface that was read, for writing in another format or unit.

use super::read::Surface;
use super::shape::{NamedPatch, Shape};
use crate::geometry::cut::{Body, HalfError, HalfSpace, half};
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
    /// Maximum change of a coordinate by rounding to single precision, in units of the result.
    pub rounded: f64,
    /// Number of omitted triangles, two corners of which are the same, for example where strips are
    /// joined.
    pub collapsed: usize,
}

impl Converted {
    /// Converts a surface to `unit`.
    ///
    /// Vertices at exactly the same position are merged. All groups with the same name become one
    /// patch, and triangles in no group become the patch `surface`. The body is called `name`,
    /// unless its patches identify it as a body of a model.
    #[must_use]
    pub fn new(surface: &Surface, unit: LengthUnit, name: &str) -> Self {
        let (from, to) = (surface.unit.metres(), unit.metres());
        // The factor or divisor of decimal units is an integer, so it is exact.
        let scaled =
            |x: f64| if from >= to { x * rounded_if_close(from / to) } else { x / rounded_if_close(to / from) };
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

    /// Converts a surface without changing its unit, or to metres if its unit is not a
    /// [`LengthUnit`].
    #[must_use]
    pub fn in_its_unit(surface: &Surface) -> Self {
        let metres = surface.unit.metres();
        let is_unit = |unit: &LengthUnit| (unit.metres() / metres - 1.0).abs() < 1e-9;
        let unit = LengthUnit::ALL.into_iter().find(is_unit).unwrap_or(LengthUnit::Metre);
        Self::new(surface, unit, "surface")
    }

    /// Converts to a body that can be cut.
    #[must_use]
    pub fn into_body(self) -> Body<'static> {
        let patches: Vec<(PatchKind, Range<usize>)> =
            self.patches.into_iter().filter_map(|(name, range)| Some((PatchKind::named(&name)?, range))).collect();
        Body::new(self.positions, self.triangles, &patches, 1e6 * self.unit.metres())
    }

    /// The part beyond a plane, whose position is in the unit of the surface. The face of the cut
    /// becomes the patch `cap`, or `cap_2` and so on if the surface already has a patch of this
    /// name. The surface must be closed.
    ///
    /// # Errors
    /// See [`HalfError`].
    pub fn half(&self, space: &HalfSpace, cap: &str) -> Result<Self, HalfError> {
        let ranges: Vec<Range<usize>> = self.patches.iter().map(|(_, triangles)| triangles.clone()).collect();
        let found = half(&self.positions, &self.triangles, &ranges, space)?;
        let names = std::iter::once(cap.to_owned()).chain((2..).map(|number| format!("{cap}_{number}")));
        let is_new = |name: &String| self.patches.iter().all(|(patch, _)| patch != name);
        let caps = names.into_iter().find(is_new).map(|name| (name, found.cap));
        let mut patches: Vec<(String, Range<usize>)> =
            self.patches.iter().map(|(name, _)| name.clone()).zip(found.patches).chain(caps).collect();
        patches.retain(|(_, triangles)| !triangles.is_empty());
        Ok(Self {
            positions: found.positions,
            triangles: found.triangles,
            patches,
            name: self.name.clone(),
            unit: self.unit,
            rounded: self.rounded,
            collapsed: self.collapsed,
        })
    }

    /// Shape for the writers.
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

/// The nearest integer, if the number differs from it only by rounding.
fn rounded_if_close(number: f64) -> f64 {
    let whole = number.round();
    if (number - whole).abs() <= 1e-12 * whole { whole } else { number }
}

/// Triangles by name, in the order in which the names first appear.
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

/// Body of a model that has exactly these patches.
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
            notes: Vec::new(),
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
    fn a_half_keeps_patches_and_names_its_cap() {
        let names = [("cut", 0..1), ("side", 1..4)];
        let mut whole = surface(Unit::Assumed, &names);
        whole.triangles.pop();
        let whole = Converted::new(&whole, LengthUnit::Millimetre, "x");
        let space = |offset| HalfSpace { normal: [0.0, 0.0, 1.0], offset };
        let half = whole.half(&space(500.0), "cut").unwrap();
        let patches: Vec<_> = half.patches.iter().map(|(name, triangles)| (name.as_str(), triangles.len())).collect();
        assert_eq!(patches, [("side", 3), ("cut_2", 1)]);
        assert_eq!((half.unit, half.name.as_str(), half.positions.len()), (LengthUnit::Millimetre, "x", 4));
        assert_eq!(whole.half(&space(1000.0), "cut"), Err(HalfError::Nothing));
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
