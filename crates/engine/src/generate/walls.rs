//! Walls of a model during its growth. The surface of the recorded sections is lofted and tested
//! slab by slab. For an even surface, the sections of every step are kept and remeshed at the end.

use super::cost::Cost;
use super::outputs::Outputs;
use super::types::{GenerateError, Request};
use crate::clock::Stopwatch;
use crate::export::Metadata;
use crate::export::sections_bin::{SectionsError, write_sections};
use crate::mesh::quality::{Lids, Quality, RemeshError, Remeshed, remesh};
use crate::mesh::smooth::smooth;
use crate::mesh::{LoftError, Lofter};
use crate::model::{Mesh, Rows, Section};
use std::borrow::Cow;
use std::io::{self, Write};

/// Length of edges of the outer wall, which is nearly flat, divided by that of edges of the inner
/// wall.
const OUTER: f64 = 2.0;
/// Fixed part of the vertex limit for mending. The limit is twice the predicted number of vertices
/// plus this constant.
const SPARE_VERTICES: u64 = 1_000_000;

/// Walls of the sections so far.
pub(super) struct Walls {
    form: Form,
    smooth_um: f64,
    /// First and last step of the model, and number of steps between recorded sections.
    recorded: [u32; 3],
    /// Sections that the model shows: recorded sections, and sections added to mend slabs.
    sections: Vec<Section>,
    flipped: usize,
    seconds: f64,
}

enum Form {
    /// Lofted surface with open ends.
    Lofted(Box<Lofter>),
    /// Sections of every step, for an even surface.
    Even(Quality, Vec<Section>),
}

/// A closed surface.
pub(super) struct Closed {
    /// The tissue.
    pub(super) tissue: Mesh,
    /// Rows of the tissue; `None` if the surface is even.
    pub(super) rows: Option<Rows>,
    /// Ends of the lumen, if it is requested and the surface is even.
    pub(super) lids: Option<Lids>,
    /// Sections that the model shows.
    pub(super) sections: Vec<Section>,
}

impl Walls {
    /// Walls that begin with a section.
    pub(super) fn new(request: &Request, first: &Section) -> Result<Self, GenerateError> {
        let first = smoothed(request.spec.mesh.smooth_um, first).into_owned();
        Self::with(request, first)
    }

    /// Walls that begin with a section that is already smooth.
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
            // If walls intersect in many places, mending could add vertices without end.
            let most = 2 * Cost::new(spec, &Outputs::none()).vertices + SPARE_VERTICES;
            Form::Lofted(Box::new(Lofter::new(first.clone())?.with_most_vertices(most)))
        };
        Ok(Self {
            form,
            smooth_um: spec.mesh.smooth_um,
            recorded: [*recorded.start(), *recorded.end(), spec.solver.record_every],
            sections: vec![first],
            flipped: 0,
            seconds: 0.0,
        })
    }

    /// Restores walls from the sections that [`Walls::save`] wrote.
    pub(super) fn restored(
        request: &Request,
        mut accepted: impl Iterator<Item = Result<Section, SectionsError>>,
        flipped: usize,
        is_cancelled: impl Fn() -> bool,
    ) -> Result<Self, GenerateError> {
        let watch = Stopwatch::start();
        let first = accepted.next().ok_or(LoftError::NoSection)??;
        let mut walls = Self::with(request, first)?;
        for section in accepted {
            if is_cancelled() {
                return Err(GenerateError::Cancelled);
            }
            let section = section?;
            match &mut walls.form {
                Form::Lofted(lofter) => {
                    walls.sections.extend(lofter.advance(&[section])?.sections);
                }
                Form::Even(..) => walls.keep(section),
            }
        }
        walls.flipped = flipped;
        walls.seconds = watch.seconds();
        Ok(walls)
    }

    /// Writes all sections of the surface.
    pub(super) fn save(&self, meta: &Metadata, mut out: &mut dyn Write) -> io::Result<()> {
        match &self.form {
            Form::Lofted(_) => write_sections(&self.sections, meta, &mut out),
            Form::Even(_, sections) => write_sections(sections, meta, &mut out),
        }
    }

    /// Seconds spent on the walls.
    pub(super) fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Number of diagonals flipped so far.
    pub(super) fn flipped(&self) -> usize {
        self.flipped
    }

    /// Adds the slab up to `section`. If the slab needs mending, calls `steps` for the sections of
    /// all steps since the previous section; `section` is the last of them.
    pub(super) fn extend<'a>(
        &mut self,
        section: &Section,
        steps: impl FnOnce() -> Result<Cow<'a, [Section]>, GenerateError>,
    ) -> Result<(), GenerateError> {
        let watch = Stopwatch::start();
        let smoothed = |section| smoothed(self.smooth_um, section);
        match &mut self.form {
            Form::Lofted(lofter) => {
                let accepted = match lofter.try_advance(&smoothed(section))? {
                    Some(accepted) => accepted,
                    None => {
                        let steps: Vec<Section> = steps()?.iter().map(|step| smoothed(step).into_owned()).collect();
                        lofter.advance(&steps)?
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

    /// True if the model shows the section of this step.
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

    /// Closes the surface. With `lids`, also closes the lumen, unless [`crate::mesh::regions`] can
    /// do so. `watch` receives the completed fraction and returns true to stop.
    pub(super) fn close(self, lids: bool, watch: &(dyn Fn(f64) -> bool + Sync)) -> Result<Closed, GenerateError> {
        Ok(match self.form {
            Form::Lofted(lofter) => {
                let (tissue, rows) = lofter.finish_with_rows()?;
                Closed { tissue, rows: Some(rows), lids: None, sections: self.sections }
            }
            Form::Even(quality, sections) => {
                let closed = remesh(&sections, &Quality { lids, ..quality }, watch);
                let Remeshed { tissue, lids } = closed.map_err(|error| match error {
                    RemeshError::Stopped => GenerateError::Cancelled,
                    error => GenerateError::Certificate { detail: error.to_string() },
                })?;
                Closed { tissue, rows: None, lids, sections: self.sections }
            }
        })
    }
}

fn smoothed(smooth_um: f64, section: &Section) -> Cow<'_, Section> {
    if smooth_um > 0.0 { Cow::Owned(smooth(section, smooth_um)) } else { Cow::Borrowed(section) }
}
