//! Accessors: typed views of buffers (glTF 2.0, sections 3.6.2 and 5.1), strided, sparse, or without bytes.
//!
//! All ranges are checked when an accessor is opened; reading it then only meets wrong values. Nothing is
//! allocated for an accessor but by a read, which takes memory in proportion to its count: that is bounded by the
//! bytes behind it or, where there are none, by a limit.

use crate::{
    SceneError,
    document::Document,
    extensions,
    json::{EXPORT_AGAIN, Item},
    limits,
};

/// The type of an accessor's components.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn parse(item: &Item<'_>) -> Result<Self, SceneError> {
        Ok(match item.integer()? {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            other => return Err(item.invalid(format!("{other} is not a component type"))),
        })
    }

    const fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// The value at the start of `bytes`, unscaled. Exact in f64 for every type.
    fn value(self, bytes: &[u8]) -> f64 {
        match self {
            Self::I8 => f64::from(bytes[0].cast_signed()),
            Self::U8 => f64::from(bytes[0]),
            Self::I16 => f64::from(i16::from_le_bytes([bytes[0], bytes[1]])),
            Self::U16 => f64::from(u16::from_le_bytes([bytes[0], bytes[1]])),
            Self::U32 => f64::from(u32_of(bytes)),
            Self::F32 => f64::from(f32::from_bits(u32_of(bytes))),
        }
    }

    /// The greatest value, which normalised integers are divided by.
    const fn max(self) -> f64 {
        match self {
            Self::I8 => 127.0,
            Self::U8 => 255.0,
            Self::I16 => 32_767.0,
            Self::U16 => 65_535.0,
            Self::U32 => 4_294_967_295.0,
            Self::F32 => 1.0,
        }
    }
}

fn u32_of(bytes: &[u8]) -> u32 {
    u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])
}

/// Elements at a fixed distance; the range of all of them was checked.
#[derive(Clone, Copy)]
struct Elements<'d> {
    bytes: &'d [u8],
    stride: usize,
}

impl<'d> Elements<'d> {
    fn get(&self, index: usize) -> &'d [u8] {
        &self.bytes[index * self.stride..]
    }
}

/// Elements that take the place of others.
#[derive(Clone, Copy)]
struct Sparse<'d> {
    count: usize,
    index_component: Component,
    indices: Elements<'d>,
    values: Elements<'d>,
}

/// An accessor whose ranges are known to be good.
#[derive(Clone)]
pub(crate) struct Accessor<'d> {
    /// What refers to the accessor, for errors.
    pub(crate) reference: Item<'d>,
    /// Index in the document.
    pub(crate) index: usize,
    /// Number of elements.
    pub(crate) count: usize,
    /// Type of a component.
    pub(crate) component: Component,
    /// Components of an element, 1 to 4.
    pub(crate) width: usize,
    /// Whether integers stand for fractions.
    pub(crate) normalized: bool,
    base: Option<Elements<'d>>,
    sparse: Option<Sparse<'d>>,
}

impl<'d> Accessor<'d> {
    /// Opens the accessor that `reference` names by its index.
    pub(crate) fn open(document: &'d Document<'_>, reference: &Item<'d>) -> Result<Self, SceneError> {
        let (index, item) = document.list("accessors")?.resolve(reference)?;
        let reference = reference.clone().remarked(&format!("accessor {index}"));
        let count = item.require("count")?.index()?;
        let component = Component::parse(&item.require("componentType")?)?;
        let width = parse_width(&item.require("type")?)?;
        let normalized = item.get("normalized").is_some_and(|value| value.boolean() == Ok(true));
        let size = component.bytes() * width;
        let base = match item.get("bufferView") {
            Some(view) => Some(open_view(document, &view, &item, size, count, true)?),
            None if count as u64 > limits::UNBACKED_ELEMENTS => {
                let advice = "give the accessor a bufferView";
                let what = "elements without bytes behind them";
                return Err(reference.too_big(what, count as u64, limits::UNBACKED_ELEMENTS, advice));
            }
            None => None,
        };
        let sparse = item.get("sparse").map(|sparse| open_sparse(document, &sparse, size, count)).transpose()?;
        Ok(Self { reference, index, count, component, width, normalized, base, sparse })
    }

