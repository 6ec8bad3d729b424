//! Large arrays on large pages of memory.
//!
//! Rays go through a tree in no order that a processor could foresee, and with pages of 4 KiB most of their steps also wait
//! for where a page is. Linux backs a mapping with pages of 2 MiB where it is asked to ("transparent huge pages"); where it
//! does not, or on other systems, all works as well, only slower.

use bytemuck::Pod;
use memmap2::MmapMut;
use std::{
    fmt,
    marker::PhantomData,
    ops::{Deref, DerefMut},
};

/// Arrays of fewer bytes than this are not worth a mapping of their own.
const LARGE: usize = 4 << 20;

/// An array of fixed length.
pub(crate) struct Pages<T> {
    memory: Memory<T>,
    len: usize,
}

enum Memory<T> {
    Heap(Vec<T>),
    Mapped(MmapMut, PhantomData<T>),
}

impl<T: Pod> Pages<T> {
    /// An array of zeros.
    pub(crate) fn zeroed(len: usize) -> Self {
        let bytes = len.saturating_mul(size_of::<T>());
        let mapped = if bytes >= LARGE { map(bytes) } else { None };
        let on_heap = || Memory::Heap(vec![T::zeroed(); len]);
        Self { memory: mapped.map_or_else(on_heap, |map| Memory::Mapped(map, PhantomData)), len }
    }
}

/// Memory from the system, none of it touched.
fn map(bytes: usize) -> Option<MmapMut> {
    let map = MmapMut::map_anon(bytes).ok()?;
    #[cfg(target_os = "linux")]
    if let Err(error) = map.advise(memmap2::Advice::HugePage) {
        // A system without large pages.
        tracing::debug!(%error, "no large pages");
    }
    Some(map)
}

impl<T: Pod> Deref for Pages<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        match &self.memory {
            Memory::Heap(vec) => vec,
            Memory::Mapped(map, _) => &bytemuck::cast_slice(map)[..self.len],
        }
    }
}

impl<T: Pod> DerefMut for Pages<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        match &mut self.memory {
            Memory::Heap(vec) => vec,
            Memory::Mapped(map, _) => &mut bytemuck::cast_slice_mut(map)[..self.len],
        }
    }
}

impl<T: Pod> Default for Pages<T> {
    fn default() -> Self {
        Self { memory: Memory::Heap(Vec::new()), len: 0 }
    }
}

impl<T: Pod> From<Vec<T>> for Pages<T> {
    fn from(vec: Vec<T>) -> Self {
        if size_of_val(vec.as_slice()) < LARGE {
            let len = vec.len();
            return Self { memory: Memory::Heap(vec), len };
        }
        let mut pages = Self::zeroed(vec.len());
        pages.copy_from_slice(&vec);
        pages
    }
}

impl<T: Pod> Clone for Pages<T> {
    fn clone(&self) -> Self {
        self.to_vec().into()
    }
}

impl<T: Pod + PartialEq> PartialEq for Pages<T> {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl<T: Pod + fmt::Debug> fmt::Debug for Pages<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_and_large_arrays_keep_what_they_are_given() {
        for len in [0, 1, 1000, LARGE / 4 - 1, LARGE / 4, LARGE / 4 + 12_345] {
            let mut pages = Pages::<u32>::zeroed(len);
            assert!(pages.len() == len && pages.iter().all(|word| *word == 0));
            pages.iter_mut().enumerate().for_each(|(index, word)| *word = index as u32);
            let vec: Vec<u32> = (0..len as u32).collect();
            assert!(pages == Pages::from(vec) && pages.clone() == pages, "{len}");
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn large_arrays_have_a_mapping_of_their_own() {
        assert!(matches!(Pages::<f32>::zeroed(LARGE / 4).memory, Memory::Mapped(..)));
        assert!(matches!(Pages::<f32>::zeroed(LARGE / 4 - 1).memory, Memory::Heap(..)));
    }
}
