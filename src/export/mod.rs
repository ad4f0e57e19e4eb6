//! Files: readers of surfaces in the usual formats.

pub mod read;
