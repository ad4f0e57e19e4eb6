//! Options of `measure`.

use crate::cli::units;
use crate::measure::micrograph::Tissue;
use clap::Args;
use clap::builder::FalseyValueParser;
use std::path::PathBuf;

/// Options of `measure`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct MeasureArgs {
    /// Images of one whole section each, masks or label images: PNG, TIFF, OME-TIFF, BMP, JPEG, or
    /// GeoJSON of QuPath
    #[arg(value_name = "IMAGE", required = true)]
    pub(in crate::cli) images: Vec<PathBuf>,
    /// Side length of a pixel, 0.05um to 100um [default: the one that the file states]
    #[arg(long, value_name = "LENGTH", value_parser = units::positive_length_um, conflicts_with = "pixel_um")]
    pub(in crate::cli) pixel: Option<f64>,
    /// --pixel in µm, without a unit
    #[arg(long, value_name = "UM")]
    pub(in crate::cli) pixel_um: Option<f64>,
    /// Pixel values that are tissue, separated by commas: grey values or palette indices; or
    /// nonzero (all except 0), or zero [default: nonzero, if 0 and at most one other value occur]
    #[arg(long, value_name = "VALUES", value_parser = str::parse::<Tissue>)]
    pub(in crate::cli) tissue: Option<Tissue>,
    /// Least value of tissue; with `--tissue zero`, values below it are tissue [default: 128 for
    /// JPEG, none for other formats]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(in crate::cli) threshold: Option<u16>,
    /// File for the quantities as CSV, one row per image; `-` writes them to stdout instead of
    /// tables
    #[arg(long, value_name = "FILE", conflicts_with = "json")]
    pub(in crate::cli) csv: Option<PathBuf>,
    /// Directory for pictures of the images with the traced outlines, IMAGE.outlines.png; created
    /// if it does not exist
    #[arg(long, value_name = "DIR")]
    pub(in crate::cli) outlines: Option<PathBuf>,
    /// Also compare with published values of a species and, if given, of one region: isthmus,
    /// junction or ampulla; other organs than the oviduct as ORGAN/SPECIES
    #[arg(long, value_name = "SPECIES[:REGION]")]
    pub(in crate::cli) compare: Option<String>,
    /// Print one JSON object with the settings and the value of each quantity; for several images,
    /// an array of such objects
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
}
