//! Placeholder header: see the house.
