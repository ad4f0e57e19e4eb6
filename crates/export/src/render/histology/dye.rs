//! Amounts of haematoxylin and eosin, and the colours that they give on a slide with light from below (Beer–Lambert).

/// Amounts of the two dyes in a pixel; 1 of haematoxylin is a dark nucleus, 1 of eosin a red blood cell.
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

    /// These, with a share of the others instead.
    pub(super) fn mixed(self, other: Self, share: f32) -> Self {
        let mix = |a: f32, b: f32| a + (b - a) * share;
        Self { blue: mix(self.blue, other.blue), pink: mix(self.pink, other.pink) }
    }

    pub(super) fn scaled(self, by: f32) -> Self {
        Self { blue: self.blue * by, pink: self.pink * by }
    }
}

/// Optical density of each dye in red, green and blue; chosen by eye, with the hues of H&E slides.
const BLUE: [f32; 3] = [1.02, 1.16, 0.62];
const PINK: [f32; 3] = [0.16, 0.86, 0.52];
/// The slide without tissue.
const GLASS: [f32; 3] = [247.0, 245.0, 247.0];
/// Steps of the table for an amount of 1, and the greatest amount.
const STEPS: f32 = 128.0;
const MOST: usize = 255;

/// Colours by amounts.
pub(super) struct Colors(Vec<[u8; 3]>);

impl Colors {
    pub(super) fn new() -> Self {
        let color = |i: usize| {
            let (blue, pink) = ((i / (MOST + 1)) as f32 / STEPS, (i % (MOST + 1)) as f32 / STEPS);
            [0, 1, 2].map(|c| (GLASS[c] * libm::expf(-(BLUE[c] * blue + PINK[c] * pink))).round() as u8)
        };
        Self((0..(MOST + 1) * (MOST + 1)).map(color).collect())
    }

    pub(super) fn of(&self, dyes: Dyes) -> [u8; 3] {
        let step = |amount: f32| ((amount * STEPS + 0.5) as usize).min(MOST);
        self.0[step(dyes.blue) * (MOST + 1) + step(dyes.pink)]
    }
}
