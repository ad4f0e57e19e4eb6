//! Where a wall meets a plane.

/// Where one of the walls meets a plane.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Border {
    /// Its lines; u and v of their points in micrometres.
    pub lines: Vec<Line>,
    /// Edges in the ends of the tube: with the lines, they enclose an area.
    pub closing: Vec<[[f32; 2]; 2]>,
}

/// A line.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Its points.
    pub points: Vec<[f32; 2]>,
    /// Whether the last point is connected to the first.
    pub is_closed: bool,
}

impl Border {
    /// A border of closed lines only.
    #[must_use]
    pub fn closed(lines: Vec<Vec<[f32; 2]>>) -> Self {
        let line = |points| Line { points, is_closed: true };
        Self { lines: lines.into_iter().map(line).collect(), closing: Vec::new() }
    }

    /// All points.
    pub fn points(&self) -> impl Iterator<Item = [f32; 2]> + '_ {
        self.lines.iter().flat_map(|line| line.points.iter().copied()).chain(self.closing.iter().flatten().copied())
    }
}
