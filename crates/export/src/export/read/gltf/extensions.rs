//! Extensions: those that are read, those that concern looks only, and all others.

use super::json::{Object, shown};
use super::notes::Notes;
use crate::export::read::error::ReadError;
use std::collections::BTreeSet;

/// Several instances of the mesh of a node.
pub(super) const INSTANCING: &str = "EXT_mesh_gpu_instancing";
/// Nodes that are not shown.
pub(super) const VISIBILITY: &str = "KHR_node_visibility";
/// Primitives that only a decoder of Draco can read.
pub(super) const DRACO: &str = "KHR_draco_mesh_compression";
/// Views compressed by meshoptimizer.
pub(super) const MESHOPT: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];
/// Positions that are integers.
pub(super) const QUANTIZATION: &str = "KHR_mesh_quantization";

/// All extensions that are read, or refused where they matter.
pub(super) const KNOWN: [&str; 6] = [MESHOPT[0], MESHOPT[1], INSTANCING, VISIBILITY, DRACO, QUANTIZATION];

/// Beginnings of the names of extensions that change looks, sounds, data or behaviour but no
/// default position.
const LOOKS: [&str; 36] = [
    "ADOBE_materials_",
    "AGI_",
    "BENTLEY_materials_",
    "CESIUM_primitive_outline",
    "EXT_instance_features",
    "EXT_lights_",
    "EXT_materials_",
    "EXT_mesh_features",
    "EXT_mesh_manifold",
    "EXT_mesh_primitive_edge_visibility",
    "EXT_property_",
    "EXT_structural_metadata",
    "EXT_texture_",
    "FB_geometry_metadata",
    "FB_ngon_encoding",
    "GODOT_single_root",
    "GOOGLE_",
    "KHR_animation_pointer",
    "KHR_audio",
    "KHR_environment_map",
    "KHR_interactivity",
    "KHR_lights_",
    "KHR_materials_",
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "KHR_physics_",
    "KHR_techniques_webgl",
    "KHR_texture_",
    "KHR_xmp",
    "MOZ_",
    "MSFT_lod",
    "MSFT_packing_",
    "MSFT_texture_",
    "NV_materials_",
    "OMI_",
    "VRM",
];

/// Extensions that a document requires.
pub(super) struct Extensions {
    required: BTreeSet<String>,
}

impl Extensions {
    /// Reads the names of required extensions.
    pub(super) fn new(root: &Object<'_>) -> Self {
        Self { required: root.texts("extensionsRequired").into_iter().collect() }
    }

    /// True if the document requires the extension.
    pub(super) fn requires(&self, name: &str) -> bool {
        self.required.contains(name)
    }

    /// Checks the extensions of the document or of a part of the geometry that is in use, of which
    /// `read` are read.
    ///
    /// # Errors
    /// [`ReadError::Document`] if another one is required and not known to concern looks only.
    pub(super) fn check(&self, part: &Object<'_>, read: &[&str], notes: &mut Notes) -> Result<(), ReadError> {
        let Some(extensions) = part.extensions() else { return Ok(()) };
        let place = if part.path.is_empty() { "document" } else { part.path.as_str() };
        for name in extensions.names().filter(|name| !read.contains(name) && !looks_only(name)) {
            if self.requires(name) {
                let detail = "the extension is required and not known, so the geometry cannot be read";
                return Err(extensions.wrong(name, detail));
            }
            notes.add(place, format!("the extension {} is not known and was passed over", shown(name)));
        }
        Ok(())
    }

    /// Notes the required extensions that were passed over.
    pub(super) fn note_required(&self, notes: &mut Notes) {
        for name in self.required.iter().filter(|name| !KNOWN.contains(&name.as_str())) {
            let why = if looks_only(name) { "it concerns looks only" } else { "no part that was read has it" };
            notes.add("extensionsRequired", format!("{} was passed over, because {why}", shown(name)));
        }
    }
}

fn looks_only(name: &str) -> bool {
    LOOKS.iter().any(|known| name.starts_with(known))
}
