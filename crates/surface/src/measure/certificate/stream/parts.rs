//! The components of the surface so far. One without a vertex in the window is complete, and only counted.

use super::super::components::{Body, Totals, components};
use super::super::topology::Found;

const NONE: u32 = u32::MAX;

/// See the module.
#[derive(Default)]
pub(super) struct Parts {
    /// For each vertex in the window its part.
    label: Vec<u32>,
    /// What is known of each part, and its volume. A vertex without triangles is a part by itself.
    parts: Vec<(Body, f64)>,
    complete: Totals,
    /// Of the last call of [`Parts::join`], whose memory the next one uses.
    least: Vec<u32>,
}

impl Parts {
    pub(super) fn labels(&self) -> &[u32] {
        &self.label
    }

    pub(super) fn part_of(&self, vertex: u32) -> usize {
        self.label[vertex as usize] as usize
    }

    /// Adds vertices, up to `vertices` in the window, and triangles, which may join parts.
    pub(super) fn join(&mut self, vertices: usize, triangles: &[[u32; 3]]) {
        let mut first = vec![NONE; self.parts.len()];
        let known = (0u32..).zip(&self.label).map(|(vertex, &part)| {
            let first = &mut first[part as usize];
            *first = vertex.min(*first);
            *first
        });
        let mut parent = std::mem::take(&mut self.least);
        parent.clear();
        parent.extend(known);
        parent.extend(parent.len() as u32..vertices as u32);
        let least = components(parent, triangles);
        let before = std::mem::take(&mut self.parts);
        self.label.clear();
        for (vertex, &least) in (0u32..).zip(&least) {
            if least == vertex {
                self.label.push(self.parts.len() as u32);
                self.parts.push((Body { vertex: NONE, ..Body::default() }, 0.0));
            } else {
                self.label.push(self.label[least as usize]);
            }
        }
        for ((body, volume), first) in before.into_iter().zip(first) {
            match self.label.get(first as usize) {
                Some(&part) => {
                    let (sum, sum_volume) = &mut self.parts[part as usize];
                    sum.add(&body);
                    *sum_volume += volume;
                }
                None => self.complete(body, volume),
            }
        }
        self.least = least;
        for t in triangles {
            let part = self.part_of(t[0]);
            self.parts[part].0.triangles += 1;
        }
    }

    /// Adds the volumes of new triangles, by part.
    pub(super) fn add_volumes(&mut self, volumes: &mut Vec<f64>) {
        for ((_, sum), volume) in self.parts.iter_mut().zip(volumes.drain(..)) {
            *sum += volume;
        }
    }

    pub(super) fn add_edges(&mut self, found: &[Found]) {
        for (part, edges) in found.iter().flat_map(|f| &f.edges) {
            self.parts[*part as usize].0.edges += edges;
        }
    }

    /// Adds a vertex that has triangles, and its number in the stream.
    pub(super) fn add_vertex(&mut self, vertex: u32, number: u32) {
        let part = self.part_of(vertex);
        let body = &mut self.parts[part].0;
        body.vertices += 1;
        body.vertex = body.vertex.min(number);
    }

    /// Forgets the first vertices of the window.
    pub(super) fn forget(&mut self, count: usize) {
        self.label.drain(..count);
    }

    /// All components, none of which has more vertices to come.
    pub(super) fn finish(mut self) -> Totals {
        for (body, volume) in std::mem::take(&mut self.parts) {
            self.complete(body, volume);
        }
        self.complete
    }

    fn complete(&mut self, body: Body, volume: f64) {
        if body.triangles > 0 {
            self.complete.add(body, volume);
        }
    }
}
