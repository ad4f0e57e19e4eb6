//! Layers of the wall: areas and thicknesses by the tissue of pixels.
//!
//! `tissue` defines the layers, so these measures agree with stained pictures and label volumes.

use super::shape::Shape;
use crate::model::Border;
use crate::tissue::{Grid, Layers, Tissue, TissueMap, bands};
use std::f64::consts::PI;

/// Pixels along the longer side of a section, margin included. Areas have thousands of pixels, so
/// radii are exact to about a tenth of a pixel.
const PIXELS: u32 = 192;
/// Directions in which the longitudinal muscle is looked for, as parts of the circumference.
const SECTORS: usize = 360;
/// Square micrometres in a square millimetre.
const MM2_UM2: f64 = 1e6;

/// Layers of a section. Thicknesses of layers of the wall are differences of equal-area radii: the
/// radii of circles with the area of a layer and of everything that it surrounds.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerMeasures {
    /// Thickness of the muscle: all its layers, and the vessels between them.
    pub muscle_um: f64,
    /// Thickness of the circular muscle.
    pub circular_um: f64,
    /// Thickness of the outer longitudinal muscle, averaged over the whole circumference.
    pub longitudinal_um: f64,
    /// Thickness of the inner longitudinal muscle.
    pub inner_longitudinal_um: f64,
    /// Thickness of the subserosa, with its vessels.
    pub subserosa_um: f64,
    /// Area of the lamina propria over the length of the mucosa.
    pub lamina_um: f64,
    /// Area of the epithelium over the length of the mucosa.
    pub epithelium_um: f64,
    /// Area of all layers of muscle, without vessels.
    pub muscle_mm2: f64,
    /// Area of epithelium and lamina propria.
    pub mucosa_mm2: f64,
    /// Area of the lamina propria over that of the epithelium.
    pub lamina_over_epithelium: Option<f64>,
    /// Share of the circumference whose outermost muscle is longitudinal; `None` without muscle.
    pub longitudinal_cover: Option<f64>,
    /// Number of separate vessels.
    pub vessels: u32,
    /// Area of the lumen over that of lumen, epithelium and lamina propria.
    pub free_lumen: f64,
    /// Median over the clefts: distance from the deepest point of the lumen to the muscle, without
    /// the epithelium. `None` without folds.
    pub cleft_lamina_um: Option<f64>,
}

impl LayerMeasures {
    /// Area of the muscle over that of the mucosa.
    pub(super) fn muscle_over_mucosa(&self) -> f64 {
        self.muscle_mm2 / self.mucosa_mm2
    }
}

/// Measures the layers of a section. `clefts` are the deepest points of the lumen between folds,
/// and `centre` is the centre of the tube.
pub(super) fn measured(shape: &Shape<'_>, layers: &Layers, clefts: &[[f64; 2]], centre: [f64; 2]) -> LayerMeasures {
    let mucosa = Border::closed(shape.lumen.iter().map(|ring| ring.to_vec()).collect());
    let outside = Border::closed(vec![shape.outer.to_vec()]);
    let map = TissueMap::coarse(&mucosa, &outside, layers);
    let counted = Counted::new(&map, &Grid::around(shape.outer, PIXELS));
    let area = |tissues: &[Tissue]| tissues.iter().map(|tissue| counted.areas_um2[*tissue as usize]).sum::<f64>();
    let (epithelium, lamina) = (area(&[Tissue::Epithelium]), area(&[Tissue::LaminaPropria]));
    let muscles = [Tissue::InnerLongitudinalMuscle, Tissue::CircularMuscle, Tissue::LongitudinalMuscle];
    let lumen = shape.lumen_area();
    // From the inside to the outside; vessels of the wall lie between circular and longitudinal
    // muscle.
    let rings = [
        lumen + epithelium + lamina,
        area(&muscles[..1]),
        area(&muscles[1..2]),
        counted.vessels_um2[0],
        area(&muscles[2..]),
        area(&[Tissue::Subserosa]) + counted.vessels_um2[1],
    ];
    let mut within = 0.0;
    let radii = rings.map(|area| {
        within += area;
        (within / PI).sqrt()
    });
    let perimeter = shape.perimeter();
    LayerMeasures {
        muscle_um: radii[4] - radii[0],
        circular_um: radii[2] - radii[1],
        longitudinal_um: radii[4] - radii[3],
        inner_longitudinal_um: radii[1] - radii[0],
        subserosa_um: radii[5] - radii[4],
        lamina_um: lamina / perimeter,
        epithelium_um: epithelium / perimeter,
        muscle_mm2: area(&muscles) / MM2_UM2,
        mucosa_mm2: (epithelium + lamina) / MM2_UM2,
        lamina_over_epithelium: (epithelium > 0.0).then(|| lamina / epithelium),
        longitudinal_cover: counted.longitudinal_cover,
        vessels: counted.vessels,
        free_lumen: lumen / (lumen + epithelium + lamina),
        cleft_lamina_um: cleft_lamina(&map, clefts, centre),
    }
}

