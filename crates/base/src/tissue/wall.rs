//! Layers of the muscular wall, by the distance from its inner and its outer border.

use super::contour::Edge;
use super::field::Field;
use super::vessels::{Side, Vessel, vessels};
use super::{Contour, Layers, Tissue, bundles};
use std::f64::consts::TAU;

/// Maximum share of the wall outside the lamina propria that the subserosa takes.
const MAX_SUBSEROSA: f64 = 0.4;
/// Maximum share of the muscle that the inner longitudinal layer takes.
const MAX_INNER: f64 = 0.4;
/// Factor by which the subserosa is thicker at the mesosalpinx, less 1.
const MESOSALPINX: f64 = 2.0;

/// The muscular wall of a section.
#[derive(Clone, Debug)]
pub(super) struct Wall {
    pub(super) outside: Contour,
    field: Field,
    centre: [f64; 2],
    /// True if the section lies across the tube. Angles have a meaning only there.
    is_across: bool,
    vessels: Vec<Vessel>,
    layers: Layers,
}

/// Distances of a point of the wall from the borders of the muscle, µm.
#[derive(Clone, Copy, Debug)]
struct Span {
    /// Distance from the inner border; negative in the lamina propria.
    inner: f64,
    /// Distance from the outer border; negative in the subserosa.
    outer: f64,
}

impl Wall {
    /// Computes the wall of a section. `closing` are the edges in the planes of caps that close the
    /// lumen; a section across the tube has none. `side` is the number of nodes along the field.
    pub(super) fn new(outside: Contour, lumen: &Contour, closing: &[Edge], layers: &Layers, side: f64) -> Self {
        let field = Field::new(lumen, lumen.edges.iter().chain(closing), &outside, layers, side);
        let centre = outside.centre();
        let mut wall =
            Self { outside, field, centre, is_across: closing.is_empty(), vessels: Vec::new(), layers: *layers };
        if wall.is_across {
            wall.vessels = vessels(layers, &|turn| wall.side(turn));
        }
        wall
    }

    /// Angle of a point around the middle of the outer contour, in turns.
    fn turn(&self, p: [f64; 2]) -> f64 {
        libm::atan2(p[1] - self.centre[1], p[0] - self.centre[0]) / TAU
    }

    /// The wall in a direction from the middle, in turns.
    fn side(&self, turn: f64) -> Option<Side> {
        let (sin, cos) = libm::sincos(turn * TAU);
        let edge = self.outside.farthest(self.centre, [cos, sin])?;
        let serosa = self.layers.serosa_um;
        let Span { inner, outer } = self.span([edge[0] - serosa * cos, edge[1] - serosa * sin], serosa);
        Some(Side { edge, out: [cos, sin], muscle_um: (inner + outer).max(0.0), subserosa_um: (-outer).max(0.0) })
    }

    /// Distance from a point of the mucosa to the muscle, along a unit vector out of the lumen.
    pub(super) fn muscle_beyond(&self, p: [f64; 2], out: [f64; 2]) -> f64 {
        // Nodes inside the lumen have no distance, so the field is read beyond their neighbours.
        let step = 2.0 * self.field.side_um();
        let beyond = [p[0] + step * out[0], p[1] + step * out[1]];
        step - (self.field.at(beyond) + self.layers.opening_um)
    }

    /// Distances of a point at `depth` below the outer contour from the borders of the muscle.
    fn span(&self, p: [f64; 2], depth: f64) -> Span {
        let inner = self.field.at(p) + self.layers.opening_um;
        let under_serosa = depth - self.layers.serosa_um;
        let subserosa = if self.is_across && self.layers.subserosa_um > 0.0 {
            let [dx, dy] = [p[0] - self.centre[0], p[1] - self.centre[1]];
            let side = 0.5 - 0.5 * dy / dx.hypot(dy).max(1e-9);
            self.layers.subserosa_um * (1.0 + MESOSALPINX * side.powi(4))
        } else {
            self.layers.subserosa_um
        };
        Span { inner, outer: under_serosa - subserosa.min(MAX_SUBSEROSA * (inner + under_serosa).max(0.0)) }
    }

    /// Tissue at a point of the wall that is not epithelium, at `depth` below the outer contour,
    /// and in a vessel the distance from its border.
    pub(super) fn tissue(&self, p: [f64; 2], depth: f64) -> (Tissue, f64) {
        if depth <= self.layers.serosa_um {
            return (Tissue::Serosa, 0.0);
        }
        let Span { inner, outer } = self.span(p, depth);
        if inner < 0.0 {
            return (Tissue::LaminaPropria, 0.0);
        }
        if let Some(within) = self.vessels.iter().find_map(|vessel| vessel.within(p)) {
            return (Tissue::Vessel, within);
        }
        if outer < 0.0 {
            return (Tissue::Subserosa, 0.0);
        }
        let whole = inner + outer;
        if inner < self.layers.inner_longitudinal_um.min(MAX_INNER * whole) {
            return (Tissue::InnerLongitudinalMuscle, 0.0);
        }
        let share = self.layers.longitudinal_share;
        if outer > share * whole {
            return (Tissue::CircularMuscle, 0.0);
        }
        let height = if self.is_across { bundles::height(self.turn(p), &self.layers) } else { 1.0 };
        let is_bundle = height > 0.0 && outer <= height * share * whole;
        (if is_bundle { Tissue::LongitudinalMuscle } else { Tissue::CircularMuscle }, 0.0)
    }
}
