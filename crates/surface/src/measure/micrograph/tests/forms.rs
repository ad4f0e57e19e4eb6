//! Forms in which programs save masks: all show the same section.

use super::files::{SIDE, chunk, deflated, file, header, ring, with};
use super::*;
use image::codecs::{bmp::BmpEncoder, jpeg::JpegEncoder};
use image::{ExtendedColorType, ImageEncoder};
use std::io::Cursor;
use tiff::encoder::colortype::{ColorType as Kind, Gray8, Gray16, Gray32, Gray32Float, RGB8, RGB16, RGBA8};
use tiff::encoder::{Compression, Rational, TiffEncoder, TiffValue};
use tiff::tags::Tag;

/// Reads a file that states nothing about its pixels, or for which 10 µm overrides it.
fn ten(file: &[u8], tissue: Option<Tissue>, threshold: Option<u16>) -> Result<Micrograph, MicrographError> {
    Micrograph::read(file, &Reading { pixel_um: Some(10.0), tissue, threshold })
}

/// The contours of [`ring`] with pixels of 10 µm.
fn expected() -> Micrograph {
    ten(&grey(SIDE, &ring(255)), None, None).unwrap()
}

#[track_caller]
fn same(file: &[u8], tissue: Option<Tissue>, threshold: Option<u16>) -> Micrograph {
    let found = ten(file, tissue, threshold).unwrap_or_else(|error| panic!("{error}"));
    let expected = expected();
    assert_eq!((&found.outer, &found.lumen), (&expected.outer, &expected.lumen));
    found
}

/// Encodes a TIFF; `tags` writes further tags.
fn tagged<C: Kind>(
    samples: &[C::Inner],
    compression: Compression,
    tags: impl FnOnce(&mut tiff::encoder::DirectoryEncoder<'_, &mut Cursor<Vec<u8>>, tiff::encoder::TiffKindStandard>),
) -> Vec<u8>
where
    [C::Inner]: TiffValue,
{
    let mut out = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut out).unwrap().with_compression(compression);
    let mut image = encoder.new_image::<C>(SIDE as u32, SIDE as u32).unwrap();
    image.rows_per_strip(7).unwrap();
    tags(image.encoder());
    image.write_data(samples).unwrap();
    out.into_inner()
}

fn plain<C: Kind>(samples: &[C::Inner]) -> Vec<u8>
where
    [C::Inner]: TiffValue,
{
    tagged::<C>(samples, Compression::Uncompressed, |_| {})
}

/// A TIFF with a description and a resolution.
fn described(text: &str, per_unit: [u32; 2], unit: u16) -> Vec<u8> {
    tagged::<Gray8>(&ring(255), Compression::Uncompressed, |tags| {
        tags.write_tag(Tag::ImageDescription, text).unwrap();
        tags.write_tag(Tag::XResolution, Rational { n: per_unit[0], d: 1 }).unwrap();
        tags.write_tag(Tag::YResolution, Rational { n: per_unit[1], d: 1 }).unwrap();
        tags.write_tag(Tag::ResolutionUnit, unit).unwrap();
    })
}

/// A TIFF with one strip, of which every tag is given: the number, the value.
fn raw(tags: &[(u16, u32)], data: &[u8]) -> Vec<u8> {
    let mut entries: Vec<(u16, u32)> = tags.to_vec();
    let start = 8 + 2 + 12 * (entries.len() as u32 + 2) + 4;
    entries.extend([(273, start), (279, data.len() as u32)]);
    entries.sort_unstable();
    let mut file = [&b"II*\0\x08\0\0\0"[..], &(entries.len() as u16).to_le_bytes()].concat();
    for (tag, value) in entries {
        file.extend(
            [&tag.to_le_bytes()[..], &4_u16.to_le_bytes(), &1_u32.to_le_bytes(), &value.to_le_bytes()].concat(),
        );
    }
    file.extend([&[0; 4], data].concat());
    file
}

