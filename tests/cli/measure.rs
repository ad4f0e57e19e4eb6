//! `oviduct measure`: measures of the section in an image.

use super::{TINY, code, folder, json, oviduct, run, said};
use serde_json::Value;
use std::fs::File;
use std::path::Path;

/// Writes an image of a ring of tissue with radii of 180 and 100 µm, at 10 µm per pixel.
fn ring(path: &Path) {
    let radius = |i: usize| ((i % 40) as f64 - 19.5).hypot((i / 40) as f64 - 19.5);
    let pixels: Vec<u8> = (0..1600).map(|i| if (10.0..18.0).contains(&radius(i)) { 255 } else { 0 }).collect();
    let mut encoder = png::Encoder::new(File::create(path).expect("created"), 40, 40);
    encoder.set_color(png::ColorType::Grayscale);
    let mut writer = encoder.write_header().expect("a header");
    writer.write_image_data(&pixels).expect("pixels");
}

#[test]
fn the_labels_of_a_section_measure_what_the_report_says() {
    let at = folder();
    let generate = [&["generate", "--seed", "3", "--gpu", "off", "--json", "--out", "model"], &TINY[..]].concat();
    json(&run(at.path(), &generate));
    let report = std::fs::read(at.path().join("model/report.json")).expect("a report");
    let report: Value = serde_json::from_slice(&report).expect("JSON");
    // The later sections of such a small model have cusped notches that are narrower than a pixel.
    let index = 4;
    let output = run(
        at.path(),
        &[
            "section",
            "model/sections.bin",
            "--index",
            &index.to_string(),
            "--labels",
            "--size",
            "1500",
            "--out",
            "labels.png",
        ],
    );
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    let pixel_um = printed.split_whitespace().nth(1).expect("the size of a pixel").to_owned();
    let measure = ["measure", "labels.png", "--pixel-um", &pixel_um, "--tissue", "2,3,4,5,6,7,8,9"];
    let found = json(&run(at.path(), &[&measure[..], &["--json"]].concat()));
    assert_eq!(found["settings"]["tissue"], serde_json::json!([2, 3, 4, 5, 6, 7, 8, 9]));
    assert_eq!(found["settings"]["pixel_um"].as_f64(), pixel_um.parse().ok());
    for name in
        ["lumen_area_mm2", "tissue_area_mm2", "outer_diameter_mm", "lumen_perimeter_mm", "hydraulic_diameter_um"]
    {
        let value = |value: &Value| value.as_f64().unwrap_or_else(|| panic!("{name}: {value}"));
        let (found, own) = (value(&found["quantities"][name]), value(&report["simulated"]["along"][name][index]));
        assert!((found / own - 1.0).abs() < 0.02, "{name}: {found}, not {own}");
    }
    let table = run(at.path(), &measure);
    assert_eq!(code(&table), 0, "{}", said(&table));
    let table = String::from_utf8_lossy(&table.stdout).into_owned();
    let quantities = found["quantities"].as_object().expect("an object").len();
    assert_eq!(table.lines().count(), quantities);
    assert!(table.lines().any(|line| line.starts_with("Lumen area  ") && line.ends_with("mm²")), "{table}");
}

#[test]
fn images_without_a_section_are_refused() {
    let at = folder();
    ring(&at.path().join("ring.png"));
    std::fs::write(at.path().join("text.png"), "no picture").expect("written");
    File::create(at.path().join("huge.png")).expect("created").set_len(65 << 20).expect("long");
    let measure = |image: &str, options: &[&str]| run(at.path(), &[&["measure", image], options].concat());
    assert_eq!(code(&measure("ring.png", &["--pixel-um", "10"])), 0);
    for (image, options, reason) in [
        ("missing.png", &["--pixel-um", "10"][..], "error: missing.png: No such file"),
        ("text.png", &["--pixel-um", "10"], "error: text.png: the file is no image that is read; PNG, TIFF"),
        ("huge.png", &["--pixel-um", "10"], "error: huge.png: larger than 64 MiB"),
        ("ring.png", &["--pixel-um", "10", "--tissue", "7"], "error: ring.png: no pixel is tissue"),
        ("ring.png", &["--pixel-um", "0.5"], "error: ring.png: the tissue has no lumen"),
    ] {
        let output = measure(image, options);
        assert_eq!((code(&output), output.stdout.len()), (1, 0), "{image} {options:?}");
        assert!(said(&output).starts_with(reason), "{}", said(&output));
    }
    for options in [&[][..], &["--pixel-um", "0"], &["--pixel-um", "NaN"], &["--pixel-um", "1", "--tissue", "65536"]] {
        let output = measure("ring.png", options);
        assert_eq!((code(&output), output.stdout.len()), (2, 0), "{options:?}");
        assert!(said(&output).contains("--pixel-um") || said(&output).contains("--tissue"), "{}", said(&output));
    }
}

