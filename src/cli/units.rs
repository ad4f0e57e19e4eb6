//! Values on the command line: durations `500ms`, `2s`, `5m`, `1h`; sizes `400MB`, `2GiB`, `65536`;
//! lengths `12mm`; planes `z=12mm`; names of the HTTP interface. Errors are messages for the user.

use crate::render::Plane;
use std::ops::RangeInclusive;
use std::time::Duration;

/// Splits `12.5ms` into 12.5 and `ms`.
fn number_and_unit(text: &str) -> Result<(f64, &str), String> {
    let text = text.trim();
    let end = text.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(text.len());
    let (number, unit) = text.split_at(end);
    let number: f64 = number.parse().map_err(|_| format!("`{text}` does not start with a number"))?;
    Ok((number, unit.trim()))
}

/// Parses a duration with its unit: `2s`, `500ms`, `5m`, `1h`, `7d`. Refuses a bare number, also 0.
pub(super) fn duration(text: &str) -> Result<Duration, String> {
    let (number, unit) = number_and_unit(text)?;
    let seconds = match unit {
        "s" => 1.0,
        "ms" => 1e-3,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        "d" => 86_400.0,
        "" => return Err("a unit of time is missing: use ms, s, m, h or d, as in 30s".to_owned()),
        other => return Err(format!("`{other}` is not a unit of time; use ms, s, m, h or d")),
    };
    Duration::try_from_secs_f64(number * seconds).map_err(|error| error.to_string())
}

/// Parses a [`duration`] above zero.
pub(super) fn positive_duration(text: &str) -> Result<Duration, String> {
    match number_and_unit(text) {
        Ok((0.0, _)) => Err("must be more than 0".to_owned()),
        _ => duration(text),
    }
}

/// Parses a [`duration`], or `0` without a unit: for options whose help says that 0 means "none".
pub(super) fn duration_or_zero(text: &str) -> Result<Duration, String> {
    if text.trim() == "0" { Ok(Duration::ZERO) } else { duration(text) }
}

/// Parses a rate per second, such as `10` or `0.5`. Accepts zero.
pub(super) fn rate(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(rate) if rate.is_finite() && rate >= 0.0 => Ok(rate),
        _ => Err("must be a number of 0 or more".to_owned()),
    }
}

/// Parses a [`rate`] above zero.
pub(super) fn positive_rate(text: &str) -> Result<f64, String> {
    rate(text).and_then(|rate| if rate > 0.0 { Ok(rate) } else { Err("must be more than 0".to_owned()) })
}

/// Parses a size in bytes, such as `400MB` (decimal), `2GiB` (binary) or `65536`.
pub(super) fn bytes(text: &str) -> Result<u64, String> {
    let (number, unit) = number_and_unit(text)?;
    let factor: f64 = match unit.to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "k" | "kb" => 1e3,
        "m" | "mb" => 1e6,
        "g" | "gb" => 1e9,
        "kib" => 1024.0,
        "mib" => 1024.0 * 1024.0,
        "gib" => 1024.0 * 1024.0 * 1024.0,
        _ => return Err(format!("`{unit}` is not a unit of size; use B, kB, MB, GB, KiB, MiB or GiB")),
    };
    let size = number * factor;
    if size < 9.0e15 { Ok(size as u64) } else { Err(format!("`{text}` is too large")) }
}

/// Parses a size in [`bytes`] above zero with its unit. Refuses a bare number, which would be so
/// few bytes that it can only be a mistake.
pub(super) fn bytes_with_unit(text: &str) -> Result<u64, String> {
    match number_and_unit(text)? {
        (_, "") => Err("a unit of size is missing: use B, kB, MB, GB, KiB, MiB or GiB, as in 2GB".to_owned()),
        _ => positive_bytes(text),
    }
}

/// Parses a size in [`bytes`] above zero.
pub(super) fn positive_bytes(text: &str) -> Result<u64, String> {
    match bytes(text)? {
        0 => Err("must be more than 0".to_owned()),
        size => Ok(size),
    }
}

/// Units of length by name, with micrometres per unit. These factors are whole, so `42mm` is
/// exactly 42,000 µm.
const LENGTHS: [(&str, f64); 6] = [("um", 1.0), ("µm", 1.0), ("μm", 1.0), ("mm", 1e3), ("cm", 1e4), ("m", 1e6)];

