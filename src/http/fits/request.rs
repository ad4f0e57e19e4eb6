//! Body of a request for a fit.

use crate::fit::{FitSpec, read_images};
use crate::http::models::request::{read_labels, read_priority};
use crate::http::wire::faults::{Faults, body_reader};
use crate::jobs::Priority;
use crate::spec::ModelSpec;
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Request for a fit. Targets come from `targets`, `targets_csv` and `images`; at least one target
/// is required.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "describes the body, which `CheckedFit::read` reads")]
pub(super) struct FitRequest {
    /// Name of a preset; see `GET /presets`. `pig` by default.
    #[schema(required = false)]
    preset: String,
    /// The spec that the search starts from, as a patch of the preset.
    #[schema(value_type = ModelSpec, required = false)]
    spec: Value,
    /// Measures to reach.
    #[schema(required = false, max_items = 100)]
    targets: Vec<FitTarget>,
    /// Targets as CSV: a header with the columns `region`, `quantity`, `value`, `low` and `high`,
    /// and one row per target.
    #[schema(required = false)]
    targets_csv: String,
    /// Images of sections whose measures become targets.
    #[schema(required = false, max_items = 20)]
    images: Vec<SectionImage>,
    /// Parameters to search for. By default, the parameters on which the targets depend, between
    /// half and twice their values.
    #[schema(required = false, min_items = 1, max_items = 20)]
    vary: Vec<FitVariable>,
    /// Maximum number of candidates; 70 by default.
    #[schema(required = false, minimum = 1, maximum = 2000)]
    evaluations: u32,
    /// Number of seeds with which each candidate is measured; 4 by default. Inexpensive measures
    /// use four times as many.
    #[schema(required = false, minimum = 1, maximum = 16)]
    seeds: u32,
    /// Number of models of the result that are grown in full, each with a different seed; 4 by
    /// default.
    #[schema(required = false, minimum = 1, maximum = 20)]
    models: u32,
    /// First of the seeds, and seed of the search; 0 by default.
    #[schema(required = false, minimum = 0, maximum = 9007199254740907i64)]
    seed: u64,
    /// Labels by which clients can find the fit: names and values.
    #[schema(required = false)]
    labels: BTreeMap<String, String>,
    /// Priority in the queue. Workers claim queued jobs of higher priority first.
    #[schema(required = false, minimum = -100, maximum = 100)]
    priority: i64,
}

/// A measure to reach. Either `value` or both `low` and `high` are required. Without `value`, the
/// value is the middle of the range. Without a range, the range extends 5 % of the value to both
/// sides.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "describes a member of the body")]
pub(super) struct FitTarget {
    /// `isthmus`, `junction`, `ampulla`, `whole`, or `tube` for a measure of the whole tube.
    region: String,
    /// Name of the quantity, as in the report of a model.
    quantity: String,
    /// Value to reach: the mean over the region.
    #[schema(required = false)]
    value: Option<f64>,
    /// Lower end of the accepted range.
    #[schema(required = false)]
    low: Option<f64>,
    /// Upper end of the accepted range.
    #[schema(required = false)]
    high: Option<f64>,
    /// Source of the value.
    #[schema(required = false, max_length = 300)]
    source: Option<String>,
}

/// An image of a section. The service traces the image and measures it like a section of a model.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "describes a member of the body")]
pub(super) struct SectionImage {
    /// Region of the tube from which the section was taken.
    region: String,
    /// The file of the image as base64: PNG, TIFF, OME-TIFF, BMP or JPEG, grey or with a palette,
    /// or GeoJSON of QuPath. Required, unless `png` has it.
    #[schema(required = false)]
    image: String,
    /// Former name of `image`.
    #[schema(required = false)]
    png: Option<String>,
    /// Side of a pixel, micrometres; by default the one that the file states.
    #[schema(required = false, minimum = 0.05, maximum = 100)]
    pixel_um: Option<f64>,
    /// Pixels that show tissue; by default all values except 0, if 0 and at most one other value
    /// occur.
    #[schema(required = false)]
    tissue: Option<TissueChoice>,
    /// Least value of tissue; with `zero` as `tissue`, values below it are tissue. By default 128
    /// in a JPEG, and none in other formats.
    #[schema(required = false, minimum = 1, maximum = 65535)]
    threshold: Option<u16>,
    /// Quantities that become targets; by default those that a single section determines reliably.
    #[schema(required = false)]
    quantities: Option<Vec<String>>,
    /// Accepted deviation to both sides, as a fraction of the value; 0.1 by default.
    #[schema(required = false, minimum = 0.001, maximum = 1)]
    tolerance: Option<f64>,
}

/// Pixels that show tissue.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "describes a member of the body")]
pub(super) enum TissueChoice {
    /// These values, which are indices if the image has a palette.
    Values(Vec<u16>),
    /// All values except 0, or all values from the threshold on; or the value 0, or all values
    /// below the threshold.
    Name(TissueName),
}

/// Name of a choice of pixels.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum TissueName {
    /// All values except 0, or all values from the threshold on.
    Nonzero,
    /// The value 0, or all values below the threshold.
    Zero,
}

/// A parameter to search for.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "describes a member of the body")]
pub(super) struct FitVariable {
    /// JSON pointer of a parameter that takes numbers, such as `/collision/gap_um`.
    parameter: String,
    /// End of the tube at which a parameter that may change along the tube is varied. By default,
    /// the parameter is varied as a whole.
    #[schema(required = false)]
    end: Option<crate::spec::End>,
    /// Lower bound; by default half of the value in the spec. For a schedule, this is the value at
    /// `end`, or at the ampulla end without `end`.
    #[schema(required = false)]
    from: Option<f64>,
    /// Upper bound; by default twice the value in the spec.
    #[schema(required = false)]
    to: Option<f64>,
}

/// A request that passed all checks of its members.
pub(super) struct CheckedFit {
    pub(super) fit: FitSpec,
    pub(super) labels: BTreeMap<String, String>,
    pub(super) priority: Priority,
}

impl CheckedFit {
    /// Reads a body. Tracing large images takes seconds.
    ///
    /// # Errors
    /// All faults. If an image is invalid, the other members that describe the fit are not checked:
    /// targets that they lack may be in the image.
    pub(super) fn read(mut body: Value) -> Result<Self, Faults> {
        let mut reader = body_reader();
        let mut take = |name: &str| body.as_object_mut().and_then(|members| members.remove(name));
        let own = ["labels", "priority", "images"];
        let [labels, priority, images] = own.map(&mut take);
        let labels = labels.map_or_else(BTreeMap::new, |value| read_labels(&mut reader, &value));
        let priority = priority.and_then(|value| read_priority(&mut reader, &value)).unwrap_or_default();
        let measured = images.map_or(Ok(Vec::new()), |images| read_images(&images));
        let fit = measured.and_then(|measured| FitSpec::read(&body, measured, &own));
        let fit = fit.map_err(|faults| reader.extend("", faults)).ok().filter(|_| reader.count() == 0);
        fit.map(|fit| Self { fit, labels, priority }).ok_or_else(|| reader.into())
    }
}
