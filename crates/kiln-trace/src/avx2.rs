//! Lanes in AVX2 registers, and what compiles kernels for them.
//!
//! All unsafe code of the tracer is here. An [`Avx2`] exists only inside kernels that [`run`] has started, which asks the
//! processor first.

#![expect(unsafe_code, reason = "instructions that not every processor has")]

use crate::{
    lanes::Lanes,
    path::{Compiled, Kernel},
};
use std::arch::x86_64::*;

/// Eight lanes in one register.
#[derive(Clone, Copy)]
pub(crate) struct Avx2(__m256);

macro_rules! binary {
    ($($name:ident $intrinsic:ident),*) => {
        $(
        #[inline(always)]
        fn $name(self, other: Self) -> Self {
            // SAFETY: an Avx2 exists only where the processor has AVX2.
            Self(unsafe { $intrinsic(self.0, other.0) })
        }
        )*
    };
}

macro_rules! comparison {
    ($($name:ident $predicate:ident),*) => {
        $(
        #[inline(always)]
        fn $name(self, other: Self) -> __m256 {
            // SAFETY: an Avx2 exists only where the processor has AVX2.
            unsafe { _mm256_cmp_ps::<$predicate>(self.0, other.0) }
        }
        )*
    };
}

impl Lanes for Avx2 {
    type Mask = __m256;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        // SAFETY: called only from kernels that run where the processor has AVX2.
        Self(unsafe { _mm256_set1_ps(x) })
    }

    #[inline(always)]
    fn load(row: &[f32; 8]) -> Self {
        // SAFETY: eight floats are readable; the rest as in `splat`.
        Self(unsafe { _mm256_loadu_ps(row.as_ptr()) })
    }

    #[inline(always)]
    fn store(self, row: &mut [f32; 8]) {
        // SAFETY: eight floats are writable; the rest as in `splat`.
        unsafe { _mm256_storeu_ps(row.as_mut_ptr(), self.0) }
    }

    binary!(
        add _mm256_add_ps,
        sub _mm256_sub_ps,
        mul _mm256_mul_ps,
        min _mm256_min_ps,
        max _mm256_max_ps
    );
    comparison!(le _CMP_LE_OQ);

    #[inline(always)]
    fn bits(mask: __m256) -> u32 {
        // SAFETY: a mask comes from an Avx2.
        unsafe { _mm256_movemask_ps(mask) }.cast_unsigned()
    }

    #[inline(always)]
    fn select(mask: __m256, a: Self, b: Self) -> Self {
        // SAFETY: a mask comes from an Avx2.
        Self(unsafe { _mm256_blendv_ps(b.0, a.0, mask) })
    }

    #[inline(always)]
    fn least(self) -> f32 {
        // SAFETY: an Avx2 exists only where the processor has AVX2.
        unsafe {
            let x = _mm_min_ps(_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0));
            let x = _mm_min_ps(x, _mm_movehl_ps(x, x));
            _mm_cvtss_f32(_mm_min_ss(x, _mm_movehdup_ps(x)))
        }
    }

    #[inline(always)]
    fn prefetch<T>(things: &[T]) {
        let mut at = 0;
        while at < size_of_val(things) {
            // SAFETY: a prefetch reads nothing that the program could see.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(things.as_ptr().cast::<i8>().wrapping_add(at)) };
            at += 64;
        }
    }

    #[inline(always)]
    fn column(bytes: &[u8; 64], slot: u32) -> u64 {
        // SAFETY: 64 bytes are readable; the rest as in `splat`. Bits that cross from one byte of a word to the other are
        // moved to its lower bits only: the top bit of each byte comes from the same byte, as slot is below 8.
        unsafe {
            let up = _mm_cvtsi32_si128(7 - (slot & 7).cast_signed());
            let low = _mm256_sll_epi16(_mm256_loadu_si256(bytes.as_ptr().cast()), up);
            let high = _mm256_sll_epi16(_mm256_loadu_si256(bytes.as_ptr().add(32).cast()), up);
            let low = _mm256_movemask_epi8(low).cast_unsigned();
            let high = _mm256_movemask_epi8(high).cast_unsigned();
            u64::from(low) | u64::from(high) << 32
        }
    }
}

/// Whether the processor has what kernels are compiled for here.
pub(crate) fn is_available() -> bool {
    is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("bmi1")
        && is_x86_feature_detected!("bmi2")
        && is_x86_feature_detected!("lzcnt")
        && is_x86_feature_detected!("popcnt")
}

impl Compiled for Avx2 {
    #[inline(always)]
    fn compiled<K: Kernel>(kernel: K) {
        // SAFETY: only kernels that `run` has started have Avx2 for their lanes.
        unsafe { compiled(kernel) }
    }
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn compiled<K: Kernel>(kernel: K) {
    kernel.run::<Avx2>();
}

/// Runs a kernel.
///
/// # Panics
///
/// Where the processor lacks the instructions.
pub(crate) fn run<K: Kernel>(kernel: K) {
    assert!(is_available(), "the caller has asked");
    // SAFETY: the instructions are available.
    unsafe { compiled(kernel) }
}
