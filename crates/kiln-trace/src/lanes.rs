//! Eight numbers at once.
//!
//! Kernels are written once, for any [`Lanes`]. Which instructions they become is chosen at run time: [`crate::avx2`]
//! where the processor has them, else [`Portable`], whose loops a compiler turns into whatever vectors the target has
//! (SSE2, NEON). Every operation is one IEEE operation rounded once, and none is fused, so that both give the same bits.
//!
//! Generic kernels and all that they call for each ray are `#[inline(always)]`, without closures: only what is inlined into
//! a function compiled for the instructions may use them.

/// Eight `f32`, and what the kernels do with them.
///
/// `min` and `max` give the second operand where one is NaN; comparisons with NaN are false.
pub(crate) trait Lanes: Copy {
    /// One truth value for each lane.
    type Mask: Copy;

    fn splat(x: f32) -> Self;
    fn load(row: &[f32; 8]) -> Self;
    fn store(self, row: &mut [f32; 8]);
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    fn min(self, other: Self) -> Self;
    fn max(self, other: Self) -> Self;
    fn le(self, other: Self) -> Self::Mask;
    /// Lane i in bit i.
    fn bits(mask: Self::Mask) -> u32;
    /// `a` where the mask is set, else `b`.
    fn select(mask: Self::Mask, a: Self, b: Self) -> Self;
    /// The least of the lanes, none of which is NaN.
    fn least(self) -> f32;
    /// Bit `slot` of each of 64 bytes: byte i in bit i.
    fn column(bytes: &[u8; 64], slot: u32) -> u64;
    /// Asks for what will be read soon, in lines of 64 bytes from the first of these on.
    fn prefetch<T>(things: &[T]);
}

/// Lanes for any processor.
#[derive(Clone, Copy)]
pub(crate) struct Portable([f32; 8]);

macro_rules! lanewise {
    ($name:ident, |$a:ident, $b:ident| $result:expr) => {
        #[inline(always)]
        fn $name(self, other: Self) -> Self {
            let mut out = [0.0; 8];
            for lane in 0..8 {
                let ($a, $b) = (self.0[lane], other.0[lane]);
                out[lane] = $result;
            }
            Self(out)
        }
    };
}

macro_rules! comparison {
    ($name:ident, |$a:ident, $b:ident| $result:expr) => {
        #[inline(always)]
        fn $name(self, other: Self) -> [u32; 8] {
            let mut out = [0; 8];
            for lane in 0..8 {
                let ($a, $b) = (self.0[lane], other.0[lane]);
                out[lane] = if $result { u32::MAX } else { 0 };
            }
            out
        }
    };
}

impl Lanes for Portable {
    type Mask = [u32; 8];

    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self([x; 8])
    }

    #[inline(always)]
    fn load(row: &[f32; 8]) -> Self {
        Self(*row)
    }

    #[inline(always)]
    fn store(self, row: &mut [f32; 8]) {
        *row = self.0;
    }

    lanewise!(add, |a, b| a + b);
    lanewise!(sub, |a, b| a - b);
    lanewise!(mul, |a, b| a * b);
    lanewise!(min, |a, b| if a < b { a } else { b });
    lanewise!(max, |a, b| if a > b { a } else { b });
    comparison!(le, |a, b| a <= b);

    #[inline(always)]
    fn bits(mask: [u32; 8]) -> u32 {
        let mut out = 0;
        for (lane, word) in mask.iter().enumerate() {
            out |= (word & 1) << lane;
        }
        out
    }

    #[inline(always)]
    fn select(mask: [u32; 8], a: Self, b: Self) -> Self {
        let mut out = [0.0; 8];
        for lane in 0..8 {
            out[lane] = if mask[lane] != 0 { a.0[lane] } else { b.0[lane] };
        }
        Self(out)
    }

    #[inline(always)]
    fn least(self) -> f32 {
        let mut least = f32::INFINITY;
        for x in self.0 {
            least = if x < least { x } else { least };
        }
        least
    }

    #[inline(always)]
    fn prefetch<T>(_: &[T]) {}

    #[inline(always)]
    fn column(bytes: &[u8; 64], slot: u32) -> u64 {
        let mut out = 0;
        for (word, eight) in bytes.as_chunks::<8>().0.iter().enumerate() {
            // One bit of each byte, moved to the top byte by a product whose partial sums do not meet (Steele 2013).
            let ones = u64::from_le_bytes(*eight) >> slot & 0x0101_0101_0101_0101;
            out |= (ones.wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * word);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::{Compiled, Kernel, Path};
    use proptest::prelude::*;

    /// The results of all operations, as bits.
    struct Everything<'a> {
        a: [f32; 8],
        b: [f32; 8],
        bytes: [u8; 64],
        results: &'a mut Vec<[u32; 8]>,
    }

    impl Kernel for Everything<'_> {
        #[inline(always)]
        fn run<V: Compiled>(self) {
            let Self { a, b, bytes, results } = self;
            let (x, y) = (V::load(&a), V::load(&b));
            for value in [x.add(y), x.sub(y), x.mul(y), x.min(y), x.max(y), V::splat(a[3])] {
                let mut row = [0.0; 8];
                value.store(&mut row);
                results.push(row.map(|r| if r.is_nan() { 0 } else { r.to_bits() }));
            }
            for mask in [x.le(y), y.le(x)] {
                let mut row = [0.0; 8];
                V::select(mask, x, y).store(&mut row);
                results.push(row.map(f32::to_bits));
                results.push([V::bits(mask); 8]);
            }
            for slot in 0..8 {
                let column = V::column(&bytes, slot);
                results.push([column as u32, (column >> 32) as u32, 0, 0, 0, 0, 0, 0]);
            }
        }
    }

    fn number() -> impl Strategy<Value = f32> {
        prop_oneof![
            -10f32..10.0,
            prop::num::f32::ANY,
            Just(0.0),
            Just(-0.0),
            Just(f32::INFINITY),
            Just(f32::NEG_INFINITY),
            Just(f32::NAN)
        ]
    }

    proptest! {
        #[test]
        fn columns_are_columns(bytes in prop::array::uniform32(any::<[u8; 2]>())) {
            let bytes: [u8; 64] = std::array::from_fn(|i| bytes[i / 2][i % 2]);
            for slot in 0..8 {
                let expected = (0..64).filter(|&i| bytes[i] >> slot & 1 == 1).fold(0u64, |m, i| m | 1 << i);
                prop_assert_eq!(Portable::column(&bytes, slot), expected);
            }
        }

        /// Where there is no AVX2, both are portable, and the test says so.
        #[test]
        fn avx2_gives_the_same_bits(
            a in prop::array::uniform8(number()), b in prop::array::uniform8(number()), bytes in prop::array::uniform32(any::<[u8; 2]>()),
        ) {
            if Path::detect() == Path::Portable {
                println!("no AVX2 here: portable lanes are compared with themselves");
            }
            let bytes: [u8; 64] = std::array::from_fn(|i| bytes[i / 2][i % 2]);
            let [avx2, portable] = [Path::Avx2, Path::Portable].map(|path| {
                let mut results = Vec::new();
                path.run(Everything { a, b, bytes, results: &mut results });
                results
            });
            prop_assert_eq!(avx2, portable);
        }
    }
}
