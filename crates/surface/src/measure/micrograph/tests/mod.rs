//! Masks painted from known contours, and files that are refused.

mod files;
mod forms;
mod models;
mod polygons;
mod shapes;

use super::*;
use png::{BitDepth, ColorType};

type Points = Vec<[f32; 2]>;

/// Encodes bytes, one per pixel, as a grey PNG.
fn grey(width: usize, pixels: &[u8]) -> Vec<u8> {
    png(width, pixels, ColorType::Grayscale, BitDepth::Eight)
}

/// Encodes a PNG; pixels of fewer than eight bits are packed.
fn png(width: usize, pixels: &[u8], color: ColorType, depth: BitDepth) -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width as u32, (pixels.len() / width) as u32);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(png::Compression::Fast);
    if color == ColorType::Indexed {
        encoder.set_palette((0..12).map(|i| 20 * i).collect::<Vec<u8>>());
    }
    let bits = depth as usize;
    let pack = |row: &[u8]| -> Vec<u8> {
        row.chunks(8 / bits)
            .map(|pixels| pixels.iter().enumerate().fold(0, |byte, (i, pixel)| byte | pixel << (8 - bits * (i + 1))))
            .collect()
    };
    let packed: Vec<u8> = pixels.chunks(width).flat_map(pack).collect();
    encoder.write_header().unwrap().write_image_data(&packed).unwrap();
    file
}

/// Paints an image around the origin: 1 for pixels whose centres lie within an odd number of
/// contours.
fn paint([width, height]: [usize; 2], pixel_um: f64, contours: &[&[[f32; 2]]]) -> Vec<u8> {
    let mut pixels = vec![0; width * height];
    for (row, pixels) in pixels.chunks_mut(width).enumerate() {
        let y = (height as f64 / 2.0 - row as f64 - 0.5) * pixel_um;
        let mut places: Vec<f64> = Vec::new();
        for contour in contours {
            for (i, a) in contour.iter().enumerate() {
                let [a, b] = [*a, contour[(i + 1) % contour.len()]].map(|p| p.map(f64::from));
                if (a[1] > y) != (b[1] > y) {
                    let x = a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
                    places.push(x / pixel_um + width as f64 / 2.0 - 0.5);
                }
            }
        }
        places.sort_by(f64::total_cmp);
        for pair in places.chunks(2) {
            let [from, to] = [pair[0], pair[1]].map(|place| (place.ceil().max(0.0) as usize).min(width));
            pixels[from..to].fill(1);
        }
    }
    pixels
}

fn read(png: &[u8], pixel_um: f64) -> Result<Micrograph, MicrographError> {
    Micrograph::read(png, &Reading { pixel_um: Some(pixel_um), ..Reading::default() })
}

/// An image drawn with characters: `#` is tissue.
fn drawn(rows: &[&str]) -> Vec<u8> {
    let pixels: Vec<u8> = rows.iter().flat_map(|row| row.bytes()).map(|c| u8::from(c == b'#')).collect();
    grey(rows[0].len(), &pixels)
}

/// Asserts that contours are simple, correctly oriented and apart, as [`Shape`] requires.
fn assert_sound(micrograph: &Micrograph) {
    use crate::geometry::polygon::{check_contour, check_nested, check_simple, signed_area};
    check_contour(&micrograph.outer).unwrap();
    for (i, contour) in micrograph.lumen.iter().enumerate() {
        check_simple(contour).unwrap();
        check_nested(contour, &micrograph.outer).unwrap();
        for other in &micrograph.lumen[..i] {
            let apart = |error| error == crate::geometry::polygon::ContourError::NotNested;
            let outside = check_nested(contour, other).map_or_else(apart, |()| signed_area(contour) < 0.0);
            assert!(outside, "contour {i} meets another, or lies in a wrong one");
        }
    }
    assert!(signed_area(&micrograph.lumen[0]) > 0.0);
}
