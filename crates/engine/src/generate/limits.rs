//! Limits of one model. The service compares the predicted cost with them before it queues the
//! model.

use super::cost::Cost;
use super::outputs::Output;

/// The length of a GLB file is a 32-bit number.
const MAX_GLB_BYTES: u64 = u32::MAX as u64;

/// Limits of one model.
#[derive(Clone, Debug, PartialEq)]
pub struct CostLimits {
    /// Seconds on the slowest backend for which there is a prediction.
    pub max_cost_seconds: f64,
    /// Bytes of memory.
    pub max_memory_bytes: u64,
    /// Vertices of the surface.
    pub max_vertices: u64,
    /// Bytes of all files together.
    pub max_output_bytes: u64,
}

impl Default for CostLimits {
    /// Ten minutes, 4 GiB of memory, 10 million vertices, 4 GiB of files.
    fn default() -> Self {
        Self { max_cost_seconds: 600.0, max_memory_bytes: 4 << 30, max_vertices: 10_000_000, max_output_bytes: 4 << 30 }
    }
}

/// A limit that a model would exceed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("predicted {quantity}: {predicted:.0} {unit}, above the limit of {limit:.0} {unit}; to stay below it, {}", advice(.quantity))]
pub struct OverLimit {
    /// Limited quantity: `seconds`, `memory`, `vertices`, `output`, or `glb`, a file of at most 4
    /// GiB.
    pub quantity: &'static str,
    /// The prediction.
    pub predicted: f64,
    /// The limit.
    pub limit: f64,
    /// Unit of both.
    pub unit: &'static str,
}

/// Changes that keep a model below a limit. A larger recording interval makes the surface smaller,
/// but keeps more steps in memory.
fn advice(quantity: &str) -> &'static str {
    match quantity {
        "memory" => {
            "reduce /steps or /particles/total, change /solver/record_every, make a shorter /piece, or, for an even surface, raise \
             /mesh/resolution_um and /mesh/tolerance_um, or, for output labels, raise /labels/voxel_um, or ask for \
             fewer outputs (lod, labels, lumen and regions take more memory)"
        }
        "glb" => {
            "ask for gltf (which has its data in a file of its own), vtp, ply, stl or obj instead of glb, reduce /steps or \
             /particles/total, raise /solver/record_every, or make a shorter /piece"
        }
        "vertices" => {
            "reduce /steps or /particles/total, raise /solver/record_every, make a shorter /piece, or, for an even surface, raise \
             /mesh/resolution_um and /mesh/tolerance_um"
        }
        _ => {
            "reduce /steps or /particles/total, raise /solver/record_every, make a shorter /piece, or, for an even surface, raise \
             /mesh/resolution_um and /mesh/tolerance_um, or, for output labels, raise /labels/voxel_um or /labels/slice_um"
        }
    }
}

impl Cost {
    /// Checks that no file exceeds the maximum size of its format.
    ///
    /// # Errors
    /// Returns the exceeded limit.
    pub fn check_formats(&self) -> Result<(), OverLimit> {
        // No body is larger than the tissue.
        let tissue = 24 * self.vertices + 12 * self.triangles;
        let predicted = self.bytes.get(Output::Glb.name()).map_or(0, |bytes| tissue.min(*bytes));
        if predicted <= MAX_GLB_BYTES {
            return Ok(());
        }
        let [predicted, limit] = [predicted, MAX_GLB_BYTES].map(|bytes| bytes as f64);
        Err(OverLimit { quantity: Output::Glb.name(), predicted, limit, unit: "bytes" })
    }
}

