//! Dyes of each tissue: the appearance of cells and fibres at the scale of a section. All of this
//! is texture; the tissue map determines the layers.

use super::cells::{EpithelialNuclei, Scatter};
use super::dye::Dyes;
use super::noise::{Noise, ramp};
use crate::tissue::{Grid, Place, Tissue, TissueMap};

/// Dyes of a nucleus.
const NUCLEUS: Dyes = Dyes::of(1.02, 0.32);
/// Dyes of the glass without tissue.
const GLASS: Dyes = Dyes::of(0.0, 0.0);
/// Dyes of the lumen.
const LUMEN: Dyes = Dyes::of(0.06, 0.2);
/// Sizes of a pixel, µm: up to the first one, a cut face shows cells and fibres; from the second
/// one on, it shows only the mean dyes of each tissue.
const DETAIL_UM: [f32; 2] = [3.5, 9.0];
/// Height of the cilia within the epithelium, µm; chosen by eye.
const CILIA_UM: f32 = 4.0;

/// Nuclei of connective tissue.
const CONNECTIVE: Scatter =
    Scatter { kind: 1, cell: [9.0, 9.0], share: 0.3, half: [3.0, 1.3], turned: true, period: 0 };
/// Small vessels.
const VESSEL: Scatter = Scatter { kind: 2, cell: [62.0, 62.0], share: 0.3, half: [9.0, 5.5], turned: true, period: 0 };
/// Nuclei of muscle that is cut along its fibres.
const ALONG: Scatter = Scatter { kind: 3, cell: [22.0, 6.5], share: 0.42, half: [7.5, 1.15], turned: false, period: 0 };
/// Nuclei of muscle that is cut across its fibres.
const ACROSS: Scatter = Scatter { kind: 4, cell: [7.5, 7.5], share: 0.36, half: [1.6, 1.5], turned: true, period: 0 };
/// Nuclei of the flat cells of the serosa.
const FLAT: Scatter = Scatter { kind: 5, cell: [16.0, 7.0], share: 0.4, half: [5.0, 0.9], turned: false, period: 0 };

/// Red cells in a vessel.
const RED: Scatter = Scatter { kind: 6, cell: [6.2, 6.2], share: 0.85, half: [2.9, 2.5], turned: true, period: 0 };
/// Nuclei of the wall of a vessel.
const LINING: Scatter = Scatter { kind: 7, cell: [9.0, 9.0], share: 0.4, half: [2.6, 1.0], turned: true, period: 0 };
/// Thickness of the wall of a vessel, µm; chosen by eye.
const VESSEL_WALL_UM: f32 = 4.5;

/// The texture of a section.
pub(super) struct Texture {
    seed: u64,
    index: u32,
    noise: Noise,
    row: EpithelialNuclei,
    height_um: f32,
    /// Length of the outer contour, µm.
    round_um: f32,
    /// Middle of the picture, µm.
    middle: [f32; 2],
    um_per_pixel: f32,
    /// Share of cells and fibres, from 0 to 1; the rest are the mean dyes of each tissue.
    detail: f32,
    /// True for a section along the tube, whose first coordinate is the place along the tube.
    is_along: bool,
}

/// Number of cells along the tube after which a texture repeats.
const ALONG_PERIOD: i32 = 256;

/// Mean dyes of a tissue, measured with pixels of 1.6 µm.
fn mean_dyes(tissue: Tissue) -> Dyes {
    match tissue {
        Tissue::Outside => GLASS,
        Tissue::Lumen => LUMEN,
        Tissue::Epithelium => Dyes::of(0.38, 0.36),
        Tissue::LaminaPropria => Dyes::of(0.13, 0.35),
        Tissue::CircularMuscle => Dyes::of(0.16, 0.48),
        Tissue::LongitudinalMuscle | Tissue::InnerLongitudinalMuscle => Dyes::of(0.13, 0.44),
        Tissue::Serosa => Dyes::of(0.12, 0.30),
        Tissue::Subserosa => Dyes::of(0.09, 0.235),
        Tissue::Vessel => Dyes::of(0.09, 0.49),
    }
}

