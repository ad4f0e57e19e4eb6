//! Options of commands that open the job store.

use clap::Args;
use std::path::PathBuf;

/// Location of the job store.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct DatabaseArgs {
    /// Directory for the database, the artifacts and the scratch directory, unless these are set
    /// separately
    #[arg(long, value_name = "DIR", default_value = "data")]
    pub(in crate::cli) data: PathBuf,
    /// Database of the job store: `postgres://USER:PASSWORD@HOST/NAME`, `sqlite:PATH` or a path
    /// [default: DATA/oviduct.db]
    #[arg(long, value_name = "URL")]
    pub(in crate::cli) database: Option<String>,
}
