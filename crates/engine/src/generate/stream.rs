//! A surface that is never whole in memory: while sections are lofted, they and the surface are examined, measured and written
//! in batches. The surface goes to a spool on the scratch disk, from which the writers of files read it.

use super::files::{Buffered, SECTIONS, buffered, output};
use super::outputs::Output;
use super::types::{FileOutput, GenerateError, Request, Seconds};
use crate::clock::Stopwatch;
use crate::export::centreline::Centreline;
use crate::export::sections_bin::{self, SectionsWriter};
use crate::export::spool::{Spool, SpoolWriter};
use crate::measure::morphometry::Survey;
use crate::measure::{Certificate, Chunk, StreamCertifier};
use crate::mesh::Part;
use crate::model::{BodyKind, LengthUnit, Mesh, Section};
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::PathBuf;

/// Points of sections that are processed together, so that threads have enough to do.
const BATCH_POINTS: usize = if cfg!(test) { 1 << 11 } else { 1 << 15 };
/// What errors of the spool name.
const SPOOL: &str = "the surface on the scratch disk";

/// What has come of the model, but for the loft itself.
pub(super) struct Stream {
    /// One for the surface in metres, and one for each other unit in which it is written.
    certifiers: Vec<(LengthUnit, StreamCertifier)>,
    /// None if no surface is written.
    spool: Option<SpoolWriter>,
    path: PathBuf,
    file: SectionsWriter<Buffered>,
    survey: Survey,
    centreline: Centreline,
    /// Sections that are not processed yet, and how many of them are in the file.
    waiting: Vec<Section>,
    written: usize,
    /// Points of the sections that wait.
    points: usize,
    sections: usize,
    added: usize,
    /// Points of the first and of the last section.
    ends: [usize; 2],
    /// Seconds of the parts of [`Stream::process`], which run at the same time.
    seconds: Seconds,
    /// Seconds of all calls of [`Stream::process`].
    busy: f64,
}

/// A surface that has been streamed.
pub(super) struct Streamed {
    /// Of the tissue in metres.
    pub(super) certificate: Certificate,
    /// Of the tissue in other units in which it is written.
    pub(super) others: Vec<(LengthUnit, Certificate)>,
    /// None if no surface is written.
    pub(super) spool: Option<Spool>,
    /// `sections.bin`.
    pub(super) file: FileOutput,
    pub(super) survey: Survey,
    pub(super) centreline: Centreline,
    /// Sections, with added ones.
    pub(super) sections: usize,
    pub(super) added: usize,
    /// Points of the first and of the last section.
    pub(super) ends: [usize; 2],
    /// Seconds of `certify`, `measure` and `export`, which run at the same time.
    pub(super) seconds: Seconds,
    /// Seconds in which they did.
    pub(super) busy: f64,
}

impl Stream {
    pub(super) fn new(request: &Request) -> Result<Self, GenerateError> {
        let (spec, outputs) = (&request.spec, &request.outputs);
        let is_written = |unit: &LengthUnit| !outputs.bodies_in(*unit).is_empty();
        let units = LengthUnit::ALL.into_iter().filter(|unit| *unit == LengthUnit::Metre || is_written(unit));
        let surface = LengthUnit::ALL.iter().any(is_written) || outputs.has(Output::Lod);
        let spool = surface.then(|| SpoolWriter::new(&request.dir, BodyKind::Tissue)).transpose();
        let path = request.dir.join(SECTIONS);
        let file = buffered(&path).and_then(|file| SectionsWriter::new(file, &request.metadata(0)));
        Ok(Self {
            certifiers: units.map(|unit| (unit, StreamCertifier::new(BodyKind::Tissue, unit))).collect(),
            spool: spool.map_err(failed(SPOOL))?,
            path,
            file: file.map_err(failed(SECTIONS))?,
            survey: Survey::new(spec.stations().count()),
            centreline: Centreline::default(),
            waiting: Vec::new(),
            written: 0,
            points: 0,
            sections: 0,
            added: 0,
            ends: [0; 2],
            seconds: Seconds::default(),
            busy: 0.0,
        })
    }

