//! Options of commands that talk to a service.

use crate::cli::secret::Key;
use clap::Args;

/// The service that a command talks to.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct RemoteArgs {
    /// Address of the service
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:8080")]
    pub(in crate::cli) url: String,
    /// Key of the service, sent as `Authorization: Bearer`. Other users of this machine can see command lines: prefer the
    /// variable OVIDUCT_KEY [default: none]
    #[arg(long, value_name = "SECRET")]
    pub(in crate::cli) key: Option<Key>,
}
