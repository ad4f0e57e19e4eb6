//! Random mutations of inputs, the same in every run. They resemble libFuzzer's mutations, without
//! coverage guidance.

/// Mutations of a target's inputs, chosen by the random number generator SplitMix64.
pub(crate) struct Mutations<'a> {
    inputs: &'a [Vec<u8>],
    state: u64,
}

impl<'a> Mutations<'a> {
    pub(crate) fn new(inputs: &'a [Vec<u8>], seed: u64) -> Self {
        Self { inputs, state: seed }
    }

    fn random(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.state ^ (self.state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.random() % limit.max(1) as u64) as usize
    }

    fn input(&mut self) -> &'a [u8] {
        &self.inputs[self.below(self.inputs.len())]
    }

    /// A random part of `bytes`, at most 64 bytes long.
    fn part<'b>(&mut self, bytes: &'b [u8]) -> &'b [u8] {
        let from = self.below(bytes.len());
        let length = self.below(64.min(bytes.len() - from) + 1);
        &bytes[from..from + length]
    }

    fn change(&mut self, bytes: &mut Vec<u8>) {
        let at = self.below(bytes.len());
        match self.below(6) {
            0 if !bytes.is_empty() => bytes[at] ^= 1 << self.below(8),
            1 if !bytes.is_empty() => bytes[at] = [0, 1, b'0', b'9', b'-', b'"', 0x7f, 0xff][self.below(8)],
            2 => bytes.truncate(at),
            3 => {
                let end = (at + 1 + self.below(64)).min(bytes.len());
                bytes.drain(at..end);
            }
            // Inserts a part of this or another input, or overwrites bytes with it.
            choice => {
                let own = bytes.clone();
                let other = self.input();
                let part = self.part(if choice == 4 { &own } else { other });
                let end = if self.below(2) == 0 { at } else { (at + part.len()).min(bytes.len()) };
                bytes.splice(at..end, part.iter().copied());
            }
        }
    }
}

impl Iterator for Mutations<'_> {
    type Item = Vec<u8>;

    /// An input with one to five changes.
    fn next(&mut self) -> Option<Vec<u8>> {
        let mut bytes = self.input().to_vec();
        for _ in 0..=self.below(4) {
            self.change(&mut bytes);
        }
        Some(bytes)
    }
}
