//! Helpers for the tests of several formats.

use super::Metadata;
use super::read::{Group, Surface, Unit};
use super::shape::{NamedPatch, Shape};
use crate::model::LengthUnit;
use proptest::prelude::*;
use std::ops::Range;

pub(crate) fn meta() -> Metadata {
    Metadata {
        preset: "pig".into(),
        seed: 7,
        digest: "0f3a".repeat(16),
        engine: "0.1.0".into(),
        length_mm: 4.0,
        sections: 2,
    }
}

/// A surface of four patches, the third of which is empty, with small and large coordinates.
#[derive(Clone, Debug)]
pub(crate) struct Sample {
    pub(crate) positions: Vec<[f32; 3]>,
    pub(crate) triangles: Vec<[u32; 3]>,
    pub(crate) patches: Vec<(String, Range<usize>)>,
    pub(crate) meta: Option<Metadata>,
    pub(crate) unit: LengthUnit,
}

impl Sample {
    /// A strip of `count` triangles.
    pub(crate) fn new(count: usize) -> Self {
        let vertex = |i: usize| [0.1 * i as f32, if i.is_multiple_of(2) { -0.0 } else { 1.0 / 3.0 }, 1e-7 * i as f32];
        let (first, second) = (count / 3, count / 2);
        let patches = [("inner_wall", 0..first), ("outer_wall", first..second), ("cap_isthmus", second..second)];
        let patches = patches.into_iter().chain([("cap_ampulla", second..count)]);
        Self {
            positions: (0..count + 2).map(vertex).collect(),
            triangles: (0..count as u32).map(|i| [i, i + 1 + i % 2, i + 2 - i % 2]).collect(),
            patches: patches.map(|(name, triangles)| (name.to_owned(), triangles)).collect(),
            meta: Some(meta()),
            unit: LengthUnit::Millimetre,
        }
    }

    pub(crate) fn shape(&self) -> Shape<'_> {
        Shape {
            name: "tissue",
            positions: &self.positions,
            triangles: &self.triangles,
            patches: self.patches.iter().map(|(name, t)| NamedPatch { name, triangles: t.clone() }).collect(),
            unit: self.unit,
            meta: self.meta.as_ref(),
        }
    }

    /// Surface that a reader of a format with shared vertices returns. Patches without triangles
    /// are not groups.
    pub(crate) fn surface(&self) -> Surface {
        let groups = self.patches.iter().filter(|(_, triangles)| !triangles.is_empty());
        Surface {
            positions: self.positions.iter().map(|p| p.map(f64::from)).collect(),
            triangles: self.triangles.clone(),
            groups: groups.map(|(name, t)| Group { name: name.as_str().into(), triangles: t.clone() }).collect(),
            unit: Unit::Stated(self.unit.metres()),
            notes: Vec::new(),
        }
    }

    /// Surface that a reader of a format without shared vertices returns.
    pub(crate) fn soup(&self) -> Surface {
        let positions = self.triangles.iter().flatten().map(|&v| self.positions[v as usize].map(f64::from)).collect();
        let triangles = (0..self.triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        Surface { positions, triangles, ..self.surface() }
    }
}

/// Samples of up to `most` triangles with arbitrary finite coordinates.
pub(crate) fn samples(most: usize) -> impl Strategy<Value = Sample> {
    (0..=most)
        .prop_flat_map(|count| {
            let finite = prop::num::f32::NORMAL | prop::num::f32::SUBNORMAL | prop::num::f32::ZERO;
            let vertices = prop::collection::vec(prop::array::uniform3(finite), count + 2);
            let corners = prop::collection::vec(prop::array::uniform3(0..count as u32 + 2), count);
            (vertices, corners, any::<bool>())
        })
        .prop_map(|(positions, triangles, metres)| {
            let unit = if metres { LengthUnit::Metre } else { LengthUnit::Micrometre };
            Sample { positions, triangles: triangles.clone(), unit, ..Sample::new(triangles.len()) }
        })
}

/// Bits of positions, so that zeros of different sign differ.
pub(crate) fn bits(positions: &[[f64; 3]]) -> Vec<[u64; 3]> {
    positions.iter().map(|p| p.map(f64::to_bits)).collect()
}

/// Rotates a triangle to start at its smallest corner, with the same orientation.
pub(crate) fn turned<T: Ord + Copy>(t: [T; 3]) -> [T; 3] {
    let least = (0..3).min_by_key(|&k| t[k]).unwrap();
    [t[least], t[(least + 1) % 3], t[(least + 2) % 3]]
}
