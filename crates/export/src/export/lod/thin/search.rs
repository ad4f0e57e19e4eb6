//! Search for the tolerance that leads to a number of triangles.

/// Limits of tolerances, m.
const FINEST: f64 = 1e-8;
const COARSEST: f64 = 1e-2;
/// The number of triangles falls about with this power of the tolerance.
const POWER: f64 = 1.1;
/// Least part of the interval between two tolerances by which the search proceeds.
const STEP: f64 = 0.1;

/// A search. The number of triangles falls as the tolerance rises.
pub(super) struct Search {
    /// The tolerance to be tried next, m.
    pub(super) tolerance: f64,
    goal: f64,
    /// The last tolerances with too many and with too few triangles, and these numbers.
    over: Option<(f64, f64)>,
    under: Option<(f64, f64)>,
}

impl Search {
    pub(super) fn new(tolerance: f64, goal: f64) -> Self {
        Self { tolerance, goal: goal.max(1.0), over: None, under: None }
    }

    /// True if no larger tolerance will be tried.
    pub(super) fn is_at_end(&self) -> bool {
        self.tolerance >= COARSEST
    }

    /// Takes the number of triangles for the tolerance.
    pub(super) fn add(&mut self, count: f64) {
        let found = Some((self.tolerance, count.max(1.0)));
        if count > self.goal {
            self.over = found;
        } else {
            self.under = found;
        }
        let next = match (self.over, self.under) {
            (Some((low, many)), Some((high, few))) => {
                let part = libm::log(many / self.goal) / libm::log(many / few);
                low * libm::pow(high / low, part.clamp(STEP, 1.0 - STEP))
            }
            _ => self.tolerance * libm::pow(count.max(1.0) / self.goal, 1.0 / POWER),
        };
        self.tolerance = next.clamp(FINEST, COARSEST);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_power_law_is_found_in_a_few_steps(power in 0.4_f64..2.0, factor in 1e-3_f64..1e3, goal in 10.0_f64..1e6) {
            let count = |tolerance: f64| factor * 1e6 * (tolerance / 1e-6).powf(-power);
            let mut search = Search::new(4e-6, goal);
            for _ in 0..20 {
                let found = count(search.tolerance);
                if (found / goal - 1.0).abs() < 0.02 || search.tolerance <= FINEST || search.is_at_end() {
                    return Ok(());
                }
                search.add(found);
            }
            prop_assert!(false, "{} for {goal}", count(search.tolerance));
        }
    }
}
