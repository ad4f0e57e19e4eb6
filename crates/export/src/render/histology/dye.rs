//! Amounts of haematoxylin and eosin, and the resulting colours of transmitted light (Beer–Lambert
//! law).

/// Amounts of the two dyes in a pixel. An amount of 1 is a dark nucleus (haematoxylin) or a red
/// blood cell (eosin).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Dyes {
    /// Haematoxylin, blue: nuclei.
    pub(super) blue: f32,
    /// Eosin, pink: muscle, collagen, cytoplasm.
    pub(super) pink: f32,
}

impl Dyes {
    pub(super) const fn of(blue: f32, pink: f32) -> Self {
        Self { blue, pink }
    }

    /// Mixture in which `other` has the given share.
    pub(super) fn mixed(self, other: Self, share: f32) -> Self {
        let mix = |a: f32, b: f32| a + (b - a) * share;
        Self { blue: mix(self.blue, other.blue), pink: mix(self.pink, other.pink) }
    }

    pub(super) fn scaled(self, by: f32) -> Self {
        Self { blue: self.blue * by, pink: self.pink * by }
    }
}

/// Optical density of haematoxylin in red, green and blue; chosen by eye from the hues of H&E
/// slides.
const BLUE: [f32; 3] = [1.02, 1.16, 0.62];
/// Optical density of eosin in red, green and blue; chosen by eye from the hues of H&E slides.
const PINK: [f32; 3] = [0.16, 0.86, 0.52];
/// Colour of the slide without tissue.
const GLASS: [f32; 3] = [247.0, 245.0, 247.0];
/// Steps of the table per amount of 1.
const STEPS: f32 = 128.0;
/// Maximum amount in the table, steps.
const MAX_STEP: usize = 255;

/// Table of colours by the amounts of both dyes.
pub(super) struct Colors(Vec<[u8; 3]>);

impl Colors {
    pub(super) fn new() -> Self {
        let color = |i: usize| {
            let (blue, pink) = ((i / (MAX_STEP + 1)) as f32 / STEPS, (i % (MAX_STEP + 1)) as f32 / STEPS);
            [0, 1, 2].map(|c| (GLASS[c] * libm::expf(-(BLUE[c] * blue + PINK[c] * pink))).round() as u8)
        };
        Self((0..(MAX_STEP + 1) * (MAX_STEP + 1)).map(color).collect())
    }

    pub(super) fn of(&self, dyes: Dyes) -> [u8; 3] {
        let step = |amount: f32| ((amount * STEPS + 0.5) as usize).min(MAX_STEP);
        self.0[step(dyes.blue) * (MAX_STEP + 1) + step(dyes.pink)]
    }
}
