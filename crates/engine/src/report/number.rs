//! Numbers as the page shows them.

/// Formats a number with at least three digits and no exponent.
pub(super) fn number(value: f64) -> String {
    let digits = if value == 0.0 { 0 } else { (2 - value.abs().log10().floor() as i32).clamp(0, 6) };
    let text = format!("{value:.*}", digits as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// Formats a number, or a dash if there is none.
pub(super) fn optional(value: Option<f64>) -> String {
    value.map_or_else(|| "–".to_owned(), number)
}

/// Formats a range: `1 to 2`, `at least 1`, `at most 2`, or a dash. The limit of an order is not
/// part of its range.
pub(super) fn range(low: Option<f64>, high: Option<f64>, is_order: bool) -> String {
    let [from, to] = if is_order { ["above", "below"] } else { ["at least", "at most"] };
    match (low, high) {
        (None, None) => "–".to_owned(),
        (Some(low), None) => format!("{from} {}", number(low)),
        (None, Some(high)) => format!("{to} {}", number(high)),
        (Some(low), Some(high)) if low == high => number(low),
        (Some(low), Some(high)) => format!("{} to {}", number(low), number(high)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_say_whether_their_limits_belong_to_them() {
        assert_eq!(range(Some(1.0), Some(2.5), false), "1 to 2.5");
        assert_eq!(range(Some(1.8), None, false), "at least 1.8");
        assert_eq!(range(None, Some(0.15), false), "at most 0.15");
        assert_eq!(range(Some(1.0), None, true), "above 1");
        assert_eq!(range(None, Some(1.0), true), "below 1");
        assert_eq!(range(Some(11.0), Some(11.0), false), "11");
        assert_eq!(range(None, None, false), "–");
        assert_eq!(optional(None), "–");
        assert_eq!(optional(Some(12.345)), "12.3");
    }
}
