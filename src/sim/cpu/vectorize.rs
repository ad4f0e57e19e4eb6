//! Runs a loop compiled for the widest vectors that the processor has (the program itself is built for any).
//!
//! Wider vectors change speed only: no operation is reordered or fused, see [`super`].

/// Calls `f`, whose body must be `#[inline(always)]` with all that it calls, with AVX2 or AVX-512 where present.
#[inline(always)]
pub(super) fn vectorize<R>(f: impl FnMut() -> R) -> R {
    pulp::Arch::new().dispatch(Body(f))
}

/// Called through `FnMut`: the adapter that makes an `FnOnce` of it would not be inlined.
struct Body<F>(F);

impl<R, F: FnMut() -> R> pulp::WithSimd for Body<F> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(mut self, _: S) -> R {
        (self.0)()
    }
}