/// Tags of a grey TIFF of [`SIDE`] pixels a side.
fn tags(bits: u32, photometric: u32, compression: u32) -> Vec<(u16, u32)> {
    let side = SIDE as u32;
    vec![(256, side), (257, side), (258, bits), (259, compression), (262, photometric), (277, 1), (278, side)]
}

fn wide(value: u16) -> Vec<u16> {
    ring(1).into_iter().map(|pixel| u16::from(pixel) * value).collect()
}

#[test]
fn pngs_of_all_kinds_are_the_same() {
    let plain = ring(255);
    let bytes = |pixel: fn(u8) -> Vec<u8>| plain.iter().flat_map(|value| pixel(*value)).collect::<Vec<u8>>();
    for (color, depth, pixels) in [
        (ColorType::Grayscale, BitDepth::Sixteen, bytes(|v| vec![v, v])),
        (ColorType::Rgb, BitDepth::Eight, bytes(|v| vec![v; 3])),
        (ColorType::Rgb, BitDepth::Sixteen, bytes(|v| vec![v; 6])),
        (ColorType::Rgba, BitDepth::Eight, bytes(|v| vec![v, v, v, 255])),
        (ColorType::Rgba, BitDepth::Sixteen, bytes(|v| vec![v, v, v, v, v, v, 255, 255])),
        (ColorType::GrayscaleAlpha, BitDepth::Eight, bytes(|v| vec![v, 255])),
        // Transparent outside and in the lumen, where the colour does not count.
        (ColorType::Rgba, BitDepth::Eight, bytes(|v| if v == 0 { vec![9, 8, 7, 0] } else { vec![5, 5, 5, 255] })),
        (ColorType::GrayscaleAlpha, BitDepth::Eight, bytes(|v| vec![7, v])),
    ] {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, SIDE as u32, SIDE as u32);
        encoder.set_color(color);
        encoder.set_depth(depth);
        encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
        same(&file, None, None);
    }
    // Grey 0 is transparent.
    let clear = same(&with(&[chunk(b"tRNS", &[0, 0])]), None, None);
    let count = ring(255).iter().filter(|value| **value == 0).count();
    assert_eq!(clear.notes(), [format!("{count} transparent pixels count as 0")]);
}

#[test]
fn tiffs_of_all_kinds_are_the_same() {
    let plain8 = ring(255);
    let three = |pixels: &[u8]| pixels.iter().flat_map(|value| [*value; 3]).collect::<Vec<u8>>();
    let four = plain8.iter().flat_map(|v| [*v, *v, *v, 255]).collect::<Vec<u8>>();
    let flat = ring(1);
    for compression in [
        Compression::Uncompressed,
        Compression::Lzw,
        Compression::Packbits,
        Compression::Deflate(tiff::encoder::DeflateLevel::Fast),
    ] {
        same(&tagged::<Gray8>(&plain8, compression, |_| {}), None, None);
        same(&tagged::<Gray16>(&wide(65535), compression, |_| {}), None, None);
    }
    same(&plain::<RGB8>(&three(&plain8)), None, None);
    same(&plain::<RGB16>(&wide(300).iter().flat_map(|v| [*v; 3]).collect::<Vec<_>>()), None, None);
    same(&plain::<RGBA8>(&four), None, None);
    same(&plain::<Gray32>(&flat.iter().map(|v| u32::from(*v) * 40_000).collect::<Vec<_>>()), None, None);
    same(&plain::<Gray32Float>(&flat.iter().map(|v| f32::from(*v)).collect::<Vec<_>>()), None, None);
    // One bit: 1 is white, or 1 is black as tifffile writes it, or the pixels are a mask.
    let packed: Vec<u8> = flat.chunks(8).map(|bits| bits.iter().fold(0, |byte, bit| byte << 1 | bit)).collect();
    let inverted: Vec<u8> = packed.iter().map(|byte| !byte).collect();
    same(&raw(&tags(1, 1, 1), &packed), None, None);
    let stored = same(&raw(&tags(1, 0, 1), &packed), None, None);
    assert_eq!(stored.notes(), ["the TIFF shows the value 0 as white: values are used as stored"]);
    same(&raw(&tags(1, 4, 1), &packed), None, None);
    assert_eq!(ten(&raw(&tags(1, 0, 1), &inverted), None, None), Err(MicrographError::CutOff));
    same(&raw(&tags(1, 0, 1), &inverted), Some(Tissue::Zero), None);
    // A palette, whose colours do not count, and the inverted grey of ImageJ.
    same(&raw(&tags(8, 3, 1), &flat), None, None);
    same(&raw(&tags(8, 0, 1), &plain8), None, None);
}

