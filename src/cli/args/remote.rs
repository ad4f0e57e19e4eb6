//! Options of commands that talk to a service.

use crate::cli::secret::Key;
use clap::Args;

/// Address of a service and the API key for it.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct RemoteArgs {
    /// Address of the service
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:8080")]
    pub(in crate::cli) url: String,
    /// API key, sent as `Authorization: Bearer`. Other users of this machine can see command lines,
    /// so prefer the variable OVIDUCT_KEY [default: none]
    #[arg(long, value_name = "SECRET")]
    pub(in crate::cli) key: Option<Key>,
}
