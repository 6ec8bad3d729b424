//! The output's binary data: what the source had, byte for byte, then what is new.
//!
//! A .glb has one binary chunk, which is buffer 0. The source's own chunk stays its start. Buffers in files of their
//! own or in data URIs are appended to it, and views into them moved, so that the output needs no other file. Buffers
//! without bytes, which only an extension can explain, stay as they are, after buffer 0.

use super::array_mut;
use crate::{
    SceneError,
    accessor::TYPES,
    document::{Buffer, Bytes, Document},
};
use kiln_core::ValueFormat;
use serde_json::{Map, Value, json};

/// A glTF bufferView target: vertex attributes.
const ARRAY_BUFFER: u32 = 34_962;

/// The binary chunk under construction.
pub(super) struct Binary {
    bytes: Vec<u8>,
    /// JSON of buffer 0, if there is one yet.
    primary: Option<Map<String, Value>>,
}

/// Where a buffer of the source is in the output.
#[derive(Clone, Copy)]
struct Moved {
    buffer: usize,
    offset: usize,
}

impl Binary {
    /// Takes over the source's buffers, and rewrites `buffers` (without buffer 0, which `finish` puts there) and
    /// `bufferViews` of `root`.
    pub(super) fn merge(document: &Document<'_>, root: &mut Value) -> Result<Self, SceneError> {
        let mut binary = Self { bytes: document.chunk.unwrap_or_default().to_vec(), primary: None };
        let mut kept = Vec::new();
        let mut moved = Vec::new();
        let sources = root.get_mut("buffers").and_then(Value::as_array_mut).map(std::mem::take).unwrap_or_default();
        for (buffer, json) in document.buffers.iter().zip(sources) {
            let offset = match &buffer.bytes {
                Bytes::Chunk(_) => Some(0),
                bytes => bytes.get().map(|bytes| binary.append(&bytes[..buffer.byte_length])),
            };
            match offset {
                Some(offset) => {
                    binary.absorb(buffer, json, offset);
                    moved.push(Moved { buffer: 0, offset });
                }
                None => {
                    kept.push(json);
                    moved.push(Moved { buffer: kept.len(), offset: 0 });
                }
            }
        }
        if !document.buffers.is_empty() {
            root["buffers"] = Value::Array(kept);
        }
        for view in root.get_mut("bufferViews").and_then(Value::as_array_mut).into_iter().flatten() {
            move_view(view, &moved);
        }
        Ok(binary)
    }

    /// Makes the JSON of a buffer that is now part of buffer 0 that one's, or keeps what else it says in its extras.
    fn absorb(&mut self, buffer: &Buffer<'_>, json: Value, offset: usize) {
        let Value::Object(mut json) = json else { return };
        json.shift_remove("uri");
        let Some(primary) = &mut self.primary else {
            self.primary = Some(json);
            return;
        };
        json.shift_remove("byteLength");
        if json.is_empty() {
            return;
        }
        json.insert("byteOffset".to_owned(), json!(offset));
        json.insert("byteLength".to_owned(), json!(buffer.byte_length));
        let extras = primary.entry("extras").or_insert_with(|| json!({}));
        if extras.is_object() {
            let kiln = &mut extras["kiln"];
            if kiln.is_null() {
                *kiln = json!({});
            }
            if let Some(merged) = array_mut(kiln, "merged_buffers") {
                merged.push(Value::Object(json));
            }
        }
    }

    /// Appends bytes at a multiple of 4, and says where.
    fn append(&mut self, bytes: &[u8]) -> usize {
        let offset = self.bytes.len().next_multiple_of(4);
        self.bytes.resize(offset, 0);
        self.bytes.extend_from_slice(bytes);
        offset
    }

    /// Adds a buffer view of vertex attributes of one format, and an accessor for each run of them.
    pub(super) fn add_attributes(&mut self, root: &mut Value, attributes: &Attributes) -> Option<Vec<usize>> {
        let stride = attributes.stride();
        let offset = self.append(&attributes.bytes);
        self.primary.get_or_insert_default();
        let views = array_mut(root, "bufferViews")?;
        let view = views.len();
        views.push(json!({
            "buffer": 0, "byteOffset": offset, "byteLength": attributes.bytes.len(), "byteStride": stride,
            "target": ARRAY_BUFFER,
        }));
        let accessors = array_mut(root, "accessors")?;
        let mut first = 0;
        let add = |&count: &usize| {
            let mut accessor = json!({
                "bufferView": view, "byteOffset": first * stride, "componentType": attributes.component_type(),
                "count": count, "type": TYPES[attributes.width - 1],
            });
            if attributes.format == ValueFormat::U16 {
                accessor["normalized"] = json!(true);
            }
            first += count;
            accessors.push(accessor);
            accessors.len() - 1
        };
        Some(attributes.runs.iter().map(add).collect())
    }

