//! Header, section table, and where sections lie.

use super::WriteError;
use crate::format::{ALIGNMENT, ENTRY_BYTES, HEADER_BYTES, MAJOR, MINOR, SIGNATURE, SectionKind};
use alloc::vec::Vec;

/// A section that is being written.
pub(super) struct Section {
    kind: SectionKind,
    stride: usize,
    bytes: Vec<u8>,
}

impl Section {
    pub(super) const fn new(kind: SectionKind, channels: usize) -> Self {
        Self { kind, stride: kind.record_bytes(channels), bytes: Vec::new() }
    }

    /// Records so far.
    pub(super) const fn count(&self) -> usize {
        self.bytes.len() / self.stride
    }

    /// Number of records, if 32 bits hold it.
    pub(super) fn index(&self) -> Result<u32, WriteError> {
        u32::try_from(self.count()).map_err(|_| WriteError::TooMany { kind: self.kind })
    }

    pub(super) fn u16(&mut self, number: u16) {
        self.bytes.extend(number.to_le_bytes());
    }

    pub(super) fn u32(&mut self, number: u32) {
        self.bytes.extend(number.to_le_bytes());
    }

    pub(super) fn u64(&mut self, number: u64) {
        self.bytes.extend(number.to_le_bytes());
    }

    pub(super) fn f64(&mut self, number: f64) {
        self.bytes.extend(number.to_le_bytes());
    }

    pub(super) fn floats(&mut self, numbers: &[f32]) {
        numbers.iter().for_each(|number| self.bytes.extend(number.to_le_bytes()));
    }

    pub(super) fn raw(&mut self, bytes: &[u8]) {
        self.bytes.extend(bytes);
    }

    /// Zeros up to the end of the record.
    pub(super) fn finish_record(&mut self) {
        self.align(self.stride);
    }

    /// Zeros up to a multiple of some bytes.
    pub(super) fn align(&mut self, bytes: usize) {
        self.bytes.resize(self.bytes.len().next_multiple_of(bytes), 0);
    }
}

/// The pack of some sections, in the order of their kinds. Empty ones are left out.
pub(super) fn assemble(mut sections: Vec<Section>) -> Result<Vec<u8>, WriteError> {
    sections.retain(|section| !section.bytes.is_empty());
    sections.sort_by_key(|section| section.kind);
    let mut offset = (HEADER_BYTES + ENTRY_BYTES * sections.len()).next_multiple_of(ALIGNMENT);
    let mut table = Vec::new();
    for section in &sections {
        table.extend((section.kind as u32).to_le_bytes());
        table.extend(0u32.to_le_bytes());
        table.extend((offset as u64).to_le_bytes());
        table.extend((section.bytes.len() as u64).to_le_bytes());
        table.extend(section.index()?.to_le_bytes());
        table.extend((section.stride as u32).to_le_bytes());
        offset = (offset + section.bytes.len()).next_multiple_of(ALIGNMENT);
    }
    let mut pack = Vec::with_capacity(offset);
    pack.extend(SIGNATURE);
    pack.extend(MAJOR.to_le_bytes());
    pack.extend(MINOR.to_le_bytes());
    pack.extend((HEADER_BYTES as u32).to_le_bytes());
    pack.extend((offset as u64).to_le_bytes());
    pack.extend((sections.len() as u32).to_le_bytes());
    pack.extend((ENTRY_BYTES as u32).to_le_bytes());
    pack.resize(HEADER_BYTES, 0);
    pack.extend(table);
    for section in sections {
        pack.resize(pack.len().next_multiple_of(ALIGNMENT), 0);
        pack.extend(section.bytes);
    }
    pack.resize(offset, 0);
    Ok(pack)
}
