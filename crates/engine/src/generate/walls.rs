//! The walls of a model while it grows. The surface of the recorded sections is lofted and tested slab by slab; for an
//! even surface the sections of every step are kept and remeshed at the end.

use super::cost::Cost;
use super::outputs::Outputs;
use super::types::{GenerateError, Request};
use crate::clock::Stopwatch;
use crate::export::Metadata;
use crate::export::sections_bin::{SectionsError, write_sections};
use crate::mesh::quality::{Lids, Quality, RemeshError, Remeshed, remesh};
use crate::mesh::smooth::{Smooth, smooth};
use crate::mesh::{LoftError, Lofter};
use crate::model::{Mesh, Section};
use crate::spec::ModelSpec;
use std::borrow::Cow;
use std::io::{self, Write};

/// Edges of the outer wall, which is nearly flat, are longer than those of the inner wall by this factor.
const OUTER: f64 = 2.0;
/// Vertices that mending may add to any model, besides as many as were predicted.
const SPARE_VERTICES: u64 = 1_000_000;

/// The walls so far.
pub(super) struct Walls {
    form: Form,
    smooth: Option<Smooth>,
    /// First and last step of the model, and steps between recorded sections.
    recorded: [u32; 3],
    /// The sections that the model shows: recorded ones, and those added to mend slabs.
    sections: Vec<Section>,
    flipped: usize,
    seconds: f64,
}

enum Form {
    /// With open ends.
    Lofted(Box<Lofter>),
    /// The sections of every step.
    Even(Quality, Vec<Section>),
}

/// A closed surface.
pub(super) struct Closed {
    /// The tissue.
    pub(super) tissue: Mesh,
    /// The ends of the lumen, if it was asked for and the surface is an even one.
    pub(super) lids: Option<Lids>,
    /// The sections that the model shows.
    pub(super) sections: Vec<Section>,
}

#[expect(clippy::needless_pass_by_value, reason = "for `map_err`")]
pub(super) fn unsound(error: LoftError) -> GenerateError {
    GenerateError::Certificate { detail: error.to_string() }
}

impl Walls {
    /// Walls that begin with a section.
    pub(super) fn new(request: &Request, first: &Section) -> Result<Self, GenerateError> {
        let first = smoothed(smoothing(&request.spec), first).into_owned();
        Self::with(request, first)
    }

    /// Walls that begin with a section that is smooth already.
    fn with(request: &Request, first: Section) -> Result<Self, GenerateError> {
        let spec = &request.spec;
        let recorded = spec.recorded();
        let form = if spec.mesh.resolution_um > 0.0 {
            let quality = Quality {
                resolution_um: spec.mesh.resolution_um,
                outer_um: OUTER * spec.mesh.resolution_um,
                tolerance_um: spec.mesh.tolerance_um,
                lids: false,
            };
            Form::Even(quality, vec![first.clone()])
        } else {
            // If walls meet in many places, mending could add vertices almost without end.
            let most = 2 * Cost::new(spec, &Outputs::none()).vertices + SPARE_VERTICES;
            Form::Lofted(Box::new(Lofter::new(first.clone()).map_err(unsound)?.with_most_vertices(most)))
        };
        Ok(Self {
            form,
            smooth: smoothing(spec),
            recorded: [*recorded.start(), *recorded.end(), spec.solver.record_every],
            sections: vec![first],
            flipped: 0,
            seconds: 0.0,
        })
    }

    /// Walls from the sections that [`Walls::save`] wrote.
    pub(super) fn restored(
        request: &Request,
        mut accepted: impl Iterator<Item = Result<Section, SectionsError>>,
        flipped: usize,
        is_cancelled: impl Fn() -> bool,
    ) -> Result<Self, GenerateError> {
        let watch = Stopwatch::start();
        let first = accepted.next().ok_or_else(|| unsound(LoftError::NoSection))??;
        let mut walls = Self::with(request, first)?;
        for section in accepted {
            if is_cancelled() {
                return Err(GenerateError::Cancelled);
            }
            let section = section?;
            match &mut walls.form {
                Form::Lofted(lofter) => {
                    walls.sections.extend(lofter.advance(&[section]).map_err(unsound)?.sections);
                }
                Form::Even(..) => walls.keep(section),
            }
        }
        walls.flipped = flipped;
        walls.seconds = watch.seconds();
        Ok(walls)
    }

