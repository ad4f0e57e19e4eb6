//! Targets from images of sections.

use super::target::{Target, refused};
use crate::measure::micrograph::{MAX_BYTES, Micrograph, MicrographError, Reading, Setting, Tissue};
use crate::measure::morphometry::Quantity;
use crate::spec::{Fault, JsonReader};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;

/// Maximum number of images in a request.
pub const MOST_IMAGES: usize = 20;
/// Half width of the accepted range if the request has none, as a fraction of the value. A single
/// section differs from the mean over its region.
pub const IMAGE_TOLERANCE: f64 = 0.1;
/// Maximum number of values of tissue in a request.
const MOST_VALUES: usize = 256;
/// Members of an image in a request.
const MEMBERS: [&str; 8] = ["region", "image", "png", "pixel_um", "tissue", "threshold", "quantities", "tolerance"];
/// Quantities that become targets if the request names none: those that pixels change little and
/// that a region has everywhere.
pub const IMAGE_QUANTITIES: [&str; 7] = [
    "tissue_area_mm2",
    "lumen_area_mm2",
    "lumen_perimeter_mm",
    "folds_on_ring",
    "fold_height_p50_um",
    "tissue_thickness_p50_um",
    "lumen_gap_p50_um",
];

/// An image of a section.
#[derive(Clone, Debug)]
pub struct SectionImage {
    /// Region of the section.
    pub region: String,
    /// Bytes of the file.
    pub file: Vec<u8>,
    /// Member of the request that has the file, for messages.
    pub member: &'static str,
    /// Size and meaning of its pixels.
    pub reading: Reading,
    /// Quantities that become targets. `None` means [`IMAGE_QUANTITIES`].
    pub quantities: Option<Vec<String>>,
    /// Half width of the accepted range as a fraction of the value.
    pub tolerance: f64,
}

/// Fault of an image: its index, the member, and a sentence.
pub type ImageFault = (usize, &'static str, String);

/// Values of a quantity in the sections of a region.
#[derive(Default)]
struct RegionValues {
    values: Vec<f64>,
    /// Maximum tolerance of the images.
    tolerance: f64,
    /// Beginnings of the digests of the images.
    images: Vec<String>,
}

/// Measures sections. Several sections of a region result in their mean. The range then extends to
/// their standard deviation if that exceeds the tolerance.
///
/// # Errors
/// All images that cannot be measured.
pub fn image_targets(images: &[SectionImage]) -> Result<Vec<Target>, Vec<ImageFault>> {
    let mut faults = Vec::new();
    // By region and quantity.
    let mut measured: BTreeMap<(String, String), RegionValues> = BTreeMap::new();
    for (i, image) in images.iter().enumerate() {
        match values(image) {
            Ok(values) => {
                for (quantity, value) in values {
                    let all = measured.entry((image.region.clone(), quantity)).or_default();
                    all.values.push(value);
                    all.tolerance = all.tolerance.max(image.tolerance);
                    all.images.push(hex::encode(&Sha256::digest(&image.file)[..6]));
                }
            }
            Err((member, detail)) => faults.push((i, member, detail)),
        }
    }
    if !faults.is_empty() {
        return Err(faults);
    }
    let target = |((region, quantity), sections): ((String, String), RegionValues)| {
        let RegionValues { values, tolerance, images } = sections;
        let n = values.len() as f64;
        let value = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|x| (x - value).powi(2)).sum();
        let sd = if values.len() > 1 { (squares / (n - 1.0)).sqrt() } else { 0.0 };
        let half = sd.max(tolerance * value.abs());
        let source = Some(format!("SHA-256 of the image: {}…", images.join("…, ")));
        Target { region, quantity, value, low: value - half, high: value + half, source }
    };
    Ok(measured.into_iter().map(target).collect())
}

