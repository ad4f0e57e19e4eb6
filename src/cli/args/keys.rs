//! Options of `keys`.

use super::shared::DatabaseArgs;
use crate::cli::units;
use crate::jobs::keys::{Owner, Scope};
use clap::builder::FalseyValueParser;
use clap::{Args, Subcommand};
use std::time::Duration;

/// Actions on API keys.
#[derive(Clone, Debug, Subcommand)]
pub(in crate::cli) enum Keys {
    /// Create a key and print its secret, which is shown only once
    Add(KeysAddArgs),
    /// List the keys, without their secrets
    List {
        /// Print one JSON array
        #[arg(long, value_parser = FalseyValueParser::new())]
        json: bool,
        #[command(flatten)]
        database: DatabaseArgs,
    },
    /// Revoke a key, so that it stops working
    Revoke {
        /// Prefix of the key: the 8 digits after `oviduct_`, as shown by `keys list`
        #[arg(value_name = "PREFIX")]
        prefix: String,
        #[command(flatten)]
        database: DatabaseArgs,
    },
    /// Replace a key with a new one that has the same owner, scopes, limits and expiry, and print
    /// the new secret
    Rotate(KeysRotateArgs),
}

/// Options of `keys add`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct KeysAddArgs {
    /// Owner of everything that is requested with the key: 1 to 64 letters, digits, `.`, `_`, `-`,
    /// `@`. Several keys may share an owner
    #[arg(long, value_name = "NAME")]
    pub(in crate::cli) owner: Owner,
    /// Scopes of the key, separated by commas: read and submit (the owner's own models), admin
    /// (everything)
    #[arg(long, value_name = "LIST", value_delimiter = ',', required = true)]
    pub(in crate::cli) scopes: Vec<Scope>,
    /// Time after which the key expires, such as 30d [default: never]
    #[arg(long, value_name = "TIME", value_parser = units::positive_duration)]
    pub(in crate::cli) expires: Option<Duration>,
    /// Average number of requests per second [default: --key-rate of the service]
    #[arg(long, value_name = "N", value_parser = units::positive_rate)]
    pub(in crate::cli) rate: Option<f64>,
    /// Maximum number of queued and running models of the owner [default: --key-models of the
    /// service]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(in crate::cli) models: Option<u64>,
    /// Maximum total size of the owner's files; an owner at the limit cannot request models
    /// [default: --key-bytes of the service]
    #[arg(long, value_name = "SIZE", value_parser = units::bytes)]
    pub(in crate::cli) bytes: Option<u64>,
    /// Create the SQLite database if it does not exist, for a service that will start later
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) create: bool,
    /// Print one JSON object
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
    #[command(flatten)]
    pub(in crate::cli) database: DatabaseArgs,
}

/// Options of `keys rotate`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct KeysRotateArgs {
    /// Prefix of the key: the 8 digits after `oviduct_`, as shown by `keys list`
    #[arg(value_name = "PREFIX")]
    pub(in crate::cli) prefix: String,
    /// Time for which the old key still works, such as 1h [0: none]
    #[arg(long, value_name = "TIME", value_parser = units::duration_or_zero, default_value = "0")]
    pub(in crate::cli) overlap: Duration,
    /// Print one JSON object
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
    #[command(flatten)]
    pub(in crate::cli) database: DatabaseArgs,
}
