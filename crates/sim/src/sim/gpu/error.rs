//! Why a simulation did not run on a GPU; the messages go into the record of a job.

/// Faults of an adapter or a batch. None is a fault of the model: the same plans run on the CPU.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GpuError {
    /// No graphics interface could be loaded: no loader, or none that found a driver.
    #[error(
        "no graphics interface could be loaded (on Linux: the Vulkan loader, Debian package libvulkan1, and a driver)"
    )]
    NoLoader,
    /// There is no adapter that may be used.
    #[error("no GPU was found{}", if *.software { "; a software adapter exists but is not allowed" } else { "" })]
    NoAdapter {
        /// Whether software adapters exist that are not allowed.
        software: bool,
    },
    /// The driver did not open the adapter.
    #[error("{adapter} could not be opened: {detail}")]
    NotOpened {
        /// Name of the adapter.
        adapter: String,
        /// The message of the driver.
        detail: String,
    },
    /// The plans do not fit the device or each other.
    #[error("the model does not fit the GPU: {detail}")]
    Unfit {
        /// What does not fit.
        detail: String,
    },
    /// The device has too little free memory for the batch.
    #[error("the GPU ran out of memory")]
    OutOfMemory,
    /// The device was lost, or completed nothing for [`super::GpuOptions::stall`]; a new one must be opened.
    #[error("the GPU was lost: {detail}")]
    Lost {
        /// The message of the driver.
        detail: String,
    },
    /// The device refused a command: a fault of this program or of the driver.
    #[error("the GPU refused a command: {detail}")]
    Refused {
        /// The message.
        detail: String,
    },
}
