//! The study of a batch, as stored and as sent.

use crate::spec::openapi::ParameterValue;
use crate::spec::study::Study;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;
use uuid::Uuid;

/// A study and its points in the record of a batch. The model at place `i` of the batch belongs to
/// point `i / seeds.len()` and has the seed `seeds[i % seeds.len()]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct StoredStudy {
    /// Member `vary` of the request.
    pub(super) vary: Value,
    /// Seeds of each point.
    seeds: Vec<u64>,
    /// JSON pointers of the varied parameters.
    pub(super) pointers: Vec<String>,
    /// Values of the varied parameters at each point.
    points: Vec<Vec<Value>>,
}

impl StoredStudy {
    pub(super) fn new(vary: Value, study: &Study, seeds: Vec<u64>) -> Self {
        let points = (0..study.points()).map(|point| study.values(point).cloned().collect()).collect();
        Self { vary, seeds, pointers: study.pointers().to_vec(), points }
    }

    pub(super) fn to_json(&self) -> Value {
        serde_json::to_value(self).expect("a study has string keys only")
    }

    /// Reads the study of a batch. `None` if the batch has none, or one of an unknown format.
    pub(super) fn of(batch: &crate::jobs::Batch) -> Option<Self> {
        let stored = batch.study.as_ref()?;
        Self::deserialize(stored)
            .inspect_err(|error| tracing::warn!(batch = %batch.id, %error, "a study is not read"))
            .ok()
    }

    /// Index of the point of the model at a place.
    fn point(&self, place: u32) -> usize {
        place as usize / self.seeds.len().max(1)
    }

    /// Varied values of the model at a place, in the order of `pointers`.
    pub(super) fn values(&self, place: u32) -> &[Value] {
        self.points.get(self.point(place)).map_or(&[], Vec::as_slice)
    }

    /// Varied values of the model at a place, by pointer.
    pub(super) fn named(&self, place: u32) -> Map<String, Value> {
        self.pointers.iter().cloned().zip(self.values(place).iter().cloned()).collect()
    }
}

/// The study of a batch.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct BatchStudy {
    /// The member `vary` of the request.
    #[schema(value_type = Study)]
    pub vary: Value,
    /// Models, in the order of `models`: points in the order of the design, each with its seeds.
    pub models: Vec<StudyModel>,
}

/// A model of a study.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct StudyModel {
    /// Id of the model.
    pub id: Uuid,
    /// Index of the point in the design, from 0.
    #[schema(minimum = 0)]
    pub point: usize,
    /// Seed of the model.
    #[schema(minimum = 0, maximum = 9007199254740991i64)]
    pub seed: u64,
    /// Varied values, by JSON pointer.
    #[schema(value_type = BTreeMap<String, ParameterValue>)]
    pub values: Map<String, Value>,
}

impl BatchStudy {
    pub(super) fn of(batch: &crate::jobs::Batch) -> Option<Self> {
        let stored = StoredStudy::of(batch)?;
        let model = |(id, place): (&crate::jobs::JobId, &u32)| StudyModel {
            id: id.0,
            point: stored.point(*place),
            seed: stored.seeds.get(*place as usize % stored.seeds.len().max(1)).copied().unwrap_or_default(),
            values: stored.named(*place),
        };
        let models = batch.jobs.iter().zip(&batch.places).map(model).collect();
        Some(Self { models, vary: stored.vary })
    }
}
