//! The file of a surface to be written: its format by its ending, its unit, and its writer.

use super::folder;
use crate::cli::exit::Failure;
use crate::cli::scratch::{Scratch, split};
use crate::export::Shape;
use crate::export::glb::GlbOptions;
use crate::generate::{Output, write_surface};
use crate::model::LengthUnit;
use anyhow::Context;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// File to write.
pub(super) struct Target {
    pub(super) output: Output,
    dir: PathBuf,
    /// Name of the file without its ending.
    pub(super) stem: String,
    /// Endings of the files: as in the table of formats, and as given.
    endings: Vec<(&'static str, String)>,
    pub(super) unit: LengthUnit,
}

impl Target {
    /// Target of a path and the options `--units` and `--ascii`.
    pub(super) fn of(path: &Path, units: Option<LengthUnit>, is_ascii: bool) -> Result<Self, Failure> {
        let shown = path.display();
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let lower = name.to_ascii_lowercase();
        // The longest ending: `.ascii.stl` also ends in `.stl`.
        let known = Output::ALL.into_iter().filter_map(|output| Some((output, output.endings().first()?.0)));
        let found = known.filter(|(_, ending)| lower.ends_with(&format!(".{ending}"))).max_by_key(|(_, e)| e.len());
        let Some((output, ending)) = found else {
            let endings: Vec<&str> =
                Output::ALL.iter().filter_map(|output| Some(output.endings().first()?.0)).collect();
            return Err(Failure::usage(format!(
                "{shown}: the format is not known; known are .{}",
                endings.join(", .")
            )));
        };
        let output = if is_ascii { ascii(output, name)? } else { output };
        let unit = output.unit(units).unwrap_or(LengthUnit::Metre);
        if units.is_some_and(|asked| asked != unit) {
            return Err(Failure::usage(format!("--units: {} is always in {}", output.name(), unit.name())));
        }
        let (stem, given) = name.split_at(name.len() - ending.len() - 1);
        if stem.is_empty() {
            return Err(Failure::usage(format!("{shown}: has no name before its ending")));
        }
        let mut endings = vec![(output.endings()[0].0, given[1..].to_owned())];
        endings.extend(output.endings().iter().skip(1).map(|(ending, _)| (*ending, (*ending).to_owned())));
        let dir = split(path).map_or(Path::new("."), |(dir, _)| dir);
        Ok(Self { output, dir: dir.to_owned(), stem: stem.to_owned(), endings, unit })
    }

    /// Checks that no file would replace the input or a file of a model.
    ///
    /// # Errors
    /// [`Failure::Usage`] that names the file.
    pub(super) fn spare(&self, input: &Path) -> Result<(), Failure> {
        let input = input.canonicalize().ok();
        for (_, given) in &self.endings {
            let path = self.dir.join(format!("{}.{given}", self.stem));
            let what = if path.canonicalize().ok().is_some_and(|path| Some(path) == input) {
                "the file that is read"
            } else if folder::is_of_model(&path) {
                "a file of the model in this folder, which manifest.json names"
            } else {
                continue;
            };
            return Err(Failure::usage(format!("{}: is {what}; choose another name", path.display())));
        }
        Ok(())
    }

    /// Writes a surface. Returns a line for each file.
    pub(super) fn write(&self, shape: &Shape<'_>) -> anyhow::Result<Vec<String>> {
        let scratch = Scratch::new(&self.dir).with_context(|| self.dir.display().to_string())?;
        let mut names = Vec::new();
        for (ending, given) in &self.endings {
            let name = format!("{}.{given}", self.stem);
            let write = || -> std::io::Result<()> {
                let mut file = BufWriter::with_capacity(1 << 18, File::create(scratch.dir().join(&name))?);
                write_surface(self.output, ending, shape, GlbOptions::default(), &self.stem, &mut file)?;
                file.flush()
            };
            write().with_context(|| name.clone())?;
            names.push(name);
        }
        let patches: Vec<&str> = shape.patches.iter().map(|patch| patch.name).collect();
        let published = |name: &String| {
            let path = scratch.publish(name).with_context(|| name.clone())?;
            Ok(format!(
                "{}: {} vertices, {} triangles, in {}; patches {}",
                path.display(),
                shape.positions.len(),
                shape.triangles.len(),
                self.unit.name(),
                patches.join(", ")
            ))
        };
        names.iter().map(published).collect()
    }
}

/// Returns the text variant of a format.
fn ascii(output: Output, name: &str) -> Result<Output, Failure> {
    match output {
        Output::Stl | Output::StlAscii => Ok(Output::StlAscii),
        _ => Err(Failure::usage(format!("--ascii: {name}: only STL can be binary or text"))),
    }
}
