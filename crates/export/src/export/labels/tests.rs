//! Tests that read back both files of a small tube.

use super::*;
use crate::export::tests::meta;
use crate::model::sample::tube;
use crate::tissue::Tissue;
use std::io::{Cursor, Read};
use tiff::decoder::{Decoder, DecodingResult};
use tiff::tags::Tag;

const LAYERS: Layers =
    Layers { epithelium_um: 30.0, lamina_um: 40.0, longitudinal_share: 0.3, serosa_um: 25.0, ..Layers::NONE };
const VOLUME: LabelVolume = LabelVolume { voxel_um: 10.0, slice_um: 50.0, from_um: 1000.0, slices: 20 };

/// Writes both files of a tube of 4 mm with radii of 0.5 and 1 mm.
fn written(volume: &LabelVolume) -> (Vec<u8>, Vec<u8>, LabelReport) {
    let (mut tiff, mut nifti) = (Cursor::new(Vec::new()), Vec::new());
    let report =
        write_labels(&tube(96, 4, 0.0), &|_| LAYERS, volume, &meta(), (&mut tiff, &mut nifti), &|| false).unwrap();
    (tiff.into_inner(), nifti, report)
}

/// Reads the voxels of an OME-TIFF.
fn pages(file: &[u8]) -> Vec<Vec<u8>> {
    let mut decoder = Decoder::new(Cursor::new(file)).unwrap();
    let mut pages = Vec::new();
    loop {
        let DecodingResult::U8(page) = decoder.read_image().unwrap() else { panic!("not of 8 bits") };
        pages.push(page);
        if !decoder.more_images() {
            return pages;
        }
        decoder.next_image().unwrap();
    }
}

fn unzipped(file: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    flate2::read::GzDecoder::new(file).read_to_end(&mut bytes).unwrap();
    bytes
}

#[test]
fn both_files_hold_the_same_voxels_with_the_areas_of_the_layers() {
    let (tiff, nifti, report) = written(&LabelVolume { voxel_um: 4.0, slices: 7, ..VOLUME });
    assert_eq!(report.size[2], 7);
    let pages = pages(&tiff);
    assert_eq!(pages.len(), 7);
    assert_eq!(unzipped(&nifti)[352..], pages.concat());
    // The contours are regular polygons of 96 corners, the wall is 500 µm thick.
    let polygon = |radius: f64| 48.0 * (std::f64::consts::TAU / 96.0).sin() * radius * radius;
    for page in &pages {
        let area = |tissue: Tissue| 16.0 * page.iter().filter(|&&label| label == tissue as u8).count() as f64;
        for (tissue, from, to) in [
            (Tissue::Lumen, 0.0, 500.0),
            (Tissue::LaminaPropria, 530.0, 570.0),
            (Tissue::CircularMuscle, 570.0, 853.5),
            (Tissue::LongitudinalMuscle, 853.5, 975.0),
        ] {
            let expected = polygon(to) - polygon(from);
            assert!((area(tissue) / expected - 1.0).abs() < 0.02, "{tissue:?}: {} and {expected}", area(tissue));
        }
    }
}

#[test]
fn the_ome_tiff_states_its_sizes() {
    let (tiff, _, report) = written(&VOLUME);
    let mut decoder = Decoder::new(Cursor::new(&tiff)).unwrap();
    assert_eq!(decoder.dimensions().unwrap(), (report.size[0], report.size[1]));
    let xml = decoder.get_tag_ascii_string(Tag::ImageDescription).unwrap();
    for part in [
        "PhysicalSizeX=\"10\"",
        "PhysicalSizeY=\"10\"",
        "PhysicalSizeZ=\"50\"",
        "SizeZ=\"20\"",
        "Type=\"uint8\"",
        "DimensionOrder=\"XYZCT\"",
        "3 lamina propria",
    ] {
        assert!(xml.contains(part), "{part} in {xml}");
    }
    assert!(xml.is_ascii());
}

#[test]
fn the_nifti_header_has_sizes_units_and_place() {
    let (_, nifti, report) = written(&VOLUME);
    let bytes = unzipped(&nifti);
    let short = |at: usize| i16::from_le_bytes([bytes[at], bytes[at + 1]]);
    let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    assert_eq!(bytes[..4], 348_i32.to_le_bytes());
    assert_eq!([40, 42, 44, 46, 48, 70, 72].map(short), [3, report.size[0] as i16, report.size[1] as i16, 20, 1, 2, 8]);
    assert_eq!([76, 80, 84, 88, 108].map(float), [-1.0, 10.0, 10.0, 50.0, 352.0]);
    assert_eq!((bytes[123], &bytes[344..352]), (3, &b"n+1\0\0\0\0\0"[..]));
    // Voxel 0 is half a voxel inside the grid along x and y, and 25 µm along z.
    assert_eq!([280, 292, 300, 308, 320, 324].map(float), [10.0, -1005.0, -10.0, 1005.0, 50.0, 1025.0]);
    assert_eq!(bytes.len(), 352 + report.size.iter().map(|&n| n as usize).product::<usize>());
}

#[test]
fn the_number_of_threads_changes_no_byte() {
    let threads = |n: usize| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
    assert_eq!(threads(1).install(|| written(&VOLUME)), threads(3).install(|| written(&VOLUME)));
}

#[test]
fn pieces_fit_together_at_any_height_and_slices_at_sections_are_cut_too() {
    // The middle of the first slice is at a section.
    let part = written(&LabelVolume { from_um: 975.0, slices: 3, ..VOLUME });
    let whole = written(&LabelVolume { from_um: 875.0, slices: 5, ..VOLUME });
    assert_eq!(pages(&part.0), pages(&whole.0)[2..]);
}

#[test]
fn it_stops_when_it_is_cancelled_and_refuses_what_does_not_fit() {
    let surface = tube(24, 2, 0.0);
    let write = |volume: &LabelVolume, cancelled: bool| {
        let outputs = (Cursor::new(Vec::new()), Vec::new());
        write_labels(&surface, &|_| LAYERS, volume, &meta(), outputs, &|| cancelled).unwrap_err().kind()
    };
    assert_eq!(write(&VOLUME, true), io::ErrorKind::Interrupted);
    assert_eq!(write(&LabelVolume { voxel_um: 0.05, ..VOLUME }, false), io::ErrorKind::InvalidInput);
    assert_eq!(write(&LabelVolume { from_um: 9000.0, ..VOLUME }, false), io::ErrorKind::InvalidInput);
}
