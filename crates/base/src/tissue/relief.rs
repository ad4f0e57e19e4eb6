//! Procedural texture of the walls, for pictures: relief and tint of mucosa and serosa as functions
//! of the place in the tube. Like the cells of stained sections, it carries no information.
//!
//! A texture is a sum of structures of different sizes. A structure that is not much larger than a
//! pixel fades, so that pictures contain no noise. Its mean tint is 1 and its mean height constant,
//! so a picture from far away has the colours of the plain surface.

use super::lattice::{SIDE, cell, noise};
use glam::{IVec3, Vec3};

/// Size of a structure in pixels at which it has faded, and at which it has its full strength.
const FADE_PIXELS: [f32; 2] = [2.0, 5.0];

/// Surfaces with a texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WallTexture {
    /// Boundary of the lumen: domed cells, some with tufts of cilia, and capillaries below them.
    Mucosa,
    /// Outside of the tube: fibres along the tube, and vessels.
    Serosa,
}

/// Scale at which a texture is sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Extent of a pixel in each direction, µm.
    pub pixel_um: Vec3,
    /// Length after which the texture repeats in x and in z, µm. Structures of more than a third of
    /// it are omitted. `None` for a texture that repeats only after many structures.
    pub repeat_um: Option<f32>,
    /// True if z runs along the tube, so that structures are longer in that direction.
    pub is_straight: bool,
}

/// Texture at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relief {
    /// Gradient of the height of the surface above its mean, µm per µm. The component along the
    /// normal of the surface has no meaning.
    pub slope: Vec3,
    /// Factor on linear red, green and blue.
    pub tint: Vec3,
}

/// A structure at a point.
struct Structure {
    /// Point in units of the lattice.
    at: Vec3,
    period: IVec3,
    /// Units of the lattice per µm.
    scale: Vec3,
    /// Strength, from 0 to 1.
    weight: f32,
}

impl Sampling {
    /// A structure of `size_um` across the tube that is `stretch` times as long along the tube.
    /// `None` if the structure has faded.
    fn structure(&self, p: Vec3, size_um: f32, stretch: f32) -> Option<Structure> {
        let size = match self.is_straight {
            true => Vec3::new(size_um, size_um, size_um * stretch),
            // The direction of the tube is unknown, so the structure is equally large in all.
            false => Vec3::splat(size_um * stretch.sqrt()),
        };
        let pixels = (size / self.pixel_um).min_element();
        let weight = ramp(FADE_PIXELS[0], FADE_PIXELS[1], pixels).0;
        if weight <= 0.0 {
            return None;
        }
        let (mut scale, mut period) = (size.recip(), IVec3::splat(SIDE));
        if let Some(repeat) = self.repeat_um {
            let count = (repeat / size).round();
            if count.x < 3.0 || count.z < 3.0 {
                return None;
            }
            (scale.x, scale.z) = (count.x / repeat, count.z / repeat);
            (period.x, period.z) = (count.x as i32, count.z as i32);
        }
        Some(Structure { at: p * scale, period, scale, weight })
    }

    /// Random displacement that bends fibres, from −½ to ½; zero in a tile, which must repeat.
    fn wave(&self, at: Vec3) -> Vec3 {
        if self.repeat_um.is_some() {
            return Vec3::ZERO;
        }
        let [x, y] = [17.3, 91.7].map(|start| noise(at + start, IVec3::splat(SIDE)).0 - 0.5);
        Vec3::new(x, y, 0.0)
    }
}

impl Structure {
    /// Value of a smooth field and its gradient per µm.
    fn noise(&self) -> (f32, Vec3) {
        let (value, gradient) = noise(self.at, self.period);
        (value, gradient * self.scale)
    }

    /// Value of another field, whose lattice is finer by a whole factor. It repeats as the
    /// structure does, because the start is along y, which does not repeat in a tile.
    fn other(&self, finer: i32, start: f32) -> f32 {
        let period = (self.period * finer).min(IVec3::splat(SIDE));
        noise(self.at * finer as f32 + Vec3::new(0.0, start, 0.0), period).0
    }

    /// Random displacement that bends lines, from −½ to ½.
    fn warp(&self) -> Vec3 {
        let [x, y] = [17.3, 91.7].map(|start| self.other(2, start) - 0.5);
        Vec3::new(x, y, x)
    }

    /// Strength of lines, from 0 to 1.
    fn places(&self) -> f32 {
        ramp(0.40, 0.58, self.other(1, 41.1)).0
    }
}

impl Relief {
    const PLAIN: Self = Self { slope: Vec3::ZERO, tint: Vec3::ONE };

    /// Texture of a surface at the point `p`, µm.
    #[must_use]
    pub fn of(texture: WallTexture, p: Vec3, sampling: &Sampling) -> Self {
        let relief = match texture {
            WallTexture::Mucosa => Self::mucosa(p, sampling),
            WallTexture::Serosa => Self::serosa(p, sampling),
        };
        // Where lines cross, their changes add up.
        Self { tint: relief.tint.max(DARKEST), ..relief }
    }

