//! Side of a pixel, as files state it: resolutions, and descriptions of ImageJ, tifffile and OME.

use super::super::limits::PIXEL_UM;
use quick_xml::Reader;
use quick_xml::events::Event;
use serde::Deserialize;

/// What a file states about its pixels.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) enum Stated {
    Nothing,
    /// Sides in x and y, µm, and where the file states them.
    Sides([f64; 2], String),
    /// A resolution for printing.
    Print(String),
}

/// Minimum side of a pixel, µm, of which a resolution without a unit of a microscope is taken to be
/// one for printing: programs write 72 to 600 dots per inch where nothing is known.
const PRINT_UM: f64 = 40.0;

impl Stated {
    /// Statement of a resolution tag, from the sides in µm.
    pub(super) fn resolution(sides: [f64; 2], source: &str) -> Self {
        if !sides.iter().all(|side| side.is_finite() && *side > 0.0) {
            Self::Nothing
        } else if sides[0] >= PRINT_UM {
            Self::Print(source.to_owned())
        } else {
            Self::Sides(sides, source.to_owned())
        }
    }

    fn described(sides: [f64; 2], source: &str) -> Self {
        if sides.iter().all(|side| side.is_finite() && *side > 0.0) {
            Self::Sides(sides, source.to_owned())
        } else {
            Self::Nothing
        }
    }
}

/// Length of a unit in µm.
fn unit_um(name: &str) -> Option<f64> {
    match name.trim().trim_matches('"') {
        // The last two: ImageJ escapes the sign, and Latin-1 is not UTF-8.
        "µm" | "μm" | "um" | "micron" | "microns" | "micrometer" | "micrometre" | "\\u00B5m" | "\u{fffd}m" => {
            Some(1.0)
        }
        "nm" | "nanometer" => Some(1e-3),
        "pm" => Some(1e-6),
        "Å" => Some(1e-4),
        "mm" | "millimeter" => Some(1e3),
        "cm" | "centimeter" => Some(1e4),
        "m" | "meter" => Some(1e6),
        "inch" | "in" => Some(25_400.0),
        _ => None,
    }
}

/// True for the unit of resolutions for printing.
fn is_inch(name: &str) -> bool {
    matches!(name.trim().trim_matches('"'), "inch" | "in")
}

/// What the description of a TIFF states.
#[derive(Debug)]
pub(super) struct Described {
    pub(super) stated: Stated,
    /// Several images, if the description says so.
    pub(super) pages: Option<String>,
}

/// Reads the description of a TIFF. `per_unit` are the resolutions without their unit.
pub(super) fn described(text: &str, per_unit: Option<[f64; 2]>) -> Described {
    if text.starts_with("ImageJ=") {
        return imagej(text, per_unit);
    }
    if text.contains("<OME") {
        return ome(text);
    }
    Described { stated: tifffile(text, per_unit).unwrap_or(Stated::Nothing), pages: None }
}

/// JSON of tifffile with a metric `unit`. The resolution is in pixels per this unit, or per
/// centimetre if such pixels would have an impossible side. The tag of the unit does not count:
/// tifffile writes inches unless its user names another unit.
fn tifffile(text: &str, per_unit: Option<[f64; 2]>) -> Option<Stated> {
    #[derive(Deserialize)]
    struct Shaped {
        unit: String,
    }
    let name = serde_json::from_str::<Shaped>(text).ok()?.unit;
    let unit = unit_um(&name).filter(|_| !is_inch(&name))?;
    // tifffile writes 1 where no resolution is known.
    let per_unit = per_unit.filter(|per_unit| *per_unit != [1.0; 2])?;
    [(unit, name.as_str()), (unit_um("cm")?, "cm")].into_iter().find_map(|(unit, name)| {
        let sides = per_unit.map(|count| unit / count);
        let source = format!("tifffile with a metric unit: {} pixels per {name}, whatever the tag says", per_unit[0]);
        sides.iter().all(|side| PIXEL_UM.contains(side)).then_some(Stated::Sides(sides, source))
    })
}

/// Lines such as `unit=micron`; the resolution is in pixels per unit.
fn imagej(text: &str, per_unit: Option<[f64; 2]>) -> Described {
    let value = |name: &str| {
        text.lines().find_map(|line| line.split_once('=').filter(|(key, _)| key.trim() == name)).map(|(_, v)| v.trim())
    };
    let stated = match (value("unit").and_then(unit_um), per_unit) {
        (Some(unit), Some(per_unit)) => {
            let y = value("yunit").and_then(unit_um).unwrap_or(unit);
            let sides = [unit / per_unit[0], y / per_unit[1]];
            if value("unit").is_some_and(is_inch) {
                Stated::resolution(sides, &format!("{} pixels per inch in ImageJ's description", per_unit[0]))
            } else {
                Stated::described(sides, "ImageJ's description")
            }
        }
        _ => Stated::Nothing,
    };
    let images = value("images").and_then(|count| count.parse::<u64>().ok()).filter(|count| *count > 1);
    Described { stated, pages: images.map(|count| format!("a stack of {count} images of ImageJ")) }
}

/// Sizes in the first element `Pixels` of an OME-XML document.
fn ome(text: &str) -> Described {
    let mut found = Described { stated: Stated::Nothing, pages: None };
    let mut reader = Reader::from_str(text);
    let (mut images, mut planes) = (0_u32, 0_u32);
    loop {
        match reader.read_event() {
            Ok(Event::Start(element) | Event::Empty(element)) => match element.local_name().as_ref() {
                "Pixels" => {
                    images += 1;
                    if images > 1 {
                        continue;
                    }
                    let value = |name: &str| {
                        let attribute = element.try_get_attribute(name).ok().flatten()?;
                        Some(attribute.value.into_owned())
                    };
                    let side = |size: &str, unit: &str| {
                        let unit = value(unit).map_or(Some(1.0), |unit| unit_um(&unit))?;
                        Some(value(size)?.trim().parse::<f64>().ok()? * unit)
                    };
                    let x = side("PhysicalSizeX", "PhysicalSizeXUnit");
                    let y = side("PhysicalSizeY", "PhysicalSizeYUnit");
                    if let Some(x) = x.or(y) {
                        found.stated = Stated::described([x, y.unwrap_or(x)], "OME-XML");
                    }
                    for (name, what) in [("SizeZ", "focal planes"), ("SizeT", "times")] {
                        let size = value(name).and_then(|size| size.trim().parse::<u32>().ok()).unwrap_or(1);
                        if size > 1 {
                            found.pages = Some(format!("{size} {what} (OME-XML {name})"));
                        }
                    }
                }
                "Channel" if images == 1 => planes += 1,
                _ => {}
            },
            Ok(Event::Eof) | Err(_) => break,
            _ => {}
        }
    }
    if images > 1 {
        found.pages = Some(format!("{images} images (OME-XML)"));
    } else if planes > 1 && found.pages.is_none() {
        found.pages = Some(format!("{planes} channels (OME-XML)"));
    }
    found
}
