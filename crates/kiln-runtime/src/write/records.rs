//! Records of each kind; their layout is `format.rs`.

use super::{
    EdgeData, ModelData, PackData, RegionData, RegionsData, RemapData, ScalarData, TreeInstanceData, ValueData,
    WriteError, sections::Section,
};
use crate::{
    format::{HARMONICS, MAX_CHANNELS, NONE, PARAMETERS, SectionKind, VALUES_ARE_F32, VALUES_ARE_U16},
    half,
    pack::volume,
};
use alloc::vec::Vec;

/// All sections, those without records too.
pub(super) fn sections(data: &PackData<'_>) -> Result<Vec<Section>, WriteError> {
    let channels = data.meta.half_distances.len();
    if !(1..=MAX_CHANNELS).contains(&channels) {
        return Err(WriteError::Channels { channels });
    }
    expect("the blend", 0, data.meta.blend.len(), channels)?;
    let mut strings = Section::new(SectionKind::Strings, channels);
    let mut values = Values::new(channels);
    let mut sections = Vec::new();
    sections.extend(meta(data, channels, &mut strings)?);
    sections.push(vertex_sets(data, &mut values)?);
    sections.extend(tree_models(data, &mut values)?);
    sections.push(tree_instances(&data.tree_instances, channels)?);
    sections.push(scalars(&data.scalars, channels)?);
    sections.extend(regions(&data.regions, channels, &mut strings)?);
    sections.push(edges(&data.regions.edges, channels));
    sections.extend(models(data, channels)?);
    sections.extend([strings, values.floats, values.integers]);
    Ok(sections)
}

fn expect(what: &'static str, index: usize, found: usize, expected: usize) -> Result<(), WriteError> {
    if found == expected { Ok(()) } else { Err(WriteError::Size { what, index, found, expected }) }
}

fn meta(data: &PackData<'_>, channels: usize, strings: &mut Section) -> Result<[Section; 2], WriteError> {
    let [mut meta, mut curve] = [SectionKind::Meta, SectionKind::RemapCurve].map(|kind| Section::new(kind, channels));
    let source = &data.meta;
    meta.raw(&source.level_digest);
    source.origin.iter().for_each(|x| meta.f64(*x));
    meta.u32(channels as u32);
    meta.u32(source.kernel as u32);
    for list in [&source.half_distances, &source.blend] {
        meta.floats(list);
        meta.floats(&[0.0; MAX_CHANNELS][channels..]);
    }
    text(&mut meta, strings, &source.version)?;
    let (remap, gamma) = match &source.remap {
        RemapData::None => (0, 0.0),
        RemapData::Gamma(gamma) => (1, *gamma),
        RemapData::Curve(points) => {
            points.iter().for_each(|point| curve.floats(point));
            (2, 0.0)
        }
    };
    meta.u32(remap);
    meta.floats(&[gamma]);
    Ok([meta, curve])
}

/// Writes where a text is, and the text.
fn text(record: &mut Section, strings: &mut Section, text: &str) -> Result<(), WriteError> {
    record.u32(strings.index()?);
    strings.raw(text.as_bytes());
    // The end, too, is within 32 bits, and so is the length.
    strings.index()?;
    record.u32(text.len() as u32);
    Ok(())
}

/// Numbers of vertices, in both formats.
struct Values {
    floats: Section,
    integers: Section,
    channels: usize,
}

/// Numbers of a primitive begin at multiples of this, so that they can be bound as vertex buffers where they are.
const VALUES_ALIGNMENT: usize = 16;

/// Where numbers were put.
#[derive(Clone, Copy)]
struct Place {
    first: u64,
    vertex_count: u32,
    format: u32,
}

impl Values {
    const fn new(channels: usize) -> Self {
        let floats = Section::new(SectionKind::ValuesF32, channels);
        Self { floats, integers: Section::new(SectionKind::ValuesU16, channels), channels }
    }

