//! Random numbers by counter, of another family than the sampler's scrambles and sequences, so that what judges a
//! bake has nothing in common with it. Source: Widynski 2020, "Squares: a fast counter-based RNG".

/// An independent stream of numbers: the same for the same seed and purpose, wherever and in whatever order asked.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stream(u64);

impl Stream {
    /// A stream of its own for each pair of a seed and a purpose.
    pub(super) fn new(seed: u64, purpose: u64) -> Self {
        let squares = Self(0xb5ad_4ece_da1c_e2a9);
        let word = |at: u64| u64::from(squares.bits(at.wrapping_mul(0xd134_2543_de82_ef95)));
        let low = word(seed.wrapping_add(word(purpose) << 17)) ^ word(purpose.wrapping_add(1 << 40));
        let high = word(seed.rotate_left(29) ^ (purpose << 3) ^ (1 << 41));
        // Keys of this generator are odd and irregular.
        Self((high << 32 | low) | 1)
    }

    /// 32 random bits.
    fn bits(self, counter: u64) -> u32 {
        let y = counter.wrapping_mul(self.0);
        let z = y.wrapping_add(self.0);
        let round = |x: u64, add: u64| x.wrapping_mul(x).wrapping_add(add).rotate_left(32);
        let x = round(round(round(y, y), z), y);
        (x.wrapping_mul(x).wrapping_add(z) >> 32) as u32
    }

    /// A number in [0, 1), a multiple of 2⁻³².
    pub(super) fn unit(self, counter: u64) -> f64 {
        f64::from(self.bits(counter)) / 4_294_967_296.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_uniform_and_uncorrelated() {
        let n = 100_000;
        let stream = Stream::new(3, 7);
        let mean = (0..n).map(|i| stream.unit(i)).sum::<f64>() / n as f64;
        let square = (0..n).map(|i| stream.unit(i).powi(2)).sum::<f64>() / n as f64;
        let lagged = (0..n).map(|i| stream.unit(i) * stream.unit(i + 1)).sum::<f64>() / n as f64;
        // Standard errors: .289, .298 and .22 over √n.
        for (found, expected) in [(mean, 0.5), (square, 1.0 / 3.0), (lagged, 0.25)] {
            assert!((found - expected).abs() < 5.0 * 0.3 / (n as f64).sqrt(), "{found} {expected}");
        }
    }

    #[test]
    fn streams_differ_by_seed_and_by_purpose() {
        let first = |seed, purpose| Stream::new(seed, purpose).unit(0);
        let mut all: Vec<u64> =
            (0..40).flat_map(|seed| (0..40).map(move |purpose| first(seed, purpose).to_bits())).collect();
        all.sort_unstable();
        all.dedup();
        // 1,600 of 2³² values meet with a chance of 3e-4.
        assert_eq!(all.len(), 1600);
    }
}
