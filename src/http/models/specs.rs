//! Specifications that were resolved recently, with their predicted costs. Requests often differ
//! only in their seeds, and resolving takes longer than all else that a request does.

use crate::generate::{Cost, Outputs};
use crate::lock::Mutex;
use crate::spec::{Fault, ModelSpec, Preset, canonical_json};
use quick_cache::sync::Cache;
use serde_json::Value;
use std::sync::Arc;

/// Number of specifications that are kept.
const KEPT: usize = 128;
/// Maximum length of a patch whose specification is kept, bytes of canonical JSON.
const MAX_PATCH: usize = 16 << 10;

/// Number of costs that are kept with a specification.
const KEPT_COSTS: usize = 4;

/// A resolved specification.
#[derive(Debug)]
pub(in crate::http) struct Resolved {
    pub(in crate::http) spec: Arc<ModelSpec>,
    /// Costs by outputs, the latest last.
    costs: Mutex<Vec<(Outputs, Arc<Cost>)>>,
}

impl Resolved {
    pub(super) fn new(spec: ModelSpec) -> Self {
        Self { spec: Arc::new(spec), costs: Mutex::default() }
    }

    /// The predicted cost with these outputs.
    pub(super) fn cost(&self, outputs: &Outputs) -> Arc<Cost> {
        let mut costs = self.costs.lock();
        if let Some((_, cost)) = costs.iter().find(|(known, _)| known == outputs) {
            return Arc::clone(cost);
        }
        let cost = Arc::new(Cost::new(&self.spec, outputs));
        if costs.len() == KEPT_COSTS {
            costs.remove(0);
        }
        costs.push((outputs.clone(), Arc::clone(&cost)));
        cost
    }
}

/// Resolved specifications by the name of their preset and their patch.
pub(in crate::http) struct Specs(Cache<(String, String), Arc<Resolved>>);

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
    pub(super) fn resolve(&self, preset: &Preset, patch: &Value) -> Result<Arc<Resolved>, Vec<Fault>> {
        let key = (preset.name.clone(), canonical_json(patch));
        if let Some(spec) = self.0.get(&key) {
            return Ok(spec);
        }
        let spec = Arc::new(Resolved::new(ModelSpec::resolve(preset, patch)?));
        if key.1.len() <= MAX_PATCH {
            self.0.insert(key, Arc::clone(&spec));
        }
        Ok(spec)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::Output;
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
            assert_eq!(*other.spec, ModelSpec::resolve(preset(name).unwrap(), &patch).unwrap());
            assert_ne!(other.spec, first.spec);
        }
        assert!(specs.resolve(preset("pig").unwrap(), &json!({ "length_mm": -1 })).is_err());
    }

    #[test]
    fn costs_are_those_of_their_outputs() {
        let resolved = Resolved::new(ModelSpec::resolve(preset("pig").unwrap(), &json!({})).unwrap());
        let all = [Output::Glb, Output::Obj, Output::Stl, Output::Ply, Output::Vtp, Output::Labels];
        for _ in 0..2 {
            for output in all {
                let outputs = Outputs::from(vec![output]);
                assert_eq!(*resolved.cost(&outputs), Cost::new(&resolved.spec, &outputs));
                assert!(Arc::ptr_eq(&resolved.cost(&outputs), &resolved.cost(&outputs)));
            }
        }
        assert_eq!(resolved.costs.lock().len(), KEPT_COSTS);
    }
}
