//! The header and the section table.

use crate::{
    PackError,
    bytes::{u16_at, u32_at, u64_at},
    format::{
        ALIGNMENT, ENTRY_BYTES, FLAG_REQUIRED, HEADER_BYTES, MAJOR, MAX_SECTIONS, SIGNATURE, SectionKind, entry, header,
    },
};

/// Records of one kind. Its bytes are exactly `count × stride`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Table<'a> {
    bytes: &'a [u8],
    stride: usize,
    count: usize,
}

impl<'a> Table<'a> {
    pub(super) const fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    pub(super) const fn stride(&self) -> usize {
        self.stride
    }

    pub(super) const fn count(&self) -> usize {
        self.count
    }

    #[inline]
    pub(super) fn record(&self, index: u32) -> Option<&'a [u8]> {
        let index = index as usize;
        if index >= self.count {
            return None;
        }
        self.bytes.get(index * self.stride..)?.get(..self.stride)
    }

    pub(super) fn records(&self) -> impl Iterator<Item = (u32, &'a [u8])> + use<'a> {
        // A stride of nothing occurs only without bytes.
        (0..).zip(self.bytes.chunks_exact(self.stride.max(1)))
    }

    /// Index of the first record that is not below what is looked for; `order` compares a record with it.
    pub(super) fn search(&self, order: impl Fn(&'a [u8]) -> core::cmp::Ordering) -> Option<u32> {
        let (mut low, mut high) = (0, self.count as u32);
        while low < high {
            let middle = low.midpoint(high);
            match order(self.record(middle)?) {
                core::cmp::Ordering::Less => low = middle + 1,
                core::cmp::Ordering::Greater => high = middle,
                core::cmp::Ordering::Equal => return Some(middle),
            }
        }
        None
    }
}

/// What a section holds, and how large it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SectionSize {
    /// Number of its kind.
    pub number: u32,
    /// Its kind, if this version knows it.
    pub kind: Option<SectionKind>,
    /// Records.
    pub count: u32,
    /// Bytes, without padding.
    pub bytes: u64,
}

/// The sections of a pack.
#[derive(Clone, Debug)]
pub(super) struct Sections<'a> {
    /// The whole pack.
    pub(super) bytes: &'a [u8],
    pub(super) minor: u16,
    entries: Entries<'a>,
    tables: [Table<'a>; SectionKind::ALL.len()],
}

impl<'a> Sections<'a> {
    pub(super) fn parse(bytes: &'a [u8]) -> Result<Self, PackError> {
        let (bytes, entries) = parse_header(bytes)?;
        let mut tables = [Table::default(); SectionKind::ALL.len()];
        let mut free = entries.end();
        for (index, fields) in entries.iter() {
            let section = Entry::parse(index, fields, bytes, free)?;
            free = section.end;
            let Some(kind) = SectionKind::of(section.kind) else {
                if section.flags & FLAG_REQUIRED != 0 {
                    return Err(PackError::UnknownRequired { kind: section.kind });
                }
                continue;
            };
            let table = &mut tables[kind as usize - 1];
            if table.stride != 0 {
                return Err(section.wrong("is the second of its kind"));
            }
            *table = section.table()?;
        }
        Ok(Self { bytes, minor: u16_at(bytes, header::MINOR), entries, tables })
    }

    pub(super) fn get(&self, kind: SectionKind) -> Table<'a> {
        self.tables[kind as usize - 1]
    }

    pub(super) fn sizes(&self) -> impl Iterator<Item = SectionSize> + use<'a> {
        self.entries.iter().map(|(_, fields)| SectionSize {
            number: u32_at(fields, entry::KIND),
            kind: SectionKind::of(u32_at(fields, entry::KIND)),
            count: u32_at(fields, entry::COUNT),
            bytes: u64_at(fields, entry::BYTES),
        })
    }
}

/// The section table.
#[derive(Clone, Copy, Debug)]
struct Entries<'a> {
    bytes: &'a [u8],
    stride: usize,
    /// Where it begins.
    start: usize,
}

