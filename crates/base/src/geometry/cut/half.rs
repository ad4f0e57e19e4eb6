//! The part of a closed surface beyond a plane, closed again by a cap.
//!
//! A vertex on the plane counts as behind it, as in all cuts, so a triangle in the plane gives way
//! to the cap. The point at which the plane cuts an edge is computed once and rounded to the single
//! precision of the surface. Points at equal positions become one vertex.

use super::{EdgeKey, edge_intersection};
use crate::geometry::triangulate::{TriangulateError, left_of};
use crate::geometry::vector::{cross, distance, dot};
use std::collections::{BTreeMap, HashMap};
use std::ops::Range;

/// What lies beyond a plane: the points whose product with `normal` exceeds `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfSpace {
    /// Unit normal of the plane, into the half-space.
    pub normal: [f64; 3],
    /// Distance of the plane from the origin along the normal, in the unit of the surface.
    pub offset: f64,
}

/// Half of a surface.
#[derive(Clone, Debug, PartialEq)]
pub struct Half {
    /// Vertices.
    pub positions: Vec<[f32; 3]>,
    /// Vertex indices of each triangle: those of the given patches, then the cap.
    pub triangles: Vec<[u32; 3]>,
    /// Triangles that are left of each given patch.
    pub patches: Vec<Range<usize>>,
    /// Triangles of the cap; empty if all of the surface lies beyond the plane.
    pub cap: Range<usize>,
}

/// Reasons why a half could not be closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HalfError {
    /// No part of the surface lies beyond the plane.
    #[error("no part of the surface lies on this side of the plane")]
    Nothing,
    /// The line of the cut ends at an edge of the surface, or divides.
    #[error("the surface is open along the cut, or the line of the cut passes through one point twice")]
    Open,
    /// The cap cannot be triangulated.
    #[error("the face of the cut cannot be closed: {0}")]
    Cap(#[from] TriangulateError),
}

/// Cuts a closed surface and closes the part beyond the plane. `patches` cover all triangles in
/// order.
///
/// # Errors
/// See [`HalfError`].
///
/// # Panics
/// If a triangle names a vertex that does not exist, or a patch a triangle.
pub fn half(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    patches: &[Range<usize>],
    space: &HalfSpace,
) -> Result<Half, HalfError> {
    let mut builder = Builder::new(positions, *space);
    let mut of_patches = Vec::with_capacity(patches.len());
    for patch in patches {
        let start = builder.triangles.len();
        triangles[patch.clone()].iter().for_each(|&triangle| builder.clip(triangle));
        of_patches.push(start..builder.triangles.len());
    }
    let start = builder.triangles.len();
    if start == 0 {
        return Err(HalfError::Nothing);
    }
    builder.close()?;
    let Builder { made, triangles, .. } = builder;
    Ok(Half { positions: made, cap: start..triangles.len(), triangles, patches: of_patches })
}

/// The half under construction.
struct Builder<'a> {
    positions: &'a [[f32; 3]],
    space: HalfSpace,
    /// New number of each given vertex that is in use.
    kept: Vec<Option<u32>>,
    /// Vertex at which the plane cuts an edge.
    cut: HashMap<EdgeKey, u32>,
    /// Vertices on the plane by position.
    at: HashMap<[u32; 3], u32>,
    made: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    /// Number of times each directed edge of the cap is needed.
    rim: BTreeMap<(u32, u32), usize>,
}

impl<'a> Builder<'a> {
    fn new(positions: &'a [[f32; 3]], mut space: HalfSpace) -> Self {
        if axis(space.normal).is_some() {
            // The cap is then flat in single precision as well.
            space.offset = f64::from(space.offset as f32);
        }
        Self {
            positions,
            space,
            kept: vec![None; positions.len()],
            cut: HashMap::new(),
            at: HashMap::new(),
            made: Vec::new(),
            triangles: Vec::new(),
            rim: BTreeMap::new(),
        }
    }

    fn point(&self, v: u32) -> [f64; 3] {
        self.positions[v as usize].map(f64::from)
    }

    fn height(&self, v: u32) -> f64 {
        dot(self.point(v), self.space.normal)
    }

    /// Adds the part of a triangle beyond the plane.
    fn clip(&mut self, triangle: [u32; 3]) {
        let beyond = triangle.map(|v| self.height(v) > self.space.offset);
        let count = beyond.iter().filter(|beyond| **beyond).count();
        // The first corner is the one that differs from the others.
        let first = (0..3).find(|&k| beyond[k] == (count == 1)).unwrap_or(0);
        let [a, b, c] = [0, 1, 2].map(|k| triangle[(first + k) % 3]);
        match count {
            0 => {}
            1 => {
                let corners = [self.keep(a), self.cross(a, b), self.cross(a, c)];
                self.add(corners);
                self.add_rim(corners[2], corners[1]);
            }
            2 => {
                let [p, q] = [self.cross(b, a), self.cross(c, a)];
                let [b, c] = [self.keep(b), self.keep(c)];
                let length = |u: u32, w: u32| {
                    let [u, w] = [u, w].map(|v| self.made[v as usize].map(f64::from));
                    distance(u, w)
                };
                if length(p, c) < length(b, q) {
                    self.add([p, b, c]);
                    self.add([p, c, q]);
                } else {
                    self.add([p, b, q]);
                    self.add([b, c, q]);
                }
                self.add_rim(p, q);
            }
            _ => {
                let corners = triangle.map(|v| self.keep(v));
                self.add(corners);
            }
        }
    }