    fn put(&mut self, what: &'static str, index: usize, values: &ValueData<'_>) -> Result<Place, WriteError> {
        let vertex_count = values.len() / self.channels;
        expect(what, index, values.len(), vertex_count * self.channels)?;
        let (section, format) = match values {
            ValueData::F32(_) => (&mut self.floats, VALUES_ARE_F32),
            ValueData::U16(_) => (&mut self.integers, VALUES_ARE_U16),
        };
        section.align(VALUES_ALIGNMENT);
        let first = section.count() as u64;
        match values {
            ValueData::F32(values) => section.floats(values),
            ValueData::U16(values) => values.iter().for_each(|value| section.u16(*value)),
        }
        section.index()?;
        Ok(Place { first, vertex_count: vertex_count as u32, format })
    }
}

/// A node and instance, by which records are sorted.
fn key(node: u32, gpu_instance: Option<u32>) -> [u32; 2] {
    [node, gpu_instance.unwrap_or(NONE)]
}

fn vertex_sets(data: &PackData<'_>, values: &mut Values) -> Result<Section, WriteError> {
    let mut records: Vec<([u32; 2], u32, Place)> = Vec::new();
    // Values lie in the order of what they belong to, whatever the order of the data.
    let mut order: Vec<usize> = (0..data.vertex_sets.len()).collect();
    order.sort_by_key(|&index| {
        let set = &data.vertex_sets[index];
        (key(set.node, set.gpu_instance), set.primitives.iter().min())
    });
    for index in order {
        let set = &data.vertex_sets[index];
        let place = values.put("vertex set", index, &set.values)?;
        records.extend(set.primitives.iter().map(|&primitive| (key(set.node, set.gpu_instance), primitive, place)));
    }
    records.sort_by_key(|(key, primitive, _)| (*key, *primitive));
    let mut section = Section::new(SectionKind::VertexSets, values.channels);
    for (key, primitive, place) in records {
        key.iter().for_each(|index| section.u32(*index));
        section.u32(primitive);
        section.u32(place.vertex_count);
        section.u64(place.first);
        section.u32(place.format);
        section.finish_record();
    }
    Ok(section)
}

fn tree_models(data: &PackData<'_>, values: &mut Values) -> Result<[Section; 2], WriteError> {
    let kinds = [SectionKind::TreeModels, SectionKind::TreeBlocks];
    let [mut models, mut blocks] = kinds.map(|kind| Section::new(kind, values.channels));
    for (index, model) in data.tree_models.iter().enumerate() {
        let first = blocks.index()?;
        for block in &model.blocks {
            let place = values.put("tree model", index, &block.values)?;
            for &primitive in &block.primitives {
                blocks.u32(primitive);
                blocks.u32(place.vertex_count);
                blocks.u64(place.first);
                blocks.u32(place.format);
                blocks.finish_record();
            }
        }
        models.u32(model.mesh);
        models.u32(first);
        models.u32(blocks.index()? - first);
        models.u32(0);
        models.floats(&model.center);
        models.u32(0);
        models.floats(&model.half_extent);
        models.finish_record();
    }
    Ok([models, blocks])
}

fn tree_instances(instances: &[TreeInstanceData], channels: usize) -> Result<Section, WriteError> {
    let mut section = Section::new(SectionKind::TreeInstances, channels);
    let mut order: Vec<usize> = (0..instances.len()).collect();
    order.sort_by_key(|&index| key(instances[index].node, instances[index].gpu_instance));
    for index in order {
        let instance = &instances[index];
        expect("tree instance", index, instance.numbers.len(), channels)?;
        key(instance.node, instance.gpu_instance).iter().for_each(|number| section.u32(*number));
        section.u32(instance.model);
        section.u32(0);
        instance.numbers.iter().for_each(|numbers| section.floats(numbers));
        section.floats(&instance.blend);
    }
    Ok(section)
}

fn scalars(scalars: &[ScalarData], channels: usize) -> Result<Section, WriteError> {
    let mut section = Section::new(SectionKind::Scalars, channels);
    let mut order: Vec<usize> = (0..scalars.len()).collect();
    order.sort_by_key(|&index| key(scalars[index].node, scalars[index].gpu_instance));
    for index in order {
        let scalar = &scalars[index];
        expect("scalar", index, scalar.values.len(), channels)?;
        key(scalar.node, scalar.gpu_instance).iter().for_each(|number| section.u32(*number));
        section.floats(&scalar.values);
    }
    Ok(section)
}

