//! `oviduct presets`, `schema` and `openapi`: print data that is built into the program.

use super::args::PresetsArgs;
use super::exit::Ended;
use super::term;
use crate::spec::{self, Preset};

/// Lists the presets.
pub(super) fn presets(args: &PresetsArgs) -> Ended {
    if args.json {
        let all: Vec<_> = spec::presets().iter().map(Preset::to_json).collect();
        return Ok(term::print_json(&all)?);
    }
    for preset in spec::presets() {
        let default = if preset.name == spec::DEFAULT_PRESET { " (default)" } else { "" };
        term::print(&format!("{}{default}: {}\n    {}", preset.name, preset.title, preset.description))?;
    }
    Ok(())
}

/// Prints the JSON Schema of the spec.
pub(super) fn schema() -> Ended {
    Ok(term::print_json(&spec::schema())?)
}

/// Prints the OpenAPI description of the service.
pub(super) fn openapi() -> Ended {
    Ok(term::print(&crate::http::openapi_yaml())?)
}
