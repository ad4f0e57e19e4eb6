//! Durations and sizes on the command line: `500ms`, `2s`, `5m`, `1h`; `400MB`, `2GiB`, `65536`.

use std::time::Duration;

/// Splits `"12.5ms"` into `12.5` and `"ms"`.
fn number_and_unit(text: &str) -> Result<(f64, &str), String> {
    let text = text.trim();
    let end = text.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(text.len());
    let (number, unit) = text.split_at(end);
    let number: f64 = number.parse().map_err(|_| format!("`{text}` does not start with a number"))?;
    Ok((number, unit.trim()))
}

/// A duration with its unit: `2s`, `500ms`, `5m`, `1h`, `7d`. A bare number is refused, zero with a unit is accepted.
///
/// # Errors
/// A message for the command line if the text is not a duration.
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

/// A [`duration`] above zero.
///
/// # Errors
/// A message for the command line if the text is not a duration, or is zero.
pub(super) fn positive_duration(text: &str) -> Result<Duration, String> {
    match number_and_unit(text) {
        Ok((0.0, _)) => Err("must be more than 0".to_owned()),
        _ => duration(text),
    }
}

/// A [`duration`], or `0` without a unit, which gives zero: for options whose help says that 0 means "none".
///
/// # Errors
/// A message for the command line if the text is neither.
pub(super) fn duration_or_zero(text: &str) -> Result<Duration, String> {
    if text.trim() == "0" { Ok(Duration::ZERO) } else { duration(text) }
}

/// A rate per second, such as `10` or `0.5`; zero is accepted.
///
/// # Errors
/// A message for the command line if the text is not such a number.
pub(super) fn rate(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(rate) if rate.is_finite() && rate >= 0.0 => Ok(rate),
        _ => Err("must be a number of 0 or more".to_owned()),
    }
}

/// A [`rate`] above zero.
///
/// # Errors
/// A message for the command line if the text is not a number above zero.
pub(super) fn positive_rate(text: &str) -> Result<f64, String> {
    rate(text).and_then(|rate| if rate > 0.0 { Ok(rate) } else { Err("must be more than 0".to_owned()) })
}

/// A size in bytes such as `400MB` (decimal), `2GiB` (binary) or `65536`.
///
/// # Errors
/// A message for the command line if the text is not a size.
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

/// A size of [`bytes`] above zero.
///
/// # Errors
/// A message for the command line if the text is not a size, or is zero.
pub(super) fn positive_bytes(text: &str) -> Result<u64, String> {
    match bytes(text)? {
        0 => Err("must be more than 0".to_owned()),
        size => Ok(size),
    }
}

/// A size in decimal units with one digit after the point: `12.3 MB`.
pub(super) fn show_bytes(bytes: u64) -> String {
    let value = bytes as f64;
    match value {
        v if v >= 1e9 => format!("{:.1} GB", v / 1e9),
        v if v >= 1e6 => format!("{:.1} MB", v / 1e6),
        v if v >= 1e3 => format!("{:.1} kB", v / 1e3),
        _ => format!("{bytes} B"),
    }
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