/// Parses a length in micrometres, such as `12mm`, `-500um` or `4.2e-2m`. Zero needs no unit.
pub(super) fn length_um(text: &str) -> Result<f64, String> {
    let text = text.trim();
    let (number, unit) = text.split_at(text.trim_end_matches(char::is_alphabetic).len());
    let number: f64 = number
        .trim_end()
        .parse()
        .map_err(|_| format!("`{text}` is not a length: a number and um, mm, cm or m, as in 12mm"))?;
    let factor = match LENGTHS.into_iter().find(|(name, _)| *name == unit) {
        Some((_, factor)) => factor,
        None if unit.is_empty() && number == 0.0 => 1.0,
        None if unit.is_empty() => {
            return Err(format!("`{text}` has no unit of length: use um, mm, cm or m, as in {text}mm"));
        }
        None => return Err(format!("`{unit}` is not a unit of length; use um, mm, cm or m")),
    };
    let um = number * factor;
    if um.abs() <= MOST_UM { Ok(um) } else { Err(format!("`{text}` is too long; the most is {MOST_UM:e} µm")) }
}

/// Parses a length in metres, written as for [`length_um`].
pub(super) fn length(text: &str) -> Result<f64, String> {
    Ok(length_um(text)? / 1e6)
}

/// Maximum of a length, µm, as over HTTP. It prevents overflows of squares.
const MOST_UM: f64 = 1e12;

/// Parses a [`length_um`] above zero.
pub(super) fn positive_length_um(text: &str) -> Result<f64, String> {
    length_um(text).and_then(|um| if um > 0.0 { Ok(um) } else { Err("must be more than 0".to_owned()) })
}

/// Parses a point: three lengths, such as `0,1.5mm,42mm`, in micrometres.
pub(super) fn point_um(text: &str) -> Result<[f64; 3], String> {
    three(text, length_um, "three lengths, x,y,z, such as 0,1.5mm,42mm")
}

/// Parses three numbers.
pub(super) fn triple(text: &str) -> Result<[f64; 3], String> {
    three(text, |part| part.trim().parse().map_err(|_| format!("`{part}` is not a number")), "three numbers, x,y,z")
}

fn three(text: &str, read: impl Fn(&str) -> Result<f64, String>, what: &str) -> Result<[f64; 3], String> {
    let parts = text.split(',').map(read).collect::<Result<Vec<f64>, String>>()?;
    parts.try_into().map_err(|_| format!("must be {what}"))
}

/// A unit of length, by its name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NamedUnit {
    /// Name, such as `mm`.
    pub(super) name: &'static str,
    /// Metres per unit.
    pub(super) metres: f64,
}

/// Parses a unit of length.
pub(super) fn length_unit(text: &str) -> Result<NamedUnit, String> {
    let found = LENGTHS.into_iter().find(|(name, _)| *name == text.trim());
    let named = found.map(|(name, um)| NamedUnit { name, metres: um / 1e6 });
    named.ok_or_else(|| format!("`{text}` is not a unit of length; use um, mm, cm or m"))
}

/// Formats metres per unit as a unit: by its name if it has one, such as `mm`.
pub(super) fn show_unit(metres: f64) -> String {
    let named = LENGTHS.into_iter().find(|(_, um)| (um / 1e6 / metres - 1.0).abs() < 1e-9);
    named.map_or_else(|| format!("units of {metres} m"), |(name, _)| name.to_owned())
}

/// Formats a length in metres with this number of significant digits, in um, mm or m: `12.5mm`.
pub(super) fn show_length(metres: f64, digits: i32) -> String {
    let um = metres * 1e6;
    let (factor, unit) = match um.abs() {
        0.0 => return "0".to_owned(),
        size if size < 1e3 => (1.0, "um"),
        size if size < 1e6 => (1e3, "mm"),
        _ => (1e6, "m"),
    };
    format!("{}{unit}", significant(um / factor, digits))
}

/// Formats a volume with six digits in µm³, mm³, cm³ or m³.
pub(super) fn show_volume(mm3: f64) -> String {
    let size = mm3.abs();
    let (factor, unit) = match size {
        _ if size == 0.0 => (1.0, "mm³"),
        _ if size < 1e-3 => (1e9, "µm³"),
        _ if size < 1e6 => (1.0, "mm³"),
        _ if size < 1e9 => (1e-3, "cm³"),
        _ => (1e-9, "m³"),
    };
    format!("{} {unit}", significant(mm3 * factor, 6))
}