/// Median thickness of the lamina between clefts and muscle; the lower one of two medians.
fn cleft_lamina(map: &TissueMap, clefts: &[[f64; 2]], centre: [f64; 2]) -> Option<f64> {
    let mut found: Vec<f64> = clefts
        .iter()
        .map(|&[x, y]| {
            let [dx, dy] = [x - centre[0], y - centre[1]];
            let length = dx.hypot(dy).max(f64::MIN_POSITIVE);
            map.muscle_beyond_um([x, y], [dx / length, dy / length]) - map.layers().epithelium_um
        })
        .collect();
    found.sort_unstable_by(f64::total_cmp);
    found.get(found.len().saturating_sub(1) / 2).map(|um| um.max(0.0))
}

/// Pixels of a section by tissue.
struct Counted {
    areas_um2: [f64; Tissue::ALL.len()],
    vessels: u32,
    /// Area of the vessels that touch mostly muscle, and of the others.
    vessels_um2: [f64; 2],
    longitudinal_cover: Option<f64>,
}

impl Counted {
    fn new(map: &TissueMap, grid: &Grid) -> Self {
        let mut labels = Vec::with_capacity(grid.width as usize * grid.height as usize);
        let mut counts = [0_u32; Tissue::ALL.len()];
        // Depth of the outermost muscle by direction, and whether it is longitudinal.
        let mut outermost = [(f32::INFINITY, false); SECTORS];
        let sector = SECTORS as f64 / map.outside().length().max(f64::MIN_POSITIVE);
        for rows in bands(grid) {
            for place in map.band(grid, rows) {
                counts[place.tissue as usize] += 1;
                labels.push(place.tissue);
                let is_longitudinal = place.tissue == Tissue::LongitudinalMuscle;
                if is_longitudinal || place.tissue == Tissue::CircularMuscle {
                    let k = (f64::from(place.around_um) * sector) as usize;
                    let found = &mut outermost[k.min(SECTORS - 1)];
                    if place.depth_um < found.0 {
                        *found = (place.depth_um, is_longitudinal);
                    }
                }
            }
        }
        let pixel_um2 = grid.um_per_pixel * grid.um_per_pixel;
        let (vessels, pixels) = vessels(&mut labels, grid.width as usize);
        let known = outermost.iter().filter(|(depth, _)| depth.is_finite()).count();
        let covered = outermost.iter().filter(|(_, is_longitudinal)| *is_longitudinal).count();
        Self {
            areas_um2: counts.map(|count| f64::from(count) * pixel_um2),
            vessels,
            vessels_um2: pixels.map(|count| f64::from(count) * pixel_um2),
            longitudinal_cover: (known > 0).then(|| covered as f64 / known as f64),
        }
    }
}

