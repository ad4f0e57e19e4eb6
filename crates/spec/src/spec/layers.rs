//! What `histology` and `labels` of a specification mean: the layers of a section, and the size of the label volume.

use super::parameters::{Histology, Parameters};
use crate::tissue::Layers;

/// Most slices of a label volume, and most voxels along the side of one: sizes of NIfTI-1 are 16-bit numbers. A predicted
/// side keeps away from it, since the tube may be wider than predicted.
pub(super) const MOST_SLICES: f64 = 32_767.0;
pub(super) const MOST_SIDE: f64 = 16_384.0;
/// Places at which the width is sampled.
const PLACES: u32 = 64;

impl Histology {
    /// The layers of a section.
    #[must_use]
    pub fn layers(&self) -> Layers {
        Layers {
            epithelium_um: self.epithelium_um,
            lamina_um: self.lamina_um,
            longitudinal_share: self.longitudinal_share,
            serosa_um: self.serosa_um,
        }
    }
}

impl Parameters {
    /// Number of slices of the label volume: as many as fill the piece, at least one.
    #[must_use]
    pub fn label_slices(&self) -> u32 {
        self.slices().clamp(1.0, MOST_SLICES) as u32
    }

    /// Where the label volume begins, µm from the isthmus end.
    #[must_use]
    pub fn label_from_um(&self) -> f64 {
        self.labels_um()[0]
    }

    /// Where the label volume begins and ends, µm from the isthmus end.
    fn labels_um(&self) -> [f64; 2] {
        let [begin, end] = self.piece_um();
        [self.labels.from, self.labels.to].map(|part| begin + part * (end - begin))
    }

    /// Slices that fit into the label volume.
    pub(super) fn slices(&self) -> f64 {
        let [from, to] = self.labels_um();
        // A thousandth of a slice is forgiven, since the ends are products of rounded numbers.
        ((to - from) / self.labels.slice_um + 1e-3).floor()
    }

    /// Predicted voxels along the longer side of a slice of the label volume, and in a slice: those over the widest place of
    /// the piece.
    pub(super) fn label_voxels(&self) -> (f64, f64) {
        let c = &self.containment;
        let ends = self.labels_um().map(|um| um / (self.length_mm * 1000.0));
        let widest = self.widest();
        let mut half = [0.0_f64; 2];
        for u in (0..=PLACES).map(|k| f64::from(k) / f64::from(PLACES)) {
            let place = self.z.at(u);
            // A place before and after the volume is within reach of its first and last slab.
            if place < ends[0] - 1.0 / f64::from(PLACES) || place > ends[1] + 1.0 / f64::from(PLACES) {
                continue;
            }
            let (radius, squash) = (widest * self.inner_radius_um(u), c.squash.at(u));
            let lobes = 1.0 + self.wall.lobing.at(u);
            half[0] = half[0].max((radius + c.wall_um.at(u)) * lobes);
            half[1] = half[1].max((radius * squash + c.wall_um.at(u)) * lobes);
        }
        let sides = half.map(|half| 2.0 * self.scale * half / self.labels.voxel_um + 3.0);
        (sides[0].max(sides[1]), sides[0] * sides[1])
    }
}