    /// Refuses an accessor of another number of components.
    pub(crate) fn expect_width(&self, widths: &[usize]) -> Result<(), SceneError> {
        if widths.contains(&self.width) {
            return Ok(());
        }
        let names: Vec<_> = widths.iter().map(|&width| TYPES[width - 1]).collect();
        let problem = format!("its type is {}, not {}", TYPES[self.width - 1], names.join(" or "));
        Err(self.reference.invalid(problem))
    }

    /// Refuses an accessor with another number of elements than another has.
    pub(crate) fn expect_count(&self, count: usize, of: &str) -> Result<(), SceneError> {
        if self.count == count {
            return Ok(());
        }
        Err(self.reference.invalid(format!("it has {} elements, but {of} has {count}", self.count)))
    }

    /// Reads vectors of `N` components, of floats or of integers as KHR_mesh_quantization permits.
    pub(crate) fn vectors<const N: usize>(&self) -> Result<Vec<[f32; N]>, SceneError> {
        self.expect_width(&[N])?;
        let component = self.component;
        match (component, self.normalized) {
            (Component::U32, _) => Err(self.reference.invalid("its components are 32-bit integers")),
            (Component::F32, _) => self.read(|bytes| f32::from_bits(u32_of(bytes))),
            (_, false) => self.read(|bytes| component.value(bytes) as f32),
            (_, true) => self.read(|bytes| (component.value(bytes) / component.max()).max(-1.0) as f32),
        }
    }

    /// Reads elements of any type as they are for a program: fractions where integers are normalised.
    pub(crate) fn numbers(&self) -> Result<Vec<Vec<f64>>, SceneError> {
        let scale = if self.normalized { self.component.max() } else { 1.0 };
        let lowest = if self.normalized { -1.0 } else { f64::NEG_INFINITY };
        let decode = |bytes: &[u8]| (self.component.value(bytes) / scale).max(lowest);
        Ok(match self.width {
            1 => self.read::<f64, 1>(decode)?.iter().map(|element| element.to_vec()).collect(),
            2 => self.read::<f64, 2>(decode)?.iter().map(|element| element.to_vec()).collect(),
            3 => self.read::<f64, 3>(decode)?.iter().map(|element| element.to_vec()).collect(),
            _ => self.read::<f64, 4>(decode)?.iter().map(|element| element.to_vec()).collect(),
        })
    }

    /// Reads vertex indices, without checking them against a number of vertices.
    pub(crate) fn indices(&self) -> Result<Vec<u32>, SceneError> {
        self.expect_width(&[1])?;
        let component = self.component;
        if !matches!(component, Component::U8 | Component::U16 | Component::U32) || self.normalized {
            return Err(self.reference.invalid("indices are unsigned integers, not normalised"));
        }
        if self.base.is_some_and(|base| base.stride != component.bytes()) {
            return Err(self.reference.invalid("the bufferView of indices has a byteStride"));
        }
        let indices = self.read::<u32, 1>(|bytes| component.value(bytes) as u32)?;
        Ok(indices.into_iter().map(|[index]| index).collect())
    }

