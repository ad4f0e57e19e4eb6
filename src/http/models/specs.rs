//! Specifications that were resolved recently. Requests often differ only in their seeds, and
//! resolving takes longer than all else that a request does.

use crate::spec::{Fault, ModelSpec, Preset, canonical_json};
use quick_cache::sync::Cache;
use serde_json::Value;
use std::sync::Arc;

/// Number of specifications that are kept.
const KEPT: usize = 128;
/// Maximum length of a patch whose specification is kept, bytes of canonical JSON.
const MAX_PATCH: usize = 16 << 10;

/// Resolved specifications by the name of their preset and their patch.
pub(in crate::http) struct Specs(Cache<(String, String), Arc<ModelSpec>>);

impl Default for Specs {
    fn default() -> Self {
        Self(Cache::new(KEPT))
    }
}

impl Specs {
    /// The result of [`ModelSpec::resolve`].
    ///
    /// # Errors
    /// Returns all faults, sorted by pointer.
    pub(super) fn resolve(&self, preset: &Preset, patch: &Value) -> Result<Arc<ModelSpec>, Vec<Fault>> {
        let key = (preset.name.clone(), canonical_json(patch));
        if let Some(spec) = self.0.get(&key) {
            return Ok(spec);
        }
        let spec = Arc::new(ModelSpec::resolve(preset, patch)?);
        if key.1.len() <= MAX_PATCH {
            self.0.insert(key, Arc::clone(&spec));
        }
        Ok(spec)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::preset;
    use serde_json::json;

    #[test]
    fn equal_patches_of_a_preset_share_a_specification() {
        let specs = Specs::default();
        let resolve = |name, patch| specs.resolve(preset(name).unwrap(), &patch).unwrap();
        let first = resolve("pig", json!({ "length_mm": 5, "steps": 2000 }));
        assert!(Arc::ptr_eq(&first, &resolve("pig", json!({ "steps": 2000.0, "length_mm": 5 }))));
        for (name, patch) in [("pig", json!({ "length_mm": 6, "steps": 2000 })), ("cow", json!({ "length_mm": 5 }))] {
            let other = resolve(name, patch.clone());
            assert_eq!(*other, ModelSpec::resolve(preset(name).unwrap(), &patch).unwrap());
            assert_ne!(other, first);
        }
        assert!(specs.resolve(preset("pig").unwrap(), &json!({ "length_mm": -1 })).is_err());
    }
}
