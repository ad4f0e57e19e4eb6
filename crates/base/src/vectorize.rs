//! Runs a loop compiled for the widest vectors of the processor; the program itself is built for any processor.
//!
//! The width of the vectors changes speed only: no operation is reordered or fused.

pub use pulp::{Simd, WithSimd};
use std::ops::{Add, Div, Mul, Sub};

/// A set of vector instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Vectors {
    /// Those that every processor of the architecture has: SSE2, NEON.
    Baseline,
    /// AVX2: 256 bits.
    Avx2,
    /// AVX-512: 512 bits.
    Avx512,
}

impl Vectors {
    /// The widest of this processor.
    #[must_use]
    #[inline]
    pub fn best() -> Self {
        [Self::Avx512, Self::Avx2].into_iter().find(|set| set.is_available()).unwrap_or(Self::Baseline)
    }

    /// The widest of this processor with eight numbers in a vector.
    #[must_use]
    #[inline]
    pub fn best_of_eight() -> Self {
        if Self::Avx2.is_available() { Self::Avx2 } else { Self::Baseline }
    }

    /// Particles that the pair forces handle at once: one vector of them, if the registers allow.
    #[must_use]
    #[inline]
    pub fn lanes(self) -> usize {
        match self {
            Self::Avx512 => 16,
            Self::Avx2 | Self::Baseline => 8,
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[inline]
    fn is_available(self) -> bool {
        match self {
            Self::Baseline => true,
            Self::Avx2 => pulp::x86::V3::is_available(),
            Self::Avx512 => pulp::x86::V4::is_available(),
        }
    }

    #[cfg(not(target_arch = "x86_64"))]
    #[inline]
    fn is_available(self) -> bool {
        self == Self::Baseline
    }

    /// Calls `f`, compiled for these instructions, or for the baseline where the processor has not got them. `f` and
    /// everything that it calls must be `#[inline(always)]`.
    #[inline(always)]
    pub fn run<R>(self, f: impl FnMut() -> R) -> R {
        self.run_in_lanes(Body(f))
    }

    /// The same for work that is written in [`Lanes`].
    #[inline(always)]
    pub fn run_in_lanes<W: WithSimd>(self, work: W) -> W::Output {
        #[cfg(target_arch = "x86_64")]
        match self {
            Self::Baseline => {}
            Self::Avx2 => {
                if let Some(simd) = pulp::x86::V3::try_new() {
                    return Simd::vectorize(simd, work);
                }
            }
            Self::Avx512 => {
                if let Some(simd) = pulp::x86::V4::try_new() {
                    return Simd::vectorize(simd, work);
                }
            }
        }
        work.with_simd(pulp::Scalar256b)
    }
}

/// Has the processor bring `place` into its caches, where it has an instruction for this.
#[inline(always)]
pub fn prefetch<T>(place: &T) {
    #[cfg(target_arch = "x86_64")]
    safe_arch::prefetch_t0(place);
    #[cfg(not(target_arch = "x86_64"))]
    let _ = place;
}

/// Takes an `FnMut`: the adapter that makes an `FnOnce` of it would not be inlined.
struct Body<F>(F);

impl<R, F: FnMut() -> R> WithSimd for Body<F> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> R {
        (self.0)()
    }
}

/// Numbers in a vector register: for loops that carry vectors from one pass to the next, which the compiler would keep in memory
/// if they were arrays.
#[derive(Clone, Copy)]
pub struct Lanes<S: Simd> {
    simd: S,
    numbers: S::f32s,
}

impl<S: Simd> Lanes<S> {
    /// How many they are.
    pub const COUNT: usize = S::F32_LANES;

    #[inline(always)]
    pub fn all(simd: S, number: f32) -> Self {
        Self { simd, numbers: simd.splat_f32s(number) }
    }

    /// The first numbers of a slice, which has enough.
    #[inline(always)]
    pub fn of(simd: S, numbers: &[f32]) -> Self {
        Self { simd, numbers: S::as_simd_f32s(&numbers[..Self::COUNT]).0[0] }
    }

    /// Writes the first numbers, as many as the slice has, which has room for no more than all.
    #[inline(always)]
    pub fn write(self, to: &mut [f32]) {
        let numbers = bytemuck::cast_slice(std::slice::from_ref(&self.numbers));
        to.copy_from_slice(&numbers[..to.len()]);
    }

    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        Self { numbers: self.simd.max_f32s(self.numbers, other.numbers), ..self }
    }

    #[inline(always)]
    pub fn min(self, other: Self) -> Self {
        Self { numbers: self.simd.min_f32s(self.numbers, other.numbers), ..self }
    }

    #[inline(always)]
    pub fn sqrt(self) -> Self {
        Self { numbers: self.simd.sqrt_f32s(self.numbers), ..self }
    }

    /// Whether one of them is less than that of `other`.
    #[inline(always)]
    pub fn any_less(self, other: Self) -> bool {
        self.simd.first_true_m32s(self.simd.less_than_f32s(self.numbers, other.numbers)) < Self::COUNT
    }

    /// Whether one of them is at most that of `other`.
    #[inline(always)]
    pub fn any_at_most(self, other: Self) -> bool {
        self.simd.first_true_m32s(self.simd.less_than_or_equal_f32s(self.numbers, other.numbers)) < Self::COUNT
    }

    /// The least of them.
    #[inline(always)]
    pub fn least(self) -> f32 {
        self.simd.reduce_min_f32s(self.numbers)
    }
}

impl<S: Simd> Add for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { numbers: self.simd.add_f32s(self.numbers, other.numbers), ..self }
    }
}

impl<S: Simd> Sub for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { numbers: self.simd.sub_f32s(self.numbers, other.numbers), ..self }
    }
}

impl<S: Simd> Mul for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self { numbers: self.simd.mul_f32s(self.numbers, other.numbers), ..self }
    }
}

impl<S: Simd> Div for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        Self { numbers: self.simd.div_f32s(self.numbers, other.numbers), ..self }
    }
}
