//! Tests that stained pictures and label images agree and depend only on their input.

use super::*;
use crate::model::{Ring, Section, sample};
use crate::tissue::Tissue;

const LAYERS: Layers = Layers { epithelium_um: 30.0, lamina_um: 40.0, longitudinal_share: 0.3, serosa_um: 25.0 };

fn slide(section: &Section) -> Slide {
    Slide { borders: section.borders(), layers: LAYERS, seed: 7, index: 3 }
}

/// Width, height, channels and pixels.
fn decoded(png: &[u8]) -> (u32, u32, usize, Vec<u8>) {
    let mut reader = png::Decoder::new(Cursor::new(png)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!(info.bit_depth, png::BitDepth::Eight);
    (info.width, info.height, info.color_type.samples(), pixels)
}

#[test]
fn every_pixel_is_stained_as_it_is_labelled() {
    let section = sample::section(360, 0.0, 0.0);
    let (stained, labels) = (slide(&section).stained(700).unwrap(), slide(&section).labels(700).unwrap());
    assert_eq!(um_per_pixel(&stained), um_per_pixel(&labels));
    let (width, height, channels, rgb) = decoded(&stained);
    let (label_width, label_height, label_channels, labels) = decoded(&labels);
    assert_eq!((width, height, channels), (label_width, label_height, 3));
    assert_eq!((width.max(height), label_channels), (700, 1));
    let mut sums = [(0.0, 0.0); 7];
    for (pixel, &label) in rgb.chunks_exact(3).zip(&labels) {
        let is_glass = label <= Tissue::Lumen as u8;
        let red_of_blue = f64::from(pixel[0]) / f64::from(pixel[2]);
        let sum = &mut sums[usize::from(label)];
        *sum = (sum.0 + 1.0, sum.1 + red_of_blue);
        // The scale bar lies outside the tissue.
        if label == Tissue::Lumen as u8 {
            assert!(pixel[1] > 185, "{pixel:?} in the lumen");
        }
        assert!(is_glass || pixel[1] < 246, "{pixel:?} in tissue {label}");
    }
    let hue = |tissue: Tissue| sums[tissue as usize].1 / sums[tissue as usize].0;
    assert!(sums.iter().all(|(count, _)| *count > 500.0), "{sums:?}");
    // The epithelium is blue, because it contains many nuclei; muscle is pink.
    assert!(hue(Tissue::Epithelium) < 1.0 && hue(Tissue::CircularMuscle) > 1.03, "{sums:?}");
    assert!(hue(Tissue::LongitudinalMuscle) > 1.03 && hue(Tissue::LaminaPropria) > hue(Tissue::Epithelium), "{sums:?}");
}

#[test]
fn a_picture_depends_on_section_layers_seed_and_index_only() {
    let section = sample::section(180, 0.0, 0.0);
    let slide = slide(&section);
    let threads = |n: usize| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
    let one = threads(1).install(|| (slide.stained(300).unwrap(), slide.labels(300).unwrap()));
    assert_eq!(one, threads(3).install(|| (slide.stained(300).unwrap(), slide.labels(300).unwrap())));
    for other in [Slide { seed: 8, ..slide.clone() }, Slide { index: 4, ..slide.clone() }] {
        assert_ne!(one.0, other.stained(300).unwrap());
        assert_eq!(one.1, other.labels(300).unwrap());
    }
    let thick = Slide { layers: Layers { epithelium_um: 60.0, ..LAYERS }, ..slide };
    assert_ne!(one.1, thick.labels(300).unwrap());
}

#[test]
fn the_size_of_a_pixel_is_in_the_file() {
    // The wall of 2 mm takes 90.9 % of 550 pixels.
    let section = sample::section(360, 0.0, 0.0);
    for png in [slide(&section).stained(550).unwrap(), slide(&section).labels(550).unwrap()] {
        assert!((um_per_pixel(&png).unwrap() - 4.0).abs() < 1e-4, "{:?}", um_per_pixel(&png));
    }
    assert_eq!(um_per_pixel(b"no picture"), None);
}

#[test]
fn odd_sizes_and_sections_are_drawn_or_refused() {
    let section = sample::section(24, 0.0, 0.0);
    assert!(matches!(slide(&section).stained(0), Err(RenderError::Size { .. })));
    assert!(matches!(slide(&section).labels(MAX_SIZE + 1), Err(RenderError::Size { .. })));
    let line = Ring { ids: vec![0, 1, 2], points: vec![[0.0, 0.0], [100.0, 0.0], [50.0, 0.0]] };
    for section in [Section::default(), Section { inner: line.clone(), outer: line, ..Section::default() }] {
        for size in [1, 33] {
            assert!(slide(&section).stained(size).is_ok() && slide(&section).labels(size).is_ok());
        }
    }
}
