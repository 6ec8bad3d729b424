//! Writing pictures.

use anyhow::Context;
use std::{fs::File, io::BufWriter, path::Path};

/// Width of the line between two pictures, pixels.
const LINE: usize = 4;

/// An 8-bit sRGB picture, rows from the top.
pub(crate) struct Image {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) rgb: Vec<u8>,
}

impl Image {
    /// Sets a pixel; one beyond the edge is no pixel.
    pub(super) fn set(&mut self, x: u32, y: u32, rgb: [u8; 3]) {
        if x < self.width && y < self.height {
            let at = 3 * (y as usize * self.width as usize + x as usize);
            self.rgb[at..at + 3].copy_from_slice(&rgb);
        }
    }

    /// Pictures of the same width, one below the other, with light lines between.
    pub(crate) fn stacked(pictures: &[Self]) -> Self {
        let width = pictures.iter().map(|picture| picture.width).max().unwrap_or(0);
        let line = vec![230; 3 * LINE * width as usize];
        let rows: Vec<Vec<u8>> = pictures.iter().map(|picture| picture.rgb.clone()).collect();
        let lines = (LINE * pictures.len().saturating_sub(1)) as u32;
        let height = pictures.iter().map(|picture| picture.height).sum::<u32>() + lines;
        Self { width, height, rgb: rows.join(&line[..]) }
    }

    /// Two pictures of the same height, with a light line between.
    pub(crate) fn beside(self, right: &Self) -> Self {
        let row = |image: &Self, y: usize| {
            let stride = image.width as usize * 3;
            image.rgb[y * stride..][..stride].to_vec()
        };
        let rows = (0..self.height as usize).flat_map(|y| [row(&self, y), vec![230; 3 * LINE], row(right, y)].concat());
        Self { width: self.width + right.width + LINE as u32, height: self.height, rgb: rows.collect() }
    }
}

pub(crate) fn write_png(path: &Path, image: &Image) -> anyhow::Result<()> {
    let context = || format!("{} cannot be written", path.display());
    let file = BufWriter::new(File::create(path).with_context(context)?);
    let mut encoder = png::Encoder::new(file, image.width, image.height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().and_then(|mut writer| writer.write_image_data(&image.rgb)).with_context(context)
}
