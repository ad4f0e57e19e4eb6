//! Runs a loop compiled for the widest vectors of the processor; the program itself is built for any processor.
//!
//! The width of the vectors changes speed only: no operation is reordered or fused.

/// A set of vector instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Vectors {
    /// Those that every processor of the architecture has: SSE2, NEON.
    Baseline,
    /// AVX2: 256 bits.
    Avx2,
    /// AVX-512: 512 bits.
    Avx512,
}

impl Vectors {
    /// The widest of this processor.
    pub(crate) fn best() -> Self {
        [Self::Avx512, Self::Avx2].into_iter().find(|set| set.is_available()).unwrap_or(Self::Baseline)
    }

    /// Particles that the pair forces handle at once: one vector of them, if the registers allow.
    pub(crate) fn lanes(self) -> usize {
        match self {
            Self::Avx512 => 16,
            Self::Avx2 | Self::Baseline => 8,
        }
    }

    #[cfg(target_arch = "x86_64")]
    fn is_available(self) -> bool {
        match self {
            Self::Baseline => true,
            Self::Avx2 => pulp::x86::V3::is_available(),
            Self::Avx512 => pulp::x86::V4::is_available(),
        }
    }

    #[cfg(not(target_arch = "x86_64"))]
    fn is_available(self) -> bool {
        self == Self::Baseline
    }

    /// Calls `f`, compiled for these instructions, or for the baseline where the processor has not got them. `f` and
    /// everything that it calls must be `#[inline(always)]`.
    #[inline(always)]
    pub(crate) fn run<R>(self, mut f: impl FnMut() -> R) -> R {
        #[cfg(target_arch = "x86_64")]
        match self {
            Self::Baseline => {}
            Self::Avx2 => {
                if let Some(simd) = pulp::x86::V3::try_new() {
                    return pulp::Simd::vectorize(simd, Body(f));
                }
            }
            Self::Avx512 => {
                if let Some(simd) = pulp::x86::V4::try_new() {
                    return pulp::Simd::vectorize(simd, Body(f));
                }
            }
        }
        f()
    }
}

/// Takes an `FnMut`: the adapter that makes an `FnOnce` of it would not be inlined.
#[cfg(target_arch = "x86_64")]
struct Body<F>(F);

#[cfg(target_arch = "x86_64")]
impl<R, F: FnMut() -> R> pulp::WithSimd for Body<F> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(mut self, _: S) -> R {
        (self.0)()
    }
}
