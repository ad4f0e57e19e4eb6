//! Errors of GPUs. The messages are stored in the record of a job.

/// Error of an adapter or a batch. The model is never the cause: the same plans run on the CPU.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GpuError {
    /// No graphics interface could be loaded: there is no loader, or the loader found no driver.
    #[error(
        "no graphics interface could be loaded (on Linux: the Vulkan loader, Debian package libvulkan1, and a driver)"
    )]
    NoLoader,
    /// No adapter may be used.
    #[error("no GPU was found{}", if *.software { "; a software adapter exists but is not allowed" } else { "" })]
    NoAdapter {
        /// True if software adapters exist that are not allowed.
        software: bool,
    },
    /// A choice names no adapter, or several.
    #[error("{detail}")]
    NotChosen {
        /// The choice, and the adapters of this machine.
        detail: String,
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
    /// The device was lost, or completed nothing for [`super::GpuOptions::stall`]. Open a new
    /// device.
    #[error("the GPU was lost: {detail}")]
    Lost {
        /// The message of the driver.
        detail: String,
    },
    /// The device refused a command: a defect of this program or of the driver.
    #[error("the GPU refused a command: {detail}")]
    Refused {
        /// The message.
        detail: String,
    },
}