/// Number of connected vessels, and pixels of those that touch mostly muscle and of the others.
/// Pixels that share a corner are connected. Clears the vessels in `labels`.
fn vessels(labels: &mut [Tissue], width: usize) -> (u32, [u32; 2]) {
    let (mut count, mut pixels) = (0, [0; 2]);
    for start in 0..labels.len() {
        if labels[start] != Tissue::Vessel {
            continue;
        }
        count += 1;
        // Neighbours of the vessel that are muscle, and all others.
        let (mut own, mut beside) = (0, [0_u32; 2]);
        let mut open = vec![start];
        labels[start] = Tissue::Outside;
        while let Some(at) = open.pop() {
            own += 1;
            let (row, column) = (at / width, at % width);
            for row in row.saturating_sub(1)..(row + 2).min(labels.len() / width) {
                for column in column.saturating_sub(1)..(column + 2).min(width) {
                    let next = row * width + column;
                    match labels[next] {
                        Tissue::Vessel => {
                            labels[next] = Tissue::Outside;
                            open.push(next);
                        }
                        Tissue::CircularMuscle | Tissue::LongitudinalMuscle => beside[0] += 1,
                        Tissue::Subserosa | Tissue::Serosa => beside[1] += 1,
                        _ => {}
                    }
                }
            }
        }
        pixels[usize::from(beside[0] < beside[1])] += own;
    }
    (count, pixels)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circle(radius: f32, n: u32) -> Vec<[f32; 2]> {
        let turns = (0..n).map(|i| (std::f32::consts::TAU * i as f32 / n as f32).sin_cos());
        turns.map(|(sin, cos)| [radius * cos, radius * sin]).collect()
    }

    const WALL: Layers = Layers {
        epithelium_um: 30.0,
        lamina_um: 50.0,
        opening_um: 40.0,
        inner_longitudinal_um: 60.0,
        longitudinal_share: 0.25,
        serosa_um: 20.0,
        ..Layers::NONE
    };

    fn annulus(layers: &Layers) -> LayerMeasures {
        let (lumen, outer) = (circle(500.0, 720), circle(1200.0, 720));
        let clefts = [[500.0, 0.0], [0.0, -500.0], [300.0, 400.0]];
        measured(&Shape { outer: &outer, lumen: vec![&lumen] }, layers, &clefts, [0.0; 2])
    }

    #[track_caller]
    fn near(found: f64, expected: f64, tolerance: f64) {
        assert!((found - expected).abs() <= tolerance, "{found} instead of {expected}");
    }

    #[test]
    fn layers_of_an_annulus_have_their_thickness() {
        // The lumen ends at 500, the mucosa at 580, the muscle at 1180 µm.
        let found = annulus(&WALL);
        let ring = |from: f64, to: f64| PI * (to * to - from * from);
        near(found.muscle_um, 600.0, 1.5);
        near(found.inner_longitudinal_um, 60.0, 1.5);
        near(found.longitudinal_um, 150.0, 1.5);
        near(found.circular_um, 390.0, 1.5);
        near(found.subserosa_um, 0.0, 0.0);
        near(found.muscle_mm2, ring(580.0, 1180.0) / 1e6, 0.005);
        near(found.mucosa_mm2, ring(500.0, 580.0) / 1e6, 0.003);
        // Area over length: a ring of 30 µm around a circle of radius 500 µm.
        near(found.epithelium_um, ring(500.0, 530.0) / (1e3 * PI), 0.9);
        near(found.lamina_um, ring(530.0, 580.0) / (1e3 * PI), 0.9);
        near(found.lamina_over_epithelium.unwrap(), ring(530.0, 580.0) / ring(500.0, 530.0), 0.06);
        near(found.free_lumen, (500.0_f64 / 580.0).powi(2), 0.003);
        near(found.cleft_lamina_um.unwrap(), 50.0, 1.0);
        assert_eq!((found.longitudinal_cover, found.vessels), (Some(1.0), 0));
    }

    #[test]
    fn a_layer_in_bundles_covers_a_part_and_is_thinner_on_average() {
        let found = annulus(&Layers { longitudinal_cover: 0.5, ..WALL });
        near(found.longitudinal_cover.unwrap(), 0.5, 0.03);
        assert!((40.0..80.0).contains(&found.longitudinal_um), "{}", found.longitudinal_um);
        near(found.muscle_um, 600.0, 1.5);
        let none = annulus(&Layers { longitudinal_cover: 0.0, ..WALL });
        near(none.longitudinal_cover.unwrap(), 0.0, 0.0);
        near(none.circular_um, 540.0, 1.5);
    }

    #[test]
    fn vessels_are_counted_and_lie_in_their_layers() {
        // One vessel lies between the muscles, the other one in the subserosa.
        let found = annulus(&Layers { subserosa_um: 60.0, vessels: 2.0, seed: 7, ..WALL });
        assert_eq!(found.vessels, 2);
        // The subserosa is up to three times as thick at the mesosalpinx: 1 + 2·35/128 on average.
        near(found.subserosa_um, 60.0 * (1.0 + 2.0 * 35.0 / 128.0), 2.0);
        let layers = found.inner_longitudinal_um + found.circular_um + found.longitudinal_um;
        assert!(layers < found.muscle_um && layers > 0.99 * found.muscle_um, "{layers} {}", found.muscle_um);
    }

    #[test]
    fn touching_vessels_are_one() {
        let picture = "\
            cccccccc\
            cVVcccVc\
            ccVcccVc\
            cccVcccc\
            sssssVVs";
        let mut labels: Vec<Tissue> = picture
            .chars()
            .map(|c| match c {
                'V' => Tissue::Vessel,
                's' => Tissue::Serosa,
                _ => Tissue::CircularMuscle,
            })
            .collect();
        assert_eq!(vessels(&mut labels, 8), (3, [8, 0]));
    }
}
