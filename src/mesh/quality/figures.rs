//! Figures of the shape of triangles.

use crate::model::Mesh;

/// Histograms of the triangles of a surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figures {
    /// Triangles by their least angle: 0 to 5 degrees, 5 to 10, up to 55 to 60.
    pub least_angles: [u64; 12],
    /// Triangles by longest over shortest edge: 1 to 1.5, 1.5 to 2, up to 5.5 to 6, then 6 and above.
    pub edge_ratios: [u64; 11],
    /// Share of all angles that are at least 20 degrees.
    pub share_of_20: f64,
    /// The least angle, degrees.
    pub least_angle: f64,
    /// The greatest ratio of edges.
    pub greatest_ratio: f64,
    /// Share of triangles with a ratio of at most 4.
    pub share_of_4: f64,
}

/// The figures of some triangles of a mesh.
#[must_use]
pub fn figures(mesh: &Mesh, triangles: &[[u32; 3]]) -> Figures {
    let mut figures = Figures { least_angle: f64::INFINITY, ..Figures::default() };
    let (mut wide, mut compact) = (0u64, 0u64);
    for t in triangles {
        let points = t.map(|v| mesh.positions[v as usize].map(f64::from));
        let sides = [0, 1, 2].map(|k| {
            let (a, b) = (points[k], points[(k + 1) % 3]);
            let square: f64 = (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum();
            square.sqrt()
        });
        let angles = [0, 1, 2].map(|k| {
            let (a, b, c) = (sides[k], sides[(k + 1) % 3], sides[(k + 2) % 3]);
            ((b * b + c * c - a * a) / (2.0 * b * c)).clamp(-1.0, 1.0).acos().to_degrees()
        });
        wide += angles.iter().filter(|angle| **angle >= 20.0).count() as u64;
        let least = angles.into_iter().fold(f64::INFINITY, f64::min);
        let shortest = sides.into_iter().fold(f64::INFINITY, f64::min);
        let ratio = sides.into_iter().fold(0.0, f64::max) / shortest;
        compact += u64::from(ratio <= 4.0);
        figures.least_angles[((least / 5.0) as usize).min(11)] += 1;
        figures.edge_ratios[((2.0 * (ratio - 1.0)) as usize).min(10)] += 1;
        figures.least_angle = figures.least_angle.min(least);
        figures.greatest_ratio = figures.greatest_ratio.max(ratio);
    }
    figures.share_of_20 = wide as f64 / (3 * triangles.len()) as f64;
    figures.share_of_4 = compact as f64 / triangles.len() as f64;
    figures
}