    fn read<T: Copy + Default, const N: usize>(&self, decode: impl Fn(&[u8]) -> T) -> Result<Vec<[T; N]>, SceneError> {
        let size = self.component.bytes();
        let element = |bytes: &[u8]| std::array::from_fn(|i| decode(&bytes[i * size..]));
        let mut elements: Vec<[T; N]> = match self.base {
            Some(base) => (0..self.count).map(|i| element(base.get(i))).collect(),
            None => vec![[T::default(); N]; self.count],
        };
        let Some(sparse) = self.sparse else { return Ok(elements) };
        let mut next = 0;
        for k in 0..sparse.count {
            let index = sparse.index_component.value(sparse.indices.get(k)) as usize;
            if index < next || index >= self.count {
                let problem = format!("sparse index {k} is {index}, but indices rise and are below {}", self.count);
                return Err(self.reference.invalid(problem));
            }
            next = index + 1;
            elements[index] = element(sparse.values.get(k));
        }
        Ok(elements)
    }
}

pub(crate) const TYPES: [&str; 4] = ["SCALAR", "VEC2", "VEC3", "VEC4"];

fn parse_width(item: &Item<'_>) -> Result<usize, SceneError> {
    let name = item.string()?;
    let width = TYPES.iter().position(|known| *known == name).map(|i| i + 1);
    width.ok_or_else(|| item.invalid(format!("{name:?} is not the type of a scalar or a vector")))
}

/// The `count` elements of `size` bytes that start at `owner.byteOffset` in a buffer view.
fn open_view<'d>(
    document: &'d Document<'_>,
    reference: &Item<'d>,
    owner: &Item<'d>,
    size: usize,
    count: usize,
    may_stride: bool,
) -> Result<Elements<'d>, SceneError> {
    let (_, view) = document.list("bufferViews")?.resolve(reference)?;
    let optional = |item: &Item<'d>, key: &str| item.get(key).map_or(Ok(0), |value| value.index());
    let view_bytes = view_bytes(document, &view, optional(&view, "byteOffset")?)?;
    let stride = match view.get("byteStride") {
        Some(stride) if may_stride => stride.index()?,
        _ => size,
    };
    if stride < size {
        return Err(view.invalid(format!("its byteStride of {stride} is less than an element of {size} bytes")));
    }
    let offset = optional(owner, "byteOffset")?;
    let needed = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
    let end = needed.and_then(|needed| offset.checked_add(needed));
    match end.and_then(|end| view_bytes.get(offset..end)) {
        Some(bytes) => Ok(Elements { bytes, stride }),
        None => Err(owner.invalid(format!(
            "{count} elements of {size} bytes, {stride} apart, from byte {offset} on, don't fit into {} ({} bytes)",
            view.place(),
            view_bytes.len()
        ))),
    }
}

/// All bytes of the buffer view that `reference` names by its index.
pub(crate) fn whole_view<'d>(document: &'d Document<'_>, reference: &Item<'d>) -> Result<&'d [u8], SceneError> {
    let (_, view) = document.list("bufferViews")?.resolve(reference)?;
    let offset = view.get("byteOffset").map_or(Ok(0), |offset| offset.index())?;
    view_bytes(document, &view, offset)
}

/// The bytes of a buffer view that starts at `offset`.
fn view_bytes<'d>(document: &'d Document<'_>, view: &Item<'d>, offset: usize) -> Result<&'d [u8], SceneError> {
    let length = view.require("byteLength")?.index()?;
    let reference = view.require("buffer")?;
    let (index, buffer_item) = document.list("buffers")?.resolve(&reference)?;
    let buffer = &document.buffers[index];
    let Some(bytes) = buffer.bytes.get() else {
        let compressed = ["EXT_meshopt_compression", "KHR_meshopt_compression"];
        if let Some(name) = compressed.into_iter().find(|name| view.extension(name).is_some()) {
            return Err(view.extension_error(name, extensions::advice(name)));
        }
        return Err(buffer_item.invalid_with("it has neither a uri nor a binary chunk behind it", EXPORT_AGAIN));
    };
    let end = offset.checked_add(length).filter(|&end| end <= buffer.byte_length);
    end.and_then(|end| bytes.get(offset..end)).ok_or_else(|| {
        view.invalid(format!(
            "its {length} bytes from byte {offset} on reach beyond buffer {index} ({} bytes)",
            buffer.byte_length
        ))
    })
}

