//! Options of `keys`.

use super::database::DatabaseArgs;
use crate::cli::units;
use crate::jobs::keys::{Owner, Scope};
use clap::builder::FalseyValueParser;
use clap::{Args, Subcommand};
use std::time::Duration;

/// What to do with keys.
#[derive(Clone, Debug, Subcommand)]
pub(in crate::cli) enum Keys {
    /// Make a key and print its secret, which is shown only this once
    Add(KeysAddArgs),
    /// List the keys, without their secrets
    List(KeysListArgs),
    /// End a key
    Revoke(KeysRevokeArgs),
    /// Replace a key by a new one with the same owner, scopes, limits and end, and print its secret
    Rotate(KeysRotateArgs),
}

/// Options of `keys add`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct KeysAddArgs {
    /// Who owns what is requested with it: 1 to 64 letters, digits, `.`, `_`, `-`, `@`. Several keys may share an owner
    #[arg(long, value_name = "NAME")]
    pub(in crate::cli) owner: Owner,
    /// What it allows, separated by commas: read and submit (the owner's own models), admin (everything)
    #[arg(long, value_name = "LIST", value_delimiter = ',', required = true)]
    pub(in crate::cli) scopes: Vec<Scope>,
    /// Time after which it ends, such as 30d [default: never]
    #[arg(long, value_name = "TIME", value_parser = units::positive_duration)]
    pub(in crate::cli) expires: Option<Duration>,
    /// Requests per second, on average [default: --key-rate of the service]
    #[arg(long, value_name = "N", value_parser = units::positive_rate)]
    pub(in crate::cli) rate: Option<f64>,
    /// Maximum number of queued and running models of its owner [default: --key-models of the service]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(in crate::cli) models: Option<u64>,
    /// Total size of the files of its owner above which it may not request models [default: --key-bytes of the service]
    #[arg(long, value_name = "SIZE", value_parser = units::bytes)]
    pub(in crate::cli) bytes: Option<u64>,
    /// Print one JSON object
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
    #[command(flatten)]
    pub(in crate::cli) database: DatabaseArgs,
}

/// Options of `keys list`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct KeysListArgs {
    /// Print one JSON array
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
    #[command(flatten)]
    pub(in crate::cli) database: DatabaseArgs,
}

/// Options of `keys revoke`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct KeysRevokeArgs {
    /// The 8 digits after `oviduct_` in the key, as `keys list` shows them
    #[arg(value_name = "PREFIX")]
    pub(in crate::cli) prefix: String,
    #[command(flatten)]
    pub(in crate::cli) database: DatabaseArgs,
}

/// Options of `keys rotate`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct KeysRotateArgs {
    /// The 8 digits after `oviduct_` in the key, as `keys list` shows them
    #[arg(value_name = "PREFIX")]
    pub(in crate::cli) prefix: String,
    /// Time for which the old key goes on to work, such as 1h [0: none]
    #[arg(long, value_name = "TIME", value_parser = units::duration_or_zero, default_value = "0")]
    pub(in crate::cli) overlap: Duration,
    /// Print one JSON object
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
    #[command(flatten)]
    pub(in crate::cli) database: DatabaseArgs,
}
