//! Layers of a section and size of the label volume, from `histology` and `labels` of a
//! specification.

use super::parameters::Parameters;
use crate::tissue::Layers;

/// Sizes of a label volume are 16-bit numbers in NIfTI-1. The maximum side leaves a margin, because
/// the tube may be wider than predicted.
pub(super) const MAX_SLICES: f64 = 32_767.0;
pub(super) const MAX_SIDE_VOXELS: f64 = 16_384.0;
/// Number of places at which the width is sampled.
const PLACES: u32 = 64;

impl Parameters {
    /// Layers of a section at a place along the tube, as a fraction of its length.
    #[must_use]
    pub fn layers_at(&self, share: f64, seed: u64) -> Layers {
        let of = &self.histology;
        Layers {
            epithelium_um: of.epithelium_um.at(share),
            lamina_um: of.lamina_um.at(share),
            opening_um: of.opening_um.at(share),
            inner_longitudinal_um: of.inner_longitudinal_um.at(share),
            longitudinal_share: of.longitudinal_share.at(share),
            longitudinal_cover: of.longitudinal_cover.at(share),
            subserosa_um: of.subserosa_um.at(share),
            serosa_um: of.serosa_um.at(share),
            vessels: of.vessels.at(share),
            z_um: share * self.length_mm * 1000.0,
            seed,
        }
    }

    /// Layers of a section at `z_um` from the isthmus end.
    #[must_use]
    pub fn layers_at_um(&self, z_um: f64, seed: u64) -> Layers {
        self.layers_at(z_um / (self.length_mm * 1000.0), seed)
    }

    /// Place in the middle of the piece of the tube that is modelled, µm from the isthmus end.
    #[must_use]
    pub fn middle_um(&self) -> f64 {
        let [begin, end] = self.piece_um();
        0.5 * (begin + end)
    }

    /// Number of slices of the label volume, at least 1.
    #[must_use]
    pub fn label_slices(&self) -> u32 {
        self.fitting_label_slices().clamp(1.0, MAX_SLICES) as u32
    }

    /// Isthmus end of the label volume, µm from the isthmus end of the tube.
    #[must_use]
    pub fn label_from_um(&self) -> f64 {
        self.label_ends_um()[0]
    }

    /// Both ends of the label volume, µm from the isthmus end of the tube.
    fn label_ends_um(&self) -> [f64; 2] {
        let [begin, end] = self.piece_um();
        [self.labels.from, self.labels.to].map(|part| begin + part * (end - begin))
    }

    /// Number of slices that fit into the label volume.
    #[must_use]
    pub fn fitting_label_slices(&self) -> f64 {
        let [from, to] = self.label_ends_um();
        // The ends are products of rounded numbers, so a thousandth of a slice is tolerated.
        ((to - from) / self.labels.slice_um + 1e-3).floor()
    }

    /// Predicted voxels along the longer side of a slice, and per slice, at the widest place of the
    /// label volume.
    #[must_use]
    pub fn label_voxels(&self) -> (f64, f64) {
        let c = &self.containment;
        let ends = self.label_ends_um().map(|um| um / (self.length_mm * 1000.0));
        let widest = self.widest();
        let mut half = [0.0_f64; 2];
        for u in (0..=PLACES).map(|k| f64::from(k) / f64::from(PLACES)) {
            let place = self.z.at(u);
            // The first and the last slab of the volume reach up to one place beyond it.
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
