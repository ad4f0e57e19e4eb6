//! State of a simulation as bytes, so that another process can continue it.
//!
//! The state contains everything that later steps depend on: both loops, the clearances that the
//! next growth event reads, and the counts. Neighbour lists are rebuilt. Additional segments in a
//! list add zeros, so a restored simulation produces the same bits as an uninterrupted one.
//!
//! All numbers are little-endian: version, time, next id and three counts (u64 each), then each
//! vector, preceded by its length (u32).

use super::{CpuSimulation, Kernel, Plan, Statistics, Vectors};
use crate::sim::state::{Checkpoint, InnerLoop, OuterLoop};

/// Version of the format.
const VERSION: u64 = 2;
/// Number of words before the vectors.
const WORDS: usize = 6;
/// Maximum coordinate that is restored, µm; beyond that of any model.
const FARTHEST: f32 = 1e7;

/// Error: the bytes are not a state of this simulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the stored state of the simulation cannot be used: {0}")]
pub struct StateError(&'static str);

impl CpuSimulation {
    /// Saves the state between two steps.
    #[must_use]
    pub fn save(&self) -> Vec<u8> {
        let (inner, outer) = (&self.inner, &self.outer);
        let words: [u64; WORDS] = [
            VERSION,
            self.time.cast_unsigned(),
            u64::from(inner.next_id),
            self.statistics.splits_deferred,
            self.statistics.moves_shortened,
            self.neighbours.builds(),
        ];
        let mut bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        push(&mut bytes, inner.id.iter().copied());
        for v in inner.fields() {
            push(&mut bytes, v.iter().map(|x| x.to_bits()));
        }
        push(&mut bytes, outer.id.iter().copied());
        for v in [&outer.p, &outer.v] {
            push(&mut bytes, v.iter().flatten().map(|x| x.to_bits()));
        }
        push(&mut bytes, self.work.clearance().iter().map(|x| x.to_bits()));
        bytes
    }

    /// Restores a state written by [`CpuSimulation::save`] with the same plan.
    ///
    /// # Errors
    /// [`StateError`] if the bytes have another version, are incomplete, or describe no state that
    /// a simulation can have. The function does not check whether they belong to the plan.
    pub fn restore(plan: Plan, threads: usize, bytes: &[u8]) -> Result<Self, StateError> {
        let mut reader = Reader(bytes);
        if reader.word()? != VERSION {
            return Err(StateError("it is of another version"));
        }
        let time = reader.word()?.cast_signed();
        let next_id = u32::try_from(reader.word()?).map_err(|_| StateError("an id is out of bounds"))?;
        let statistics =
            Statistics { splits_deferred: reader.count()?, moves_shortened: reader.count()?, ..Statistics::default() };
        let builds = reader.count()?;
        let mut inner = InnerLoop { id: reader.numbers()?, next_id, ..InnerLoop::default() };
        let n = inner.len();
        for v in inner.fields_mut() {
            *v = reader.floats(n)?;
        }
        let mut outer = OuterLoop { id: reader.numbers()?, ..OuterLoop::default() };
        let m = outer.len();
        for v in [&mut outer.p, &mut outer.v] {
            *v = reader.floats(2 * m)?.as_chunks::<2>().0.to_vec();
        }
        // Before the first step there are no clearances; after a growth event there are fewer than
        // particles.
        let clearance: Vec<f32> = reader.numbers()?.into_iter().map(f32::from_bits).collect();
        if !reader.0.is_empty() || n < 3 || m < 3 || clearance.len() > n {
            return Err(StateError("its parts are inconsistent"));
        }
        // Particles are never removed, so the next id is their number.
        if next_id as usize != n {
            return Err(StateError("an id is out of bounds"));
        }
        let mut positions = inner.x.iter().chain(&inner.y).chain(outer.p.as_flattened());
        if !positions.all(|x| x.abs() <= FARTHEST) {
            return Err(StateError("a position is out of bounds"));
        }
        if !(-i64::from(plan.burn_in)..=i64::from(plan.steps)).contains(&time) {
            return Err(StateError("its time is out of bounds"));
        }
        let state = Checkpoint { time, inner, outer, clearance };
        let mut simulation = Self::from_checkpoint(plan, state, Kernel::default(), Vectors::best(), threads);
        simulation.statistics = statistics;
        simulation.neighbours.count_from(builds);
        Ok(simulation)
    }
}

fn push(bytes: &mut Vec<u8>, numbers: impl Iterator<Item = u32>) {
    let start = bytes.len();
    bytes.extend([0; 4]);
    let mut count = 0u32;
    for number in numbers {
        bytes.extend(number.to_le_bytes());
        count += 1;
    }
    bytes[start..start + 4].copy_from_slice(&count.to_le_bytes());
}

struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    const SHORT: StateError = StateError("it is truncated");

    fn take<const N: usize>(&mut self) -> Result<[u8; N], StateError> {
        let (head, rest) = self.0.split_first_chunk::<N>().ok_or(Self::SHORT)?;
        self.0 = rest;
        Ok(*head)
    }

    fn word(&mut self) -> Result<u64, StateError> {
        self.take().map(u64::from_le_bytes)
    }

    /// Reads a count. The limit leaves room to add steps.
    fn count(&mut self) -> Result<u64, StateError> {
        Some(self.word()?).filter(|count| *count <= u64::MAX / 2).ok_or(StateError("a count is out of bounds"))
    }

    fn numbers(&mut self) -> Result<Vec<u32>, StateError> {
        let count = u32::from_le_bytes(self.take()?) as usize;
        let (head, rest) = self.0.split_at_checked(count.saturating_mul(4)).ok_or(Self::SHORT)?;
        self.0 = rest;
        Ok(head.as_chunks::<4>().0.iter().map(|&bytes| u32::from_le_bytes(bytes)).collect())
    }

    fn floats(&mut self, count: usize) -> Result<Vec<f32>, StateError> {
        let numbers = self.numbers()?;
        if numbers.len() != count {
            return Err(StateError("its vectors differ in length"));
        }
        Ok(numbers.into_iter().map(f32::from_bits).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::{ModelSpec, preset};
    use proptest::prelude::*;
    use serde_json::json;

    fn plan(integrator: &str) -> Plan {
        let patch = json!({
            "steps": 60, "burn_in": 20, "solver": { "integrator": integrator },
            "particles": { "total": { "keys": [[0, 260], [1, 520]] }, "outer": { "keys": [[0, 60], [1, 90]] } },
        });
        Plan::new(&ModelSpec::resolve(preset("pig").unwrap(), &patch).unwrap(), 11)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(6))]
        #[test]
        fn a_restored_simulation_continues_bit_for_bit(
            at in 0u32..80, rk4: bool, threads in 1usize..4,
        ) {
            let plan = plan(if rk4 { "rk4" } else { "euler" });
            let mut whole = CpuSimulation::new(plan.clone(), 1);
            for _ in 0..at {
                whole.step().unwrap();
            }
            let mut other = CpuSimulation::restore(plan, threads, &whole.save()).unwrap();
            prop_assert_eq!(whole.section(), other.section());
            for _ in at..80 {
                whole.step().unwrap();
                other.step().unwrap();
            }
            prop_assert_eq!(&whole.inner, &other.inner);
            prop_assert_eq!(&whole.outer, &other.outer);
            prop_assert_eq!(whole.time, other.time);
            let (a, b) = (whole.statistics(), other.statistics());
            prop_assert_eq!((a.splits_deferred, a.moves_shortened), (b.splits_deferred, b.moves_shortened));
        }
    }

    #[test]
    fn broken_states_are_refused() {
        let saved = CpuSimulation::new(plan("euler"), 1).save();
        let restore = |bytes: &[u8]| CpuSimulation::restore(plan("euler"), 1, bytes).map(drop);
        assert_eq!(restore(&saved), Ok(()));
        for cut in [0, 7, 40, 60, saved.len() - 1] {
            assert!(restore(&saved[..cut]).is_err(), "{cut}");
        }
        assert!(restore(&[saved.as_slice(), &[0]].concat()).is_err());
        let mut later = saved.clone();
        later[0] = 3;
        assert_eq!(restore(&later), Err(StateError("it is of another version")));
        for (at, word, message) in [
            (16, u64::from(u32::MAX), "an id is out of bounds"),
            (24, u64::MAX, "a count is out of bounds"),
            (32, u64::MAX, "a count is out of bounds"),
            (40, u64::MAX, "a count is out of bounds"),
        ] {
            let mut broken = saved.clone();
            broken[at..at + 8].copy_from_slice(&word.to_le_bytes());
            assert_eq!(restore(&broken), Err(StateError(message)), "{at}");
        }
        let ids = u32::from_le_bytes(*saved[48..].first_chunk().unwrap()) as usize;
        for far in [f32::NAN, f32::INFINITY, -1e30] {
            let mut broken = saved.clone();
            let x = 48 + 4 + 4 * ids + 4;
            broken[x..x + 4].copy_from_slice(&far.to_le_bytes());
            assert_eq!(restore(&broken), Err(StateError("a position is out of bounds")), "{far}");
        }
        let mut lost = saved;
        lost[8..16].copy_from_slice(&i64::MAX.to_le_bytes());
        assert_eq!(restore(&lost), Err(StateError("its time is out of bounds")));
    }
}
