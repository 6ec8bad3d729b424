//! What is written for an instance: `_AO` for each block of vertices, and colours.

use super::Target;
use crate::{SceneError, accessor::Accessor, json::Item};
use kiln_core::{ColorMode, OutputSettings, Remap, VertexBlock};

/// The values of one block's vertices.
pub(super) fn block_values<'a>(target: &Target<'a>, block: &VertexBlock, channels: usize) -> &'a [f32] {
    of_block(target.values, block, channels)
}

/// What one block's vertices have of `vertices × channels` numbers.
pub(super) fn of_block<'a>(numbers: &'a [f32], block: &VertexBlock, channels: usize) -> &'a [f32] {
    let first = block.first_vertex as usize * channels;
    &numbers[first..first + block.vertex_count as usize * channels]
}

/// One grey for each vertex: the blend of the half-distances, remapped.
pub(super) fn greys(values: &[f32], channels: usize, output: &OutputSettings) -> Vec<f32> {
    let equal = vec![1.0 / channels as f64; channels];
    let weights = output.blend.as_ref().filter(|blend| blend.len() == channels).unwrap_or(&equal);
    let grey = |element: &[f32]| {
        let blend: f64 = element.iter().zip(weights).map(|(&value, weight)| f64::from(value) * weight).sum();
        remap(blend.clamp(0.0, 1.0), output.remap.as_ref()) as f32
    };
    values.chunks_exact(channels).map(grey).collect()
}

/// Applies a curve; outside a curve's inputs its end points hold.
fn remap(value: f64, curve: Option<&Remap>) -> f64 {
    let remapped = match curve {
        None => value,
        Some(Remap::Gamma(gamma)) => value.powf(*gamma),
        Some(Remap::Curve(points)) => piecewise(value, points),
    };
    remapped.clamp(0.0, 1.0)
}

fn piecewise(value: f64, points: &[[f64; 2]]) -> f64 {
    let above = points.partition_point(|point| point[0] <= value);
    match (above.checked_sub(1).map(|below| points[below]), points.get(above)) {
        (Some([x0, y0]), Some(&[x1, y1])) => y0 + (y1 - y0) * (value - x0) / (x1 - x0),
        (Some([_, y]), None) | (None, Some(&[_, y])) => y,
        (None, None) => value,
    }
}

/// Components of a colour: RGB, or RGBA where the source has alpha.
pub(super) fn color_width(existing: Option<&Accessor<'_>>) -> usize {
    existing.map_or(3, |accessor| accessor.width)
}

/// Colours of a primitive's vertices, of `color_width` components; alpha stays as it is.
pub(super) fn colors(greys: &[f32], existing: Option<&Accessor<'_>>, mode: ColorMode) -> Result<Vec<f32>, SceneError> {
    let Some(accessor) = existing else { return Ok(greys.iter().flat_map(|&grey| [grey; 3]).collect()) };
    accessor.expect_width(&[3, 4])?;
    accessor.expect_count(greys.len(), "POSITION")?;
    let shade = |color: f32, grey: f32| match mode {
        ColorMode::Multiply => color * grey,
        ColorMode::Replace => grey,
    };
    if accessor.width == 3 {
        let existing = accessor.vectors::<3>()?;
        return Ok(existing.iter().zip(greys).flat_map(|(rgb, &grey)| rgb.map(|color| shade(color, grey))).collect());
    }
    let existing = accessor.vectors::<4>()?;
    let shaded = |(&[r, g, b, alpha], &grey): (&[f32; 4], &f32)| {
        let [r, g, b] = [r, g, b].map(|color| shade(color, grey));
        [r, g, b, alpha]
    };
    Ok(existing.iter().zip(greys).flat_map(shaded).collect())
}

/// The refusal to write a colour over one where nothing says how.
pub(super) fn color_exists(reference: &Item<'_>, mesh: &str) -> SceneError {
    SceneError::ColorExists {
        file: reference.file().to_owned(),
        place: reference.place().to_owned(),
        mesh: mesh.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves() {
        let points = vec![[0.2, 0.0], [0.6, 1.0]];
        let curve = Remap::Curve(points);
        for (value, expected) in [(0.0, 0.0), (0.2, 0.0), (0.4, 0.5), (0.6, 1.0), (1.0, 1.0)] {
            assert!((remap(value, Some(&curve)) - expected).abs() < 1e-12, "{value}");
        }
        assert_eq!(remap(0.5, Some(&Remap::Gamma(2.0))), 0.25);
        assert_eq!(remap(0.5, None), 0.5);
    }

    #[test]
    fn blends_are_weighted() {
        let output = OutputSettings { blend: Some(vec![0.25, 0.75]), ..OutputSettings::default() };
        assert_eq!(greys(&[1.0, 0.0, 0.0, 1.0, 1.0, 1.0], 2, &output), [0.25, 0.75, 1.0]);
    }
}