#[test]
fn bmp_and_jpeg_are_masks() {
    let plain = ring(255);
    let encode = |color: ExtendedColorType, pixels: &[u8]| {
        let mut file = Vec::new();
        BmpEncoder::new(&mut file).write_image(pixels, SIDE as u32, SIDE as u32, color).unwrap();
        file
    };
    let three: Vec<u8> = plain.iter().flat_map(|value| [*value; 3]).collect();
    same(&encode(ExtendedColorType::L8, &plain), None, None);
    same(&encode(ExtendedColorType::Rgb8, &three), None, None);
    let jpeg = |color: ExtendedColorType, pixels: &[u8], quality: u8| {
        let mut file = Vec::new();
        let encoder = JpegEncoder::new_with_quality(&mut file, quality);
        encoder.write_image(pixels, SIDE as u32, SIDE as u32, color).unwrap();
        file
    };
    for quality in [100, 90] {
        let found = same(&jpeg(ExtendedColorType::L8, &plain, quality), None, None);
        assert_eq!(found.notes(), ["no threshold was given: values from 128 on are taken as bright"]);
        same(&jpeg(ExtendedColorType::Rgb8, &three, quality), None, Some(120));
    }
    let inverted: Vec<u8> = plain.iter().map(|value| !value).collect();
    same(&jpeg(ExtendedColorType::L8, &inverted, 95), Some(Tissue::Zero), Some(128));
    let file = jpeg(ExtendedColorType::L8, &plain, 90);
    assert_eq!(ten(&file, Some(Tissue::Values(vec![255])), None), Err(MicrographError::Blurred));
    for end in [3, file.len() / 2, file.len() - 1] {
        assert!(matches!(ten(&file[..end], None, None), Err(MicrographError::Damaged("JPEG", _))), "{end}");
    }
    let pink: Vec<u8> = plain.iter().flat_map(|_| [230, 120, 180]).collect();
    let found = ten(&jpeg(ExtendedColorType::Rgb8, &pink, 90), None, None).unwrap_err();
    assert!(matches!(found, MicrographError::Colour { column: 0, row: 0, .. }), "{found}");
    assert!(found.to_string().contains("segment a stained photo first"), "{found}");
}

#[test]
fn labels_need_a_choice() {
    // 1 is the lumen, 2 the tissue, as ilastik or a label image in 16 bits has them.
    let mut labels = wide(2);
    for (i, label) in labels.iter_mut().enumerate() {
        let inside = ((i % SIDE) as f32 - 22.5).hypot((i / SIDE) as f32 - 15.5) < 8.0;
        *label = if inside { 1 } else { *label };
    }
    let file = plain::<Gray16>(&labels);
    let found = ten(&file, None, None).unwrap_err();
    assert_eq!(found, MicrographError::Values("0, 1 and 2".into()));
    same(&file, Some(Tissue::Values(vec![2])), None);
    same(&file, None, Some(2));
    assert_eq!(ten(&file, Some(Tissue::Values(vec![2])), Some(2)), Err(MicrographError::Exclusive));
    // Instances of cellpose: each cell has its number.
    let cells: Vec<u16> = wide(1).iter().enumerate().map(|(i, v)| v * (300 + i as u16)).collect();
    let file = plain::<Gray16>(&cells);
    let Err(MicrographError::Values(listed)) = ten(&file, None, None) else { panic!("no values") };
    assert!(listed.starts_with("0, ") && listed.contains(" … and "), "{listed}");
    same(&file, Some(Tissue::Nonzero), None);
    // Two labels without 0.
    let two: Vec<u16> = wide(1).iter().map(|v| v + 1).collect();
    assert_eq!(ten(&plain::<Gray16>(&two), None, None), Err(MicrographError::Values("1 and 2".into())));
    same(&plain::<Gray16>(&two), Some(Tissue::Values(vec![2])), None);
    // An inverted mask.
    let inverted: Vec<u8> = ring(255).iter().map(|value| !value).collect();
    assert_eq!(ten(&grey(SIDE, &inverted), None, None), Err(MicrographError::CutOff));
    for tissue in ["0", "zero", "dark"] {
        same(&grey(SIDE, &inverted), Some(tissue.parse().unwrap()), None);
    }
    // Smoothed edges: grey values between.
    let smooth: Vec<u8> = ring(200).iter().map(|value| value + 20).collect();
    same(&grey(SIDE, &smooth), None, Some(128));
    assert_eq!("1, 2".parse(), Ok(Tissue::Values(vec![1, 2])));
    assert!("2,70000".parse::<Tissue>().unwrap_err().contains("`70000`"));
}

