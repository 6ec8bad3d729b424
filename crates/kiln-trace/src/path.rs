//! Which instructions the kernels are compiled for, chosen at run time.

use crate::lanes::{Lanes, Portable};

/// Instructions that the CPU tracer uses. Results are the same bits on all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Path {
    /// AVX2, on x86-64.
    Avx2,
    /// What the target always has.
    Portable,
}

impl Path {
    /// The fastest that this processor has.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if crate::avx2::is_available() {
            return Self::Avx2;
        }
        Self::Portable
    }

    /// Runs a kernel with these instructions, or portable ones where the processor lacks them.
    pub(crate) fn run<K: Kernel>(self, kernel: K) {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 if crate::avx2::is_available() => crate::avx2::run(kernel),
            _ => Portable::compiled(kernel),
        }
    }
}

/// Work that is written once for all lanes. `run` and all that it calls for each ray are inlined, up to the next kernel.
pub(crate) trait Kernel {
    fn run<V: Compiled>(self);
}

/// Lanes with the instructions that their kernels are compiled for.
pub(crate) trait Compiled: Lanes {
    /// Runs a kernel in a function of its own.
    fn compiled<K: Kernel>(kernel: K);
}

impl Compiled for Portable {
    #[inline(never)]
    fn compiled<K: Kernel>(kernel: K) {
        kernel.run::<Self>();
    }
}
