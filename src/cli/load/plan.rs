//! The plan of an open loop: time and kind of each call.
//!
//! The plan is a function of the seed and does not depend on the service. Calls are due at the
//! stated rate even while the service stalls.

use super::mix::{Call, Mix};
use crate::random::{self, Stream};
use clap::ValueEnum;
use std::str::FromStr;
use std::time::Duration;

/// Calls per second, above 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::cli) struct Rate(pub(super) f64);

impl FromStr for Rate {
    type Err = String;

    /// Parses `200`, `200/s`, `12000/min` or `100/h`.
    fn from_str(text: &str) -> Result<Self, String> {
        let (number, unit) = text.split_once('/').unwrap_or((text, "s"));
        let seconds = match unit.trim() {
            "s" => 1.0,
            "m" | "min" => 60.0,
            "h" => 3600.0,
            other => return Err(format!("`{other}` is not a unit of time; use /s, /min or /h")),
        };
        let number: f64 = number.trim().parse().map_err(|_| format!("`{number}` is not a number"))?;
        let rate = number / seconds;
        // Above a million per second the times would not be distinct.
        if rate > 0.0 && rate <= 1e6 { Ok(Self(rate)) } else { Err("must be above 0 and at most 1000000/s".to_owned()) }
    }
}

/// Distribution of the calls of an open loop over time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(in crate::cli) enum Arrivals {
    /// Independent of each other, as those of many users: the gaps are exponentially distributed
    Poisson,
    /// Equal gaps
    Uniform,
}

/// One call of a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Planned {
    /// Planned time, from the start of the run.
    pub(super) at: Duration,
    pub(super) call: Call,
    /// A random word that chooses the model.
    pub(super) word: u32,
}

/// The calls of an open loop in the order of their times.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    pub(super) seed: u64,
    pub(super) rate: Rate,
    pub(super) arrivals: Arrivals,
    pub(super) mix: Mix,
    /// Length of the run with its warm-up.
    pub(super) length: Duration,
}

/// Returns the random words of a call: gap before the call, kind of call, model.
pub(super) fn words(seed: u64, index: u64) -> [u32; 3] {
    let [gap, call, model, _] = random::words(seed, Stream::Load, index as u32, (index >> 32) as u32);
    [gap, call, model]
}

impl Plan {
    /// Returns all calls that are due before the end of the run.
    pub(super) fn calls(self) -> impl Iterator<Item = Planned> + Send {
        let (end, mut seconds) = (self.length.as_secs_f64(), 0.0);
        (0u64..).map_while(move |index| {
            let [gap, call, word] = words(self.seed, index);
            match self.arrivals {
                Arrivals::Uniform => seconds = index as f64 / self.rate.0,
                Arrivals::Poisson => {
                    // Uniform in (0, 1), so that the logarithm is finite.
                    let unit = (f64::from(gap) + 0.5) / 2f64.powi(32);
                    seconds -= unit.ln() / self.rate.0;
                }
            }
            let call = self.mix.call(call);
            (seconds < end).then(|| Planned { at: Duration::from_secs_f64(seconds), call, word })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(arrivals: Arrivals, seed: u64) -> Vec<Planned> {
        let length = Duration::from_secs(100);
        Plan { seed, rate: Rate(200.0), arrivals, mix: Mix::default(), length }.calls().collect()
    }

    fn gaps(plan: &[Planned]) -> Vec<f64> {
        plan.windows(2).map(|pair| (pair[1].at - pair[0].at).as_secs_f64()).collect()
    }

    #[test]
    fn rates_have_a_unit() {
        for (text, rate) in [("200", 200.0), ("200/s", 200.0), ("12000/min", 200.0), ("1.5/s", 1.5), ("3600/h", 1.0)] {
            assert_eq!(text.parse(), Ok(Rate(rate)), "{text}");
        }
        for wrong in ["", "/s", "fast", "0", "-1", "nan", "inf", "2e6", "200/week", "200 s"] {
            assert!(wrong.parse::<Rate>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_plan_depends_on_its_seed_only() {
        assert_eq!(plan(Arrivals::Poisson, 7), plan(Arrivals::Poisson, 7));
        assert_ne!(plan(Arrivals::Poisson, 7)[..10], plan(Arrivals::Poisson, 8)[..10]);
    }

    #[test]
    fn uniform_arrivals_have_equal_gaps() {
        let plan = plan(Arrivals::Uniform, 1);
        assert_eq!((plan.len(), plan[0].at), (20_000, Duration::ZERO));
        assert!(gaps(&plan).iter().all(|gap| (gap - 0.005).abs() < 1e-6));
    }

    #[test]
    fn poisson_arrivals_have_exponential_gaps() {
        let plan = plan(Arrivals::Poisson, 1);
        // The number of arrivals has a standard deviation of 141.
        assert!((19_500..20_500).contains(&plan.len()), "{}", plan.len());
        let gaps = gaps(&plan);
        assert!(gaps.iter().all(|gap| *gap >= 0.0));
        let mean = gaps.iter().sum::<f64>() / gaps.len() as f64;
        let deviation = (gaps.iter().map(|gap| (gap - mean).powi(2)).sum::<f64>() / gaps.len() as f64).sqrt();
        assert!((deviation / mean - 1.0).abs() < 0.05, "{deviation} / {mean}");
        // A share of exp(-2) of the gaps is longer than twice the mean.
        let long = gaps.iter().filter(|gap| **gap > 2.0 * mean).count() as f64 / gaps.len() as f64;
        assert!((long - (-2f64).exp()).abs() < 0.02, "{long}");
        assert!(plan.iter().all(|planned| planned.at < Duration::from_secs(100)));
    }

    #[test]
    fn calls_do_not_depend_on_their_times() {
        let plan = plan(Arrivals::Poisson, 3);
        let submitted = plan.iter().filter(|planned| planned.call == Call::Submit).count();
        // Half of about 20,000, with a standard deviation of 71.
        assert!((plan.len() / 2).abs_diff(submitted) < 350, "{submitted} of {}", plan.len());
    }
}
