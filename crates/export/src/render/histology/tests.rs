//! Tests that stained pictures and label images agree and depend only on their input.

use super::*;
use crate::model::{Ring, Section, sample};
use crate::spec::{ModelSpec, presets};
use crate::tissue::Tissue;

const LAYERS: Layers =
    Layers { epithelium_um: 30.0, lamina_um: 40.0, longitudinal_share: 0.3, serosa_um: 25.0, ..Layers::NONE };

fn slide(section: &Section) -> Slide {
    let layers = Layers { subserosa_um: 40.0, vessels: 16.0, ..LAYERS };
    Slide { borders: section.borders(), layers, seed: 7, index: 3 }
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
    let mut sums = [(0.0, 0.0); 10];
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
    assert!(sums[..8].iter().chain(&sums[9..]).all(|(count, _)| *count > 500.0), "{sums:?}");
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
    let thick = Slide { layers: Layers { epithelium_um: 60.0, ..slide.layers }, ..slide };
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

#[test]
fn pictures_of_every_preset_have_its_layers() {
    for preset in presets() {
        let spec = ModelSpec::resolve(preset, &serde_json::json!({})).unwrap();
        for share in [0.0, 0.9] {
            let layers = spec.layers_at(share, 3);
            let inner = spec.scale * 0.7 * spec.inner_radius_um(share);
            let outer =
                inner + layers.epithelium_um + layers.lamina_um + spec.scale * spec.containment.wall_um.at(share);
            let circle = |radius: f64| {
                let at = |k: u32| libm::sincosf(k as f32 * std::f32::consts::TAU / 360.0);
                let points = (0..360).map(at).map(|(sin, cos)| [radius as f32 * cos, radius as f32 * sin]);
                Border::closed(vec![points.collect()])
            };
            let slide = Slide { borders: [circle(inner), circle(outer)], layers, seed: 3, index: 0 };
            let labels = decoded(&slide.labels(900).unwrap()).3;
            let has = |tissue: Tissue| labels.contains(&(tissue as u8));
            let name = preset.name.as_str();
            for tissue in &Tissue::ALL[..7] {
                assert!(has(*tissue), "{name} at {share}: no {tissue:?}");
            }
            assert_eq!(has(Tissue::Subserosa), layers.subserosa_um > 0.0, "{name} at {share}");
            let is_intramural = name == "human" && share == 0.0;
            assert_eq!(has(Tissue::InnerLongitudinalMuscle), is_intramural, "{name} at {share}");
            // Vessels of a mouse are thinner than a pixel.
            assert!(has(Tissue::Vessel) || name == "mouse", "{name} at {share}");
            let area = |tissue: Tissue| labels.iter().filter(|&&label| label == tissue as u8).count();
            let is_thin = matches!(name, "pig" | "human" | "cow" | "mouse");
            assert!(!is_thin || area(Tissue::LaminaPropria) < area(Tissue::Epithelium), "{name} at {share}");
        }
    }
}