impl CostLimits {
    /// Checks a predicted cost.
    ///
    /// # Errors
    /// Returns every limit that the model would exceed.
    pub fn check(&self, cost: &Cost) -> Result<(), Vec<OverLimit>> {
        let slowest = cost.longest_seconds();
        let bytes = cost.bytes.values().fold(0_u64, |sum, bytes| sum.saturating_add(*bytes));
        let over: Vec<OverLimit> = [
            ("seconds", slowest, self.max_cost_seconds, "seconds"),
            ("memory", cost.memory_bytes as f64, self.max_memory_bytes as f64, "bytes"),
            ("vertices", cost.vertices as f64, self.max_vertices as f64, "vertices"),
            ("output", bytes as f64, self.max_output_bytes as f64, "bytes"),
        ]
        .into_iter()
        .filter(|(_, predicted, limit, _)| predicted > limit)
        .map(|(quantity, predicted, limit, unit)| OverLimit { quantity, predicted, limit, unit })
        .chain(cost.check_formats().err())
        .collect();
        if over.is_empty() { Ok(()) } else { Err(over) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::{ModelSpec, preset};
    use Output::{Glb, Gltf, Lod, Obj, Ply, Stl, Vtp};
    use serde_json::json;

    fn predict(spec: &ModelSpec, formats: &[Output]) -> Cost {
        Cost::new(spec, &formats.to_vec().into())
    }

    #[test]
    fn presets_are_within_the_default_limits() {
        for name in ["pig", "paper"] {
            let cost = predict(&ModelSpec::resolve(preset(name).unwrap(), &json!({})).unwrap(), &[Glb, Obj, Stl]);
            assert_eq!(CostLimits::default().check(&cost), Ok(()), "{name}");
        }
    }

    #[test]
    fn every_limit_that_is_exceeded_is_named_with_its_prediction() {
        let cost = predict(&ModelSpec::resolve(preset("pig").unwrap(), &json!({})).unwrap(), &[Glb]);
        let tight =
            CostLimits { max_cost_seconds: 0.1, max_memory_bytes: 1, max_vertices: cost.vertices, max_output_bytes: 9 };
        let over = tight.check(&cost).unwrap_err();
        let quantities: Vec<&str> = over.iter().map(|o| o.quantity).collect();
        assert_eq!(quantities, ["seconds", "memory", "output"]);
        assert_eq!(over[1].predicted, cost.memory_bytes as f64);
        assert!(over[1].to_string().contains("above the limit of 1 bytes; "), "{}", over[1]);
        assert!(over.iter().all(|o| o.to_string().contains("/solver/record_every")), "{over:?}");
    }

    #[test]
    fn a_glb_beyond_4_gib_is_refused_and_other_formats_are_not() {
        let patch = json!({ "steps": 20_000, "solver": { "record_every": 1 }, "particles": { "total": { "keys": [[0, 710], [1, 20_000]] } } });
        let spec = ModelSpec::resolve(preset("paper").unwrap(), &patch).unwrap();
        let boundless = CostLimits {
            max_cost_seconds: f64::INFINITY,
            max_memory_bytes: u64::MAX,
            max_vertices: u64::MAX,
            max_output_bytes: u64::MAX,
        };
        let over = boundless.check(&predict(&spec, &[Glb, Vtp])).unwrap_err();
        assert_eq!((over.len(), over[0].quantity, over[0].limit), (1, "glb", 4_294_967_295.0));
        assert!(over[0].to_string().contains("ask for gltf"), "{}", over[0]);
        assert_eq!(boundless.check(&predict(&spec, &[Gltf, Vtp, Ply, Stl, Obj, Lod])), Ok(()));
        let strips = json!({ "mesh": { "strips": true }, "steps": 12_000 });
        let spec = ModelSpec::resolve_all(preset("paper").unwrap(), &[&patch, &strips]).unwrap();
        assert_eq!(boundless.check(&predict(&spec, &[Glb])), Ok(()), "strips take less");
    }

    #[test]
    fn a_giant_within_the_bounds_of_the_table_is_over_the_limits() {
        let patch = json!({
            "steps": 100_000, "solver": { "record_every": 1 }, "length_mm": 1000,
            "particles": { "total": 200_000, "outer": 1000 }, "wall": { "lobing": 0 },
            "z": { "keys": [[0, 0], [1, 1]] },
        });
        let cost = predict(&ModelSpec::resolve(preset("pig").unwrap(), &patch).unwrap(), &[Obj, Lod]);
        assert_eq!(CostLimits::default().check(&cost).unwrap_err().len(), 4);
    }
}
