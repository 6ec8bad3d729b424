//! From alpha to a bit for each texel.
//!
//! A renderer compares the alpha that it interpolates between four texels with the cutoff, so that edges are lines and curves,
//! not steps. The mask has 4 × 4 bits for each texel, each the comparison at its own middle: an edge is where a renderer near
//! by has it, to an eighth of a texel. Where that would be more than 2 MiB it is 2 × 2, or one. A texture that is
//! magnified with NEAREST has the steps, and one bit for each texel. Smaller mip levels are not looked at.

use super::image::Alpha;
use kiln_core::{Mask, Wrap};

/// Bits of the largest mask that has more than one for each texel.
const MOST_BITS: u64 = 1 << 24;

/// The mask of an image under a factor and a cutoff: opaque is what is not below the cutoff.
pub(super) fn mask(alpha: &Alpha, wrap: [Wrap; 2], is_nearest: bool, factor: f64, cutoff: f64) -> Mask {
    let is_opaque = |value: f64| value / 255.0 * factor >= cutoff;
    let (least, greatest) =
        alpha.values.iter().fold((u8::MAX, 0), |(least, greatest), &value| (value.min(least), value.max(greatest)));
    if is_opaque(f64::from(least)) || !is_opaque(f64::from(greatest)) {
        return Mask::uniform(is_opaque(f64::from(least)));
    }
    let fits = |parts: &u32| u64::from(parts * parts) * alpha.pixels() <= MOST_BITS;
    let parts = if is_nearest { 1 } else { [4, 2].into_iter().find(fits).unwrap_or(1) };
    let texel = |[x, y]: [u32; 2]| u32::from(alpha.values[y as usize * alpha.size[0] as usize + x as usize]);
    Mask::new(alpha.size.map(|size| size * parts), wrap, |at| {
        let [u, v] = [0, 1].map(|axis| between(at[axis], parts, wrap[axis], alpha.size[axis]));
        let mut sum = 0;
        for (x, weight_x) in u {
            for (y, weight_y) in v {
                sum += texel([x, y]) * weight_x * weight_y;
            }
        }
        is_opaque(f64::from(sum) / f64::from(4 * parts * parts))
    })
}

/// The two texels that the middle of a part of a texel lies between, and their weights, of which the sum is twice the number
/// of parts.
fn between(at: u32, parts: u32, wrap: Wrap, size: u32) -> [(u32, u32); 2] {
    let (cell, part) = (i64::from(at / parts), at % parts);
    // How far behind the middle of the texel before: its half, and what of the part's own texel lies before the part's middle.
    let behind = parts + 2 * part + 1;
    let (first, behind) = if behind < 2 * parts { (cell - 1, behind) } else { (cell, behind - 2 * parts) };
    [(wrap.texel(first, size), 2 * parts - behind), (wrap.texel(first + 1, size), behind)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Alpha as a renderer interpolates it.
    fn bilinear(alpha: &Alpha, wrap: [Wrap; 2], uv: [f64; 2]) -> f64 {
        let cell = |axis: usize| {
            let x = uv[axis] * f64::from(alpha.size[axis]) - 0.5;
            (x.floor() as i64, x - x.floor())
        };
        let ((x, fx), (y, fy)) = (cell(0), cell(1));
        let texel = |x: i64, y: i64| {
            let [x, y] = [wrap[0].texel(x, alpha.size[0]), wrap[1].texel(y, alpha.size[1])];
            f64::from(alpha.values[(y * alpha.size[0] + x) as usize]) / 255.0
        };
        let row = |y: i64| texel(x, y) * (1.0 - fx) + texel(x + 1, y) * fx;
        row(y) * (1.0 - fy) + row(y + 1) * fy
    }

    proptest! {
        #[test]
        fn parts_are_as_a_renderer_has_them(
            width in 1u32..9, height in 1u32..9, values in prop::collection::vec(any::<u8>(), 64),
            wraps in prop::array::uniform2(0usize..3), factor in 0.2f64..1.0, cutoff in 0.1f64..0.9,
        ) {
            let wrap = wraps.map(|wrap| [Wrap::Repeat, Wrap::Mirrored, Wrap::Clamp][wrap]);
            let values = values[..(width * height) as usize].to_vec();
            let alpha = Alpha { size: [width, height], values };
            for (is_nearest, parts) in [(true, 1), (false, 4)] {
                let mask = mask(&alpha, wrap, is_nearest, factor, cutoff);
                for (x, y) in (0..parts * width).flat_map(|x| (0..parts * height).map(move |y| (x, y))) {
                    let middle = |at: u32, size: u32| (f64::from(at) + 0.5) / f64::from(parts * size);
                    let uv = [middle(x, width), middle(y, height)];
                    let value = factor * bilinear(&alpha, wrap, uv);
                    if (value - cutoff).abs() > 1e-9 {
                        prop_assert_eq!(mask.is_opaque(uv), value > cutoff, "{} {}", value, cutoff);
                    }
                }
            }
        }
    }

    #[test]
    fn large_textures_have_fewer_parts() {
        let of = |size: u32, is_nearest| {
            let values = (0..size * size).map(|i| if i == 0 { 255 } else { 0 }).collect();
            mask(&Alpha { size: [size; 2], values }, [Wrap::Clamp; 2], is_nearest, 1.0, 0.5).size()[0]
        };
        assert_eq!([of(64, false), of(64, true)], [256, 64]);
        assert_eq!(of(1500, false), 3000);
    }
}