/// Formats a number with significant digits, without zeros at the end.
fn significant(value: f64, digits: i32) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let digits = (digits - 1 - value.abs().log10().floor() as i32).clamp(0, 15);
    let text = format!("{value:.*}", digits as usize);
    if digits == 0 { text } else { text.trim_end_matches('0').trim_end_matches('.').to_owned() }
}

/// Parses a plane and the side in front of it: `z=12mm` (greater z), `-z=12mm` (smaller z), or a
/// direction and the distance from the origin along it, such as `1,1,0=2mm`.
pub(super) fn plane(text: &str) -> Result<Plane, String> {
    let (direction, place) = text.split_once('=').ok_or("must be written as z=12mm, -z=12mm or 1,1,0=2mm")?;
    let place = length(place)?;
    let axis = |normal: [f64; 3]| Ok(Plane { normal, offset: place * normal.iter().sum::<f64>() });
    match direction.trim() {
        "x" => axis([1.0, 0.0, 0.0]),
        "y" => axis([0.0, 1.0, 0.0]),
        "z" => axis([0.0, 0.0, 1.0]),
        "-x" => axis([-1.0, 0.0, 0.0]),
        "-y" => axis([0.0, -1.0, 0.0]),
        "-z" => axis([0.0, 0.0, -1.0]),
        numbers => {
            let [x, y, z] = triple(numbers).map_err(|_| format!("`{numbers}` is neither an axis nor three numbers"))?;
            let length = (x * x + y * y + z * z).sqrt();
            if !length.is_normal() {
                return Err(format!("`{numbers}` is not a direction"));
            }
            Ok(Plane { normal: [x / length, y / length, z / length], offset: place })
        }
    }
}

/// Parses the first and the last seed of a range, such as `1..20`.
pub(super) fn seeds(text: &str) -> Result<RangeInclusive<u64>, String> {
    let read = || {
        let (first, last) = text.split_once("..")?;
        let (first, last) = (first.trim().parse().ok()?, last.trim().parse().ok()?);
        (first <= last && last <= crate::spec::SEED_MAX).then_some(first..=last)
    };
    read().ok_or_else(|| "must be a first and a last seed below 2^53, such as 1..20".to_owned())
}

/// Formats a size in decimal units with one digit after the point, such as `12.3 MB`.
#[must_use]
pub fn show_bytes(bytes: u64) -> String {
    let value = bytes as f64;
    match value {
        v if v >= 1e9 => format!("{:.1} GB", v / 1e9),
        v if v >= 1e6 => format!("{:.1} MB", v / 1e6),
        v if v >= 1e3 => format!("{:.1} kB", v / 1e3),
        _ => format!("{bytes} B"),
    }
}

