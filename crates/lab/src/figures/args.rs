//! Options of `figures`.

use clap::builder::FalseyValueParser;
use clap::{Args, ValueEnum};
use oviduct::cli::{GpuArgs, SpecArgs, units};
use oviduct::generate::Backend;
use std::path::PathBuf;

/// Seed of the figures in docs/validation.md and of `bench paper`.
const SEED: &str = "1";

/// Options of `figures`.
#[derive(Clone, Debug, Args)]
#[command(mut_arg("preset", |preset| preset.default_value("paper")))]
#[command(mut_arg("seed", |seed| seed.help("Seed of the random numbers, 0 to 2^53 - 1").default_value(SEED)))]
pub(crate) struct FiguresArgs {
    #[command(flatten)]
    pub(super) of: SpecArgs,
    /// Backend that grows the model of Figures 4 to 9: auto, gpu, cpu or cpu-single
    #[arg(long, value_parser = units::named::<Backend>, default_value = "auto")]
    pub(super) backend: Backend,
    /// Directory for the files; created if it does not exist
    #[arg(long, value_name = "DIR", required = true)]
    pub(super) out: PathBuf,
    /// Figures to draw, separated by commas [default: all]
    #[arg(long, value_name = "LIST", value_enum, value_delimiter = ',')]
    pub(super) only: Vec<FigureNumber>,
    /// Width of the pictures, pixels
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(400..=4000), default_value_t = 1800)]
    pub(super) size: u32,
    /// Take fewer measurements for Figures 10 and 11, within half a minute
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) quick: bool,
    #[command(flatten)]
    pub(crate) gpu: GpuArgs,
}

impl FiguresArgs {
    /// Returns true if the figure is to be drawn.
    pub(super) fn wants(&self, number: FigureNumber) -> bool {
        self.only.is_empty() || self.only.contains(&number)
    }
}

/// A figure of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum FigureNumber {
    /// Cross sections as lines.
    #[value(name = "4")]
    Four,
    /// Cross sections along the tube.
    #[value(name = "7")]
    Seven,
    /// End caps and wire frame.
    #[value(name = "8")]
    Eight,
    /// Views of the model.
    #[value(name = "9")]
    Nine,
    /// Time against particles.
    #[value(name = "10")]
    Ten,
    /// Total times.
    #[value(name = "11")]
    Eleven,
}