/// Path of an image of another program.
fn case(name: &str) -> String {
    format!("{}/tests/cases/image-forms/{name}", env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn forms_of_one_mask_measure_the_same() {
    let at = folder();
    let lumen = |image: &str, options: &[&str]| {
        let found = json(&run(at.path(), &[&["measure", &case(image), "--json"], options].concat()));
        (found["quantities"]["lumen_area_mm2"].as_f64().expect("a number"), found["settings"].clone())
    };
    let (expected, _) = lumen("mask-rgb.png", &["--pixel-um", "2"]);
    assert!((expected - 1.419).abs() < 0.0005, "{expected}");
    let (labels, settings) = lumen("labels16.png", &["--pixel", "2um", "--tissue", "2"]);
    assert_eq!((labels, &settings["tissue"], &settings["pixel_um"]), (expected, &Value::from(vec![2]), &2.0.into()));
    let (ome, settings) = lumen("mask.ome.tif", &[]);
    assert_eq!((ome, &settings["pixel_um"], &settings["tissue"]), (expected, &2.0.into(), &Value::Null));
    let (tif, settings) = lumen("mask.tif", &[]);
    assert_eq!((tif, &settings["pixel_um"]), (expected, &2.0.into()));
    let output = run(at.path(), &["measure", &case("labels16.png"), "--pixel-um", "2"]);
    assert_eq!(code(&output), 1);
    assert!(said(&output).contains("the values 0, 1 and 2") && said(&output).contains("--tissue"), "{}", said(&output));
    let output = run(at.path(), &["measure", &case("mask.ome.tif"), "--pixel-um", "3"]);
    assert_eq!(code(&output), 0);
    let note = "the file states pixels of 2 × 2 µm (OME-XML); the given side, 3 µm, is used";
    assert!(said(&output).contains(note), "{}", said(&output));
}

#[test]
fn several_images_are_measured_in_one_call() {
    let at = folder();
    ring(&at.path().join("ring.png"));
    std::fs::write(at.path().join("text.png"), "no picture").expect("written");
    let images = ["measure", "ring.png", "text.png", &case("mask.tif"), "--pixel-um", "2"];
    let with = |options: &[&str]| run(at.path(), &[&images[..], options].concat());
    let output = with(&["--csv", "all.csv", "--outlines", "drawn"]);
    assert_eq!(code(&output), 1, "{}", said(&output));
    assert!(said(&output).contains("error: text.png: the file is no image that is read"), "{}", said(&output));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.starts_with("ring.png\nLumen area  ") && text.contains("mask.tif\nLumen area  "), "{text}");
    let rows = std::fs::read_to_string(at.path().join("all.csv")).expect("a table");
    let rows: Vec<&str> = rows.lines().collect();
    assert_eq!(rows.len(), 4);
    assert!(rows[0].starts_with("image,pixel_um,lumen_area_mm2,tissue_area_mm2,") && rows[0].ends_with(",error"));
    assert!(rows[1].starts_with("ring.png,2,0.00") && rows[1].ends_with(','), "{}", rows[1]);
    assert!(rows[2].starts_with("text.png,,") && rows[2].contains("no image that is read"), "{}", rows[2]);
    assert!(rows[3].contains("mask.tif,2,1.4"), "{}", rows[3]);
    for (name, side) in [("ring.png.outlines.png", 40), ("mask.tif.outlines.png", 1100)] {
        let picture = tiny_skia::Pixmap::load_png(at.path().join("drawn").join(name)).expect("a picture");
        assert_eq!((picture.width(), picture.height()), (side, side));
        let coloured = picture.pixels().iter().filter(|pixel| pixel.red() != pixel.blue()).count();
        assert!(coloured > 100, "{name}: {coloured}");
    }
    assert!(!at.path().join("drawn/text.png.outlines.png").exists());
    let output = with(&["--csv", "-"]);
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(printed.lines().collect::<Vec<_>>(), rows);
    let output = with(&["--json"]);
    assert_eq!(code(&output), 1);
    let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(found.as_array().map(Vec::len), Some(3));
    assert_eq!((&found[0]["image"], &found[0]["error"]), (&"ring.png".into(), &Value::Null));
    assert!(found[1]["error"].as_str().is_some_and(|why| why.contains("no image")) && found[1]["quantities"].is_null());
    std::fs::create_dir(at.path().join("other")).expect("a folder");
    ring(&at.path().join("other/ring.png"));
    let output = run(at.path(), &["measure", "ring.png", "other/ring.png", "--pixel-um", "2", "--outlines", "drawn"]);
    assert_eq!(code(&output), 2);
    assert!(said(&output).contains("would both be drawn/ring.png.outlines.png"), "{}", said(&output));
}

#[test]
fn sections_are_compared_with_published_values() {
    let at = folder();
    let measure = |options: &[&str]| run(at.path(), &[&["measure", &case("mask.ome.tif")], options].concat());
    let output = measure(&["--compare", "human:ampulla"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("\nPublished values\n") && text.contains("\nprimary_folds (ampulla) "), "{text}");
    assert!(!text.contains("(isthmus)"), "{text}");
    let found = json(&measure(&["--compare", "human", "--json"]));
    let compared = found["comparison"].as_array().expect("an array");
    assert!(compared.iter().any(|one| one["region"] == "isthmus" && one["quantity"] == "primary_folds"));
    let output = measure(&["--compare", "dragon"]);
    assert_eq!(code(&output), 2);
    assert!(
        said(&output).contains("are published for ") && said(&output).contains(", cow, human, pig,"),
        "{}",
        said(&output)
    );
}

/// An image with a gigabyte of zeros in one chunk, and an image whose header claims 2^31 pixels per
/// side. The process may use less memory than either needs.
#[cfg(target_os = "linux")]
#[test]
fn an_image_takes_bounded_memory_whatever_it_contains() {
    let at = folder();
    ring(&at.path().join("ring.png"));
    let plain = std::fs::read(at.path().join("ring.png")).expect("read");
    let mut compress = flate2::Compress::new(flate2::Compression::fast(), false);
    let mut block = Vec::with_capacity(1 << 16);
    compress.compress_vec(&[0; 1 << 20], &mut block, flate2::FlushCompress::Full).expect("compressed");
    let zeros = [&[0x78, 0x01], &block.repeat(1024)[..], &[0x03, 0x00, 0, 0, 0, 0]].concat();
    let chunk = |kind: &[u8; 4], data: &[u8]| {
        let mut sum = flate2::Crc::new();
        sum.update(&[kind, data].concat());
        [&(data.len() as u32).to_be_bytes()[..], kind, data, &sum.sum().to_be_bytes()].concat()
    };
    // The signature and the header chunk have 33 bytes.
    let with = |chunk: Vec<u8>| [&plain[..33], &chunk, &plain[33..]].concat();
    let wide = [&(1_u32 << 31).to_be_bytes()[..], &(1_u32 << 31).to_be_bytes(), &[1, 0, 0, 0, 0]].concat();
    let full = [&8192_u32.to_be_bytes()[..], &8192_u32.to_be_bytes(), &[8, 0, 0, 0, 0]].concat();
    let of =
        |header: &[u8]| [&plain[..8], &chunk(b"IHDR", header), &chunk(b"IDAT", &zeros), &chunk(b"IEND", &[])].concat();
    for (name, bytes, expected) in [
        ("iccp.png", with(chunk(b"iCCP", &[b"x\0\0", &zeros[..]].concat())), 0),
        ("ztxt.png", with(chunk(b"zTXt", &[b"x\0\0", &zeros[..]].concat())), 0),
        ("wide.png", of(&wide), 1),
        ("full.png", of(&full), 1),
    ] {
        std::fs::write(at.path().join(name), bytes).expect("written");
        let program = oviduct(at.path()).get_program().to_owned();
        let line = format!("ulimit -v 900000; exec \"$0\" measure {name} --pixel-um 10");
        let output = std::process::Command::new("/bin/sh")
            .args(["-c", &line])
            .arg(program)
            .current_dir(at.path())
            .env_clear()
            // Thread stacks count towards the limit.
            .env("TOKIO_WORKER_THREADS", "2")
            .output()
            .expect("a shell");
        assert_eq!(code(&output), expected, "{name}: {}", said(&output));
    }
}
