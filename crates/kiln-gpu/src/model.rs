//! What rate of rays to expect of a device: a roofline (Williams, Waterman and Patterson 2009) of three roofs.
//!
//! A ray costs instructions of one lane and bytes. Instructions are bound by the device's arithmetic and by the share of
//! lanes that are busy (lanes of a cone part ways). Bytes are shared by the lanes of a cone that read the same record at
//! the same time; what is left comes from the last cache, and from memory as far as the scene is larger than that cache.
//! The least of the three rates is predicted. It is a bound with two assumptions in it ([`BUSY_LANES`],
//! [`LANES_PER_READ`]), not a measurement: docs/gpu.md says what speaks for them.

use crate::{AdapterKind, Visits};

/// Bytes of the record of a node or an instance, and of a triangle.
const NODE_BYTES: f64 = 80.0;
const TRIANGLE_BYTES: f64 = 48.0;

/// Bytes that a ray brings and takes: its share of a sample of 16 rays and of that sample's sums.
const RAY_BYTES: f64 = (48.0 + 24.0) / 16.0;

/// Instructions of a lane, counted by hand in the kernels' WGSL, a fused multiply-add as one.
const RAY_INSTRUCTIONS: f64 = 350.0;
const NODE_INSTRUCTIONS: f64 = 230.0;
const TRIANGLE_INSTRUCTIONS: f64 = 85.0;
const INSTANCE_INSTRUCTIONS: f64 = 90.0;

/// Assumed share of lanes that do something useful.
pub const BUSY_LANES: f64 = 0.4;

/// Assumed number of lanes that one read of a record serves.
pub const LANES_PER_READ: f64 = 4.0;

/// What a device can do at most, from its data sheet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Roofs {
    /// Single-precision arithmetic, a fused multiply-add counted as two, GFLOP/s.
    pub gflop_per_s: f64,
    /// Bandwidth of memory, GB/s.
    pub memory_gb_per_s: f64,
    /// Bandwidth of the last cache, GB/s.
    pub cache_gb_per_s: f64,
    /// Size of the last cache, MiB.
    pub cache_mib: f64,
}

/// What limits the rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limit {
    /// Instructions.
    Arithmetic,
    /// Bytes from the last cache.
    Cache,
    /// Bytes from memory.
    Memory,
}

/// A predicted rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// Rays per second.
    pub rays_per_s: f64,
    /// The lowest roof.
    pub limit: Limit,
    /// Instructions of one lane for one ray.
    pub instructions_per_ray: f64,
    /// Bytes of records that one ray reads, before any are shared.
    pub bytes_per_ray: f64,
}

impl Roofs {
    /// Typical figures of a kind of adapter, for want of better.
    pub fn of_kind(kind: AdapterKind) -> Self {
        let [gflop_per_s, memory_gb_per_s, cache_gb_per_s, cache_mib] = match kind {
            AdapterKind::Discrete => [15_000.0, 400.0, 1_600.0, 16.0],
            AdapterKind::Integrated | AdapterKind::Virtual | AdapterKind::Unknown => [2_000.0, 60.0, 240.0, 4.0],
            // Two cores with eight lanes at 3 GHz.
            AdapterKind::Software => [96.0, 20.0, 100.0, 16.0],
        };
        Self { gflop_per_s, memory_gb_per_s, cache_gb_per_s, cache_mib }
    }

    /// The rate that these roofs permit where rays visit on average what `visits` says, in a scene of `scene_bytes` on the
    /// device ([`crate::GpuTracer::memory_bytes`]). Without rays there are no visits.
    pub fn predict(&self, visits: &Visits, scene_bytes: u64) -> Prediction {
        let per_ray = |count: u64| count as f64 / visits.rays.max(1) as f64;
        let [nodes, triangles, instances] = [visits.nodes, visits.triangles, visits.instances].map(per_ray);
        let instructions_per_ray = RAY_INSTRUCTIONS
            + NODE_INSTRUCTIONS * nodes
            + TRIANGLE_INSTRUCTIONS * triangles
            + INSTANCE_INSTRUCTIONS * instances;
        let bytes_per_ray = NODE_BYTES * (nodes + instances) + TRIANGLE_BYTES * triangles;
        let beyond_cache = 1.0 - (self.cache_mib * 1_048_576.0 / scene_bytes.max(1) as f64).min(1.0);
        let read = bytes_per_ray / LANES_PER_READ;
        let rates = [
            (Limit::Arithmetic, 0.5e9 * self.gflop_per_s * BUSY_LANES / instructions_per_ray),
            (Limit::Cache, 1e9 * self.cache_gb_per_s / (read + RAY_BYTES)),
            (Limit::Memory, 1e9 * self.memory_gb_per_s / (read * beyond_cache + RAY_BYTES)),
        ];
        let (limit, rays_per_s) =
            rates.into_iter().fold(rates[0], |least, rate| if rate.1 < least.1 { rate } else { least });
        Prediction { rays_per_s, limit, instructions_per_ray, bytes_per_ray }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VISITS: Visits = Visits { rays: 10, hits: 5, nodes: 120, triangles: 50, instances: 10 };
    const ROOFS: Roofs = Roofs { gflop_per_s: 1000.0, memory_gb_per_s: 100.0, cache_gb_per_s: 400.0, cache_mib: 4.0 };

    #[test]
    fn costs_are_those_of_the_mean_ray() {
        let prediction = ROOFS.predict(&VISITS, 1000);
        assert!((prediction.bytes_per_ray - (13.0 * 80.0 + 5.0 * 48.0)).abs() < 1e-9);
        let instructions = 350.0 + 12.0 * 230.0 + 5.0 * 85.0 + 90.0;
        assert!((prediction.instructions_per_ray - instructions).abs() < 1e-9);
        assert_eq!(prediction.limit, Limit::Arithmetic);
        assert!((prediction.rays_per_s * instructions / 2e11 - 1.0).abs() < 1e-9);
    }

    #[test]
    fn the_lowest_roof_limits() {
        let slow = |roofs: Roofs| roofs.predict(&VISITS, 1 << 30);
        assert_eq!(slow(ROOFS).limit, Limit::Arithmetic);
        let memory = slow(Roofs { memory_gb_per_s: 1.0, ..ROOFS });
        assert_eq!(memory.limit, Limit::Memory);
        // A cache that holds the scene lifts that roof.
        let cached = slow(Roofs { memory_gb_per_s: 1.0, cache_mib: 1024.0, ..ROOFS });
        assert!(cached.rays_per_s > 3.0 * memory.rays_per_s);
        assert_eq!(slow(Roofs { cache_gb_per_s: 0.5, ..ROOFS }).limit, Limit::Cache);
    }

    #[test]
    fn better_devices_are_never_slower_and_more_visits_never_faster() {
        let kinds = [AdapterKind::Software, AdapterKind::Integrated, AdapterKind::Discrete].map(Roofs::of_kind);
        for bytes in [0, 1 << 20, 1 << 26, 1 << 34] {
            let rates = kinds.map(|roofs| roofs.predict(&VISITS, bytes).rays_per_s);
            assert!(rates[0] > 0.0 && rates[0] < rates[1] && rates[1] < rates[2]);
            let more = Visits { nodes: 240, triangles: 100, ..VISITS };
            assert!(kinds.iter().zip(rates).all(|(roofs, rate)| roofs.predict(&more, bytes).rays_per_s < rate));
        }
        assert!(ROOFS.predict(&Visits::default(), 0).rays_per_s.is_finite());
    }
}
