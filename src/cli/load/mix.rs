//! The calls of a load test and their weights.

use serde::Serialize;
use std::str::FromStr;

/// Kind of call.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub(in crate::cli) enum Call {
    /// `POST /models`.
    Submit,
    /// `GET /models/{id}` of a model of this run.
    Get,
    /// `GET /models`, the newest page.
    List,
    /// The largest file of a model of this run.
    Download,
    /// `GET /models/{id}/events` of a model of this run, up to the first event.
    Events,
    /// A model from its first request until its end is known; only in a closed loop without a mix.
    Model,
}

impl Call {
    /// The calls of a mix.
    const MIXED: [Self; 5] = [Self::Submit, Self::Get, Self::List, Self::Download, Self::Events];

    /// Returns the name on the command line and in reports.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Submit => "submit",
            Self::Get => "get",
            Self::List => "list",
            Self::Download => "download",
            Self::Events => "events",
            Self::Model => "model",
        }
    }
}

/// Calls with their weights. At least one weight is positive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::cli) struct Mix {
    weights: Vec<(Call, u32)>,
    total: u32,
}

impl Default for Mix {
    fn default() -> Self {
        let weights = vec![(Call::Submit, 8), (Call::Get, 4), (Call::List, 2), (Call::Download, 1), (Call::Events, 1)];
        Self { total: 16, weights }
    }
}

impl FromStr for Mix {
    type Err = String;

    /// Parses a mix such as `submit=8,get=4`.
    fn from_str(text: &str) -> Result<Self, String> {
        let mut weights: Vec<(Call, u32)> = Vec::new();
        for part in text.split(',') {
            let (name, weight) = part.split_once('=').ok_or_else(|| format!("`{part}` must be NAME=WEIGHT"))?;
            let (name, weight) = (name.trim(), weight.trim());
            let call = Call::MIXED.into_iter().find(|call| call.name() == name);
            let call =
                call.ok_or_else(|| format!("`{name}` is not a call; use {}", Call::MIXED.map(Call::name).join(", ")))?;
            let weight = weight.parse().ok().filter(|weight| *weight <= 1_000_000);
            let weight = weight.ok_or_else(|| format!("the weight of {name} must be an integer from 0 to 1000000"))?;
            if weights.iter().any(|(given, _)| *given == call) {
                return Err(format!("{name} is given twice"));
            }
            weights.push((call, weight));
        }
        let total = weights.iter().map(|(_, weight)| weight).sum();
        if total == 0 { Err("one weight must be positive".to_owned()) } else { Ok(Self { weights, total }) }
    }
}

impl Mix {
    /// Returns the call for a random word.
    pub(super) fn call(&self, word: u32) -> Call {
        let mut at = ((u64::from(word) * u64::from(self.total)) >> 32) as u32;
        for (call, weight) in &self.weights {
            if at < *weight {
                return *call;
            }
            at -= weight;
        }
        unreachable!("a draw is below the sum of the weights")
    }

    /// Returns true if the mix contains this call.
    pub(super) fn has(&self, call: Call) -> bool {
        self.weights.iter().any(|(given, weight)| *given == call && *weight > 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calls_are_drawn_by_their_weights() {
        let mix: Mix = "submit=3, get=0,list=1".parse().expect("valid");
        let draws: Vec<Call> = (0..4000u32).map(|i| mix.call(((u64::from(i) << 32) / 4000) as u32)).collect();
        let count = |call| draws.iter().filter(|drawn| **drawn == call).count();
        assert_eq!((count(Call::Submit), count(Call::Get), count(Call::List)), (3000, 0, 1000));
        assert_eq!((mix.call(0), mix.call(u32::MAX)), (Call::Submit, Call::List));
        assert!(mix.has(Call::List) && !mix.has(Call::Get) && !mix.has(Call::Events));
    }

    #[test]
    fn the_default_is_that_of_the_help() {
        assert_eq!("submit=8,get=4,list=2,download=1,events=1".parse(), Ok(Mix::default()));
    }

    #[test]
    fn faults_are_named() {
        for (text, fault) in [
            ("", "NAME=WEIGHT"),
            ("submit", "NAME=WEIGHT"),
            ("put=1", "`put` is not a call; use submit, get, list, download, events"),
            ("model=1", "not a call"),
            ("get=-1", "weight of get"),
            ("get=1000001", "weight of get"),
            ("get=1,get=2", "twice"),
            ("get=0,list=0", "positive"),
        ] {
            let said = text.parse::<Mix>().expect_err(text);
            assert!(said.contains(fault), "{text}: {said}");
        }
    }
}
