//! The rays of a bundle, a column for each of their numbers.

use crate::{
    ray::{TracedRay, inverse_of},
    scene::Place,
};
use glam::Vec3;

/// Rays of a bundle.
pub(crate) const BUNDLE: usize = 64;

/// Rays that are tested against one box at once.
pub(crate) const GROUP: usize = 8;

/// One number of each ray of a bundle.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Column([f32; BUNDLE]);

impl Column {
    pub(crate) const ZERO: Self = Self::of(0.0);

    /// The same for all rays.
    pub(crate) const fn of(x: f32) -> Self {
        Self([x; BUNDLE])
    }

    /// The same for all rays from one on.
    #[inline(always)]
    pub(crate) fn fill_from(&mut self, ray: usize, x: f32) {
        self.0[ray.min(BUNDLE)..].fill(x);
    }

    #[inline(always)]
    pub(crate) fn get(&self, ray: usize) -> f32 {
        self.0[ray % BUNDLE]
    }

    #[inline(always)]
    pub(crate) fn set(&mut self, ray: usize, x: f32) {
        self.0[ray % BUNDLE] = x;
    }

    #[inline(always)]
    pub(crate) fn group(&self, group: usize) -> &[f32; GROUP] {
        &self.0.as_chunks().0[group]
    }

    #[inline(always)]
    pub(crate) fn group_mut(&mut self, group: usize) -> &mut [f32; GROUP] {
        &mut self.0.as_chunks_mut().0[group]
    }
}

/// The rays of a bundle as one tree sees them, a column for each of their numbers.
#[derive(Clone, Debug)]
pub(crate) struct Rays {
    pub(crate) origin: [Column; 3],
    direction: [Column; 3],
    /// One over the direction.
    pub(crate) inverse: [Column; 3],
}

impl Rays {
    pub(crate) const NEW: Self = {
        let none = [Column::ZERO; 3];
        Self { origin: none, direction: none, inverse: none }
    };

    /// Puts a ray in; [`Rays::finish`] is due before it is traced.
    #[inline(always)]
    pub(crate) fn put(&mut self, ray: usize, origin: Vec3, direction: Vec3) {
        let (origin, direction) = (origin.to_array(), direction.to_array());
        for axis in 0..3 {
            self.origin[axis].set(ray, origin[axis]);
            self.direction[axis].set(ray, direction[axis]);
        }
    }

    /// Computes what follows from origins and directions.
    #[inline(always)]
    pub(crate) fn finish(&mut self) {
        for axis in 0..3 {
            for ray in 0..BUNDLE {
                self.inverse[axis].set(ray, inverse_of(self.direction[axis].get(ray)));
            }
        }
    }

    /// Takes over the rays of a mask from world space into that of a place, and maybe others beside them.
    #[inline(always)]
    pub(crate) fn put_seen_from(&mut self, place: &Place, world: &Self, mask: u64) {
        for group in 0..BUNDLE / 8 {
            if mask >> (8 * group) & 0xff == 0 {
                continue;
            }
            for ray in 8 * group..8 * group + 8 {
                let (origin, direction) = (place.point(world.origin(ray)), place.direction(world.direction(ray)));
                self.put(ray, origin, direction);
                for (inverse, d) in self.inverse.iter_mut().zip(direction.to_array()) {
                    inverse.set(ray, inverse_of(d));
                }
            }
        }
    }

    #[inline(always)]
    pub(crate) fn origin(&self, ray: usize) -> Vec3 {
        Vec3::from_array(row(&self.origin, ray))
    }

    #[inline(always)]
    pub(crate) fn direction(&self, ray: usize) -> Vec3 {
        Vec3::from_array(row(&self.direction, ray))
    }

    #[inline(always)]
    pub(crate) fn inverse(&self, ray: usize) -> [f32; 3] {
        row(&self.inverse, ray)
    }

    /// One of the rays, to be traced alone.
    #[inline(always)]
    pub(crate) fn alone(&self, ray: usize) -> TracedRay {
        TracedRay {
            origin: row(&self.origin, ray),
            direction: row(&self.direction, ray),
            inverse: row(&self.inverse, ray),
        }
    }
}

#[inline(always)]
pub(crate) fn row(columns: &[Column; 3], ray: usize) -> [f32; 3] {
    [columns[0].get(ray), columns[1].get(ray), columns[2].get(ray)]
}