impl Texture {
    /// Texture of a slide.
    pub(super) fn new(seed: u64, index: u32, map: &TissueMap, grid: &Grid) -> Self {
        let middle = [grid.x(grid.width / 2) as f32, grid.y(grid.height / 2) as f32];
        Self::with_detail(seed, index, map, grid, middle, 1.0)
    }

    /// Texture of a cut face, whose cells fade where they are smaller than a pixel. The grid may
    /// cover a part of the section; `middle` is that of the whole section, µm. `is_along` is true
    /// if the face lies along the tube and x is the place along it.
    pub(super) fn of_face(
        seed: u64,
        index: u32,
        map: &TissueMap,
        grid: &Grid,
        middle: [f32; 2],
        is_along: bool,
    ) -> Self {
        let detail = 1.0 - ramp(DETAIL_UM[0], DETAIL_UM[1], grid.um_per_pixel as f32);
        Self { is_along, ..Self::with_detail(seed, index, map, grid, middle, detail) }
    }

    fn with_detail(seed: u64, index: u32, map: &TissueMap, grid: &Grid, middle: [f32; 2], detail: f32) -> Self {
        let height_um = map.layers().epithelium_um as f32;
        // The mucosa of a cut along the tube may be metres long.
        let row = if detail > 0.0 {
            EpithelialNuclei::new(seed, index, map.lumen(), height_um)
        } else {
            EpithelialNuclei::none()
        };
        Self {
            seed,
            index,
            noise: Noise::new(seed, index),
            row,
            height_um,
            round_um: (map.outside().length() as f32).max(1.0),
            middle,
            um_per_pixel: grid.um_per_pixel as f32,
            detail,
            is_along: false,
        }
    }

    /// Dyes of a pixel with its middle at `p`, µm, in a slide with light glass around the tissue.
    pub(super) fn dyes(&self, place: &Place, p: [f32; 2]) -> Dyes {
        if place.tissue == Tissue::Outside {
            return GLASS;
        }
        let tissue = self.tissue(place, p);
        // A pixel at the border mixes both sides. The tissue at its middle covers more than half of
        // it.
        let edge_um = if place.tissue == Tissue::Serosa { place.depth_um } else { place.lumen_um };
        let within = (edge_um / self.um_per_pixel).min(0.5);
        let share = if place.tissue == Tissue::Lumen { 0.5 - within } else { 0.5 + within };
        GLASS.mixed(tissue, share)
    }

    /// Dyes of the tissue in the middle of a pixel at `p`, µm.
    pub(super) fn tissue(&self, place: &Place, p: [f32; 2]) -> Dyes {
        let tissue = match self.detail {
            1.0 => self.detailed(place, p),
            0.0 => mean_dyes(place.tissue),
            detail => mean_dyes(place.tissue).mixed(self.detailed(place, p), detail),
        };
        // Variation of the thickness of the slice and of its uptake of dye.
        let cut = self.noise.at(p[0] / 420.0, p[1] / 420.0) + 0.4 * self.noise.at(p[0] / 90.0, p[1] / 90.0);
        tissue.scaled(0.86 + 0.2 * cut)
    }

    /// Dyes of a tissue with its cells and fibres.
    fn detailed(&self, place: &Place, p: [f32; 2]) -> Dyes {
        match place.tissue {
            Tissue::Outside => GLASS,
            Tissue::Lumen => LUMEN,
            Tissue::Epithelium => self.epithelium(place, p),
            Tissue::LaminaPropria => self.connective(place, p),
            Tissue::CircularMuscle if self.is_along => self.fibres_across(p),
            Tissue::CircularMuscle => self.fibres_along(place, p),
            Tissue::LongitudinalMuscle | Tissue::InnerLongitudinalMuscle if self.is_along => {
                self.fibres_along(place, p)
            }
            Tissue::LongitudinalMuscle | Tissue::InnerLongitudinalMuscle => self.fibres_across(p),
            Tissue::Serosa => self.serosa(place, p),
            Tissue::Subserosa => self.subserosa(p),
            Tissue::Vessel => self.vessel(place, p),
        }
    }

    /// Draws a scattered nucleus over the dyes `under`.
    fn nucleus(&self, scatter: &Scatter, p: [f32; 2], under: Dyes) -> Dyes {
        let (cover, dark) = scatter.at(self.seed, self.index, p, self.um_per_pixel);
        under.mixed(NUCLEUS.scaled(dark), cover)
    }