    /// Adds a field of bumps with this height.
    fn bumps(&mut self, structure: Option<Structure>, height_um: f32) {
        if let Some(structure) = structure {
            self.slope += structure.noise().1 * (height_um * structure.weight);
        }
    }

    /// Adds slow differences in colour: by `change` from the lowest to the highest value.
    fn shades(&mut self, structure: Option<Structure>, change: Vec3) {
        if let Some(structure) = structure {
            self.tint += change * ((structure.noise().0 - 0.5) * structure.weight);
        }
    }

    /// Adds branching lines of even width where a field has its mean value. `at` is the point in
    /// units of the lattice. Lines that are thin relative to a pixel fade.
    fn lines(&mut self, structure: &Structure, at: Vec3, line: &Lines, sampling: &Sampling) {
        let shown = ramp(SHOWN_PIXELS[0], SHOWN_PIXELS[1], line.half_um / sampling.pixel_um.max_element()).0;
        let weight = structure.weight * shown;
        if weight <= 0.0 {
            return;
        }
        let (value, gradient) = noise(at, structure.period);
        // A field that is nearly level would have a pool instead of a line.
        let level = ramp(LEVEL[0], LEVEL[1], gradient.length()).0;
        let gradient = gradient * structure.scale;
        let steepness = gradient.length().max(1e-6);
        let distance_um = (value - 0.5) / steepness;
        let (inside, change) = ramp(line.half_um, 0.35 * line.half_um, distance_um.abs());
        let strength = weight * level * structure.places();
        self.tint += line.change * (strength * inside - weight * line.mean);
        let rise = change * distance_um.signum() * line.height_um * strength;
        self.slope += gradient * (rise / steepness);
    }

    fn mucosa(p: Vec3, sampling: &Sampling) -> Self {
        let mut relief = Self::PLAIN;
        relief.bumps(sampling.structure(p, 128.0, 2.0), 14.0);
        relief.bumps(sampling.structure(p, 43.0, 1.5), 7.0);
        relief.bumps(sampling.structure(p, 19.0, 1.0), 1.8);
        relief.shades(sampling.structure(p, 330.0, 2.0), Vec3::new(0.16, 0.42, 0.34));
        relief.shades(sampling.structure(p, 95.0, 1.0), Vec3::new(0.08, 0.30, 0.24));
        relief.shades(sampling.structure(p, 31.0, 1.3), Vec3::new(0.06, 0.22, 0.18));
        if let Some(structure) = sampling.structure(p, 88.0, 1.8) {
            relief.lines(&structure, structure.at, &CAPILLARIES, sampling);
        }
        let Some(cells) = sampling.structure(p, 9.2, 1.0) else { return relief };
        // Ciliated cells stand in groups of a few cells between secretory ones.
        let group = sampling.structure(p, 37.0, 1.0).map_or(0.5, |structure| structure.noise().0);
        let found = cell(cells.at, cells.period);
        let ciliated = ramp(0.44, 0.56, group + 0.16 * (found.own - 0.5)).0;
        // Secretory cells bulge into the lumen; ciliated cells are flatter.
        let height_um = 3.1 - 1.5 * ciliated;
        relief.slope -= found.offset * cells.scale * (2.0 * height_um * cells.weight);
        let groove = ramp(0.22, 0.0, found.border).0;
        let shade = 0.16 * (found.own - 0.5) - 0.34 * (groove - 0.345) + 0.16 * (ciliated - 0.5);
        relief.tint += Vec3::new(0.7, 1.15, 1.0) * (shade * cells.weight);
        if let Some(cilia) = sampling.structure(p, 2.1, 1.0) {
            let (value, slope) = cilia.noise();
            let strength = cilia.weight * ciliated;
            relief.slope += slope * (1.1 * strength);
            relief.tint += Vec3::new(0.3, 0.44, 0.4) * ((value - 0.5) * strength);
        }
        relief
    }

    fn serosa(p: Vec3, sampling: &Sampling) -> Self {
        let mut relief = Self::PLAIN;
        // Fibres are wavy.
        let fibre = p + sampling.wave(p / 260.0) * 50.0;
        relief.bumps(sampling.structure(p, 150.0, 3.0), 20.0);
        relief.bumps(sampling.structure(fibre, 44.0, 7.0), 8.0);
        relief.bumps(sampling.structure(fibre, 17.0, 9.0), 3.2);
        relief.bumps(sampling.structure(p, 13.0, 1.0), 1.3);
        relief.shades(sampling.structure(p, 520.0, 2.0), Vec3::new(0.06, 0.20, 0.18));
        relief.shades(sampling.structure(fibre, 46.0, 8.0), Vec3::new(0.12, 0.24, 0.24));
        relief.shades(sampling.structure(fibre, 15.0, 12.0), Vec3::new(0.07, 0.13, 0.13));
        for (size_um, stretch, line) in [(430.0, 4.0, &VESSELS), (170.0, 2.2, &SMALL_VESSELS)] {
            if let Some(structure) = sampling.structure(p, size_um, stretch) {
                // Vessels meander, and reach the surface only in places.
                relief.lines(&structure, structure.at + 0.5 * structure.warp(), line, sampling);
            }
        }
        relief
    }
}