    /// New number of a given vertex.
    fn keep(&mut self, v: u32) -> u32 {
        let made = &mut self.made;
        *self.kept[v as usize].get_or_insert_with(|| {
            made.push(self.positions[v as usize]);
            made.len() as u32 - 1
        })
    }

    /// Vertex at which the plane cuts the edge from a vertex beyond it to one that is not.
    fn cross(&mut self, beyond: u32, other: u32) -> u32 {
        let key = (beyond.min(other), beyond.max(other));
        if let Some(&vertex) = self.cut.get(&key) {
            return vertex;
        }
        let offset = self.space.offset;
        let at = if self.height(other) == offset {
            self.positions[other as usize]
        } else {
            let heights = [self.height(key.0), self.height(key.1)];
            let mut at = edge_intersection(self.point(key.0), self.point(key.1), heights, offset);
            if let Some((axis, sign)) = axis(self.space.normal) {
                at[axis] = sign * offset;
            }
            at.map(|x| x as f32)
        };
        // Adding zero turns −0 into 0.
        let bits = |p: [f32; 3]| p.map(|x| (x + 0.0).to_bits());
        let vertex = if bits(at) == bits(self.positions[beyond as usize]) {
            self.keep(beyond)
        } else {
            *self.at.entry(bits(at)).or_insert_with(|| {
                self.made.push(at);
                self.made.len() as u32 - 1
            })
        };
        self.cut.insert(key, vertex);
        vertex
    }

    /// Adds a triangle, unless rounding made two of its corners one.
    fn add(&mut self, [a, b, c]: [u32; 3]) {
        if a != b && b != c && c != a {
            self.triangles.push([a, b, c]);
        }
    }

    /// Adds an edge of the cap, which cancels an opposite one.
    fn add_rim(&mut self, from: u32, to: u32) {
        match self.rim.get_mut(&(to, from)) {
            _ if from == to => {}
            Some(count) if *count > 1 => *count -= 1,
            Some(_) => {
                self.rim.remove(&(to, from));
            }
            None => *self.rim.entry((from, to)).or_default() += 1,
        }
    }

    /// Adds the cap.
    fn close(&mut self) -> Result<(), HalfError> {
        let contours = contours(&self.rim)?;
        let [u, v] = axes(self.space.normal);
        let flat = |&vertex: &u32| {
            let p = self.made[vertex as usize].map(f64::from);
            [dot(p, u), dot(p, v)]
        };
        let flat: Vec<Vec<[f64; 2]>> = contours.iter().map(|contour| contour.iter().map(flat).collect()).collect();
        let vertices: Vec<u32> = contours.into_iter().flatten().collect();
        let cap = left_of(&flat)?;
        self.triangles.extend(cap.into_iter().map(|t| t.map(|i| vertices[i as usize])));
        Ok(())
    }
}

/// Closed lines of directed edges.
fn contours(rim: &BTreeMap<(u32, u32), usize>) -> Result<Vec<Vec<u32>>, HalfError> {
    let mut next: BTreeMap<u32, u32> = BTreeMap::new();
    for (&(from, to), &count) in rim {
        if count > 1 || next.insert(from, to).is_some() {
            return Err(HalfError::Open);
        }
    }
    let mut contours = Vec::new();
    while let Some((start, mut to)) = next.pop_first() {
        let mut contour = vec![start];
        while to != start {
            contour.push(to);
            to = next.remove(&to).ok_or(HalfError::Open)?;
        }
        contours.push(contour);
    }
    Ok(contours)
}

/// Axis and sign of a normal along an axis.
fn axis(normal: [f64; 3]) -> Option<(usize, f64)> {
    (0..3).find(|&axis| normal[axis].abs() == 1.0).map(|axis| (axis, normal[axis]))
}

/// Directions of the coordinates in the plane. Seen from the side to which the cap faces, against
/// the normal, the second is 90° counter-clockwise from the first.
fn axes(normal: [f64; 3]) -> [[f64; 3]; 2] {
    let mut unit = [[0.0; 3]; 3];
    (0..3).for_each(|axis| unit[axis][axis] = 1.0);
    if let Some((axis, sign)) = axis(normal) {
        let [u, v] = [unit[(axis + 1) % 3], unit[(axis + 2) % 3]];
        return if sign > 0.0 { [v, u] } else { [u, v] };
    }
    let least = (0..3).min_by(|&a, &b| normal[a].abs().total_cmp(&normal[b].abs())).unwrap_or(0);
    let v = cross(normal, unit[least]);
    let length = dot(v, v).sqrt();
    let v = v.map(|x| x / length);
    [cross(normal, v), v]
}

#[cfg(test)]
mod tests;
