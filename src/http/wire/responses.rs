//! Error responses of the routes, as their descriptions name them.

use super::problem::Kind;
use std::collections::BTreeMap;
use utoipa::IntoResponses;
use utoipa::openapi::content::ContentBuilder;
use utoipa::openapi::{Ref, RefOr, Response, ResponseBuilder};

macro_rules! problems {
    ($($(#[$doc:meta])* $name:ident: $($kind:ident),+;)*) => {$(
        $(#[$doc])*
        pub(in crate::http) struct $name;

        impl IntoResponses for $name {
            fn responses() -> BTreeMap<String, RefOr<Response>> {
                problem_responses(&[$(Kind::$kind),+])
            }
        }
    )*};
}

problems! {
    /// No model has this id.
    ModelMissing: ModelNotFound;
    /// No batch has this id.
    BatchMissing: BatchNotFound;
    /// No fit has this id.
    FitMissing: FitNotFound;
    /// No operation has this id.
    OperationMissing: OperationNotFound;
    /// The owner has too many unfinished operations.
    OperationsFull: QuotaExceeded;
    /// No model has this id, or it has no such file.
    FileMissing: ModelNotFound, FileNotFound;
    /// No model has this id, or it has no such section.
    SectionMissing: ModelNotFound, FileNotFound, SectionNotFound;
    /// No model has this id, the model has no surface, or the plane does not intersect it.
    CutMissing: ModelNotFound, FileNotFound, CutNotFound;
    /// No model has this id, the model has no surface, or no way was found.
    WayMissing: ModelNotFound, FileNotFound, WayNotFound;
    /// A query parameter is invalid, or the surface is too large.
    CutProblems: BadRequest, InvalidRequest, SurfaceTooLarge;
    /// No preset has this name.
    PresetMissing: PresetNotFound;
    /// No worker has this name.
    WorkerMissing: WorkerNotFound;
    /// The range lies outside the file.
    RangeOutside: RangeNotSatisfiable;
    /// No representation matches `Accept`.
    Unacceptable: NotAcceptable;
    /// A query parameter is invalid.
    BadParameters: BadRequest, InvalidRequest;
    /// The body or a header is invalid.
    BodyProblems: BadRequest, InvalidJson, RequestTimeout, PayloadTooLarge, UnsupportedMediaType, InvalidRequest, CostLimit, GpuUnavailable, IdempotencyConflict;
    /// The body of a request for a fit is invalid.
    FitProblems: BadRequest, InvalidJson, RequestTimeout, PayloadTooLarge, UnsupportedMediaType, InvalidRequest, CostLimit, IdempotencyConflict;
    /// The body of a request for a ticket is invalid.
    TicketProblems: BadRequest, InvalidJson, RequestTimeout, PayloadTooLarge, UnsupportedMediaType, InvalidRequest;
    /// The model has not failed.
    NotFailed: NotFailed;
    /// The model cannot be grown with this version, or a header is invalid.
    RetryProblems: InvalidRequest, CostLimit, GpuUnavailable, IdempotencyConflict;
    /// The queue is full, or the quota of the key is used up.
    QueueFull: QueueFull, QuotaExceeded;
    /// One of the stores is unavailable.
    StoresUnavailable: StoreUnavailable, StorageUnavailable;
    /// A store is unavailable, this process cannot store files, or GPU workers are still opening
    /// their devices.
    NotReadyOrUnavailable: StoreUnavailable, StorageUnavailable, NotReady;
    /// A store is unavailable, this process cannot store files, GPU workers are still opening their
    /// devices, or too many bodies are being processed.
    BodyUnavailable: StoreUnavailable, StorageUnavailable, NotReady, TooManyBodies;
    /// A store is unavailable, or too many bodies are being processed or images traced.
    FitUnavailable: StoreUnavailable, StorageUnavailable, TooManyBodies, TooManyPictures;
    /// A store is unavailable, this process cannot store files, or too many bodies are being
    /// processed or images traced.
    FitNotReadyOrUnavailable: StoreUnavailable, StorageUnavailable, NotReady, TooManyBodies, TooManyPictures;
    /// The job store is unavailable, or too many bodies are being processed.
    TicketUnavailable: StoreUnavailable, TooManyBodies;
    /// The artifact store is unavailable, or too many downloads are running.
    DownloadUnavailable: StoreUnavailable, StorageUnavailable, TooManyDownloads;
    /// A store is unavailable, or too many downloads are running or pictures being drawn.
    PictureUnavailable: StoreUnavailable, StorageUnavailable, TooManyDownloads, TooManyPictures;
    /// The job store is unavailable, or too many streams are open.
    StreamUnavailable: StoreUnavailable, TooManyStreams;
    /// The process does not accept requests.
    Unready: StoreUnavailable, StorageUnavailable, NotReady;
    /// A worker of this process is stuck.
    Unhealthy: WorkersStuck;
}

/// One response per status of `kinds`.
pub(in crate::http) fn problem_responses(kinds: &[Kind]) -> BTreeMap<String, RefOr<Response>> {
    let mut responses = BTreeMap::new();
    add_problems(&mut responses, kinds);
    responses
}

/// Adds problems to the responses of an operation. A problem with the status of an existing
/// response extends its description.
pub(in crate::http) fn add_problems(responses: &mut BTreeMap<String, RefOr<Response>>, kinds: &[Kind]) {
    for kind in kinds {
        let line = format!("{} (`{}`)", kind.title(), kind.slug());
        match responses.get_mut(kind.status().as_str()) {
            Some(RefOr::T(known)) if known.description.split("; ").any(|known| known == line) => {}
            Some(RefOr::T(known)) => known.description = format!("{}; {line}", known.description),
            Some(RefOr::Ref(_)) => {}
            None => {
                let schema = ContentBuilder::new().schema(Some(Ref::from_schema_name("Problem"))).build();
                let response = ResponseBuilder::new().description(line).content("application/problem+json", schema);
                responses.insert(kind.status().as_str().to_owned(), response.build().into());
            }
        }
    }
}
