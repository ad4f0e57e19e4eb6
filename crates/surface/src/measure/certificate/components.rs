//! Connected components of a surface.

use super::types::Component;

/// Counts of a component.
#[derive(Clone, Copy, Default)]
pub(super) struct ComponentCounts {
    pub(super) vertices: u64,
    pub(super) edges: u64,
    pub(super) triangles: u64,
    /// Smallest vertex of the component.
    pub(super) vertex: u32,
}

impl ComponentCounts {
    pub(super) fn euler(&self) -> i64 {
        self.vertices as i64 - self.edges as i64 + self.triangles as i64
    }

    pub(super) fn report(&self, volume_mm3: f64) -> Component {
        Component { vertices: self.vertices, triangles: self.triangles, euler: self.euler(), volume_mm3 }
    }
}

/// Returns for each of `vertices` vertices the smallest vertex of its component.
pub(super) fn components(vertices: u32, triangles: &[[u32; 3]]) -> Vec<u32> {
    // For each vertex, a vertex of its component that is not larger.
    let mut parent: Vec<u32> = (0..vertices).collect();
    for t in triangles {
        // Usually all three are already known to be in one component.
        let [a, b, c] = t.map(|v| parent[v as usize]);
        if a == b && b == c {
            continue;
        }
        let mut least = root(&mut parent, t[0]);
        for &v in &t[1..] {
            let other = root(&mut parent, v);
            if other != least {
                let (low, high) = (least.min(other), least.max(other));
                parent[high as usize] = low;
                least = low;
            }
        }
    }
    for v in 0..parent.len() as u32 {
        // The parent is smaller than the vertex, so it already has its final value.
        parent[v as usize] = parent[parent[v as usize] as usize];
    }
    parent
}

/// Numbers the components in the order of their smallest vertices and counts their vertices.
/// Returns the number of each vertex and the components.
pub(super) fn number(least: &[u32], has_triangles: impl Fn(u32) -> bool) -> (Vec<u32>, Vec<ComponentCounts>) {
    let (mut label, mut bodies) = (vec![0u32; least.len()], Vec::<ComponentCounts>::new());
    for (v, &first) in (0u32..).zip(least) {
        if !has_triangles(v) {
            continue;
        }
        if first == v {
            label[v as usize] = bodies.len() as u32;
            bodies.push(ComponentCounts { vertex: v, ..ComponentCounts::default() });
        } else {
            label[v as usize] = label[first as usize];
        }
        bodies[label[v as usize] as usize].vertices += 1;
    }
    (label, bodies)
}

/// Smallest vertex known to be in the component of `v`.
pub(super) fn root(parent: &mut [u32], mut v: u32) -> u32 {
    while parent[v as usize] != v {
        let above = parent[parent[v as usize] as usize];
        parent[v as usize] = above;
        v = above;
    }
    v
}
