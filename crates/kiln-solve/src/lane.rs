//! The instruction set that solves run on, as part of their keys.

/// Names the instruction set that faer picks at run time, such as `x86_64+avx2` or `x86_64+avx2+avx512`.
///
/// Everything in this crate but faer's factorisation gives the same bits on every machine (no fused
/// multiply-add, fixed order of sums). faer's kernels use fused operations and other widths where the processor
/// has them, so solves of two lanes may differ in the last bits, and their keys must differ. Within a lane
/// faer's blocking along sums is fixed on x86-64; elsewhere it follows the sizes of the caches.
pub fn lane() -> String {
    let mut name = std::env::consts::ARCH.to_owned();
    features().iter().filter(|(_, present)| *present).for_each(|(feature, _)| {
        name.push('+');
        name.push_str(feature);
    });
    name
}

/// What `pulp` (vector code) asks of an x86-64-v3 processor, and what faer's matrix product asks of an AVX-512 one.
#[cfg(target_arch = "x86_64")]
fn features() -> [(&'static str, bool); 2] {
    let fused = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
    let rest =
        is_x86_feature_detected!("bmi1") && is_x86_feature_detected!("bmi2") && is_x86_feature_detected!("lzcnt");
    [("avx2", fused && rest), ("avx512", is_x86_feature_detected!("avx512f"))]
}

#[cfg(target_arch = "aarch64")]
fn features() -> [(&'static str, bool); 1] {
    [("neon", std::arch::is_aarch64_feature_detected!("neon"))]
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
fn features() -> [(&'static str, bool); 0] {
    []
}

#[cfg(test)]
mod tests {
    #[test]
    fn names_the_architecture() {
        let lane = super::lane();
        assert!(lane.starts_with(std::env::consts::ARCH), "{lane}");
        assert!(lane.split('+').skip(1).all(|feature| ["avx2", "avx512", "neon"].contains(&feature)), "{lane}");
    }
}
