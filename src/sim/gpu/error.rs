//! Why a simulation did not run on a GPU, in words for a job's record.

/// What may go wrong with an adapter or a batch. None of these is the model's fault: the same plans run on the CPU.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GpuError {
    /// No graphics interface could be loaded: no loader, or none that found a driver.
    #[error(
        "no graphics interface could be loaded (on Linux: the Vulkan loader, Debian package libvulkan1, and a driver)"
    )]
    NoLoader,
    /// There is no adapter that may be used.
    #[error("no GPU was found{}", if *.software { "; a software adapter is there but not allowed" } else { "" })]
    NoAdapter {
        /// Whether software adapters were passed over.
        software: bool,
    },
    /// The driver did not open the adapter.
    #[error("{adapter} could not be opened: {detail}")]
    NotOpened {
        /// Name of the adapter.
        adapter: String,
        /// What the driver said.
        detail: String,
    },
    /// The plans do not fit the device or each other.
    #[error("the model does not fit the GPU: {detail}")]
    Unfit {
        /// What does not fit.
        detail: String,
    },
    /// The device has no memory left for the batch.
    #[error("the GPU ran out of memory")]
    OutOfMemory,
    /// The device was lost; a new one must be opened.
    #[error("the GPU was lost: {detail}")]
    Lost {
        /// What the driver said.
        detail: String,
    },
    /// The device refused a command: a fault of this program or of the driver.
    #[error("the GPU refused a command: {detail}")]
    Refused {
        /// What was said.
        detail: String,
    },
}
