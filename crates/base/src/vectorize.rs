//! Loops compiled for the widest vectors of the processor, in a program that runs on any processor.
//!
//! The vector width affects only speed: no operation is reordered or fused.

pub use pulp::{Simd, WithSimd};
use std::ops::{Add, Div, Mul, Sub};

/// A set of vector instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Vectors {
    /// Instructions of every processor of the architecture: SSE2, NEON.
    Baseline,
    /// AVX2: 256 bits.
    Avx2,
    /// AVX-512: 512 bits.
    Avx512,
}

impl Vectors {
    /// Widest set of this processor.
    #[must_use]
    #[inline]
    pub fn best() -> Self {
        [Self::Avx512, Self::Avx2].into_iter().find(|set| set.is_available()).unwrap_or(Self::Baseline)
    }

    /// Widest set of this processor with at most eight numbers per vector.
    #[must_use]
    #[inline]
    pub fn best_of_eight() -> Self {
        if Self::Avx2.is_available() { Self::Avx2 } else { Self::Baseline }
    }

    /// Number of particles that a pair force computes at once: one vector of them, if the registers
    /// suffice.
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

    /// Calls `f`, compiled for these instructions, or for the baseline if the processor lacks them.
    /// `f` and everything that it calls must be `#[inline(always)]`.
    #[inline(always)]
    pub fn run<R>(self, f: impl FnMut() -> R) -> R {
        self.run_in_lanes(Body(f))
    }

    /// Like [`Self::run`], for work written with [`Lanes`].
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

/// Work of [`Vectors::run`]. Holds an `FnMut`, because the adapter from `FnOnce` would not be
/// inlined.
struct Body<F>(F);

impl<R, F: FnMut() -> R> WithSimd for Body<F> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> R {
        (self.0)()
    }
}

/// Numbers in a vector register. The compiler would keep plain arrays in memory between the passes
/// of a loop.
#[derive(Clone, Copy)]
pub struct Lanes<S: Simd> {
    simd: S,
    numbers: S::f32s,
}

impl<S: Simd> Lanes<S> {
    /// Numbers per register.
    pub const COUNT: usize = S::F32_LANES;

    #[inline(always)]
    pub fn all(simd: S, number: f32) -> Self {
        Self { simd, numbers: simd.splat_f32s(number) }
    }

    /// Loads the first numbers of a slice, which must have at least [`Self::COUNT`].
    #[inline(always)]
    pub fn of(simd: S, numbers: &[f32]) -> Self {
        Self { simd, numbers: S::as_simd_f32s(&numbers[..Self::COUNT]).0[0] }
    }

    /// Stores the first numbers into `to`, which must have at most [`Self::COUNT`].
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

    /// True if any number is less than its counterpart in `other`.
    #[inline(always)]
    pub fn any_less(self, other: Self) -> bool {
        self.simd.first_true_m32s(self.simd.less_than_f32s(self.numbers, other.numbers)) < Self::COUNT
    }

    /// True if any number is at most its counterpart in `other`.
    #[inline(always)]
    pub fn any_at_most(self, other: Self) -> bool {
        self.simd.first_true_m32s(self.simd.less_than_or_equal_f32s(self.numbers, other.numbers)) < Self::COUNT
    }

    /// Minimum of the numbers.
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