    /// Takes accepted sections. Returns whether there are enough for a batch: what they and the loft gave is then to be
    /// processed. This depends on nothing but the sections, so that sums have the same order after a checkpoint.
    pub(super) fn accept(&mut self, sections: Vec<Section>) -> bool {
        for section in &sections {
            self.points += section.particles();
            self.added += usize::from(section.added);
            if self.sections == 0 {
                self.ends[0] = section.particles();
            }
            self.ends[1] = section.particles();
            self.sections += 1;
        }
        let is_recorded = sections.last().is_some_and(|section| !section.added);
        self.waiting.extend(sections);
        is_recorded && self.points >= BATCH_POINTS
    }

    /// Processes the sections that wait, and the part of the surface that has come of them and of earlier ones.
    pub(super) fn process(&mut self, part: &Part) -> Result<(), GenerateError> {
        let watch = Stopwatch::start();
        let sections = std::mem::take(&mut self.waiting);
        self.points = 0;
        let Self { certifiers, spool, file, survey, centreline, written, seconds, .. } = self;
        let certify = || {
            let watch = Stopwatch::start();
            for (unit, certifier) in certifiers {
                if *unit == LengthUnit::Metre {
                    certifier.examine(&sections);
                }
                certifier.push(&Chunk {
                    positions: &unit.of_metres(&part.positions),
                    first_vertex: part.first_vertex,
                    triangles: part.patches.iter().map(Vec::as_slice).collect(),
                    retired_vertices: part.retired_vertices,
                    retired_z: unit.of_metres(&[[part.retired_z; 3]])[0][2],
                });
            }
            seconds.certify += watch.seconds();
        };
        let measure = || {
            let watch = Stopwatch::start();
            survey.add(&sections);
            sections.iter().for_each(|section| centreline.push(section, None));
            seconds.measure += watch.seconds();
        };
        let write = || {
            let watch = Stopwatch::start();
            for section in &sections[std::mem::take(written)..] {
                file.push(section).map_err(failed(SECTIONS))?;
            }
            if let Some(spool) = spool {
                let patches = BodyKind::Tissue.patches().iter().copied();
                let patches: Vec<_> = patches.zip(part.patches.iter().map(Vec::as_slice)).collect();
                spool.push(&part.positions, &patches, part.retired_vertices).map_err(failed(SPOOL))?;
            }
            seconds.export += watch.seconds();
            Ok(())
        };
        let ((), ((), is_written)) = rayon::join(certify, || rayon::join(measure, write));
        self.busy += watch.seconds();
        is_written
    }

    /// Writes all sections so far as a sections file.
    pub(super) fn save(&mut self, out: &mut dyn Write) -> io::Result<()> {
        for section in &self.waiting[self.written..] {
            self.file.push(section)?;
        }
        self.written = self.waiting.len();
        self.file.flush()?;
        let so_far = self.file.bytes();
        io::copy(&mut File::open(&self.path)?.take(so_far), out)?;
        out.write_all(&self.file.end())
    }

    /// Ends the model with the last part of its surface.
    pub(super) fn finish(mut self, part: &Part) -> Result<Streamed, GenerateError> {
        self.process(part)?;
        let watch = Stopwatch::start();
        let mut certificates = self.certifiers.into_iter().map(|(unit, certifier)| (unit, certifier.finish()));
        let (_, certificate) = certificates.next().expect("the first is that in metres");
        let others = certificates.collect();
        self.seconds.certify += watch.seconds();
        self.busy += watch.seconds();
        let spool = self.spool.map(SpoolWriter::finish).transpose().map_err(failed(SPOOL))?;
        let (_, digest) = self.file.finish().map_err(failed(SECTIONS))?.finish();
        Ok(Streamed {
            certificate,
            others,
            spool,
            file: output(SECTIONS, sections_bin::MEDIA_TYPE, digest),
            survey: self.survey,
            centreline: self.centreline,
            sections: self.sections,
            added: self.added,
            ends: self.ends,
            seconds: self.seconds,
            busy: self.busy,
        })
    }
}

/// The whole surface, for what cannot be made of parts of it.
pub(super) fn read_back(spool: &Spool) -> Result<Mesh, GenerateError> {
    spool.mesh().map_err(failed(SPOOL))
}

fn failed(name: &'static str) -> impl Fn(io::Error) -> GenerateError {
    move |source| GenerateError::Io { name: name.into(), source }
}