/// Quantities of one section.
fn values(image: &SectionImage) -> Result<Vec<(String, f64)>, (&'static str, String)> {
    if image.region == "tube" {
        return Err(("region", "an image shows one section of a region, not the tube".into()));
    }
    let wanted: Vec<&str> = match &image.quantities {
        Some(names) => names.iter().map(String::as_str).collect(),
        None => IMAGE_QUANTITIES.to_vec(),
    };
    for name in &wanted {
        if let Some((member, detail)) = refused(&image.region, name) {
            let member = if member == "region" { "region" } else { "quantities" };
            return Err((member, format!("`{name}` {detail}")));
        }
        if Quantity::named(name).is_none() {
            return Err(("quantities", format!("`{name}` needs more than one section")));
        }
    }
    let traced = Micrograph::read(&image.file, &image.reading).map_err(|error| {
        let chosen = image.reading.tissue.is_some();
        match error.setting() {
            Some(Setting::PixelSize) => ("pixel_um", error.to_string()),
            // Values, `nonzero` and `zero` are all choices of `tissue`.
            Some(Setting::Tissue) => ("tissue", error.to_string()),
            None if chosen && error == MicrographError::NoTissue => ("tissue", error.to_string()),
            None => (image.member, error.to_string()),
        }
    })?;
    let measures = traced.measure();
    let mut found = Vec::new();
    for name in wanted {
        match Quantity::named(name).and_then(|quantity| quantity.of(&measures)) {
            Some(value) => found.push((name.to_owned(), value)),
            // A section without folds has no height of folds. The request did not name the
            // quantity.
            None if image.quantities.is_none() => {}
            None => return Err(("quantities", format!("the section has no `{name}`"))),
        }
    }
    Ok(found)
}

/// Measures the images of a request, `[{ "region", "image", "pixel_um", "tissue", "threshold",
/// "quantities", "tolerance" }]`, with `image` as base64. The former name of `image`, `png`, is read
/// too.
///
/// # Errors
/// Returns all faults, with pointers that start with `/images`.
pub fn read_images(list: &Value) -> Result<Vec<Target>, Vec<Fault>> {
    let Some(items) = list.as_array().filter(|items| items.len() <= MOST_IMAGES) else {
        return Err(vec![Fault::new("/images", format!("must be an array of at most {MOST_IMAGES} objects"))]);
    };
    let mut reader = JsonReader::default();
    let read = |(i, item): (usize, &Value)| read_image(&mut reader, item, &format!("/images/{i}"));
    let images: Vec<SectionImage> = items.iter().enumerate().filter_map(read).collect();
    let images = reader.finish(Some(images))?;
    let at = |(i, member, detail): ImageFault| Fault::new(format!("/images/{i}/{member}"), detail);
    image_targets(&images).map_err(|faults| faults.into_iter().map(at).collect())
}

