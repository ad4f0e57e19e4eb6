//! The model of the figures, read back from its files, so that the figures show the exported model.

use anyhow::{Context, ensure};
use oviduct::cli::render;
use oviduct::export::read::read_surface;
use oviduct::export::sections_bin::SectionsReader;
use oviduct::generate::{Request, Summary};
use oviduct::model::{Mesh, Section};
use oviduct::preview;
use oviduct::render::{Finish, NamedView, Slide};
use std::fs::File;
use std::io::BufReader;
use std::path::PathBuf;

/// A grown model.
pub(super) struct Grown {
    pub(super) request: Request,
    /// In order from the isthmus end.
    pub(super) sections: Vec<Section>,
    /// The surface as exported; as in the file, its patches do not share vertices.
    pub(super) mesh: Mesh,
    /// The summary of its report.
    pub(super) summary: Summary,
}

impl Grown {
    /// Reads the files that a generation wrote.
    pub(super) fn read(request: &Request, summary: Summary) -> anyhow::Result<Self> {
        let glb = request.dir.join("model.glb");
        let mesh = render::mesh(read_surface(&glb).with_context(|| glb.display().to_string())?);
        let mut reader = SectionsReader::open(Self::stored(request)?)?;
        let sections = (0..reader.len()).map(|k| reader.section(k)).collect::<Result<Vec<_>, _>>()?;
        ensure!(sections.len() > 1, "the model has fewer than two sections");
        Ok(Self { request: request.clone(), sections, mesh, summary })
    }

    fn stored(request: &Request) -> anyhow::Result<BufReader<File>> {
        let path: PathBuf = request.dir.join("sections.bin");
        Ok(BufReader::new(File::open(&path).with_context(|| path.display().to_string())?))
    }

    /// Returns the surface that a view of `size` pixels shows.
    pub(super) fn surface(&self, view: NamedView, size: u32) -> anyhow::Result<Mesh> {
        Ok(preview::surface(Self::stored(&self.request)?, view, size)?)
    }

    /// Returns the length of the tube, µm.
    pub(super) fn length_um(&self) -> f64 {
        self.sections[self.sections.len() - 1].z_um
    }

    /// Returns the index of the section nearest to a fraction of the length.
    pub(super) fn nearest(&self, fraction: f64) -> usize {
        let at = fraction * self.length_um();
        let off = |k: &usize| (self.sections[*k].z_um - at).abs();
        (0..self.sections.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0)
    }

    /// Returns the end of the isthmus and the start of the ampulla, as fractions of the length.
    pub(super) fn junction(&self) -> [f64; 2] {
        [self.request.spec.regions.junction_from, self.request.spec.regions.junction_to]
    }

    /// Returns a section for a stained picture.
    pub(super) fn slide(&self, index: usize) -> Slide {
        let (section, seed) = (&self.sections[index], self.request.seed);
        let layers = self.request.spec.layers_at_um(section.z_um, seed);
        Slide { borders: section.borders(), layers, seed, index: index as u32 }
    }

    /// Returns the tissue that pictures show.
    pub(super) fn finish(&self) -> Finish<'_> {
        Finish { spec: &self.request.spec, seed: self.request.seed }
    }

    /// Returns preset and seed for captions.
    pub(super) fn name(&self) -> String {
        format!("preset {}, seed {}", self.request.preset, self.request.seed)
    }
}
