//! Target of the fuzzers: images of sections.

use super::{Micrograph, Reading, Tissue};
use crate::geometry::polygon::{check_contour, check_simple};
use crate::measure::morphometry::QUANTITIES;

/// Maximum side of an image. Larger images take long; their memory does not depend on their
/// content.
const SIDE: u32 = 1024;

/// Reads the bytes unchanged, and a PNG again with correct checksums, so that the fuzzer also
/// reaches the code behind the checks.
pub fn micrograph(bytes: &[u8]) {
    image(bytes);
    if bytes.starts_with(b"\x89PNG") {
        let mut sealed = bytes.to_vec();
        seal(&mut sealed);
        image(&sealed);
    }
}

/// Asserts that contours are simple and correctly oriented, that measures are finite, and that the
/// message of a refusal is short.
fn image(bytes: &[u8]) {
    let labels = Tissue::Values((2..=9).collect());
    for reading in [
        Reading::default(),
        Reading { pixel_um: Some(2.0), tissue: None, threshold: Some(100) },
        Reading { pixel_um: Some(60.0), tissue: Some(labels), threshold: None },
    ] {
        match Micrograph::read_within(bytes, &reading, SIDE) {
            Ok(micrograph) => {
                let shape = micrograph.shape();
                check_contour(shape.outer).expect("the outer contour is sound");
                check_contour(shape.lumen[0]).expect("the lumen is sound");
                shape.lumen.iter().for_each(|contour| check_simple(contour).expect("all contours are simple"));
                let measures = micrograph.measure();
                assert!(QUANTITIES.iter().all(|quantity| quantity.of(&measures).is_none_or(f64::is_finite)));
                assert!(measures.lumen_area_mm2 > 0.0 && measures.tissue_area_mm2 > 0.0, "{measures:?}");
            }
            Err(error) => {
                let text = error.to_string();
                assert!((1..=1000).contains(&text.chars().count()), "{text}");
            }
        }
    }
}

/// Corrects the checksums of all chunks.
fn seal(bytes: &mut [u8]) {
    let mut at = 8;
    while let Some(length) = bytes.get(at..at + 4).and_then(|length| length.try_into().ok()).map(u32::from_be_bytes) {
        let end = at + 8 + length as usize;
        let Some(chunk) = bytes.get(at + 4..end) else { return };
        let mut sum = flate2::Crc::new();
        sum.update(chunk);
        let Some(place) = bytes.get_mut(end..end + 4) else { return };
        place.copy_from_slice(&sum.sum().to_be_bytes());
        at = end + 4;
    }
}
