//! A mutex that ignores panics of its holders.

use std::sync::PoisonError;

pub use std::sync::MutexGuard;

/// A [`std::sync::Mutex`] without poisoning: after a panic of a holder, the next holder gets the
/// data unchanged.
///
/// Fits data that are valid after each statement that changes them. A panic then costs the work of
/// the thread that panicked, not that of every other thread.
#[derive(Debug, Default)]
pub struct Mutex<T>(std::sync::Mutex<T>);

impl<T> Mutex<T> {
    /// A mutex that holds `value`.
    pub const fn new(value: T) -> Self {
        Self(std::sync::Mutex::new(value))
    }

    /// Waits for the lock. Must not be held across an `.await`.
    pub fn lock(&self) -> MutexGuard<'_, T> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_value_survives_a_panic_of_a_holder() {
        let value = Mutex::new(1);
        let panicked = std::thread::scope(|threads| {
            let holder = threads.spawn(|| {
                *value.lock() = 2;
                let _held = value.lock();
                panic!("on purpose");
            });
            holder.join()
        });
        assert!(panicked.is_err());
        assert_eq!(*value.lock(), 2);
    }
}
