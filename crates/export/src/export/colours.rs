//! Colours of patches in files that have colours.

use crate::model::PatchKind;

/// Colour of a patch, linear red, green and blue from 0 to 1.
pub(super) fn of_patch(name: &str) -> [f32; 3] {
    match PatchKind::named(name) {
        Some(PatchKind::InnerWall | PatchKind::Wall) => [0.694, 0.254, 0.352],
        Some(PatchKind::OuterWall) => [0.839, 0.578, 0.491],
        Some(PatchKind::CapIsthmus | PatchKind::CapAmpulla) => [0.730, 0.301, 0.397],
        Some(PatchKind::Inlet | PatchKind::Outlet) => [0.888, 0.791, 0.687],
        None => [0.8, 0.8, 0.8],
    }
}

/// Converts a linear value from 0 to 1 to the sRGB value from 0 to 255.
pub(super) fn srgb(linear: f32) -> u8 {
    let encoded = if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * libm::powf(linear, 1.0 / 2.4) - 0.055 };
    (encoded * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_values_are_encoded() {
        assert_eq!([0.0, 0.001, 0.214_041, 1.0].map(srgb), [0, 3, 127, 255]);
        assert_eq!(of_patch("inner_wall").map(srgb), [217, 138, 160]);
    }
}
