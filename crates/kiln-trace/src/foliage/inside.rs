//! The part of a ray that is in a box.

use crate::ray::{HIT_SLACK, TracedRay, WIDEN};
use glam::Vec3;

/// A box in the space of a ray, and how far the ray goes.
pub(super) struct InBox {
    pub(super) min: Vec3,
    pub(super) max: Vec3,
    pub(super) t_max: f32,
}

impl InBox {
    /// The part of the ray.
    #[inline(always)]
    pub(super) fn part(&self, ray: &TracedRay) -> Option<[f32; 2]> {
        let [near, far] = self.between(ray);
        let far = far.min(self.t_max);
        (near < far).then_some([near, far])
    }

    /// Whether a node's slot of these bounds would be entered.
    #[inline(always)]
    pub(super) fn is_entered(&self, ray: &TracedRay) -> bool {
        let [near, far] = self.between(ray);
        near <= (far * WIDEN).min(self.t_max * HIT_SLACK)
    }

    #[inline(always)]
    fn between(&self, ray: &TracedRay) -> [f32; 2] {
        let (origin, inverse) = (Vec3::from_array(ray.origin), Vec3::from_array(ray.inverse));
        let (low, high) = ((self.min - origin) * inverse, (self.max - origin) * inverse);
        [low.min(high).max_element().max(0.0), low.max(high).min_element()]
    }
}