/// Branching lines.
struct Lines {
    /// Half of the width, µm.
    half_um: f32,
    /// Height above the surface, µm.
    height_um: f32,
    /// Share of the surface that the lines cover, weighted by their strength.
    mean: f32,
    /// Change of the tint.
    change: Vec3,
}

/// Steepness up to which a field has no lines, and from which they have their full strength, units
/// of the field per unit of the lattice.
const LEVEL: [f32; 2] = [0.2, 0.5];
/// Half of the width of a line in pixels up to which it is invisible, and from which it has its
/// full strength.
const SHOWN_PIXELS: [f32; 2] = [0.25, 0.9];
/// Minimum tint.
const DARKEST: Vec3 = Vec3::new(0.45, 0.25, 0.28);
const CAPILLARIES: Lines = Lines { half_um: 5.0, height_um: 0.4, mean: 0.05, change: Vec3::new(-0.06, -0.22, -0.15) };
const VESSELS: Lines = Lines { half_um: 30.0, height_um: 16.0, mean: 0.033, change: Vec3::new(-0.32, -0.64, -0.50) };
const SMALL_VESSELS: Lines =
    Lines { half_um: 9.0, height_um: 4.0, mean: 0.033, change: Vec3::new(-0.14, -0.40, -0.32) };

/// Smooth step from 0 at `from` to 1 at `to`, and its derivative. `from` may be above `to`.
fn ramp(from: f32, to: f32, value: f32) -> (f32, f32) {
    let t = ((value - from) / (to - from)).clamp(0.0, 1.0);
    (t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t) / (to - from))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXTURES: [WallTexture; 2] = [WallTexture::Mucosa, WallTexture::Serosa];

    fn sampling(pixel_um: f32) -> Sampling {
        Sampling { pixel_um: Vec3::splat(pixel_um), repeat_um: None, is_straight: true }
    }

    /// Points spread over a cube of several millimetres.
    fn points() -> impl Iterator<Item = Vec3> {
        (0..40_000).map(|k| Vec3::new(0.754_877_7, 0.569_840_3, 0.430_159_7) * k as f32 % 1.0 * 6000.0 + 100.0)
    }

    #[test]
    fn the_mean_tint_of_every_scale_is_one() {
        for texture in TEXTURES {
            for pixel_um in [0.3, 3.0, 12.0, 60.0] {
                let sum: Vec3 = points().map(|p| Relief::of(texture, p, &sampling(pixel_um)).tint).sum();
                let mean = sum / points().count() as f32;
                assert!((mean - 1.0).abs().max_element() < 0.012, "{texture:?} at {pixel_um} µm: {mean}");
            }
        }
    }

    #[test]
    fn a_texture_fades_as_pixels_grow() {
        for texture in TEXTURES {
            let steepness = |pixel_um: f32| -> f32 {
                let slope = |p| Relief::of(texture, p, &sampling(pixel_um)).slope.length();
                points().take(2000).map(slope).sum::<f32>() / 2000.0
            };
            let found = [0.4, 4.0, 20.0].map(steepness);
            assert!(found[0] > 0.12 && found[0] > found[1] && found[1] > found[2], "{texture:?}: {found:?}");
            assert_eq!(steepness(1000.0), 0.0);
            assert!(points().all(|p| Relief::of(texture, p, &sampling(1000.0)) == Relief::PLAIN));
        }
    }

    #[test]
    fn a_tile_repeats_without_a_seam() {
        for texture in TEXTURES {
            let tile = Sampling { repeat_um: Some(256.0), ..sampling(1.0) };
            for p in points().take(500) {
                let [here, there] = [p, p + Vec3::new(256.0, 0.0, 512.0)].map(|p| Relief::of(texture, p, &tile));
                let off = (here.tint - there.tint).abs().max_element() + (here.slope - there.slope).length();
                assert!(off < 0.05, "{texture:?} at {p}: {here:?} and {there:?}");
            }
        }
    }

    #[test]
    fn the_slope_of_the_cells_points_to_their_middle() {
        // A dome is highest in its middle, so the gradient points there.
        let p = Vec3::new(411.0, 96.0, 703.0);
        let cells = sampling(0.2).structure(p, 9.2, 1.0).unwrap();
        let found = cell(cells.at, cells.period);
        let only = Sampling { pixel_um: Vec3::splat(1.8), ..sampling(1.8) };
        assert!(only.structure(p, 2.1, 1.0).is_none(), "cilia have faded");
        let toward = Relief::of(WallTexture::Mucosa, p, &sampling(1.2)).slope.dot(-found.offset);
        assert!(toward > 0.0);
    }
}
