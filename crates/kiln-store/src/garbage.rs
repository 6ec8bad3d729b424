//! Collection: the packs that were used longest ago go, until the rest fits.
//!
//! A pack stays as long as anything in it is alive: space within packs is not reclaimed.

use crate::{Store, StoreError, packs};
use kiln_core::Digest;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::PoisonError,
};

/// What a collection did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Collected {
    /// Packs removed.
    pub packs: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Artefacts that were in them.
    pub artefacts: u64,
    /// Bytes of packs that stay: above the limit only if what is alive or was just used is.
    pub kept_bytes: u64,
}

impl Store {
    /// Removes packs, those not used for longest first, until all together have at most `max_bytes`. Packs with
    /// anything of `live`, artefacts and results' artefacts, stay, and so do those used within
    /// [`crate::OpenOptions::garbage_grace_secs`].
    pub fn collect_garbage(&self, live: &BTreeSet<Digest>, max_bytes: u64) -> Result<Collected, StoreError> {
        let _gate = self.gate.write().unwrap_or_else(PoisonError::into_inner);
        let packs = &self.catalogue.packs;
        let mut kept_bytes = packs.bytes();
        let mut collected = Collected { kept_bytes, ..Collected::default() };
        if kept_bytes <= max_bytes {
            return Ok(collected);
        }
        let mut contents: BTreeMap<Digest, Vec<Digest>> = BTreeMap::new();
        for (digest, location) in self.catalogue.artefacts()? {
            contents.entry(location.pack).or_default().push(digest);
        }
        let before = packs::before(self.options.garbage_grace_secs);
        let mut candidates = packs.list();
        candidates.retain(|(_, pack)| pack.used_unix_ms() <= before);
        candidates.sort_by_key(|(name, pack)| (pack.used_unix_ms(), *name));
        let (mut chosen, mut artefacts) = (Vec::new(), BTreeSet::new());
        for (name, pack) in candidates {
            if kept_bytes <= max_bytes {
                break;
            }
            let held = contents.get(&name).map_or(&[][..], Vec::as_slice);
            if held.iter().any(|digest| live.contains(digest)) || self.names_live_results(&name, live) {
                continue;
            }
            kept_bytes -= pack.bytes;
            collected.bytes += pack.bytes;
            artefacts.extend(held.iter().copied());
            chosen.push(name);
        }
        if chosen.is_empty() {
            return Ok(collected);
        }
        self.catalogue.forget_packs(&chosen, &artefacts)?;
        chosen.iter().try_for_each(|name| packs.remove(name))?;
        collected.packs = chosen.len() as u64;
        collected.artefacts = artefacts.len() as u64;
        collected.kept_bytes = kept_bytes;
        Ok(collected)
    }

    /// Whether a pack records that a live artefact is a task's result.
    fn names_live_results(&self, pack: &Digest, live: &BTreeSet<Digest>) -> bool {
        self.catalogue
            .packs
            .header(pack)
            .is_ok_and(|(header, _)| header.table.results.iter().any(|(_, digest)| live.contains(digest)))
    }
}