fn regions(data: &RegionsData, channels: usize, strings: &mut Section) -> Result<[Section; 2], WriteError> {
    let kinds = [SectionKind::Regions, SectionKind::RegionNeighbours];
    let [mut regions, mut neighbours] = kinds.map(|kind| Section::new(kind, channels));
    let beside = neighbours_of(data);
    for (index, region) in data.regions.iter().enumerate() {
        let own = beside.partition_point(|beside| (beside.of as usize) < index);
        let own = beside[own..].iter().take_while(|beside| beside.of as usize == index);
        let first = neighbours.index()?;
        own.clone().for_each(|beside| neighbours.u32(beside.neighbour));
        regions.floats(&region.min);
        regions.u32(region.model);
        regions.floats(&region.max);
        text(&mut regions, strings, &region.id)?;
        regions.u32(first);
        regions.u32(neighbours.index()? - first);
        regions.u32(own.filter(|beside| !beside.is_outer).count() as u32);
        regions.finish_record();
    }
    Ok([regions, neighbours])
}

/// A region's neighbour. In the order in which neighbours are written.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Beside {
    of: u32,
    /// Whether it does not overlap the region, or is not smaller.
    is_outer: bool,
    neighbour: u32,
}

/// Each pair of regions that touch, both ways, in order.
fn neighbours_of(data: &RegionsData) -> Vec<Beside> {
    let beside = |[of, neighbour]: [u32; 2]| Beside { of, is_outer: !is_inner(data, of, neighbour), neighbour };
    let both = |edge: &EdgeData| [edge.regions, [edge.regions[1], edge.regions[0]]];
    let mut pairs: Vec<Beside> = data.edges.iter().flat_map(both).map(beside).collect();
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// Whether a neighbour's box overlaps a region's by more than a face, and comes before it where a point is in both.
fn is_inner(data: &RegionsData, of: u32, neighbour: u32) -> bool {
    let both = [of, neighbour].map(|index| data.regions.get(index as usize));
    // Indices that do not exist are found by who reads the pack.
    let [Some(region), Some(other)] = both else { return false };
    let overlap = (0..3).all(|i| region.min[i].max(other.min[i]) < region.max[i].min(other.max[i]));
    let rank = |index, region: &RegionData| (volume(region.min, region.max), index);
    overlap && rank(neighbour, other) < rank(of, region)
}

fn edges(edges: &[EdgeData], channels: usize) -> Section {
    let mut section = Section::new(SectionKind::RegionEdges, channels);
    for edge in edges {
        edge.regions.iter().for_each(|index| section.u32(*index));
        section.floats(&[edge.area_m2]);
        section.floats(&edge.center);
    }
    section
}

fn models(data: &PackData<'_>, channels: usize) -> Result<[Section; 2], WriteError> {
    let kinds = [SectionKind::ModelsFull, SectionKind::ModelsEngine];
    let [mut full, mut engine] = kinds.map(|kind| Section::new(kind, channels));
    let forms = data.regions.forms;
    for (index, model) in data.regions.models.iter().enumerate() {
        expect("region model", index, model.coefficients.len(), channels * HARMONICS)?;
        if forms.full {
            full.floats(&model.center);
            full.u32(model.region);
            for parameter in 0..PARAMETERS {
                model.coefficients.iter().for_each(|parameters| full.floats(&[parameters[parameter]]));
            }
        }
        if forms.engine {
            engine.floats(&model.center);
            for parameter in 0..PARAMETERS {
                for harmonic in 0..4 {
                    let value = blended(model, &data.meta.blend, parameter, harmonic);
                    // Not for NaN, which the reader refuses.
                    if value.abs() > half::LARGEST {
                        return Err(WriteError::Half { model: index });
                    }
                    engine.u16(half::from_f32(value));
                }
            }
        }
    }
    Ok([full, engine])
}

/// A parameter of the blend of the channels.
fn blended(model: &ModelData, weights: &[f32], parameter: usize, harmonic: usize) -> f32 {
    let sum: f64 = weights.iter().map(|weight| f64::from(*weight)).sum();
    let channels = model.coefficients.chunks_exact(HARMONICS).zip(weights);
    let blend: f64 = channels.map(|(c, weight)| f64::from(c[harmonic][parameter]) * f64::from(*weight)).sum();
    (blend / sum) as f32
}
