//! Description of the machine, for the results.

use serde_json::{Value, json};

/// Returns the name of the processor; `unknown processor` if it cannot be determined.
pub(super) fn processor() -> String {
    let told = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let field = |name: &str| {
        let line = told.lines().find(|line| line.split(':').next().is_some_and(|key| key.trim() == name))?;
        line.split_once(':').map(|(_, value)| value.trim().to_owned()).filter(|value| !value.is_empty())
    };
    let Some(model) = field("model name") else { return "unknown processor".to_owned() };
    match (field("cpu family"), field("model")) {
        // Virtual machines often report only the vendor.
        (Some(family), Some(number)) => format!("{model} (family {family}, model {number})"),
        _ => model,
    }
}

/// Returns the number of hardware threads.
pub(crate) fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

/// Returns the description as JSON.
pub(crate) fn describe() -> Value {
    json!({
        "processor": processor(),
        "threads": threads(),
        "os": std::env::consts::OS,
        "architecture": std::env::consts::ARCH,
        "optimised": !cfg!(debug_assertions),
    })
}

/// Returns the description as one line.
pub(crate) fn line() -> String {
    let slow = if cfg!(debug_assertions) { "; NOT an optimised build" } else { "" };
    format!("{}, {} threads, {} {}{slow}", processor(), threads(), std::env::consts::OS, std::env::consts::ARCH)
}

/// Returns the statistic that a number of runs gives, as text.
pub(super) fn runs(count: usize) -> String {
    if count == 1 { "one run".to_owned() } else { format!("median of {count} runs") }
}

/// Returns the median: the upper one of the two middle values for an even number of values, 0 for
/// none.
pub(super) fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_median_is_in_the_middle() {
        assert_eq!(super::median(vec![3.0, 1.0, 2.0]), 2.0);
        assert_eq!(super::median(vec![4.0, 1.0, 2.0, 3.0]), 3.0);
        assert_eq!(super::median(Vec::new()), 0.0);
    }
}
