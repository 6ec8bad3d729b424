//! Colours for deviations: lightness rises evenly, so that equal steps look equal, also without colour vision.

use super::Image;
use glam::Vec3;

/// The deviation that has the last colour; greater ones have it too. A step from 0 to 1 has .5, but is rare.
pub(crate) const TOP: f64 = 0.3;

/// The bar beside the picture has a tick at each multiple.
pub(crate) const TICK: f64 = 0.1;

/// Linear RGB of a deviation: from dark blue by crimson to yellow.
pub(crate) fn color(deviation: f32) -> Vec3 {
    use std::f32::consts::PI;
    let t = (deviation / TOP as f32).clamp(0.0, 1.0);
    let (lightness, chroma, hue) = (0.32 + 0.58 * t, 0.11 + 0.05 * (PI * t).sin(), (265.0 + 200.0 * t).to_radians());
    from_oklab(lightness, chroma * hue.cos(), chroma * hue.sin()).clamp(Vec3::ZERO, Vec3::ONE)
}

/// Linear sRGB of a colour in Oklab (Ottosson 2020, "A perceptual color space for image processing").
fn from_oklab(lightness: f32, a: f32, b: f32) -> Vec3 {
    let cubes = Vec3::new(
        lightness + 0.396_337_78 * a + 0.215_803_76 * b,
        lightness - 0.105_561_346 * a - 0.063_854_17 * b,
        lightness - 0.089_484_18 * a - 1.291_485_5 * b,
    );
    let cones = cubes * cubes * cubes;
    Vec3::new(
        cones.dot(Vec3::new(4.076_741_7, -3.307_711_6, 0.230_969_94)),
        cones.dot(Vec3::new(-1.268_438, 2.609_757_4, -0.341_319_4)),
        cones.dot(Vec3::new(-0.004_196_086_3, -0.703_418_6, 1.707_614_7)),
    )
}

/// Draws the bar into the lower left corner: 0 at its left end, [`TOP`] at its right end.
pub(crate) fn draw_bar(image: &mut Image, to_srgb: impl Fn(f32) -> u8) {
    const INK: [u8; 3] = [240; 3];
    let margin = (image.height / 40).clamp(2, 20);
    let (length, thickness) = ((image.width / 4).max(12), (image.height / 50).clamp(3, 16));
    let top = image.height - margin - 2 * thickness;
    for x in 0..length {
        let part = f64::from(x) / f64::from(length - 1);
        let paint = color((part * TOP) as f32).to_array().map(&to_srgb);
        (0..thickness).for_each(|y| image.set(margin + x, top + y, paint));
    }
    let ticks = (TOP / TICK).round() as u32;
    for tick in 0..=ticks {
        let x = (length - 1) * tick / ticks;
        (0..thickness / 2 + 1).for_each(|y| image.set(margin + x, top + thickness + y, INK));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lightness in Oklab, by the inverse of [`from_oklab`].
    fn lightness(rgb: Vec3) -> f32 {
        let cones = [
            Vec3::new(0.412_221_46, 0.536_332_55, 0.051_445_995),
            Vec3::new(0.211_903_5, 0.680_699_5, 0.107_396_96),
            Vec3::new(0.088_302_46, 0.281_718_85, 0.629_978_7),
        ];
        Vec3::from_array(cones.map(|row| row.dot(rgb).cbrt())).dot(Vec3::new(0.210_454_26, 0.793_617_8, -0.004_072_047))
    }

    #[test]
    fn lightness_rises_evenly() {
        let of = |step: u16| lightness(color(f32::from(step) / 10.0 * TOP as f32));
        for step in 0..10 {
            let rise = of(step + 1) - of(step);
            assert!((rise - 0.058).abs() < 1e-3, "{step}: {rise}");
        }
        assert_eq!(color(TOP as f32), color(1.0));
        assert_eq!(from_oklab(1.0, 0.0, 0.0).round(), Vec3::ONE);
    }

    #[test]
    fn the_bar_has_the_ends_of_the_ramp() {
        for (width, height) in [(16, 16), (320, 200)] {
            let mut image = Image { width, height, rgb: vec![0; (3 * width * height) as usize] };
            draw_bar(&mut image, |x| (x * 255.0) as u8);
            let bytes = |deviation: f32| color(deviation).to_array().map(|x| (x * 255.0) as u8);
            let pixels: Vec<[u8; 3]> = image.rgb.as_chunks().0.to_vec();
            assert!(pixels.contains(&bytes(0.0)) && pixels.contains(&bytes(1.0)), "{width} × {height}");
        }
    }
}