    fn epithelium(&self, place: &Place, p: [f32; 2]) -> Dyes {
        let (deep, along) = (place.lumen_um, place.along_um);
        let grain = self.noise.at(p[0] / 2.3, p[1] / 2.3) - 0.5;
        let cell = self.noise.at(along / 5.0, 3.5) - 0.5;
        let basal = ramp(0.75 * self.height_um, self.height_um, deep);
        let mut dyes = Dyes::of(0.24 + 0.12 * grain + 0.1 * cell + 0.06 * basal, 0.36 + 0.14 * grain + 0.12 * cell);
        // Groups of ciliated cells have a pale fringe above a darker line.
        let cilia = CILIA_UM.min(0.2 * self.height_um);
        let ciliated = ramp(0.38, 0.5, self.noise.at(along / 40.0, 7.5));
        let fringe = Dyes::of(0.12 + 0.1 * cell, 0.22 + 0.25 * self.noise.at(along / 1.3, 11.5));
        let top = 1.0 - ramp(0.75 * cilia, 1.1 * cilia, deep);
        dyes = dyes.mixed(fringe, top * ciliated);
        let line = ramp(0.8 * cilia, cilia, deep) * (1.0 - ramp(1.2 * cilia, 1.6 * cilia, deep));
        dyes = dyes.mixed(Dyes::of(0.42, 0.52), 0.6 * line * ciliated);
        // The basement membrane.
        dyes = dyes.mixed(Dyes::of(0.16, 0.55), 0.6 * ramp(self.height_um - 1.8, self.height_um - 0.4, deep));
        let mut most = (0.0, 0.0);
        for nucleus in self.row.near(along) {
            let cover = nucleus.cover(p, self.um_per_pixel);
            if cover > most.0 {
                most = (cover, nucleus.dark);
            }
        }
        let chromatin = 0.86 + 0.3 * self.noise.at(p[0] / 1.4, p[1] / 1.4);
        dyes.mixed(NUCLEUS.scaled(most.1 * chromatin), most.0)
    }

    fn connective(&self, place: &Place, p: [f32; 2]) -> Dyes {
        let noise = &self.noise;
        // Wavy fibres of varying density.
        let (wx, wy) = (noise.at(p[0] / 31.0, p[1] / 31.0), noise.at(p[1] / 31.0 + 50.0, p[0] / 31.0));
        let (x, y) = (p[0] + 46.0 * wx, p[1] + 46.0 * wy);
        let fibres =
            0.45 * noise.at(x / 7.5, y / 2.6) + 0.35 * noise.at(x / 2.9, y / 1.5) + 0.2 * noise.at(y / 5.0, x / 2.2);
        let dense = noise.at(p[0] / 55.0 + 20.0, p[1] / 55.0);
        let mut dyes = Dyes::of(0.05 + 0.08 * fibres, 0.1 + 0.42 * fibres + 0.1 * dense);
        let cleft = 1.0 - ramp(0.27 - 0.1 * dense, 0.4 - 0.1 * dense, fibres);
        dyes = dyes.mixed(Dyes::of(0.02, 0.05), 0.8 * cleft);
        // Denser directly below the epithelium.
        let near = 1.0 - ramp(self.height_um, self.height_um + 7.0, place.lumen_um);
        dyes = dyes.mixed(Dyes::of(0.12, 0.46), 0.6 * near);
        let (vessel, _) = VESSEL.at(self.seed, self.index, p, self.um_per_pixel);
        let blood = Dyes::of(0.08, 0.9).scaled(0.75 + 0.5 * noise.at(p[0] / 3.0, p[1] / 3.0));
        dyes = dyes.mixed(blood, vessel);
        dyes = dyes.mixed(Dyes::of(0.45, 0.5), 1.6 * vessel.min(1.0 - vessel));
        if vessel > 0.5 { dyes } else { self.nucleus(&CONNECTIVE, p, dyes) }
    }

    /// Position of a point around the tube, in cells of about `cell_um`, and the number of cells,
    /// which is whole, so that the texture closes. In a section along the tube, the position along
    /// it.
    fn turn(&self, p: [f32; 2], cell_um: f32) -> (f32, i32) {
        if self.is_along {
            return (p[0] / cell_um, ALONG_PERIOD);
        }
        let cells = (self.round_um / cell_um).round().max(1.0);
        let angle = libm::atan2f(p[1] - self.middle[1], p[0] - self.middle[0]);
        ((angle / std::f32::consts::TAU + 0.5) * cells, cells as i32)
    }

