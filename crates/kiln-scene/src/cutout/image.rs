//! From the bytes of an image to the alpha of its pixels.

use super::MaskProblem;
use std::io::Cursor;

/// No deflate stream holds more than this many bytes for each of its own.
const MOST_INFLATED: u64 = 1032;

/// Bytes that the decoder may take for itself, the picture aside.
const DECODER_BYTES: usize = 64 << 20;

/// What an image says of opacity.
#[derive(Debug, PartialEq)]
pub(super) enum Picture {
    /// It has no alpha.
    Opaque,
    /// It has.
    Alpha(Alpha),
}

/// The alpha of each pixel, 0 to 255, in rows from the top.
#[derive(Debug, PartialEq)]
pub(super) struct Alpha {
    pub(super) size: [u32; 2],
    pub(super) values: Vec<u8>,
}

impl Alpha {
    pub(super) fn pixels(&self) -> u64 {
        self.values.len() as u64
    }
}

/// Reads an image of at most so many pixels. JPEG has no alpha, so that nothing of it need be decoded; of 16-bit alpha the
/// upper 8 bits count.
pub(super) fn read(bytes: &[u8], most_pixels: u64) -> Result<Picture, MaskProblem> {
    if bytes.starts_with(b"\xff\xd8\xff") {
        return Ok(Picture::Opaque);
    }
    if !bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        return Err(MaskProblem::Format);
    }
    read_png(bytes, most_pixels)
}

fn read_png(bytes: &[u8], most_pixels: u64) -> Result<Picture, MaskProblem> {
    let undecodable = |_| MaskProblem::Undecodable;
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), png::Limits { bytes: DECODER_BYTES });
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    // Nothing is allocated for pixels before their number is known to be fair.
    let header = decoder.read_header_info().map_err(undecodable)?;
    let (width, height) = (header.width, header.height);
    if u64::from(width) * u64::from(height) > most_pixels {
        return Err(MaskProblem::TooLarge);
    }
    let row = u64::from(width) * header.bits_per_pixel() as u64 / 8 + 1;
    if row * u64::from(height) / MOST_INFLATED > bytes.len() as u64 {
        return Err(MaskProblem::Undecodable);
    }
    let mut reader = decoder.read_info().map_err(undecodable)?;
    let channels = match reader.output_color_type() {
        (png::ColorType::Rgba, png::BitDepth::Eight) => 4,
        (png::ColorType::GrayscaleAlpha, png::BitDepth::Eight) => 2,
        _ => return Ok(Picture::Opaque),
    };
    let pixels = width as usize * height as usize;
    let size = reader.output_buffer_size().filter(|size| *size == channels * pixels);
    let mut picture = vec![0; size.ok_or(MaskProblem::Undecodable)?];
    reader.next_frame(&mut picture).map_err(undecodable)?;
    let values = picture.chunks_exact(channels).map(|pixel| pixel[channels - 1]).collect();
    Ok(Picture::Alpha(Alpha { size: [width, height], values }))
}
