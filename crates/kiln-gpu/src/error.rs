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
    /// The driver ends loops before they are over, so that rays would miss what they meet.
    #[error(
        "the driver of the adapter {adapter} ends a shader's loops too soon, or counts wrong ({found} of {asked} rounds of a check), so that rays would miss \
         what they meet; update it (Mesa's software driver of 2025 is right, that of 22.3 is not), name another adapter in KILN_GPU, or use \
         --backend cpu"
    )]
    CutsLoops {
        /// The adapter, with its driver.
        adapter: String,
        /// Rounds that there were.
        found: u32,
        /// Rounds that were asked for.
        asked: u32,
    },
    /// The adapter has no ray queries.
    #[error(
        "the adapter {adapter} cannot trace by ray queries: {missing}; leave --ray-queries away, name another adapter in KILN_GPU, or install a \
         newer driver"
    )]
    NoRayQueries {
        /// The adapter, with its driver.
        adapter: String,
        /// What it lacks.
        missing: String,
    },
    /// Ray queries and the software traversal have other results on this device.
    #[error(
        "on the adapter {adapter} ray queries differ from the software traversal on {differing} of {rays} rays of a check; leave --ray-queries \
         away, and tell us which card and driver this is"
    )]
    RayQueriesDiffer {
        /// The adapter, with its driver.
        adapter: String,
        /// Rays whose hits differ.
        differing: usize,
        /// Rays that were traced both ways.
        rays: usize,
    },
    /// The scene does not fit, or the device was lost while it was sent.
    #[error(transparent)]
    Trace(#[from] TraceError),
}