    /// As [`nucleus`](Self::nucleus), for nuclei along the tube's circumference at the depth
    /// `deep`, µm.
    fn nucleus_around(&self, scatter: Scatter, p: [f32; 2], deep: f32, under: Dyes) -> Dyes {
        let (u, period) = self.turn(p, scatter.cell[0]);
        self.nucleus(&Scatter { period, ..scatter }, [u * scatter.cell[0], deep], under)
    }

    /// Muscle that is cut along its fibres.
    fn fibres_along(&self, place: &Place, p: [f32; 2]) -> Dyes {
        let noise = &self.noise;
        let wave =
            14.0 * (noise.at(p[0] / 110.0, p[1] / 110.0) - 0.5) + 4.0 * (noise.at(p[0] / 33.0, p[1] / 33.0) - 0.5);
        let deep = place.depth_um + wave;
        let streak = |long: f32, wide: f32, row: f32| {
            let (u, period) = self.turn(p, long);
            noise.around(u, deep / wide + row, period)
        };
        let fibres =
            0.4 * streak(48.0, 4.6, 0.0) + 0.35 * streak(19.0, 2.1, 91.0) + 0.25 * noise.at(p[0] / 2.0, p[1] / 2.0);
        let mut dyes = Dyes::of(0.11 + 0.1 * (fibres - 0.5), 0.56 + 0.42 * (fibres - 0.5));
        // Connective tissue and clefts between bundles.
        let septum = ramp(0.7, 0.84, streak(170.0, 19.0, 30.0));
        let cleft = ramp(0.78, 0.88, streak(85.0, 5.0, 140.0));
        dyes = dyes.mixed(Dyes::of(0.06, 0.22 + 0.2 * fibres), 0.8 * septum).mixed(Dyes::of(0.03, 0.1), 0.75 * cleft);
        self.nucleus_around(ALONG, p, deep, dyes)
    }

    /// Muscle that is cut across its fibres.
    fn fibres_across(&self, p: [f32; 2]) -> Dyes {
        let noise = &self.noise;
        let wave = |u: f32, v: f32| 16.0 * (noise.at(u / 24.0, v / 24.0) - 0.5);
        let (x, y) = (p[0] + wave(p[0], p[1]), p[1] + wave(p[1] + 2000.0, p[0]));
        // Fibres are cut across and lie in bundles, separated by connective tissue.
        let fibre = 0.6 * noise.at(p[0] / 2.4, p[1] / 2.4) + 0.4 * noise.at(p[0] / 6.0, p[1] / 6.0);
        let (border, bundle) = noise.bundle(x / 44.0, y / 44.0);
        let mut dyes = Dyes::of(0.09 + 0.05 * fibre, 0.3 + 0.3 * fibre + 0.12 * bundle);
        let between = 1.0 - ramp(0.04, 0.04 + 0.14 * (0.4 + bundle), border);
        dyes = dyes.mixed(Dyes::of(0.04, 0.1 + 0.2 * fibre), 0.85 * between);
        let nuclei = self.nucleus(&ACROSS, p, dyes);
        dyes.mixed(nuclei, 1.0 - 0.8 * between)
    }

    fn subserosa(&self, p: [f32; 2]) -> Dyes {
        let noise = &self.noise;
        // Loose, wavy strands with wide clefts between them.
        let (wx, wy) = (noise.at(p[0] / 38.0, p[1] / 38.0 + 9.0), noise.at(p[1] / 38.0 + 70.0, p[0] / 38.0));
        let (x, y) = (p[0] + 60.0 * wx, p[1] + 60.0 * wy);
        let strand = 0.5 * noise.at(x / 11.0, y / 5.0) + 0.3 * noise.at(y / 9.0 + 30.0, x / 4.0);
        let strand = strand + 0.2 * noise.at(x / 2.4, y / 2.4);
        let mut dyes = Dyes::of(0.03, 0.06).mixed(Dyes::of(0.09, 0.42), ramp(0.42, 0.66, strand));
        dyes = dyes.mixed(Dyes::of(0.1, 0.5), 0.5 * ramp(0.62, 0.75, noise.at(x / 16.0, y / 6.0 + 40.0)));
        let nuclei = self.nucleus(&CONNECTIVE, p, dyes);
        dyes.mixed(nuclei, 0.8)
    }