fn open_sparse<'d>(
    document: &'d Document<'_>,
    item: &Item<'d>,
    size: usize,
    of: usize,
) -> Result<Sparse<'d>, SceneError> {
    let count = item.require("count")?;
    let count = match count.index()? {
        more if more > of => return Err(count.invalid(format!("{more} elements take the place of {of}"))),
        count => count,
    };
    let (indices, values) = (item.require("indices")?, item.require("values")?);
    let component_item = indices.require("componentType")?;
    let index_component = Component::parse(&component_item)?;
    if !matches!(index_component, Component::U8 | Component::U16 | Component::U32) {
        return Err(component_item.invalid("sparse indices are unsigned integers"));
    }
    let view = |owner: &Item<'d>, size| open_view(document, &owner.require("bufferView")?, owner, size, count, false);
    let (index_elements, value_elements) = (view(&indices, index_component.bytes())?, view(&values, size)?);
    Ok(Sparse { count, index_component, indices: index_elements, values: value_elements })
}

#[cfg(test)]
#[expect(
    clippy::redundant_closure_for_method_calls,
    reason = "the method itself is not general enough in its lifetime"
)]
mod tests {
    use super::*;
    use serde_json::{Value, json};
    use std::collections::BTreeMap;

    /// Opens accessor 0 of a document whose buffer holds `bytes`, and passes it on.
    fn with<T>(
        bytes: &[u8],
        accessor: &Value,
        views: &Value,
        then: impl Fn(&Accessor<'_>) -> Result<T, SceneError>,
    ) -> Result<T, SceneError> {
        let document = json!({
            "asset": { "version": "2.0" }, "ref": 0, "accessors": [accessor], "bufferViews": views,
            "buffers": [{ "uri": "b", "byteLength": bytes.len() }],
        });
        let files: BTreeMap<String, Vec<u8>> = [("b".to_owned(), bytes.to_vec())].into();
        let text = document.to_string();
        let document = Document::parse("l.gltf", text.as_bytes(), &files)?;
        let reference = document.root().require("ref")?;
        then(&Accessor::open(&document, &reference)?)
    }

    fn floats(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|value| value.to_le_bytes()).collect()
    }

    #[test]
    fn interleaved_floats() {
        let bytes = floats(&[9.0, 1.0, 2.0, 9.0, 3.0, 4.0]);
        let accessor = json!({ "bufferView": 0, "byteOffset": 4, "count": 2, "componentType": 5126, "type": "VEC2" });
        let views = json!([{ "buffer": 0, "byteLength": 24, "byteStride": 12 }]);
        assert_eq!(
            with(&bytes, &accessor, &views, |accessor| accessor.vectors::<2>()).unwrap(),
            [[1.0, 2.0], [3.0, 4.0]]
        );
    }

    #[test]
    fn quantised_components() {
        let read = |kind: u32, normalized: bool, bytes: &[u8]| {
            let accessor = json!({
                "bufferView": 0, "count": 1, "componentType": kind, "type": "VEC3", "normalized": normalized
            });
            let views = json!([{ "buffer": 0, "byteLength": bytes.len() }]);
            with(bytes, &accessor, &views, |accessor| accessor.vectors::<3>()).unwrap()[0]
        };
        assert_eq!(read(5120, true, &[127, 0x80, 0]), [1.0, -1.0, 0.0]);
        assert_eq!(read(5120, false, &[127, 0x80, 0]), [127.0, -128.0, 0.0]);
        assert_eq!(read(5121, true, &[255, 51, 0]), [1.0, 0.2, 0.0]);
        assert_eq!(read(5122, true, &[0xff, 0x7f, 0, 0x80, 0, 0]), [1.0, -1.0, 0.0]);
        assert_eq!(read(5123, false, &[1, 1, 0, 0, 2, 0]), [257.0, 0.0, 2.0]);
        assert_eq!(read(5123, true, &[0xff, 0xff, 0, 0, 0, 0]), [1.0, 0.0, 0.0]);
    }

