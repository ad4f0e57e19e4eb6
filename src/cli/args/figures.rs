//! Options of `figures`.

use super::gpu::GpuArgs;
use super::model::SpecArgs;
use crate::cli::units;
use crate::generate::Backend;
use clap::builder::FalseyValueParser;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Seed of the figures in docs/validation.md and of `bench paper`.
const SEED: &str = "1";

/// Options of `figures`.
#[derive(Clone, Debug, Args)]
#[command(mut_arg("preset", |preset| preset.default_value("paper")))]
#[command(mut_arg("seed", |seed| seed.help("Seed of the random numbers, 0 to 2^53 - 1").default_value(SEED)))]
pub(in crate::cli) struct FiguresArgs {
    #[command(flatten)]
    pub(in crate::cli) of: SpecArgs,
    /// Backend that grows the model of Figures 4 to 9: auto, gpu, cpu or cpu-single
    #[arg(long, value_parser = units::named::<Backend>, default_value = "auto")]
    pub(in crate::cli) backend: Backend,
    /// Directory for the files; created if it does not exist
    #[arg(long, value_name = "DIR", required = true)]
    pub(in crate::cli) out: PathBuf,
    /// Figures to draw, separated by commas [default: all]
    #[arg(long, value_name = "LIST", value_enum, value_delimiter = ',')]
    pub(in crate::cli) only: Vec<Number>,
    /// Width of the pictures, pixels
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(400..=4000), default_value_t = 1800)]
    pub(in crate::cli) size: u32,
    /// Take fewer measurements for Figures 10 and 11, within half a minute
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) quick: bool,
    #[command(flatten)]
    pub(in crate::cli) gpu: GpuArgs,
}

impl FiguresArgs {
    /// Returns true if the figure is to be drawn.
    pub(in crate::cli) fn wants(&self, number: Number) -> bool {
        self.only.is_empty() || self.only.contains(&number)
    }
}

/// A figure of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(in crate::cli) enum Number {
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