    fn vessel(&self, place: &Place, p: [f32; 2]) -> Dyes {
        let noise = &self.noise;
        let wall_um = VESSEL_WALL_UM * (0.7 + 0.6 * noise.at(p[0] / 25.0, p[1] / 25.0));
        // Red cells fill a part of the vessel; the rest is pale plasma.
        let full = ramp(0.36, 0.5, noise.at(p[0] / 34.0 + 80.0, p[1] / 34.0));
        let (cell, dark) = RED.at(self.seed, self.index, p, self.um_per_pixel);
        let plasma = Dyes::of(0.03, 0.16 + 0.08 * noise.at(p[0] / 6.0, p[1] / 6.0));
        let blood = plasma.mixed(Dyes::of(0.07, 0.92).scaled(dark), full * cell.max(0.35));
        let fibre = noise.at(p[0] / 3.0, p[1] / 3.0);
        let wall = self.nucleus(&LINING, p, Dyes::of(0.14, 0.46 + 0.2 * fibre));
        wall.mixed(blood, ramp(wall_um - 0.5, wall_um + 0.5, place.within_um))
    }

    fn serosa(&self, place: &Place, p: [f32; 2]) -> Dyes {
        let noise = &self.noise;
        let deep = place.depth_um + 6.0 * (noise.at(p[0] / 40.0, p[1] / 40.0) - 0.5);
        let (u, period) = self.turn(p, 24.0);
        let fibres = noise.around(u, deep / 3.4, period);
        let loose = ramp(0.3, 0.62, fibres);
        let mut dyes = Dyes::of(0.03, 0.07).mixed(Dyes::of(0.09, 0.44), loose);
        // Flat cells of the surface.
        dyes = dyes.mixed(Dyes::of(0.2, 0.5), 1.0 - ramp(1.2, 2.6, place.depth_um));
        self.nucleus_around(FLAT, p, place.depth_um, dyes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sample;
    use crate::tissue::Layers;

    #[test]
    fn mean_dyes_are_those_of_cells_and_fibres() {
        let [mucosa, outside] = sample::section(360, 0.0, 0.0).borders();
        let layers = Layers {
            epithelium_um: 30.0,
            lamina_um: 60.0,
            opening_um: 40.0,
            inner_longitudinal_um: 50.0,
            longitudinal_share: 0.35,
            subserosa_um: 60.0,
            serosa_um: 30.0,
            vessels: 12.0,
            seed: 7,
            ..Layers::NONE
        };
        let map = TissueMap::new(&mucosa, &outside, &layers);
        let grid = Grid::around(&outside.points().collect::<Vec<_>>(), 1400);
        let texture = Texture::new(7, 0, &map, &grid);
        let mut sums = [[0.0_f64; 3]; 10];
        for (i, place) in map.band(&grid, 0..grid.height).iter().enumerate() {
            let [x, y] = [i % grid.width as usize, i / grid.width as usize].map(|k| k as u32);
            let dyes = texture.detailed(place, [grid.x(x) as f32, grid.y(y) as f32]);
            let sum = &mut sums[place.tissue as usize];
            *sum = [sum[0] + f64::from(dyes.blue), sum[1] + f64::from(dyes.pink), sum[2] + 1.0];
        }
        let off = Tissue::ALL.into_iter().filter(|tissue| *tissue != Tissue::Outside).filter_map(|tissue| {
            let [blue, pink, count] = sums[tissue as usize];
            assert!(count > 500.0, "{tissue:?}");
            let stated = mean_dyes(tissue);
            let (blue, pink) = ((blue / count) as f32, (pink / count) as f32);
            let is_near = (blue - stated.blue).abs() < 0.025 && (pink - stated.pink).abs() < 0.035;
            (!is_near).then(|| format!("{tissue:?}: {blue:.3} {pink:.3}"))
        });
        let off: Vec<String> = off.collect();
        assert!(off.is_empty(), "{off:#?}");
    }
}
