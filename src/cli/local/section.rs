//! `oviduct section`: draws a section of `sections.bin` as a stained picture or a label image.

use crate::cli::args::{LayerArgs, SectionArgs};
use crate::cli::exit::{Ended, Failure};
use crate::cli::interrupt::Signals;
use crate::cli::scratch::split;
use crate::cli::{scratch, term};
use crate::export::sections_bin::SectionsReader;
use crate::render::{Slide, um_per_pixel};
use crate::spec::{ModelSpec, preset, presets};
use anyhow::Context;
use serde_json::{Map, Value, json};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

pub(in crate::cli) async fn run(args: SectionArgs) -> Ended {
    let (dir, name) = target(&args.out, args.index, args.labels);
    let png = Signals::listen().run("drawing", move || draw(&args)).await??;
    let path = scratch::write(&dir.join(name), &png)?;
    let scale = um_per_pixel(&png).map(|um| format!("  {um:.4} µm per pixel")).unwrap_or_default();
    term::print(&format!("{}{scale}", path.display()))?;
    Ok(())
}

/// Returns the directory and the name of the picture.
fn target(out: &Path, index: u32, labels: bool) -> (PathBuf, String) {
    let is_picture = out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"));
    if let (true, Some((dir, name))) = (is_picture, split(out)) {
        return (dir.to_owned(), name.to_owned());
    }
    let suffix = if labels { "-labels" } else { "" };
    (out.to_owned(), format!("section-{index}{suffix}.png"))
}

fn draw(args: &SectionArgs) -> Result<Vec<u8>, Failure> {
    let shown = args.file.display();
    let file = File::open(&args.file).with_context(|| shown.to_string())?;
    let mut reader = SectionsReader::open(BufReader::new(file)).with_context(|| shown.to_string())?;
    if args.index as usize >= reader.len() {
        let count = reader.len();
        return Err(Failure::usage(format!("--index: {shown} has {count} sections; indices start at 0")));
    }
    let section = reader.section(args.index as usize).with_context(|| shown.to_string())?;
    let header = reader.header();
    let spec = spec(&header.preset, &args.layers)?;
    let layers = spec.layers_at_um(section.z_um, header.seed);
    let slide = Slide { borders: section.borders(), layers, seed: header.seed, index: args.index };
    let drawn = if args.labels { slide.labels(args.size) } else { slide.stained(args.size) };
    Ok(drawn.context("the section cannot be drawn")?)
}

/// Returns a preset, with its layers changed by the options. The options are checked like a spec.
pub(super) fn spec(name: &str, args: &LayerArgs) -> Result<ModelSpec, Failure> {
    let given = args.lengths_um().into_iter().chain([("longitudinal_share", args.longitudinal_share)]);
    let given: Map<String, Value> = given.filter_map(|(name, value)| Some((name.to_owned(), value?.into()))).collect();
    let preset = preset(name).unwrap_or(&presets()[0]);
    ModelSpec::resolve(preset, &json!({ "histology": given }))
        .map_err(|faults| Failure::Usage(faults.iter().map(|f| format!("{}: {}", f.pointer, f.detail)).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_named_as_asked_or_by_their_section() {
        let found = |out: &str, labels| target(Path::new(out), 7, labels);
        assert_eq!(found("a/x.png", true), ("a".into(), "x.png".into()));
        assert_eq!(found("x.PNG", false), (".".into(), "x.PNG".into()));
        assert_eq!(found("dir", false), ("dir".into(), "section-7.png".into()));
        assert_eq!(found(".", true), (".".into(), "section-7-labels.png".into()));
    }
}
