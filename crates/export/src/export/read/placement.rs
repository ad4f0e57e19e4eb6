//! The placement of a mesh by a glTF node: affine transforms in f64.

use ::gltf::scene::Transform;

type Matrix = [[f64; 4]; 4];

/// A transform of positions; none if nothing moves, so that coordinates stay exactly as they are.
#[derive(Clone, Copy)]
pub(super) struct Placement(Option<Matrix>);

impl Placement {
    pub(super) const AS_IS: Self = Self(None);

    /// The placement of a child by its own transform.
    pub(super) fn of_child(self, transform: Transform) -> Self {
        let own = transform.matrix().map(|column| column.map(f64::from));
        let identity: Matrix = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 1.0 } else { 0.0 }));
        match self.0 {
            _ if own == identity => self,
            None => Self(Some(own)),
            // Columns first, as in the format.
            Some(m) => {
                Self(Some(own.map(|column| std::array::from_fn(|row| (0..4).map(|k| m[k][row] * column[k]).sum()))))
            }
        }
    }

    pub(super) fn apply(self, p: [f64; 3]) -> [f64; 3] {
        let Some(m) = self.0 else { return p };
        std::array::from_fn(|row| m[0][row] * p[0] + m[1][row] * p[1] + m[2][row] * p[2] + m[3][row])
    }

    /// Whether it reverses orientation.
    pub(super) fn mirrors(self) -> bool {
        self.0.is_some_and(|m| determinant(&m) < 0.0)
    }
}

fn determinant(m: &Matrix) -> f64 {
    m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[1][0] * (m[0][1] * m[2][2] - m[0][2] * m[2][1])
        + m[2][0] * (m[0][1] * m[1][2] - m[0][2] * m[1][1])
}
