//! Random numbers that depend only on a seed.

use oviduct::random::{Stream, below, words};

/// A sequence of random numbers.
#[derive(Clone, Debug)]
pub struct Dice {
    seed: u64,
    of: u32,
    rolls: u32,
}

impl Dice {
    /// The sequence with this number.
    pub fn new(seed: u64, of: u32) -> Self {
        Self { seed, of, rolls: 0 }
    }

    /// A number from 0 to `n` - 1.
    pub fn below(&mut self, n: u32) -> u32 {
        self.rolls += 1;
        below(words(self.seed, Stream::Growth, self.of, self.rolls)[0], n)
    }

    /// One of these.
    pub fn pick<'a, T>(&mut self, of: &'a [T]) -> &'a T {
        &of[self.below(of.len() as u32) as usize]
    }
}
