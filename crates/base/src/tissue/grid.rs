//! A grid of square pixels over a section. y points up: row 0 has the largest y.

/// Margin around a section, as a fraction of its longer side.
const MARGIN: f64 = 0.05;

/// Position and size of the pixels over a section.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// Side of a pixel, µm.
    pub um_per_pixel: f64,
    /// x of the left edge of column 0, µm.
    pub left_um: f64,
    /// y of the upper edge of row 0, µm.
    pub top_um: f64,
}

impl Grid {
    /// Grid around points, with a margin and `size` pixels along its longer side. Points without
    /// extent get pixels of 1 µm.
    #[must_use]
    pub fn around(points: &[[f32; 2]], size: u32) -> Self {
        let [[left, right], [bottom, top]] = extent(points).unwrap_or_default();
        let (wide, high) = (right - left, top - bottom);
        let longer = wide.max(high);
        let um_per_pixel = if longer > 0.0 { longer * (1.0 + 2.0 * MARGIN) / f64::from(size) } else { 1.0 };
        let side = |extent: f64| {
            let pixels = (extent + 2.0 * MARGIN * longer) / um_per_pixel;
            (pixels.round() as u32).clamp(1, size)
        };
        let (width, height) = (side(wide), side(high));
        Self {
            width,
            height,
            um_per_pixel,
            left_um: (left + right) / 2.0 - 0.5 * f64::from(width) * um_per_pixel,
            top_um: (bottom + top) / 2.0 + 0.5 * f64::from(height) * um_per_pixel,
        }
    }

    /// x of the centre of a column, µm.
    #[must_use]
    #[inline]
    pub fn x(&self, column: u32) -> f64 {
        self.left_um + (f64::from(column) + 0.5) * self.um_per_pixel
    }

    /// y of the centre of a row, µm.
    #[must_use]
    #[inline]
    pub fn y(&self, row: u32) -> f64 {
        self.top_um - (f64::from(row) + 0.5) * self.um_per_pixel
    }

    /// Columns whose centres lie between `from` and `to`, µm.
    pub(super) fn columns(&self, from: f64, to: f64) -> std::ops::Range<usize> {
        span((from - self.left_um) / self.um_per_pixel, (to - self.left_um) / self.um_per_pixel, self.width)
    }

    /// Rows whose centres lie between `from` and `to`, µm.
    pub(super) fn rows(&self, from: f64, to: f64) -> std::ops::Range<usize> {
        span((self.top_um - to) / self.um_per_pixel, (self.top_um - from) / self.um_per_pixel, self.height)
    }
}

/// Pixels, of `count`, whose centres lie between `from` and `to`, in units of pixels.
fn span(from: f64, to: f64, count: u32) -> std::ops::Range<usize> {
    let most = f64::from(count);
    let first = (from - 0.5).ceil().clamp(0.0, most) as usize;
    first..((to - 0.5).floor() + 1.0).clamp(first as f64, most) as usize
}

/// Minimum and maximum of x and of y over the finite points. `None` if there are none.
fn extent(points: &[[f32; 2]]) -> Option<[[f64; 2]; 2]> {
    let mut range = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
    for point in points.iter().filter(|p| p.iter().all(|c| c.is_finite())) {
        for axis in 0..2 {
            let value = f64::from(point[axis]);
            range[axis] = [range[axis][0].min(value), range[axis][1].max(value)];
        }
    }
    (range[0][0] <= range[0][1]).then_some(range)
}