#[test]
fn files_state_the_side_of_a_pixel() {
    let ome =
        |x: &str| format!("<?xml version=\"1.0\"?><OME><Image><Pixels SizeZ=\"1\" SizeC=\"1\" {x}/></Image></OME>");
    for (text, per_unit, unit, side) in [
        ("", [5000, 5000], 3, 2.0),
        ("", [5000, 5000], 2, 5.08),
        ("ImageJ=1.54f\nunit=micron\n", [2, 2], 1, 0.5),
        ("ImageJ=1.54f\nunit=\\u00B5m\n", [1, 1], 1, 1.0),
        ("ImageJ=1.54f\nunit=mm\n", [400, 400], 1, 2.5),
        ("ImageJ=1.54f\nunit=inch\n", [10_160, 10_160], 2, 2.5),
        (r#"{"shape": [40, 40], "unit": "mm"}"#, [400, 400], 2, 2.5),
        (r#"{"shape": [40, 40], "unit": "um"}"#, [4000, 4000], 2, 2.5),
        (r#"{"shape": [40, 40], "unit": "inch"}"#, [10_160, 10_160], 2, 2.5),
        (r#"{"shape": [40, 40]}"#, [10_160, 10_160], 2, 2.5),
        ("ImageJ=1.54f\nunit=um\nimages=1\n", [1, 1], 2, 1.0),
        (&ome("PhysicalSizeX=\"2.5\" PhysicalSizeY=\"2.5\""), [1, 1], 1, 2.5),
        (&ome("PhysicalSizeX=\"650\" PhysicalSizeXUnit=\"nm\""), [72, 72], 2, 0.65),
        (&ome("PhysicalSizeX=\"0.002\" PhysicalSizeXUnit=\"mm\" PhysicalSizeY=\"2\""), [1, 1], 1, 2.0),
    ] {
        let file = described(text, per_unit, unit);
        let found = Micrograph::read(&file, &Reading::default());
        let side_of = |error| match error {
            // A section of 34 pixels is too small for this side, and the side is known.
            MicrographError::Extent(mm) => mm * 1e3 / 34.0,
            MicrographError::NoLumen => side,
            other => panic!("{text}: {other}"),
        };
        let found = found.map_or_else(side_of, |found| found.pixel_um());
        assert!((found / side - 1.0).abs() < 0.05, "{text}: {found}, not {side}");
    }
    let unstated = |text: &str, per_unit: [u32; 2], unit: u16| {
        Micrograph::read(&described(text, per_unit, unit), &Reading::default()).unwrap_err()
    };
    for (text, per_unit, unit) in [
        ("", [300, 300], 2),
        ("", [72, 72], 2),
        ("", [1, 1], 1),
        ("ImageJ=1.54f\nunit=pixel\n", [1, 1], 1),
        ("ImageJ=1.54f\nunit=inch\n", [72, 72], 2),
        (r#"{"shape": [40, 40], "unit": "um"}"#, [1, 1], 1),
        ("", [0, 0], 3),
    ] {
        let found = unstated(text, per_unit, unit);
        assert!(matches!(found, MicrographError::NoPixelSize(_)), "{text} {per_unit:?}: {found}");
    }
    assert!(unstated("", [300, 300], 2).to_string().contains("300 pixels per inch"));
    let file = described("", [5000, 2500], 3);
    assert_eq!(Micrograph::read(&file, &Reading::default()), Err(MicrographError::NotSquare(2.0, 4.0)));
    let found = same(&file, None, None);
    assert_eq!(
        found.notes(),
        ["the file states pixels of 2 × 4 µm (5000 pixels per centimetre); the given side, 10 µm, is used"]
    );
    // PNG states pixels per metre.
    let physical = |per_metre: u32| {
        let value = [&per_metre.to_be_bytes()[..], &per_metre.to_be_bytes(), &[1]].concat();
        Micrograph::read(&with(&[chunk(b"pHYs", &value)]), &Reading::default())
    };
    assert_eq!(physical(100_000).unwrap().pixel_um(), 10.0);
    assert!(matches!(physical(11_811), Err(MicrographError::NoPixelSize(_))), "300 dots per inch");
    assert_eq!(read(&grey(SIDE, &ring(255)), 10.0).unwrap().notes(), [""; 0]);
}

#[test]
fn several_images_are_refused() {
    let pages = |file: &[u8]| match ten(file, None, None) {
        Err(MicrographError::Pages(what)) => what,
        other => panic!("{other:?}"),
    };
    let mut out = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut out).unwrap();
    for _ in 0..3 {
        encoder.write_image::<Gray8>(SIDE as u32, SIDE as u32, &ring(255)).unwrap();
    }
    assert_eq!(pages(&out.into_inner()), "3 pages");
    assert_eq!(pages(&described("ImageJ=1.54f\nimages=5\nslices=5\n", [1, 1], 1)), "a stack of 5 images of ImageJ");
    let ome = |pixels: &str| described(&format!("<OME><Image><Pixels {pixels}</Pixels></Image></OME>"), [1, 1], 1);
    assert_eq!(pages(&ome("SizeZ=\"4\">")), "4 focal planes (OME-XML SizeZ)");
    assert_eq!(pages(&ome("SizeT=\"2\">")), "2 times (OME-XML SizeT)");
    assert_eq!(pages(&ome("SizeC=\"2\"><Channel/><Channel/>")), "2 channels (OME-XML)");
    // Smaller copies are no pages.
    let mut out = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut out).unwrap();
    encoder.write_image::<Gray8>(SIDE as u32, SIDE as u32, &ring(255)).unwrap();
    let mut small = encoder.new_image::<Gray8>(20, 20).unwrap();
    small.encoder().write_tag(Tag::NewSubfileType, 1_u32).unwrap();
    small.write_data(&[0; 400]).unwrap();
    same(&out.into_inner(), None, None);
}

#[test]
fn tiffs_that_are_not_read_say_why() {
    let refused = |file: &[u8]| ten(file, None, None).unwrap_err().to_string();
    let flat = ring(1);
    for (tags, text) in [
        (tags(8, 1, 7), "JPEG"),
        (tags(8, 1, 50_000), "compressed by"),
        (tags(12, 1, 1), "12 bits"),
        (tags(8, 6, 1), "YCbCr"),
    ] {
        let found = refused(&raw(&tags, &flat));
        assert!(found.contains(text), "{found}");
    }
    let half: Vec<f32> = flat.iter().map(|v| f32::from(*v) / 2.0).collect();
    assert!(refused(&plain::<Gray32Float>(&half)).contains("the value 0.5"));
    let wide: Vec<u32> = flat.iter().map(|v| u32::from(*v) * 70_000).collect();
    assert!(refused(&plain::<Gray32>(&wide)).contains("the value 70000"));
    let huge = |width: u32, height: u32| {
        let mut tags = tags(8, 1, 1);
        (tags[0].1, tags[1].1) = (width, height);
        raw(&tags, &flat)
    };
    assert_eq!(ten(&huge(9000, 40), None, None), Err(MicrographError::Size { width: 9000, height: 40 }));
    assert!(ten(&huge(u32::MAX, u32::MAX), None, None).is_err());
    assert!(matches!(ten(&huge(8192, 8192), None, None), Err(MicrographError::Damaged("TIFF", _))));
    // The list of directories leads back to the first one.
    let mut looped = raw(&tags(8, 1, 1), &flat);
    let next = 8 + 2 + 12 * 9;
    looped[next..next + 4].copy_from_slice(&8_u32.to_le_bytes());
    assert!(matches!(ten(&looped, None, None), Err(MicrographError::Damaged("TIFF", _))));
    let whole = raw(&tags(8, 1, 1), &flat);
    for end in 4..whole.len() {
        assert!(ten(&whole[..end], None, None).is_err(), "{end}");
    }
}

#[test]
fn long_messages_of_decoders_are_cut() {
    let text = "1, ".repeat(100_000);
    for error in [MicrographError::Variant(text.clone()), MicrographError::Damaged("TIFF", text)] {
        let found = error.to_string();
        assert!(found.contains("1, 1, 1") && found.contains('…') && found.chars().count() < 400, "{found}");
    }
    assert_eq!(MicrographError::Damaged("TIFF", "é".into()).to_string(), "the TIFF is damaged: é");
}

#[test]
fn the_cases_of_other_programs_measure_the_same() {
    let case = |name: &str| {
        let path = format!("{}/../../tests/cases/image-forms/{name}", env!("CARGO_MANIFEST_DIR"));
        std::fs::read(path).unwrap()
    };
    let two = |tissue: Option<Tissue>| Reading { pixel_um: Some(2.0), tissue, threshold: None };
    let expected = Micrograph::read(&case("mask-rgb.png"), &two(None)).unwrap();
    let lumen = expected.measure().lumen_area_mm2;
    assert!((lumen - 1.419).abs() < 0.0005, "{lumen}");
    let labels = Micrograph::read(&case("labels16.png"), &two(Some(Tissue::Values(vec![2])))).unwrap();
    let ome = Micrograph::read(&case("mask.ome.tif"), &Reading::default()).unwrap();
    let tif = Micrograph::read(&case("mask.tif"), &Reading::default()).unwrap();
    for found in [&labels, &ome, &tif] {
        assert_eq!((&found.outer, &found.lumen), (&expected.outer, &expected.lumen));
    }
    assert_eq!((ome.pixel_um(), tif.pixel_um()), (2.0, 2.0));
    let source = "tifffile with a metric unit: 5000 pixels per cm, whatever the tag says";
    assert_eq!(tif.notes(), [format!("the side of a pixel is 2 µm, as the file states ({source})")]);
    let found = Micrograph::read(&case("labels16.png"), &two(None));
    assert_eq!(found, Err(MicrographError::Values("0, 1 and 2".into())));
}

#[test]
fn pictures_show_the_image_under_its_contours() {
    let file = grey(SIDE, &ring(7));
    let picture = Picture::read(&file).unwrap();
    assert_eq!((picture.size, picture.side, picture.centre), ([40, 40], 1.0, [20.0, 20.0]));
    assert_eq!(picture.grey, ring(255));
    let traced = expected();
    let places = picture.place(&traced.outer, 10.0);
    assert!(places.iter().all(|p| ((p[0] - 20.0).hypot(p[1] - 20.0) - 17.0).abs() < 0.6), "{places:?}");
    // A large image is reduced.
    let large = file_of(9, 8000);
    let picture = Picture::read(&large).unwrap();
    assert_eq!((picture.size, picture.side), ([5, 4000], 2.0));
    assert_eq!(&picture.grey[..5], [0; 5]);
}

/// A black image.
fn file_of(width: usize, height: usize) -> Vec<u8> {
    let rows = vec![0; (width + 1) * height];
    file(&[header(width as u32, height as u32, 8, 0, 0), chunk(b"IDAT", &deflated(&rows))])
}