fn read_image(reader: &mut JsonReader, item: &Value, at: &str) -> Option<SectionImage> {
    let before = reader.count();
    let members = reader.members(at, item, &MEMBERS)?;
    let mut wrong = |name: &str, detail: &str| {
        reader.fault::<()>(format!("{at}/{name}"), detail);
    };
    let given = |name: &str| members.get(name).filter(|value| !value.is_null());
    let region = given("region").and_then(Value::as_str).unwrap_or_else(|| {
        wrong("region", "must be the name of a region");
        ""
    });
    let member = if given("png").is_some() && given("image").is_none() { "png" } else { "image" };
    if given("png").is_some() && given("image").is_some() {
        wrong("png", "is the former name of `image`: state one of them");
    }
    let file = given(member).and_then(Value::as_str).and_then(|text| BASE64_STANDARD.decode(text.trim()).ok());
    if file.is_none() {
        wrong(member, "must be the file of an image as base64");
    } else if file.as_ref().is_some_and(|file| file.len() as u64 > MAX_BYTES) {
        wrong(member, "is too large");
    }
    let pixel_um = given("pixel_um").map(Value::as_f64);
    if pixel_um == Some(None) {
        wrong("pixel_um", "must be the side of a pixel in micrometres");
    }
    let tissue = given("tissue").map(|choice| serde_json::from_value::<Tissue>(choice.clone()));
    if matches!(tissue, Some(Err(_))) {
        wrong("tissue", "must be an array of integers from 0 to 65535, `nonzero` or `zero`");
    }
    let tissue = tissue.and_then(Result::ok);
    if matches!(&tissue, Some(Tissue::Values(values)) if values.is_empty() || values.len() > MOST_VALUES) {
        wrong("tissue", &format!("must have 1 to {MOST_VALUES} values"));
    }
    let threshold =
        given("threshold").map(|value| value.as_u64().and_then(|n| u16::try_from(n).ok()).filter(|n| *n > 0));
    if threshold == Some(None) {
        wrong("threshold", "must be an integer from 1 to 65535");
    }
    let quantities: Option<Vec<String>> = given("quantities").map(|list| {
        serde_json::from_value(list.clone()).unwrap_or_else(|_| {
            wrong("quantities", "must be an array of names of quantities");
            Vec::new()
        })
    });
    if quantities.as_ref().is_some_and(|names| names.is_empty() || names.len() > 50) {
        wrong("quantities", "must have 1 to 50 names");
    }
    let tolerance = given("tolerance").map_or(Some(IMAGE_TOLERANCE), Value::as_f64);
    if !tolerance.is_some_and(|tolerance| (0.001..=1.0).contains(&tolerance)) {
        wrong("tolerance", "must be a number from 0.001 to 1");
    }
    if reader.count() > before {
        return None;
    }
    let reading = Reading { pixel_um: pixel_um.flatten(), tissue, threshold: threshold.flatten() };
    Some(SectionImage { region: region.to_owned(), file: file?, member, reading, quantities, tolerance: tolerance? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// A ring of tissue with four folds, as a mask of one byte per pixel. Radii are in pixels.
    fn mask(outer: f64) -> Vec<u8> {
        let side = 400_u32;
        let middle = f64::from(side) / 2.0;
        let pixel = |i: u32| {
            let [x, y] = [f64::from(i % side) + 0.5 - middle, f64::from(i / side) + 0.5 - middle];
            let [r, turn] = [x.hypot(y), y.atan2(x)];
            u8::from(r < outer && r > 60.0 + 25.0 * (4.0 * turn).cos()) * 255
        };
        let values: Vec<u8> = (0..side * side).map(pixel).collect();
        let mut png = Vec::new();
        let mut encoder = png::Encoder::new(&mut png, side, side);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.write_header().unwrap().write_image_data(&values).unwrap();
        png
    }

    fn image(png: &[u8]) -> Value {
        json!({ "region": "isthmus", "image": BASE64_STANDARD.encode(png), "pixel_um": 5 })
    }

    #[test]
    fn sections_become_targets() {
        let targets = read_images(&json!([image(&mask(150.0))])).unwrap();
        let named = |name: &str| targets.iter().find(|target| target.quantity == name).expect("it is measured");
        assert!(targets.iter().all(|target| target.region == "isthmus" && target.source.is_some()), "{targets:?}");
        assert_eq!(named("folds_on_ring").value, 4.0);
        let area = std::f64::consts::PI * (60.0_f64.powi(2) + 25.0_f64.powi(2) / 2.0) * 25e-6;
        let lumen = named("lumen_area_mm2");
        assert!((lumen.value / area - 1.0).abs() < 0.01, "{lumen:?} {area}");
        assert!((lumen.high / lumen.value - 1.1).abs() < 1e-9 && (lumen.low / lumen.value - 0.9).abs() < 1e-9);
    }

    #[test]
    fn several_sections_of_a_region_give_mean_and_spread() {
        let mut images = [image(&mask(120.0)), image(&mask(180.0))];
        for image in &mut images {
            image["quantities"] = json!(["tissue_area_mm2"]);
            image["tolerance"] = json!(0.01);
        }
        let [target]: [Target; 1] = read_images(&json!(images)).unwrap().try_into().unwrap();
        let [one, two] = [120.0_f64, 180.0].map(|r| std::f64::consts::PI * (r * r - 60.0 * 60.0 - 312.5) * 25e-6);
        let (mean, sd) = ((one + two) / 2.0, (two - one) / 2.0_f64.sqrt());
        assert!(
            (target.value / mean - 1.0).abs() < 0.01 && ((target.high - mean) / sd - 1.0).abs() < 0.02,
            "{target:?}"
        );
    }

    #[test]
    fn every_fault_names_its_member() {
        let good = image(&mask(150.0));
        let with = |name: &str, value: Value| {
            let mut image = good.clone();
            image[name] = value;
            json!([image])
        };
        let whole = mask(150.0);
        for (list, pointer) in [
            (json!({}), "/images"),
            (json!(vec![good.clone(); 21]), "/images"),
            (json!([good.clone(), 3]), "/images/1"),
            (with("image", json!("not base64!")), "/images/0/image"),
            (with("image", json!(BASE64_STANDARD.encode(b"GIF89a"))), "/images/0/image"),
            (with("image", json!(BASE64_STANDARD.encode(&whole[..whole.len() / 2]))), "/images/0/image"),
            (with("image", Value::Null), "/images/0/image"),
            (with("png", json!(BASE64_STANDARD.encode(&whole))), "/images/0/png"),
            (json!([{ "region": "isthmus", "png": "R0lGODlh", "pixel_um": 5 }]), "/images/0/png"),
            (json!([{ "region": "isthmus", "image": BASE64_STANDARD.encode(&whole) }]), "/images/0/pixel_um"),
            (with("pixel_um", json!(0)), "/images/0/pixel_um"),
            (with("pixel_um", json!("5")), "/images/0/pixel_um"),
            (with("tissue", json!([7])), "/images/0/tissue"),
            (with("tissue", json!([65536])), "/images/0/tissue"),
            (with("tissue", json!("grey")), "/images/0/tissue"),
            (with("tissue", json!("zero")), "/images/0/image"),
            (with("threshold", json!(0)), "/images/0/threshold"),
            (with("threshold", json!(65536)), "/images/0/threshold"),
            (with("threshold", json!("128")), "/images/0/threshold"),
            (with("tissue", json!([])), "/images/0/tissue"),
            (with("region", json!("ishtmus")), "/images/0/region"),
            (with("region", json!("tube")), "/images/0/region"),
            (with("quantities", json!(["folds"])), "/images/0/quantities"),
            (with("quantities", json!(["fold_continuity"])), "/images/0/quantities"),
            (with("quantities", json!([])), "/images/0/quantities"),
            (with("tolerance", json!(0)), "/images/0/tolerance"),
            (with("pixels", json!(1)), "/images/0/pixels"),
        ] {
            let faults = read_images(&list).unwrap_err();
            assert_eq!(faults[0].pointer, pointer, "{faults:?}");
        }
        assert_eq!(read_images(&json!([])).unwrap(), []);
    }

    #[test]
    fn the_former_name_a_threshold_and_a_choice_give_the_same_targets() {
        let file = BASE64_STANDARD.encode(mask(150.0));
        let expected = read_images(&json!([image(&mask(150.0))])).unwrap();
        for image in [
            json!({ "region": "isthmus", "png": file, "pixel_um": 5 }),
            json!({ "region": "isthmus", "image": file, "pixel_um": 5, "threshold": 200 }),
            json!({ "region": "isthmus", "image": file, "pixel_um": 5, "tissue": "nonzero" }),
            json!({ "region": "isthmus", "image": file, "pixel_um": 5, "tissue": [255], "png": null }),
        ] {
            assert_eq!(read_images(&json!([image])).unwrap(), expected);
        }
    }
}