    /// Writes all sections that the surface is made of.
    pub(super) fn save(&self, meta: &Metadata, mut out: &mut dyn Write) -> io::Result<()> {
        match &self.form {
            Form::Lofted(_) => write_sections(&self.sections, meta, &mut out),
            Form::Even(_, sections) => write_sections(sections, meta, &mut out),
        }
    }

    /// Seconds spent on them.
    pub(super) fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Diagonals flipped so far.
    pub(super) fn flipped(&self) -> usize {
        self.flipped
    }

    /// Adds the slab up to `section`. If it needs mending, calls `steps` for the sections of all steps since the last one, of
    /// which `section` is the last.
    pub(super) fn extend<'a>(
        &mut self,
        section: &Section,
        steps: impl FnOnce() -> Result<Cow<'a, [Section]>, GenerateError>,
    ) -> Result<(), GenerateError> {
        let watch = Stopwatch::start();
        let smoothed = |section| smoothed(self.smooth, section);
        match &mut self.form {
            Form::Lofted(lofter) => {
                let accepted = match lofter.try_advance(&smoothed(section)).map_err(unsound)? {
                    Some(accepted) => accepted,
                    None => {
                        let steps: Vec<Section> = steps()?.iter().map(|step| smoothed(step).into_owned()).collect();
                        lofter.advance(&steps).map_err(unsound)?
                    }
                };
                self.flipped += accepted.flipped;
                self.sections.extend(accepted.sections);
            }
            Form::Even(..) => {
                let section = smoothed(section).into_owned();
                self.keep(section);
            }
        }
        self.seconds += watch.seconds();
        Ok(())
    }

    /// Whether the section of a step is among those that the model shows.
    pub(super) fn shows(&self, step: u32) -> bool {
        let [first, last, every] = self.recorded;
        step == first || step == last || step.is_multiple_of(every)
    }

    /// Keeps a section of an even surface.
    fn keep(&mut self, section: Section) {
        if self.shows(section.step as u32) {
            self.sections.push(section.clone());
        }
        if let Form::Even(_, sections) = &mut self.form {
            sections.push(section);
        }
    }

    /// Closes the surface; that of the lumen, too, with `lids`, unless [`crate::mesh::regions`] can do so. `watch` is told the
    /// fraction that is done, and says whether to stop.
    pub(super) fn close(self, lids: bool, watch: &(dyn Fn(f64) -> bool + Sync)) -> Result<Closed, GenerateError> {
        Ok(match self.form {
            Form::Lofted(lofter) => {
                let tissue = lofter.finish().map_err(unsound)?;
                Closed { tissue, lids: None, sections: self.sections }
            }
            Form::Even(quality, sections) => {
                let closed = remesh(&sections, &Quality { lids, ..quality }, watch);
                let Remeshed { tissue, lids } = closed.map_err(|error| match error {
                    RemeshError::Stopped => GenerateError::Cancelled,
                    error => GenerateError::Certificate { detail: error.to_string() },
                })?;
                Closed { tissue, lids, sections: self.sections }
            }
        })
    }
}

fn smoothing(spec: &ModelSpec) -> Option<Smooth> {
    (spec.mesh.smooth_um > 0.0).then_some(Smooth { distance_um: spec.mesh.smooth_um })
}

fn smoothed(options: Option<Smooth>, section: &Section) -> Cow<'_, Section> {
    options.map_or(Cow::Borrowed(section), |options| Cow::Owned(smooth(section, &options)))
}
