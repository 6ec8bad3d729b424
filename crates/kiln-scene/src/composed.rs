//! Values as a game would show them: the local AO of a tree's model times the function of its instance, and the one number of
//! a shrub ([`crate::export`] writes both).

use crate::{
    SceneError,
    accessor::Accessor,
    document::Document,
    export::{GLOBAL, SCALAR},
    instancing::EXTENSION,
    json::Item,
    scene::Placement,
};
use serde_json::Value;
use std::collections::{HashMap, hash_map::Entry};

/// What an instance has in place of values at its vertices.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Numbers {
    /// y0 to y3 for each channel, and the box in which they hold, in object space.
    Global(Vec<[f32; 4]>, [[f32; 3]; 2]),
    /// A value for each channel.
    Scalar(Vec<f32>),
}

impl Numbers {
    /// What a placement has, if anything.
    pub(crate) fn read(
        document: &Document<'_>,
        placement: &Placement,
        mesh: &Item<'_>,
        nodes: &mut Columns,
    ) -> Result<Option<Self>, SceneError> {
        let Some(node) = document.list("nodes")?.get(placement.node) else { return Ok(None) };
        let (global, scalar) = match placement.gpu_instance {
            Some(index) => match nodes.entry(placement.node) {
                Entry::Occupied(known) => of_columns(known.get(), index as usize),
                Entry::Vacant(new) => of_columns(new.insert(columns(document, &node)?), index as usize),
            },
            None => of_extras(node.value()),
        };
        let corner = |name: &str| {
            let corner = mesh.value().pointer(&format!("/extras/kiln/ao_box/{name}")).and_then(floats)?;
            <[f32; 3]>::try_from(corner).ok()
        };
        Ok(match (corner("min"), corner("max")) {
            (Some(min), Some(max)) if !global.is_empty() => Some(Self::Global(global, [min, max])),
            _ => (!scalar.is_empty()).then_some(Self::Scalar(scalar)),
        })
    }

    /// Values of a primitive's vertices, `vertices × channels`, and the number of channels, from those it has.
    pub(crate) fn compose(&self, positions: &[[f32; 3]], (channels, local): (usize, Vec<f32>)) -> (usize, Vec<f32>) {
        match self {
            Self::Scalar(ao) if local.is_empty() => (ao.len(), ao.repeat(positions.len())),
            Self::Global(global, corners) if channels == global.len() => {
                let of_vertex = |(position, local): (&[f32; 3], &[f32])| -> Vec<f32> {
                    let u = place(*position, corners);
                    let one = |([y0, y1, y2, y3], local): (&[f32; 4], &f32)| {
                        (local * (y0 + y1 * u[0] + y2 * u[1] + y3 * u[2])).clamp(0.0, 1.0)
                    };
                    global.iter().zip(local).map(one).collect()
                };
                (channels, positions.iter().zip(local.chunks_exact(channels)).flat_map(of_vertex).collect())
            }
            _ => (channels, local),
        }
    }
}

/// Where a position is within a box, each coordinate from −1 to 1, 0 where the box is flat.
fn place(position: [f32; 3], [min, max]: &[[f32; 3]; 2]) -> [f32; 3] {
    std::array::from_fn(|axis| {
        let half = 0.5 * (max[axis] - min[axis]);
        let from_middle = position[axis] - 0.5 * (max[axis] + min[axis]);
        if half > 0.0 { (from_middle / half).clamp(-1.0, 1.0) } else { 0.0 }
    })
}

type Found = (Vec<[f32; 4]>, Vec<f32>);

fn of_extras(node: &Value) -> Found {
    let at = |name: &str| node.pointer(&format!("/extras/kiln/{name}"));
    let rows = at("ao_global").and_then(Value::as_array).into_iter().flatten();
    let global = rows.filter_map(|row| <[f32; 4]>::try_from(floats(row)?).ok()).collect();
    (global, at("ao").and_then(floats).unwrap_or_default())
}

/// Attributes of the instances of nodes that have been looked at: those of trees, then the numbers of shrubs.
pub(crate) type Columns = HashMap<usize, (Vec<Column>, Option<Column>)>;

/// A row for each instance.
type Column = Vec<Vec<f64>>;

fn columns(document: &Document<'_>, node: &Item<'_>) -> Result<(Vec<Column>, Option<Column>), SceneError> {
    let attributes = node.extension(EXTENSION).and_then(|extension| extension.get("attributes"));
    let read = |name: &str| {
        let reference = attributes.as_ref().and_then(|attributes| attributes.get(name));
        reference.map(|reference| Accessor::open(document, &reference)?.numbers()).transpose()
    };
    let mut global = Vec::new();
    while let Some(column) = read(&format!("{GLOBAL}{}", global.len()))? {
        global.push(column);
    }
    Ok((global, read(SCALAR)?))
}

#[expect(clippy::cast_possible_truncation, reason = "values are f32")]
fn of_columns((global, scalar): &(Vec<Column>, Option<Column>), index: usize) -> Found {
    let row = |column: &Column| column.get(index).map(|row| row.iter().map(|x| *x as f32).collect::<Vec<f32>>());
    let global = global.iter().filter_map(|column| <[f32; 4]>::try_from(row(column)?).ok()).collect();
    (global, scalar.as_ref().and_then(row).unwrap_or_default())
}

#[expect(clippy::cast_possible_truncation, reason = "values are f32")]
fn floats(value: &Value) -> Option<Vec<f32>> {
    value.as_array()?.iter().map(|x| Some(x.as_f64()? as f32)).collect()
}
