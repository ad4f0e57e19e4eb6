//! The study of a batch: as it is stored, and as it is answered.

use crate::http::wire::responses::{ParameterValue, Vary};
use crate::spec::study::Study;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;
use uuid::Uuid;

/// A study and what it gave, as the record of its batch keeps it. The model at place `i` of the batch is that of the point
/// `i / seeds.len()` and of the seed `seeds[i % seeds.len()]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct StoredStudy {
    /// The member `vary` of the request.
    pub(in crate::http) vary: Value,
    /// The seeds of each point.
    pub(in crate::http) seeds: Vec<u64>,
    /// The parameters that are varied.
    pub(super) pointers: Vec<String>,
    /// Their values in each point.
    pub(in crate::http) points: Vec<Vec<Value>>,
}

impl StoredStudy {
    /// What is to be stored of a study.
    pub(in crate::http) fn new(vary: Value, study: &Study, seeds: Vec<u64>) -> Self {
        let points = (0..study.points()).map(|point| study.values(point).cloned().collect()).collect();
        Self { vary, seeds, pointers: study.pointers().to_vec(), points }
    }

    /// As JSON.
    pub(in crate::http) fn to_json(&self) -> Value {
        serde_json::to_value(self).expect("a study has string keys only")
    }

    /// The study of a batch; `None` if it has none, or none that this version can read.
    pub(in crate::http) fn of(batch: &crate::jobs::Batch) -> Option<Self> {
        let stored = batch.study.as_ref()?;
        Self::deserialize(stored)
            .inspect_err(|error| tracing::warn!(batch = %batch.id, %error, "a study is not read"))
            .ok()
    }

    /// The point of the model at this place.
    fn point(&self, place: u32) -> usize {
        place as usize / self.seeds.len().max(1)
    }

    /// The values of the model at this place, in the order of the pointers.
    pub(in crate::http) fn values(&self, place: u32) -> &[Value] {
        self.points.get(self.point(place)).map_or(&[], Vec::as_slice)
    }

    /// The values of the model at this place by pointer.
    pub(in crate::http) fn named(&self, place: u32) -> Map<String, Value> {
        self.pointers.iter().cloned().zip(self.values(place).iter().cloned()).collect()
    }
}

/// The study of a batch.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct BatchStudy {
    /// The member `vary` of the request.
    #[schema(value_type = Vary)]
    pub vary: Value,
    /// The models in the order of `models`: points in the order of the design, each with its seeds.
    pub models: Vec<StudyModel>,
}

/// A model of a study.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct StudyModel {
    /// Id of the model.
    pub id: Uuid,
    /// Index of its point in the design, from 0.
    #[schema(minimum = 0)]
    pub point: usize,
    /// Its seed.
    #[schema(minimum = 0, maximum = 9007199254740991i64)]
    pub seed: u64,
    /// The varied values by their pointers.
    #[schema(value_type = BTreeMap<String, ParameterValue>)]
    pub values: Map<String, Value>,
}

impl BatchStudy {
    /// The study of a batch, if it has one.
    pub(in crate::http) fn of(batch: &crate::jobs::Batch) -> Option<Self> {
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
