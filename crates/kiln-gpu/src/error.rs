//! What can go wrong before a tracer is ready.

use kiln_trace::TraceError;

/// A device could not be opened or made ready.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    /// No adapter has the name that was asked for.
    #[error("no GPU adapter is named like {wanted:?}; there is {found}; change KILN_GPU or use --backend cpu")]
    NotFound {
        /// Part of a name, as given.
        wanted: String,
        /// The adapters that there are.
        found: String,
    },
    /// The driver refused to open the adapter.
    #[error("cannot open the adapter {adapter}: {reason}; name another one in KILN_GPU or use --backend cpu")]
    Open {
        /// The adapter's name.
        adapter: String,
        /// What the driver said.
        reason: String,
    },
    /// The driver refused a kernel.
    #[error("the adapter {adapter} cannot run the kernel {kernel}: {reason}; update its driver or use --backend cpu")]
    Kernel {
        /// The adapter's name.
        adapter: String,
        /// The kernel's name.
        kernel: &'static str,
        /// What the driver said.
        reason: String,
    },
    /// The scene does not fit, or the device was lost while it was sent.
    #[error(transparent)]
    Trace(#[from] TraceError),
}
