//! Heights of layers in pictures of sections and cuts.

use super::args::LayerArgs;
use super::exit::Failure;
use crate::spec::{ModelSpec, preset, presets};
use crate::tissue::Layers;
use serde_json::{Map, Value, json};

/// The layers of a preset, changed by options, which are checked as a spec is.
pub(super) fn layers(name: &str, args: &LayerArgs) -> Result<Layers, Failure> {
    let given = [
        ("epithelium_um", args.epithelium_um),
        ("lamina_um", args.lamina_um),
        ("longitudinal_share", args.longitudinal_share),
        ("serosa_um", args.serosa_um),
    ];
    let given: Map<String, Value> =
        given.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?.into()))).collect();
    let preset = preset(name).unwrap_or(&presets()[0]);
    match ModelSpec::resolve(preset, &json!({ "histology": given })) {
        Ok(spec) => Ok(spec.histology.layers()),
        Err(faults) => Err(Failure::Usage(faults.iter().map(|f| format!("{}: {}", f.pointer, f.detail)).collect())),
    }
}
