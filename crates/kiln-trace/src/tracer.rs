//! The contract that every backend keeps.

use crate::{KernelRates, SobolScramble, SpherePoint, SphereSums};
use glam::Vec3;

/// A point whose hemisphere is gathered. It is used as it is: the origin has been moved off its surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceSample {
    /// Ray origin, metres relative to the level's origin.
    pub origin: Vec3,
    /// Unit normal that directions are distributed about.
    pub normal: Vec3,
    /// Unit normal of the surface: directions that are not above it are left out of sum and count.
    pub geometric: Vec3,
    /// Scramble of the directions.
    pub scramble: SobolScramble,
    /// Index of the first direction in the scrambled sequence, a multiple of the rays per sample.
    pub first_index: u32,
}

/// What gathering one sample gives, in integers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct CosineSums {
    /// Sum of the rays' values for each channel, in units of 2⁻¹⁶.
    pub values: [u32; 4],
    /// Rays above the surface.
    pub rays: u32,
    /// Of these, rays whose closest hit is the back of a single-sided face.
    pub back_faces: u32,
}

impl CosineSums {
    /// AO of a channel in [0, 1]; 1 for a sample without a ray above its surface.
    pub fn ao(&self, channel: usize) -> f64 {
        if self.rays == 0 { 1.0 } else { f64::from(self.values[channel]) / (65536.0 * f64::from(self.rays)) }
    }

    /// Fraction of rays whose closest hit is a back face.
    pub fn back_face_fraction(&self) -> f64 {
        if self.rays == 0 { 0.0 } else { f64::from(self.back_faces) / f64::from(self.rays) }
    }
}

/// A ray in metres relative to the level's origin. The direction need not be of unit length; `t` is in its units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts.
    pub origin: Vec3,
    /// Where it goes.
    pub direction: Vec3,
    /// Hits beyond this are not seen.
    pub t_max: f32,
}

/// The closest hit of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in units of the direction's length; infinite on a miss.
    pub t: f32,
    /// Index of the object that the scene was built of.
    pub instance: u32,
    /// Face of the mesh.
    pub primitive: u32,
    /// The back of a single-sided face was hit.
    pub back_face: bool,
}

impl Hit {
    /// No hit.
    pub const MISS: Self = Self { t: f32::INFINITY, instance: u32::MAX, primitive: u32::MAX, back_face: false };

    /// Whether anything was hit.
    pub fn is_hit(&self) -> bool {
        self.t < f32::INFINITY
    }
}

/// A backend could not trace.
#[derive(Debug, thiserror::Error)]
pub enum TraceError {
    /// The device went away; its work can be done by another.
    #[error("the device {adapter} was lost ({reason}); its leases are handed back")]
    DeviceLost {
        /// The adapter's name.
        adapter: String,
        /// What the driver said.
        reason: String,
    },
    /// The scene is larger than the device's limits.
    #[error("the scene needs {needed} bytes in {what}, the device {adapter} has {available}; use --backend cpu")]
    TooLarge {
        /// The adapter's name.
        adapter: String,
        /// Which buffer.
        what: &'static str,
        /// Bytes needed.
        needed: u64,
        /// Bytes that the device's limits permit.
        available: u64,
    },
    /// The scene has more of something than the device's ray queries can tell apart.
    #[error("the scene has {needed} {what}, the device {adapter} permits {available}; leave --ray-queries away")]
    TooMany {
        /// The adapter's name.
        adapter: String,
        /// Of what.
        what: &'static str,
        /// How many there are.
        needed: u64,
        /// How many the device permits.
        available: u64,
    },
    /// A ray starts so far from the scene that ray queries are not known to be right for it.
    #[error(
        "a ray starts {distance_m} m from the level's origin; ray queries hold up to {reach_m} m on this scene; \
         leave --ray-queries away"
    )]
    OutOfReach {
        /// Greatest coordinate of the ray's origin, metres.
        distance_m: f32,
        /// Greatest coordinate that is permitted, metres.
        reach_m: f32,
    },
}

/// A backend over one scene. Calls may come from several threads at once.
pub trait Tracer: Send + Sync {
    /// Traces `rays_per_sample` cosine-distributed rays of each sample and sums their values.
    ///
    /// `sums` has one entry for each sample; `rays_per_sample` is a power of two up to
    /// [`crate::MAX_RAYS_PER_SAMPLE`].
    fn gather_cosine(
        &self,
        samples: &[SurfaceSample],
        kernel: &KernelRates,
        rays_per_sample: u32,
        sums: &mut [CosineSums],
    ) -> Result<(), TraceError>;

    /// Traces the `rays_per_point` directions of each point, uniform over the sphere, and sums the projections of their
    /// values on the quadratic spherical harmonics.
    ///
    /// `sums` has one entry for each point; `rays_per_point` is a power of two up to [`crate::MAX_RAYS_PER_SAMPLE`]. What
    /// comes back is what [`crate::gather_sphere_by_rays`] makes of the closest hits of the same backend, which is also
    /// how a backend without a kernel of its own does it.
    fn gather_sphere(
        &self,
        points: &[SpherePoint],
        kernel: &KernelRates,
        rays_per_point: u32,
        sums: &mut [SphereSums],
    ) -> Result<(), TraceError>;

    /// Closest hit of each ray, for probes and benchmarks. `hits` has one entry for each ray.
    fn trace(&self, rays: &[Ray], hits: &mut [Hit]) -> Result<(), TraceError>;

    /// Whether each ray hits anything up to its `t_max`: with the same rays, what [`Tracer::trace`] finds. `blocked` has
    /// one entry for each ray.
    fn any_hit(&self, rays: &[Ray], blocked: &mut [bool]) -> Result<(), TraceError>;
}
