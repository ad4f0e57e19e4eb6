//! Runs a loop compiled for the widest vectors of the processor; the program itself is built for any processor.
//!
//! The vector width changes speed only: no operation is reordered or fused, see [`super`].

/// Calls `f` with AVX2 or AVX-512 if present. `f` and everything that it calls must be `#[inline(always)]`.
#[inline(always)]
pub(super) fn vectorize<R>(f: impl FnMut() -> R) -> R {
    pulp::Arch::new().dispatch(Body(f))
}

/// Takes an `FnMut`: the adapter that makes an `FnOnce` of it would not be inlined.
struct Body<F>(F);

impl<R, F: FnMut() -> R> pulp::WithSimd for Body<F> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(mut self, _: S) -> R {
        (self.0)()
    }
}