    #[test]
    fn sparse_over_zeros() {
        let mut bytes = floats(&[5.0, 7.0]);
        bytes.extend([1, 3]);
        let accessor = |indices: usize| {
            json!({ "count": 4, "componentType": 5126, "type": "SCALAR", "sparse": { "count": 2,
                "indices": { "bufferView": indices, "componentType": 5121 }, "values": { "bufferView": 0 } } })
        };
        let views = json!([
            { "buffer": 0, "byteLength": 8 }, { "buffer": 0, "byteOffset": 8, "byteLength": 2 },
            { "buffer": 0, "byteLength": 2 }
        ]);
        let read = |indices| with(&bytes, &accessor(indices), &views, |accessor| accessor.vectors::<1>());
        assert_eq!(read(1).unwrap(), [[0.0], [5.0], [0.0], [7.0]]);
        assert!(read(2).unwrap_err().to_string().contains("indices rise"));
    }

    #[test]
    fn ranges_are_checked() {
        let refuse = |change: Value, part: &str| {
            let mut accessor = json!({ "bufferView": 0, "count": 2, "componentType": 5126, "type": "SCALAR" });
            let mut views = json!([{ "buffer": 0, "byteLength": 8 }]);
            let target = if part == "view" { &mut views[0] } else { &mut accessor };
            for (key, value) in change.as_object().unwrap() {
                target[key] = value.clone();
            }
            with(&[0; 8], &accessor, &views, |accessor| accessor.vectors::<1>()).unwrap_err().to_string()
        };
        assert!(refuse(json!({ "count": 3 }), "").contains("don't fit"));
        assert!(refuse(json!({ "count": u64::MAX }), "").contains("don't fit"));
        assert!(refuse(json!({ "byteOffset": 5 }), "").contains("don't fit"));
        assert!(refuse(json!({ "byteOffset": u64::MAX }), "").contains("don't fit"));
        assert!(refuse(json!({ "componentType": 5124 }), "").contains("not a component type"));
        assert!(refuse(json!({ "type": "MAT4" }), "").contains("not the type"));
        assert!(refuse(json!({ "type": "VEC2" }), "").contains("don't fit"));
        assert!(refuse(json!({ "byteLength": 9 }), "view").contains("reach beyond"));
        assert!(refuse(json!({ "byteStride": 2 }), "view").contains("byteStride"));
        assert!(refuse(json!({ "buffer": 1 }), "view").contains("only 1"));
    }

    #[test]
    fn zeros_are_bounded() {
        let accessor = json!({ "count": 1u64 << 40, "componentType": 5126, "type": "VEC3" });
        let error = with(&[], &accessor, &json!([]), |accessor| accessor.vectors::<3>()).unwrap_err();
        assert!(matches!(error, SceneError::TooBig { found: 0x100_0000_0000, .. }), "{error}");
    }

    #[test]
    fn meshopt_without_fallback_is_named() {
        let document = json!({
            "asset": { "version": "2.0" }, "ref": 0, "buffers": [{ "byteLength": 4 }],
            "accessors": [{ "bufferView": 0, "count": 1, "componentType": 5126, "type": "SCALAR" }],
            "bufferViews": [{ "buffer": 0, "byteLength": 4, "extensions": { "EXT_meshopt_compression": {} } }],
        });
        let text = document.to_string();
        let files = BTreeMap::<String, Vec<u8>>::new();
        let document = Document::parse("l.gltf", text.as_bytes(), &files).unwrap();
        let error = Accessor::open(&document, &document.root().require("ref").unwrap()).err().unwrap();
        assert!(matches!(&error, SceneError::Extension { extension, .. } if extension == "EXT_meshopt_compression"));
    }
}