/// Parses a value by its name in JSON, so that the command line and the HTTP interface accept the
/// same names.
pub fn named<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, String> {
    serde_json::from_value(serde_json::Value::from(text)).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_have_a_unit() {
        assert_eq!(duration("500ms"), Ok(Duration::from_millis(500)));
        assert_eq!(duration("2s"), Ok(Duration::from_secs(2)));
        assert_eq!(duration("1.5 m"), Ok(Duration::from_secs(90)));
        assert_eq!(duration("0s"), Ok(Duration::ZERO));
        for wrong in ["", "s", "2 weeks", "-1s", "1e9", "99999999999999999999d"] {
            assert!(duration(wrong).is_err(), "{wrong}");
        }
        for bare in ["30", "0", "1.5"] {
            let message = duration(bare).expect_err(bare);
            assert!(message.contains("ms, s, m, h or d"), "{message}");
        }
    }

    #[test]
    fn zero_is_accepted_only_where_it_has_a_meaning() {
        for zero in ["0", " 0 ", "0s", "0d"] {
            assert_eq!(duration_or_zero(zero), Ok(Duration::ZERO), "{zero}");
            assert!(positive_duration(zero).expect_err(zero).contains("more than 0"), "{zero}");
        }
        assert_eq!(positive_duration("30d"), Ok(Duration::from_secs(30 * 86_400)));
        for bare in ["30", "7"] {
            assert!(duration_or_zero(bare).is_err() && positive_duration(bare).is_err(), "{bare}");
        }
    }

    #[test]
    fn lengths_have_a_unit() {
        for (text, um) in [
            ("42mm", 42_000.0),
            ("500um", 500.0),
            ("1.5 cm", 15_000.0),
            ("4.2e-2m", 42_000.0),
            ("1E+1µm", 10.0),
            ("-2mm", -2_000.0),
            ("+.5mm", 500.0),
            ("0", 0.0),
        ] {
            assert_eq!(length_um(text), Ok(um), "{text}");
        }
        for wrong in ["", "mm", "42", "1e3", "5 apples", "5mm2", "1e", "nan", "infm", "1e999mm", "1e13um", "--5mm"] {
            assert!(length_um(wrong).is_err(), "{wrong}");
        }
        assert!(length_um("42").unwrap_err().ends_with("as in 42mm"));
        assert!(positive_length_um("0").is_err() && positive_length_um("-2um").is_err());
        assert_eq!(positive_length_um("2um"), Ok(2.0));
        assert_eq!(point_um("0, -1.5mm,42mm"), Ok([0.0, -1_500.0, 42_000.0]));
        assert!(point_um("0,0").unwrap_err().contains("three lengths"));
        assert!(point_um("0,0,42").unwrap_err().contains("no unit"));
    }

    #[test]
    fn units_and_volumes_are_named() {
        assert_eq!(length_unit("cm").map(|unit| unit.metres), Ok(0.01));
        assert!(length_unit("inch").unwrap_err().contains("um, mm, cm or m"));
        assert_eq!([1e-6, 0.001, 1.0, 0.0254].map(show_unit), ["um", "mm", "m", "units of 0.0254 m"]);
        let shown = [0.0, 5e-6, -0.012_5, 60e-3, 1.5].map(|metres| show_length(metres, 6));
        assert_eq!(shown, ["0", "5um", "-12.5mm", "60mm", "1.5m"]);
        for (mm3, text) in [
            (90.000_001, "90 mm³"),
            (1_234.567_8, "1234.57 mm³"),
            (2e-4, "200000 µm³"),
            (2.5e6, "2500 cm³"),
            (9e10, "90 m³"),
            (-8.0, "-8 mm³"),
            (0.0, "0 mm³"),
        ] {
            assert_eq!(show_volume(mm3), text);
        }
    }

    #[test]
    fn planes_have_a_direction_and_a_place() {
        let found = |text: &str| plane(text).map(|plane| (plane.normal, plane.offset));
        assert_eq!(found("x=0"), Ok(([1.0, 0.0, 0.0], 0.0)));
        assert_eq!(found("z=12mm"), Ok(([0.0, 0.0, 1.0], 0.012)));
        // What has a lesser z than 12 mm.
        assert_eq!(found("-z=12mm"), Ok(([0.0, 0.0, -1.0], -0.012)));
        assert_eq!(found(" y = -2cm"), Ok(([0.0, 1.0, 0.0], -0.02)));
        assert_eq!(found("0,-2,0=1 m"), Ok(([0.0, -1.0, 0.0], 1.0)));
        for wrong in ["z", "z=", "z=12", "w=0", "1,2=0", "0,0,0=0", "1,x,2,3=0", "inf,0,0=0", "z=3 apples", "1,2,3,4=0"]
        {
            assert!(plane(wrong).is_err(), "{wrong}");
        }
        assert!(plane("z=12").unwrap_err().contains("um, mm, cm or m"));
    }

    #[test]
    fn seeds_are_a_range() {
        assert_eq!(seeds("1..20"), Ok(1..=20));
        assert_eq!(seeds("7..7"), Ok(7..=7));
        for text in ["7", "2..1", "1..9007199254740992", "a..b", "1...3", ""] {
            assert!(seeds(text).is_err(), "{text}");
        }
    }

    #[test]
    fn sizes() {
        assert_eq!(bytes("65536"), Ok(65_536));
        assert_eq!(bytes("400MB"), Ok(400_000_000));
        assert_eq!(bytes("2 GiB"), Ok(2 << 30));
        for wrong in ["", "MB", "2 apples", "-1", "99999999GB"] {
            assert!(bytes(wrong).is_err(), "{wrong}");
        }
        assert_eq!(bytes_with_unit("2GB"), Ok(2_000_000_000));
        for wrong in ["2", "2000000000", "0", "0GB"] {
            assert!(bytes_with_unit(wrong).is_err(), "{wrong}");
        }
        assert_eq!(show_bytes(1_250_000), "1.2 MB");
        assert_eq!(show_bytes(12), "12 B");
    }
}
