//! How much of a model an answer or an event holds: the parameter `view`.

use crate::http::wire::extract::Parameters;
use crate::http::wire::faults::{Fault, Faults};
use serde::Deserialize;
use utoipa::ToSchema;

/// How much of each model is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = View)]
pub(in crate::http) enum Detail {
    /// All but the spec, which never changes and is most of the bytes.
    Summary,
    /// All.
    Full,
}

impl Detail {
    /// The value of `view`, or `default` if it is absent.
    pub(in crate::http) fn read(parameters: &Parameters, default: Self, faults: &mut Faults) -> Self {
        match parameters.get("view") {
            None => default,
            Some("summary") => Self::Summary,
            Some("full") => Self::Full,
            Some(_) => {
                faults.push(Fault::parameter("view", "must be summary or full"));
                default
            }
        }
    }
}
