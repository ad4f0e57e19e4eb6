//! Options of commands that use GPUs.

use clap::builder::FalseyValueParser;
use clap::{Args, ValueEnum};

/// Selection of GPUs.
#[derive(Clone, Copy, Debug, Args)]
pub struct GpuArgs {
    /// Use of GPUs
    #[arg(long, value_name = "WHEN", value_enum, default_value_t = GpuUse::Auto)]
    pub gpu: GpuUse,
    /// Also use software adapters, which compute on the CPU (Mesa's llvmpipe); slow, for tests
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub allow_software_adapter: bool,
}

/// Use of GPUs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum GpuUse {
    /// All GPUs of this machine.
    Auto,
    /// No GPU.
    Off,
}
