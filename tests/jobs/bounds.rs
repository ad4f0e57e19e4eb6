//! Bounds on time that the product promises, on a machine that may be busy with other things.

use oviduct::clock::Stopwatch;

/// Does `round` up to five times, each with a job of its own, until it keeps what is promised. What is broken is slow in
/// every round; a machine that has other things to do is not.
pub async fn best_of_five(mut round: impl AsyncFnMut(u64) -> Result<(), String>) {
    let mut faults = Vec::new();
    for number in 1..=5 {
        match round(number).await {
            Ok(()) => return,
            Err(fault) => faults.push(fault),
        }
    }
    panic!("no round kept it: {faults:#?}");
}

/// Whether that took less than so many seconds.
pub fn within(seconds: f64, since: Stopwatch) -> Result<(), String> {
    let took = since.seconds();
    if took < seconds { Ok(()) } else { Err(format!("{took} s, not {seconds} s")) }
}
