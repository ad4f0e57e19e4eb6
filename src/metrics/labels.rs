//! Labels of metrics. Their values come from the code, never from requests, so that their number is bounded.

use prometheus_client::encoding::{EncodeLabelSet, EncodeLabelValue, LabelValueEncoder};
use std::fmt::Write as _;

/// A label value known at compile time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Word(pub(super) &'static str);

impl EncodeLabelValue for Word {
    fn encode(&self, encoder: &mut LabelValueEncoder<'_>) -> Result<(), std::fmt::Error> {
        encoder.write_str(self.0)
    }
}

macro_rules! labels {
    ($($name:ident { $($label:ident: $kind:ty),+ })*) => {$(
        #[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
        pub(super) struct $name {
            $(pub(super) $label: $kind,)+
        }
    )*};
}

labels! {
    StatusLabel { status: Word }
    BackendLabel { backend: Word }
    StageLabel { stage: Word }
    EndLabel { end: Word }
    MadeLabel { backend: Word, device: String }
    CauseLabel { cause: Word }
    DirectionLabel { direction: Word }
    ResultLabel { result: Word }
    RequestLabel { method: String, route: String, status: u16 }
    DurationLabel { method: String, route: String, status: Word }
    WorkerLabel { backend: Word, state: Word }
    PoolLabel { pool: Word }
    ConnectionLabel { pool: Word, state: Word }
    BuildLabel { version: Word, engine: Word, arch: Word }
}

/// The class of a status of HTTP.
pub(super) fn class(status: u16) -> Word {
    Word(match status / 100 {
        1 => "1xx",
        2 => "2xx",
        3 => "3xx",
        4 => "4xx",
        _ => "5xx",
    })
}
