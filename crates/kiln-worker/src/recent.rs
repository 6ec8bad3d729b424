//! Artefacts that were just made or had: in memory, for whoever wants them next.

use bytes::Bytes;
use kiln_core::Digest;
use std::collections::{HashMap, VecDeque};

/// Small artefacts by digest; the oldest go when there are too many bytes of them.
#[derive(Debug, Default)]
pub(crate) struct Recent {
    by_digest: HashMap<Digest, Bytes>,
    /// Oldest first.
    order: VecDeque<Digest>,
    bytes: usize,
}

impl Recent {
    /// Most bytes of all together.
    const CAPACITY_BYTES: usize = 256 << 20;

    /// Largest artefact that is small.
    pub(crate) const SMALL_BYTES: usize = 1 << 20;

    pub(crate) fn get(&self, digest: &Digest) -> Option<Bytes> {
        self.by_digest.get(digest).cloned()
    }

    /// Keeps an artefact for a while; not a large one.
    pub(crate) fn add(&mut self, digest: Digest, artefact: &Bytes) {
        if artefact.len() > Self::SMALL_BYTES || self.by_digest.contains_key(&digest) {
            return;
        }
        // What is kept has memory of its own: a part of something larger would hold all of it.
        self.by_digest.insert(digest, Bytes::copy_from_slice(artefact));
        self.order.push_back(digest);
        self.bytes += artefact.len();
        while self.bytes > Self::CAPACITY_BYTES {
            let Some(oldest) = self.order.pop_front() else { break };
            self.bytes -= self.by_digest.remove(&oldest).map_or(0, |artefact| artefact.len());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_go_first_and_large_ones_are_not_kept() {
        let mut recent = Recent::default();
        let artefact = Bytes::from(vec![0; Recent::SMALL_BYTES]);
        let digest = |number: usize| Digest::of(&number.to_le_bytes());
        let held = Recent::CAPACITY_BYTES / Recent::SMALL_BYTES;
        for number in 0..=held {
            recent.add(digest(number), &artefact);
            recent.add(digest(number), &artefact);
        }
        assert_eq!(recent.get(&digest(0)), None);
        assert!((1..=held).all(|number| recent.get(&digest(number)).as_ref() == Some(&artefact)));
        assert_eq!(recent.bytes, Recent::CAPACITY_BYTES);
        recent.add(digest(0), &Bytes::from(vec![0; Recent::SMALL_BYTES + 1]));
        assert_eq!(recent.get(&digest(0)), None);
    }
}
