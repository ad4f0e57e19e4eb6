//! Accepted formats, and files that are refused.

use super::*;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::io::Write;

pub(super) const SIDE: usize = 40;

/// A ring of tissue with a given value; the lumen is off-centre.
pub(super) fn ring(value: u8) -> Vec<u8> {
    let at = |i: usize| [(i % SIDE) as f32 - 19.5, (i / SIDE) as f32 - 19.5];
    let within = |i: usize, [x, y]: [f32; 2], radius: f32| (at(i)[0] - x).hypot(at(i)[1] - y) < radius;
    let tissue = |i: usize| within(i, [0.0; 2], 17.0) && !within(i, [3.0, -4.0], 8.0);
    (0..SIDE * SIDE).map(|i| if tissue(i) { value } else { 0 }).collect()
}

pub(super) fn deflated(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// A compressed gigabyte of zeros: the same block repeated.
fn bomb() -> Vec<u8> {
    let mut compress = flate2::Compress::new(Compression::fast(), false);
    let mut block = Vec::with_capacity(1 << 16);
    compress.compress_vec(&[0; 1 << 20], &mut block, flate2::FlushCompress::Full).unwrap();
    assert_eq!(compress.total_in(), 1 << 20);
    [&[0x78, 0x01], &block.repeat(1024)[..], &[0x03, 0x00, 0, 0, 0, 0]].concat()
}

pub(super) fn chunk(kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let mut sum = flate2::Crc::new();
    sum.update(kind);
    sum.update(data);
    [&(data.len() as u32).to_be_bytes()[..], kind, data, &sum.sum().to_be_bytes()].concat()
}

pub(super) fn header(width: u32, height: u32, depth: u8, color: u8, interlaced: u8) -> Vec<u8> {
    chunk(b"IHDR", &[&width.to_be_bytes()[..], &height.to_be_bytes(), &[depth, color, 0, 0, interlaced]].concat())
}

pub(super) fn file(chunks: &[Vec<u8>]) -> Vec<u8> {
    [&[b"\x89PNG\r\n\x1a\n".to_vec()], chunks, &[chunk(b"IEND", &[])]].concat().concat()
}

/// Rows of an image, each after the number of its filter: none.
fn scanlines(width: usize, pixels: &[u8]) -> Vec<u8> {
    pixels.chunks(width).flat_map(|row| [&[0], row].concat()).collect()
}

/// A grey image of eight bits with additional chunks before its pixels.
pub(super) fn with(chunks: &[Vec<u8>]) -> Vec<u8> {
    let start = [header(SIDE as u32, SIDE as u32, 8, 0, 0)];
    let pixels = [chunk(b"IDAT", &deflated(&scanlines(SIDE, &ring(255))))];
    file(&[&start, chunks, &pixels].concat())
}

#[test]
fn grey_and_palette_images_of_all_depths_are_the_same() {
    let expected = read(&grey(SIDE, &ring(255)), 10.0).unwrap();
    assert_eq!(read(&with(&[]), 10.0).unwrap(), expected);
    for depth in [BitDepth::One, BitDepth::Two, BitDepth::Four, BitDepth::Eight] {
        for color in [ColorType::Grayscale, ColorType::Indexed] {
            assert_eq!(read(&png(SIDE, &ring(1), color, depth), 10.0).unwrap(), expected, "{color:?} {depth:?}");
        }
    }
    // Interlaced: first column and row of each pass, and their steps.
    let passes = [[0, 0, 8, 8], [4, 0, 8, 8], [0, 4, 4, 8], [2, 0, 4, 4], [0, 2, 2, 4], [1, 0, 2, 2], [0, 1, 1, 2]];
    let pixels = ring(255);
    let mut rows = Vec::new();
    for [x, y, dx, dy] in passes {
        for row in (y..SIDE).step_by(dy) {
            rows.push(0);
            rows.extend((x..SIDE).step_by(dx).map(|column| pixels[row * SIDE + column]));
        }
    }
    let interlaced = file(&[header(SIDE as u32, SIDE as u32, 8, 0, 1), chunk(b"IDAT", &deflated(&rows))]);
    assert_eq!(read(&interlaced, 10.0).unwrap(), expected);
}

#[test]
fn the_values_of_tissue_are_a_choice() {
    let mut pixels = ring(6);
    for (i, pixel) in pixels.iter_mut().enumerate() {
        // Two tissues, and a lumen with its own value.
        *pixel = if *pixel == 6 && i % SIDE < 20 { 3 } else { *pixel };
        let inside = ((i % SIDE) as f32 - 22.5).hypot((i / SIDE) as f32 - 15.5) < 8.0;
        *pixel = if inside { 1 } else { *pixel };
    }
    let of = |tissue: &[u16]| {
        let tissue = Some(Tissue::Values(tissue.to_vec()));
        Micrograph::read(&grey(SIDE, &pixels), &Reading { pixel_um: Some(10.0), tissue, threshold: None })
    };
    assert_eq!(of(&[3, 6]), read(&grey(SIDE, &ring(255)), 10.0));
    assert_eq!(of(&[1, 3, 6]), Err(MicrographError::NoLumen));
    assert_eq!(of(&[3]), Err(MicrographError::NoLumen));
    assert_eq!(of(&[7]), Err(MicrographError::NoTissue));
    assert_eq!(of(&[]), Err(MicrographError::NoTissue));
    assert_eq!(of(&[0, 1]), Err(MicrographError::CutOff));
}

#[track_caller]
fn refused(file: &[u8], expected: &MicrographError) {
    let found = read(file, 10.0).unwrap_err();
    assert_eq!(&found, expected);
    assert!(found.to_string().len() < 300, "{found}");
}

#[track_caller]
fn damaged(file: &[u8]) {
    let found = read(file, 10.0).unwrap_err();
    assert!(matches!(&found, MicrographError::Damaged(..)), "{found}");
}

#[test]
fn what_is_no_mask_is_refused() {
    for (not, name) in [
        (&b""[..], "the file is no image that is read"),
        (b"GIF89a", "the file is a GIF"),
        (b"\x89PNG\r\n\x1a", "the file is no image that is read"),
        (b"\x93NUMPY\x01", "the file is a NumPy array; cellpose also saves its masks as PNG or TIFF"),
        (b"  <svg>", "the file is XML, such as an SVG"),
        (b"no picture", "the file is no image that is read"),
    ] {
        refused(not, &MicrographError::Format(name));
    }
    let of = |depth: u8, color: u8, pixel: &[u8]| {
        let row: Vec<u8> = [&[0], &pixel.repeat(40)[..]].concat();
        file(&[header(40, 40, depth, color, 0), chunk(b"IDAT", &deflated(&row.repeat(40)))])
    };
    let colour = |red, green, blue| MicrographError::Colour { column: 0, row: 0, red, green, blue };
    refused(&of(16, 2, &[0, 9, 1, 0, 0, 9]), &colour(9, 256, 9));
    refused(&of(8, 2, &[1, 2, 3]), &colour(1, 2, 3));
    refused(&of(8, 6, &[9, 9, 8, 255]), &colour(9, 9, 8));
    refused(&of(8, 4, &[9, 128]), &MicrographError::Transparent { column: 0, row: 0 });
    refused(&of(16, 6, &[0, 0, 0, 0, 0, 0, 255, 254]), &MicrographError::Transparent { column: 0, row: 0 });
    let animated = with(&[chunk(b"acTL", &[0, 0, 0, 2, 0, 0, 0, 0])]);
    refused(&animated, &MicrographError::Pages("an animation".into()));
    for size in [[MAX_SIDE + 1, 10], [10, MAX_SIDE + 1], [1 << 31, 1 << 31], [u32::MAX >> 1; 2]] {
        let huge = file(&[header(size[0], size[1], 8, 0, 0), chunk(b"IDAT", &deflated(&[0]))]);
        let found = read(&huge, 10.0).unwrap_err();
        assert!(matches!(found, MicrographError::Size { .. } | MicrographError::Damaged(..)), "{found}");
    }
    refused(&file(&[header(9000, 9000, 1, 0, 0)]), &MicrographError::Size { width: 9000, height: 9000 });
}

#[test]
fn damage_is_noticed_wherever_it_is() {
    let whole = with(&[]);
    for end in 8..whole.len() {
        damaged(&whole[..end]);
    }
    // Any bit of a relevant chunk; text is ignored.
    for at in (8..whole.len()).step_by(7) {
        let mut changed = whole.clone();
        changed[at] ^= 1 << (at % 8);
        assert!(read(&changed, 10.0).is_err(), "byte {at}");
    }
    let short = chunk(b"IDAT", &deflated(&scanlines(SIDE, &ring(255))[..900]));
    damaged(&file(&[header(SIDE as u32, SIDE as u32, 8, 0, 0), short]));
    damaged(&file(&[header(0, 40, 8, 0, 0)]));
    damaged(&file(&[header(40, 40, 3, 0, 0)]));
    damaged(&file(&[header(SIDE as u32, SIDE as u32, 8, 3, 0), chunk(b"IDAT", &deflated(&[0]))]));
    let mut text = with(&[chunk(b"tEXt", b"Software\0any")]);
    text[45] ^= 1;
    assert!(read(&text, 10.0).is_ok());
}

#[test]
fn what_inflates_without_bound_is_left_out() {
    let expected = read(&grey(SIDE, &ring(255)), 10.0).unwrap();
    let zeros = bomb();
    for (kind, start) in [(b"iCCP", &b"x\0\0"[..]), (b"zTXt", b"x\0\0"), (b"iTXt", b"x\0\x01\0\0\0")] {
        let with = with(&[chunk(kind, &[start, &zeros].concat())]);
        assert_eq!(read(&with, 10.0).unwrap(), expected, "{kind:?}");
    }
    // Pixels beyond the declared number are not inflated.
    let start = [header(SIDE as u32, SIDE as u32, 8, 0, 0), chunk(b"IDAT", &zeros)];
    assert_eq!(read(&file(&start), 10.0), Err(MicrographError::NoTissue));
    // An uncompressed chunk with more bytes than chunks may have.
    damaged(&with(&[chunk(b"eXIf", &vec![0; 17 << 20])]));
}

#[test]
fn sizes_of_pixels_and_sections_are_bounded() {
    let mask = grey(SIDE, &ring(255));
    for pixel_um in [0.0, -1.0, 0.04, 100.1, f64::NAN, f64::INFINITY] {
        assert!(matches!(read(&mask, pixel_um), Err(MicrographError::PixelSize(_))), "{pixel_um}");
    }
    // 34 pixels.
    assert!(read(&mask, 100.0).is_ok() && read(&mask, 2.5).is_ok());
    assert_eq!(read(&mask, 1.0), Err(MicrographError::NoLumen), "201 µm²");
    let large = |side: usize| {
        let pixels: Vec<u8> = (0..side * side)
            .map(|i| {
                let edge = (i % side).min(i / side).min(side - 1 - i % side).min(side - 1 - i / side);
                u8::from((1..4).contains(&edge))
            })
            .collect();
        grey(side, &pixels)
    };
    assert!(read(&large(1990), 100.0).is_ok());
    assert!(matches!(read(&large(2010), 100.0), Err(MicrographError::Extent(mm)) if mm > 200.0));
    assert!(matches!(read(&large(500), 0.05), Err(MicrographError::Extent(mm)) if mm < 0.05));
}

#[test]
fn sections_that_cannot_be_measured_are_refused() {
    refused(&grey(SIDE, &[0; SIDE * SIDE]), &MicrographError::NoTissue);
    refused(&grey(SIDE, &[9; SIDE * SIDE]), &MicrographError::CutOff);
    refused(&grey(1, &[1]), &MicrographError::CutOff);
    refused(&drawn(&[".....", ".###.", ".###.", "....."]), &MicrographError::NoLumen);
    let cut = |from: usize, to: usize| {
        let rows: Vec<u8> = ring(1)[from * SIDE..to * SIDE].to_vec();
        refused(&grey(SIDE, &rows), &MicrographError::CutOff);
    };
    cut(3, SIDE);
    cut(0, SIDE - 3);
    // Islands with longer borders than can be measured.
    let side = 2400;
    let islands: Vec<u8> = (0..side * side)
        .map(|i| {
            let (x, y) = (i % side, i / side);
            let inside = (2..side - 2).contains(&x) && (2..side - 2).contains(&y);
            let frame = inside && (x < 4 || y < 4 || x >= side - 4 || y >= side - 4);
            u8::from(frame || inside && x % 5 < 3 && y % 5 < 3)
        })
        .collect();
    refused(&grey(side, &islands), &MicrographError::Rough);
}
