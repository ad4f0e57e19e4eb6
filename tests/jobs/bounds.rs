//! Bounds on durations, tested on a machine that may have other load.

use oviduct::clock::Stopwatch;

/// Runs `round` up to five times, each time with a new job, until it keeps the bound. A defect
/// slows down every round; other load of the machine does not.
pub async fn best_of_five(mut round: impl AsyncFnMut(u64) -> Result<(), String>) {
    let mut faults = Vec::new();
    for number in 1..=5 {
        match round(number).await {
            Ok(()) => return,
            Err(fault) => faults.push(fault),
        }
    }
    panic!("no round kept the bound: {faults:#?}");
}

/// Returns an error unless less than `seconds` have elapsed.
pub fn within(seconds: f64, since: Stopwatch) -> Result<(), String> {
    let took = since.seconds();
    if took < seconds { Ok(()) } else { Err(format!("{took} s, not {seconds} s")) }
}
