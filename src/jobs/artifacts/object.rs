//! What a listing shows of an object.

/// A stored object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::jobs) struct Object {
    /// Its key.
    pub(in crate::jobs) key: String,
    /// When it was written, microseconds since 1970 UTC, by the clock of the store.
    pub(in crate::jobs) modified_micros: i64,
}