    /// Puts buffer 0 in its place; the bytes of the binary chunk, if there is one.
    pub(super) fn finish(mut self, root: &mut Value) -> Option<Vec<u8>> {
        let others = root.get("buffers").and_then(Value::as_array).is_some_and(|others| !others.is_empty());
        if self.primary.is_none() && !others {
            return (!self.bytes.is_empty()).then_some(self.bytes);
        }
        if self.bytes.is_empty() {
            // Buffer 0 has to be there, because views were moved to the buffers after it, and can't be empty.
            self.bytes = vec![0; 4];
        }
        let mut primary = self.primary.unwrap_or_default();
        primary.insert("byteLength".to_owned(), json!(self.bytes.len()));
        array_mut(root, "buffers")?.insert(0, Value::Object(primary));
        Some(self.bytes)
    }
}

/// Rewrites the buffer that a view refers to, in itself and in extensions that give it another place.
fn move_view(view: &mut Value, moved: &[Moved]) {
    move_reference(view, moved);
    for extension in view.get_mut("extensions").and_then(Value::as_object_mut).into_iter().flatten() {
        move_reference(extension.1, moved);
    }
}

fn move_reference(object: &mut Value, moved: &[Moved]) {
    let Some(buffer) = object.get("buffer").and_then(Value::as_u64) else { return };
    let Some(to) = moved.get(buffer as usize) else { return };
    object["buffer"] = json!(to.buffer);
    if to.offset > 0 {
        let offset = object.get("byteOffset").and_then(Value::as_u64).unwrap_or(0);
        object["byteOffset"] = json!(offset + to.offset as u64);
    }
}

/// Vertex attributes of one format, in runs that become accessors. Elements start at multiples of 4 bytes, as
/// glTF demands of vertex attributes.
pub(super) struct Attributes {
    format: ValueFormat,
    width: usize,
    bytes: Vec<u8>,
    runs: Vec<usize>,
}

impl Attributes {
    /// No runs yet, of elements of `width` components.
    pub(super) fn new(format: ValueFormat, width: usize) -> Self {
        Self { format, width, bytes: Vec::new(), runs: Vec::new() }
    }

    const fn stride(&self) -> usize {
        let component = match self.format {
            ValueFormat::F32 => 4,
            ValueFormat::U16 => 2,
        };
        (self.width * component).next_multiple_of(4)
    }

    const fn component_type(&self) -> u32 {
        match self.format {
            ValueFormat::F32 => 5126,
            ValueFormat::U16 => 5123,
        }
    }

    /// Adds a run of elements; integers hold values from 0 to 1.
    pub(super) fn add_run(&mut self, values: &[f32]) {
        let stride = self.stride();
        for element in values.chunks_exact(self.width) {
            let end = self.bytes.len() + stride;
            for &value in element {
                match self.format {
                    ValueFormat::F32 => self.bytes.extend_from_slice(&value.to_le_bytes()),
                    ValueFormat::U16 => self.bytes.extend_from_slice(&unorm16(value).to_le_bytes()),
                }
            }
            self.bytes.resize(end, 0);
        }
        self.runs.push(values.len() / self.width);
    }
}

/// The nearest 16-bit fraction.
fn unorm16(value: f32) -> u16 {
    (f64::from(value.clamp(0.0, 1.0)) * f64::from(u16::MAX)).round() as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_are_aligned() {
        for (format, width, stride) in [
            (ValueFormat::F32, 1, 4),
            (ValueFormat::F32, 3, 12),
            (ValueFormat::U16, 1, 4),
            (ValueFormat::U16, 2, 4),
            (ValueFormat::U16, 3, 8),
            (ValueFormat::U16, 4, 8),
        ] {
            let mut attributes = Attributes::new(format, width);
            attributes.add_run(&vec![0.5; width * 5]);
            assert_eq!(attributes.bytes.len(), 5 * stride);
        }
    }

    #[test]
    fn fractions_round_to_the_nearest() {
        assert_eq!([-1.0, 0.0, 0.5, 1.0, 2.0].map(unorm16), [0, 0, 32_768, 65_535, 65_535]);
    }

    #[test]
    fn views_are_moved_also_in_extensions() {
        let moved = [Moved { buffer: 0, offset: 0 }, Moved { buffer: 0, offset: 100 }, Moved { buffer: 1, offset: 0 }];
        let mut view = json!({ "buffer": 1, "byteLength": 4, "extensions": { "X": { "buffer": 2, "byteOffset": 8 } } });
        move_view(&mut view, &moved);
        let expected = json!({
            "buffer": 0, "byteLength": 4, "extensions": { "X": { "buffer": 1, "byteOffset": 8 } }, "byteOffset": 100
        });
        assert_eq!(view, expected);
    }
}