impl<'a> Entries<'a> {
    fn iter(self) -> impl Iterator<Item = (u32, &'a [u8])> + use<'a> {
        (0..).zip(self.bytes.chunks_exact(self.stride))
    }

    const fn end(&self) -> usize {
        self.start + self.bytes.len()
    }
}

/// The pack without what may follow it, and its section table.
fn parse_header(bytes: &[u8]) -> Result<(&[u8], Entries<'_>), PackError> {
    if !bytes.starts_with(&SIGNATURE) {
        return Err(PackError::NotAPack);
    }
    let actual = bytes.len() as u64;
    if bytes.len() < HEADER_BYTES {
        return Err(PackError::CutOff { stated: HEADER_BYTES as u64, actual });
    }
    let (major, minor) = (u16_at(bytes, header::MAJOR), u16_at(bytes, header::MINOR));
    if major != MAJOR {
        return Err(PackError::Version { major, minor });
    }
    let stated = u64_at(bytes, header::PACK_BYTES);
    let whole = usize::try_from(stated).ok().and_then(|size| bytes.get(..size));
    let pack = whole.ok_or(PackError::CutOff { stated, actual })?;
    let wrong = |field, value: u32| PackError::Header { field, value: u64::from(value) };
    let start = u32_at(bytes, header::HEADER_BYTES);
    if (start as usize) < HEADER_BYTES {
        return Err(wrong("size", start));
    }
    let stride = u32_at(bytes, header::ENTRY_BYTES);
    if (stride as usize) < ENTRY_BYTES {
        return Err(wrong("size of section entries", stride));
    }
    let count = u32_at(bytes, header::SECTION_COUNT);
    if count > MAX_SECTIONS {
        return Err(wrong("number of sections", count));
    }
    let table_bytes = (stride as usize).checked_mul(count as usize);
    let table = table_bytes.and_then(|size| pack.get(start as usize..)?.get(..size));
    let bytes = table.ok_or(wrong("number of sections", count))?;
    Ok((pack, Entries { bytes, stride: stride as usize, start: start as usize }))
}

/// An entry of the section table that lies within the pack, after the one before it.
struct Entry<'a> {
    index: u32,
    kind: u32,
    flags: u32,
    count: usize,
    stride: usize,
    bytes: &'a [u8],
    end: usize,
}

impl<'a> Entry<'a> {
    /// `free` is the end of what lies before it.
    fn parse(index: u32, fields: &[u8], pack: &'a [u8], free: usize) -> Result<Self, PackError> {
        let kind = u32_at(fields, entry::KIND);
        let wrong = |problem| PackError::Section { index, kind, problem };
        let place = |at| usize::try_from(u64_at(fields, at)).ok();
        let offset = place(entry::OFFSET).ok_or(wrong("begins beyond the pack's end"))?;
        let size = place(entry::BYTES).ok_or(wrong("is larger than the pack"))?;
        if offset % ALIGNMENT != 0 {
            return Err(wrong("is not aligned to 16 bytes"));
        }
        if offset < free {
            return Err(wrong("overlaps what is before it, or is out of order"));
        }
        let bytes = pack.get(offset..).and_then(|rest| rest.get(..size)).ok_or(wrong("ends beyond the pack's end"))?;
        Ok(Self {
            index,
            kind,
            flags: u32_at(fields, entry::FLAGS),
            count: u32_at(fields, entry::COUNT) as usize,
            stride: u32_at(fields, entry::STRIDE) as usize,
            bytes,
            // It is within the pack, so this does not overflow.
            end: offset + size,
        })
    }

    fn table(&self) -> Result<Table<'a>, PackError> {
        if self.stride == 0 || self.count.checked_mul(self.stride) != Some(self.bytes.len()) {
            return Err(self.wrong("has another size than its records"));
        }
        Ok(Table { bytes: self.bytes, stride: self.stride, count: self.count })
    }

    const fn wrong(&self, problem: &'static str) -> PackError {
        PackError::Section { index: self.index, kind: self.kind, problem }
    }
}
