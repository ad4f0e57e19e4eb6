//! Options of `fit`.

use crate::cli::units;
use crate::measure::micrograph::Tissue;
use clap::Args;
use clap::builder::FalseyValueParser;
use std::path::PathBuf;

/// Options of `fit`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct FitArgs {
    /// File with targets: CSV with the columns region, quantity, value, low and high, or a JSON
    /// array of objects with these members; `-` reads either from stdin
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) targets: Option<PathBuf>,
    /// Target, as REGION/QUANTITY=VALUE or REGION/QUANTITY=LOW..HIGH; may be repeated
    #[arg(long, value_name = "TARGET")]
    pub(in crate::cli) target: Vec<String>,
    /// Image of a section, as REGION=FILE, whose measures become targets; `oviduct measure` reads
    /// the same files; may be repeated
    #[arg(long, value_name = "REGION=FILE")]
    pub(in crate::cli) image: Vec<String>,
    /// Side length of a pixel in all images, such as 2um [default: the one that each file states]
    #[arg(long, value_name = "LENGTH", value_parser = units::positive_length_um, conflicts_with = "pixel_um")]
    pub(in crate::cli) pixel: Option<f64>,
    /// --pixel in µm, without a unit
    #[arg(long, value_name = "UM")]
    pub(in crate::cli) pixel_um: Option<f64>,
    /// Pixel values that are tissue, or nonzero or zero [default: nonzero, if 0 and at most one
    /// other value occur]
    #[arg(long, value_name = "VALUES", value_parser = str::parse::<Tissue>, requires = "image")]
    pub(in crate::cli) tissue: Option<Tissue>,
    /// Least value of tissue; with `--tissue zero`, values below it are tissue [default: 128 for
    /// JPEG, none for other formats]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..), requires = "image")]
    pub(in crate::cli) threshold: Option<u16>,
    /// Preset to start from; see `oviduct presets`
    #[arg(long, value_name = "NAME", default_value = crate::spec::DEFAULT_PRESET)]
    pub(in crate::cli) preset: String,
    /// JSON file with a merge patch on the preset; `-` reads stdin
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) spec: Option<PathBuf>,
    /// Value of one parameter of the spec, as JSON or a plain string, such as collision.gap_um=30;
    /// may be repeated
    #[arg(long, value_name = "A.B=V", value_delimiter = ';')]
    pub(in crate::cli) set: Vec<String>,
    /// Parameter to search, such as collision.gap_um, collision.gap_um@ampulla or
    /// collision.gap_um@ampulla=20..60; may be repeated [default: the parameters that affect the
    /// targets, between half and twice their values]
    #[arg(long, value_name = "A.B[@END][=FROM..TO]")]
    pub(in crate::cli) vary: Vec<String>,
    /// Maximum number of candidates
    #[arg(long, value_name = "N", default_value_t = crate::fit::EVALUATIONS[1])]
    pub(in crate::cli) evaluations: u32,
    /// Number of seeds per candidate; inexpensive measures use four times as many
    #[arg(long, value_name = "N", default_value_t = crate::fit::SEEDS[1])]
    pub(in crate::cli) seeds: u32,
    /// Number of models of the result that are grown in full, each with a different seed
    #[arg(long, value_name = "N", default_value_t = crate::fit::MODELS[1])]
    pub(in crate::cli) models: u32,
    /// First seed of the candidates, and seed of the search
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(in crate::cli) seed: u64,
    /// File for the fitted spec, which `oviduct generate --spec` reads
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) out: Option<PathBuf>,
    /// File for the candidates so far; if it exists, the search continues from it
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) checkpoint: Option<PathBuf>,
    /// Memory limit of all models together, such as 2GB; it reduces the number of models grown at
    /// the same time [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = units::bytes_with_unit)]
    pub(in crate::cli) memory_limit: Option<u64>,
    /// Print the result as JSON
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
}
