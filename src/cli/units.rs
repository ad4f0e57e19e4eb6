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

/// Parses a size in [`bytes`] above zero.
pub(super) fn positive_bytes(text: &str) -> Result<u64, String> {
    match bytes(text)? {
        0 => Err("must be more than 0".to_owned()),
        size => Ok(size),
    }
}

/// Parses a length in metres, such as `12mm` or `-500um`. Zero needs no unit.
fn length(text: &str) -> Result<f64, String> {
    let text = text.trim();
    let (sign, digits) = text.strip_prefix('-').map_or((1.0, text), |rest| (-1.0, rest));
    let (number, unit) = number_and_unit(digits)?;
    let metres = match unit {
        "um" | "µm" | "μm" => 1e-6,
        "mm" => 1e-3,
        "cm" => 1e-2,
        "m" => 1.0,
        "" if number == 0.0 => 1.0,
        "" => return Err("a unit of length is missing: use um, mm, cm or m, as in 12mm".to_owned()),
        other => return Err(format!("`{other}` is not a unit of length; use um, mm, cm or m")),
    };
    Ok(sign * number * metres)
}

/// Parses a [`length`] above zero.
pub(super) fn positive_length(text: &str) -> Result<f64, String> {
    match length(text)? {
        metres if metres > 0.0 && metres.is_finite() => Ok(metres),
        _ => Err("must be more than 0".to_owned()),
    }
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
            let parts: Result<Vec<f64>, _> = numbers.split(',').map(|part| part.trim().parse()).collect();
            let Ok(&[x, y, z]) = parts.as_deref() else {
                return Err(format!("`{numbers}` is neither an axis nor three numbers"));
            };
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
        assert_eq!(show_bytes(1_250_000), "1.2 MB");
        assert_eq!(show_bytes(12), "12 B");
    }
}
