"""Responses of the service as frozen dataclasses.

Unknown members are ignored, so this version works with a newer service; `raw` of a model, a batch
and a fit contains the whole response. Members that an older service omits have their defaults.
"""

from __future__ import annotations

import dataclasses
import datetime
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypedDict, TypeVar, overload
from urllib.parse import urljoin
from uuid import UUID

import numpy as np
import numpy.typing as npt

from .errors import UnexpectedAnswer

if TYPE_CHECKING:
    import pandas

T = TypeVar("T")
Json = dict[str, Any]
ENDED = ("succeeded", "failed", "cancelled")


def read(kind: type[T], answer: Any) -> T:
    """Creates an instance of a dataclass from the JSON object of a response.

    Raises UnexpectedAnswer if the response is not an object or lacks a member without a default.
    """
    try:
        members: Json = {}
        for known in dataclasses.fields(kind):  # type: ignore[arg-type]
            if known.name in answer and answer[known.name] is not None:
                convert = known.metadata.get("convert")
                members[known.name] = convert(answer[known.name]) if convert else answer[known.name]
            elif known.name == "raw":
                members["raw"] = answer
        return kind(**members)
    except (TypeError, ValueError, KeyError, AttributeError, IndexError) as error:
        raise UnexpectedAnswer(f"the answer is not a {kind.__name__}: {error}") from error


def _as(kind: type[T]) -> dict[str, Callable[[Any], T]]:
    return {"convert": lambda answer: read(kind, answer)}


def _all(kind: type[T]) -> dict[str, Callable[[Any], tuple[T, ...]]]:
    return {"convert": lambda answer: tuple(read(kind, item) for item in answer)}


def _moment(text: str) -> datetime.datetime:
    """Parses an RFC 3339 time. Python 3.10 accepts neither `Z` nor other than 3 or 6 decimals."""
    match = re.fullmatch(r"(.{19})(?:\.(\d+))?(Z|z|[+-]\d\d:\d\d)", text)
    if match is None:
        raise ValueError(f"not a time: {text!r}")
    second, decimals, zone = match.groups()
    zone = "+00:00" if zone in "Zz" else zone
    return datetime.datetime.fromisoformat(f"{second}.{(decimals or '').ljust(6, '0')[:6]}{zone}")


def _points(answer: Any) -> npt.NDArray[np.float32]:
    return np.asarray(answer, np.float32).reshape(-1, 2)


_TIME = {"convert": _moment}
_TUPLE = {"convert": tuple}
_POINTS = {"convert": _points}


@dataclass(frozen=True)
class Progress:
    """Progress of a running model."""

    stage: str
    """`simulate`, `mesh`, `certify`, `measure`, `export` or `store`."""
    fraction: float
    """Progress, 0 to 1; never decreases within an attempt."""
    step: int = 0
    steps: int = 0
    particles: int = 0
    sections: int = 0
    eta_seconds: float | None = None


@dataclass(frozen=True)
class File:
    """A file of a model."""

    name: str
    bytes: int
    """Size in bytes."""
    sha256: str
    """SHA-256 in lower-case hexadecimal."""
    media_type: str = "application/octet-stream"
    href: str = ""
    """Absolute URL; relative in the response of the service."""


@dataclass(frozen=True)
class Queue:
    """Place in the queue."""

    position: int | None = None
    """Number of models and fits ahead, at most 1000; None after the model has left the queue."""
    position_is_exact: bool | None = None
    """False if at least 1000 models and fits are ahead."""
    reason: str | None = None
    """Why no worker starts the model: `no-worker`, `paused`, `storage` or `equal-model`; None if it waits its turn."""
    wait_seconds: float | None = None
    """Seconds between acceptance and the first attempt."""


@dataclass(frozen=True)
class Backend:
    """The backend that computes or computed a model."""

    requested: str = "auto"
    used: str | None = None
    device: str | None = None
    fallback: str | None = None
    """Reason why an `auto` model ran on the CPU instead of a GPU; None if no fallback happened."""


@dataclass(frozen=True)
class ModelProblem:
    """The reason why a model or a fit failed."""

    type: str
    title: str = ""
    detail: str = ""


@dataclass(frozen=True)
class ModelWarning:
    """A sign of poor growth of a model that has succeeded."""

    code: str
    detail: str = ""


@dataclass(frozen=True)
class Model:
    """A model: its request, progress and result."""

    id: str
    status: str
    """`queued`, `running`, `succeeded`, `failed` or `cancelled`."""
    version: int
    preset: str
    seed: int
    outputs: tuple[str, ...] = field(default=(), metadata=_TUPLE)
    bodies: tuple[str, ...] = field(default=(), metadata=_TUPLE)
    units: str | None = None
    labels: Mapping[str, str] = field(default_factory=dict, hash=False)
    priority: int = 0
    owner: str | None = None
    batch: str | None = None
    backend: Backend = field(default=Backend(), metadata=_as(Backend))
    worker: str | None = None
    queue: Queue = field(default=Queue(), metadata=_as(Queue))
    progress: Progress | None = field(default=None, metadata=_as(Progress))
    attempts: int = 0
    created_at: datetime.datetime | None = field(default=None, metadata=_TIME)
    started_at: datetime.datetime | None = field(default=None, metadata=_TIME)
    finished_at: datetime.datetime | None = field(default=None, metadata=_TIME)
    expires_at: datetime.datetime | None = field(default=None, metadata=_TIME)
    files: tuple[File, ...] = field(default=(), metadata=_all(File))
    summary: Json | None = field(default=None, hash=False)
    """Counts and measures of a succeeded model; `certificate` has those of the certificate."""
    warnings: tuple[ModelWarning, ...] = field(default=(), metadata=_all(ModelWarning))
    problem: ModelProblem | None = field(default=None, metadata=_as(ModelProblem))
    digest: str = ""
    reused_from: str | None = None
    retry_of: str | None = None
    spec: Json | None = field(default=None, hash=False, repr=False)
    """The complete spec; None in lists and events unless requested."""
    raw: Json = field(default_factory=dict, repr=False, compare=False)
    """The whole response."""

    @property
    def has_ended(self) -> bool:
        """True if the model has succeeded, failed or was cancelled; it never changes after that."""
        return self.status in ENDED


def read_model(answer: Any, url: str) -> Model:
    """Parses a model from a response; the references of its files are relative to `url`."""
    model = read(Model, answer)
    files = tuple(dataclasses.replace(file, href=urljoin(url, file.href)) for file in model.files)
    return dataclasses.replace(model, files=files)


@dataclass(frozen=True)
class LiveSection:
    """The last section of a growing model, thinned to at most 512 points per contour."""

    index: int
    step: int
    z_um: float
    inner: npt.NDArray[np.float32] = field(metadata=_POINTS, repr=False, compare=False)
    """Boundary of the lumen, shape (n, 2), micrometres."""
    outer: npt.NDArray[np.float32] = field(metadata=_POINTS, repr=False, compare=False)
    """Boundary of the tissue, shape (n, 2), micrometres."""


@dataclass(frozen=True)
class Event:
    """A change of a model."""

    name: str
    """`status`, `progress`, `section` or `end`; `end` is the last event of a model."""
    model_id: str
    status: str
    """Status of the model, or `deleted`."""
    model: Model | None = None
    """Whole state of the model; None if it was deleted."""
    section: LiveSection | None = None
    """Latest section of the model, in `section` events."""
    id: str | None = None
    """Cursor of the stream; pass it as `last_event_id` to resume after this event."""


def read_event(name: str, data: Any, cursor: str | None, url: str) -> Event:
    """Parses an event of the stream at `url`."""
    if not isinstance(data, dict) or "id" not in data or "status" not in data:
        raise UnexpectedAnswer("the event has no model")
    model = None if data["status"] == "deleted" else read_model(data, url)
    section = read(LiveSection, data["section"]) if data.get("section") else None
    return Event(name, data["id"], data["status"], model, section, cursor)


@dataclass(frozen=True)
class Counts:
    """Number of a batch's models by status."""

    total: int = 0
    queued: int = 0
    running: int = 0
    succeeded: int = 0
    failed: int = 0
    cancelled: int = 0

    @property
    def ended(self) -> int:
        """Number of models that have succeeded, failed or were cancelled."""
        return self.succeeded + self.failed + self.cancelled


@dataclass(frozen=True)
class StudyModel:
    """A model of a study."""

    id: str
    point: int
    """Index of the model's point in the design."""
    seed: int
    values: Json
    """Varied values by JSON pointer."""


@dataclass(frozen=True)
class Study:
    """The study of a batch."""

    vary: Json
    models: tuple[StudyModel, ...] = field(default=(), metadata=_all(StudyModel))


@dataclass(frozen=True)
class Batch:
    """A batch: several models of one spec, or of the points of a study."""

    id: str
    counts: Counts = field(metadata=_as(Counts))
    created_at: datetime.datetime | None = field(default=None, metadata=_TIME)
    priority: int = 0
    owner: str | None = None
    models: tuple[str, ...] = field(default=(), metadata=_TUPLE, repr=False)
    """Ids of the models in the order of the request; empty in lists."""
    study: Study | None = field(default=None, metadata=_as(Study), repr=False)
    raw: Json = field(default_factory=dict, repr=False, compare=False)
    """The whole response."""

    @property
    def has_ended(self) -> bool:
        """True if all models of the batch have ended."""
        return self.counts.ended == self.counts.total


@dataclass(frozen=True)
class FitProgress:
    """Progress of a running fit."""

    stage: str
    """`search`, then `verify`."""
    fraction: float
    """Progress, 0 to 1; never decreases."""
    evaluations: int = 0
    """Number of candidates measured so far."""
    evaluations_most: int = 0
    """Maximum number of candidates."""
    models: int = 0
    """Number of full models grown so far."""
    misfit: float | None = None
    """Minimum misfit so far."""
    eta_seconds: float | None = None
    """Seconds until all evaluations are used."""


@dataclass(frozen=True)
class FitResult:
    """The result of a fit. docs/fitting.md of the service describes the members."""

    preset: str
    spec: Json = field(hash=False, repr=False)
    """The complete spec, for `Client.submit`."""
    parameters: tuple[Json, ...] = field(default=(), hash=False, metadata=_TUPLE)
    """Varied parameters: `parameter`, `end`, `unit`, `start`, `value`, `from`, `to`."""
    targets: tuple[Json, ...] = field(default=(), hash=False, metadata=_TUPLE)
    """Targets: `region`, `quantity`, `value`, `low`, `high`, `measured`, `deviation`, …"""
    unmet: tuple[Json, ...] = field(default=(), hash=False, metadata=_TUPLE)
    """Missed targets: `region`, `quantity`, `why`, `nearest`, `conflicts`, `bounds`."""
    search: Json = field(default_factory=dict, hash=False, repr=False)
    """The search: why it `ended`, `evaluations`, `misfit`, `start_misfit`, `history`, …"""
    models: tuple[Json, ...] = field(default=(), hash=False, metadata=_TUPLE)
    """Full models of the spec: `seed`, `certified`, `failure`, `measures`."""


@dataclass(frozen=True)
class Fit:
    """A fit, a search for parameters: its request, progress and result."""

    id: str
    status: str
    """`queued`, `running`, `succeeded`, `failed` or `cancelled`."""
    version: int
    preset: str
    labels: Mapping[str, str] = field(default_factory=dict, hash=False)
    priority: int = 0
    owner: str | None = None
    worker: str | None = None
    queue: Queue = field(default=Queue(), metadata=_as(Queue))
    progress: FitProgress | None = field(default=None, metadata=_as(FitProgress))
    attempts: int = 0
    created_at: datetime.datetime | None = field(default=None, metadata=_TIME)
    started_at: datetime.datetime | None = field(default=None, metadata=_TIME)
    finished_at: datetime.datetime | None = field(default=None, metadata=_TIME)
    expires_at: datetime.datetime | None = field(default=None, metadata=_TIME)
    problem: ModelProblem | None = field(default=None, metadata=_as(ModelProblem))
    digest: str = ""
    request: Json | None = field(default=None, hash=False, repr=False)
    """The request with the defaults of omitted members; None in lists and events."""
    result: FitResult | None = field(default=None, metadata=_as(FitResult), repr=False)
    """The result of a succeeded fit; None in lists."""
    raw: Json = field(default_factory=dict, repr=False, compare=False)
    """The whole response."""

    @property
    def has_ended(self) -> bool:
        """True if the fit has succeeded, failed or was cancelled; it never changes after that."""
        return self.status in ENDED


@dataclass(frozen=True)
class FitEvent:
    """A change of a fit."""

    name: str
    """`status`, `progress` or `end`; `end` is the last event."""
    fit_id: str
    status: str
    """Status of the fit, or `deleted`."""
    fit: Fit | None = None
    """Whole state of the fit without the request; None if it was deleted."""
    id: str | None = None
    """Cursor of the stream; pass it as `last_event_id` to resume after this event."""


def read_fit_event(name: str, data: Any, cursor: str | None, _: str) -> FitEvent:
    """Parses an event of a fit's stream."""
    if not isinstance(data, dict) or "id" not in data or "status" not in data:
        raise UnexpectedAnswer("the event has no fit")
    fit = None if data["status"] == "deleted" else read(Fit, data)
    return FitEvent(name, data["id"], data["status"], fit, cursor)


@dataclass(frozen=True)
class FitValidation:
    """A valid request for a fit."""

    request: Json = field(repr=False)
    """The request with defaults, targets measured in images, and the parameters to vary."""
    digest: str = ""
    seconds: float = 0.0
    """Predicted seconds on one core if all evaluations are used."""
    counts_as: int = 1
    """Number of models as which the fit counts against the quota of its owner."""


@dataclass(frozen=True)
class Estimate:
    """A predicted time and its basis."""

    seconds: float
    basis: str = ""


def _estimates(answer: Any) -> dict[str, Estimate]:
    return {backend: read(Estimate, estimate) for backend, estimate in answer.items()}


@dataclass(frozen=True)
class Cost:
    """Predicted cost of a model."""

    particles_end: int = 0
    sections: int = 0
    vertices: int = 0
    triangles: int = 0
    bytes: Mapping[str, int] = field(default_factory=dict)
    """Size in bytes by output."""
    memory_bytes: int = 0
    seconds: Mapping[str, Estimate] = field(default_factory=dict, metadata={"convert": _estimates})
    """Seconds by backend."""


@dataclass(frozen=True)
class Validation:
    """A valid request and its predicted cost."""

    preset: str
    cost: Cost = field(metadata=_as(Cost))
    seed: int | None = None
    """None if the service would draw a seed."""
    digest: str | None = None
    spec: Json = field(default_factory=dict, repr=False)
    """The complete spec."""


@dataclass(frozen=True)
class BatchCost:
    """Predicted cost of a batch."""

    seconds: Mapping[str, float] = field(default_factory=dict)
    """Seconds for growing all models one after the other, by backend."""
    bytes: int = 0
    memory_bytes: int = 0
    """Memory of the largest model."""


@dataclass(frozen=True)
class Point:
    """A point of a study."""

    values: Json
    cost: Cost = field(metadata=_as(Cost))


@dataclass(frozen=True)
class BatchValidation:
    """A valid request for a batch and its predicted cost."""

    preset: str
    models: int
    cost: BatchCost = field(metadata=_as(BatchCost))
    points: tuple[Point, ...] = field(default=(), metadata=_all(Point), repr=False)
    seeds: tuple[int, ...] | None = field(default=None, metadata=_TUPLE)
    """None if the service would draw the seeds."""


@dataclass(frozen=True)
class Preset:
    """A preset without its values; `Client.preset` returns these."""

    name: str
    title: str = ""
    organ: str = ""
    species: str = ""
    description: str = ""
    default: bool = False


@dataclass(frozen=True)
class Applied:
    """Result of a bulk request."""

    count: int
    """Number of models that were cancelled or deleted, or would be with `dry_run`."""
    dry_run: bool = False


@dataclass(frozen=True)
class OperationProgress:
    """Progress of an operation."""

    changed: int
    """Number of models that have changed."""
    total: int
    """Number of models that matched when the request was accepted."""
    fraction: float = 0.0


@dataclass(frozen=True)
class Operation:
    """Cancellation or deletion of many models, which the service executes in the background."""

    id: str
    action: str
    """`cancel` or `delete`."""
    status: str
    progress: OperationProgress = field(metadata=_as(OperationProgress))
    owner: str | None = None
    conditions: dict[str, list[str]] = field(default_factory=dict)
    version: int = 1
    created_at: datetime.datetime | None = field(default=None, metadata=_TIME)
    finished_at: datetime.datetime | None = field(default=None, metadata=_TIME)


@dataclass(frozen=True)
class Ticket:
    """A ticket: the right to one GET of one path within 60 seconds, without an API key."""

    ticket: str = field(repr=False)
    path: str
    expires_at: datetime.datetime | None = field(default=None, metadata=_TIME)
    url: str = field(default="", repr=False)
    """URL of the path, including the ticket."""


@dataclass(frozen=True)
class Pause:
    """A pause of one worker or of all workers."""

    since: datetime.datetime = field(metadata=_TIME)
    by: str | None = None


@dataclass(frozen=True)
class Worker:
    """A worker."""

    id: str
    state: str
    """`active`, `paused`, `draining` or `drained`."""
    host: str = ""
    backend: str = ""
    device: str = ""
    jobs: tuple[str, ...] = field(default=(), metadata=_TUPLE)
    """Ids of the models and fits that the worker runs."""
    jobs_done: int = 0
    heartbeat_at: datetime.datetime | None = field(default=None, metadata=_TIME)
    pause: Pause | None = field(default=None, metadata=_as(Pause))
    condition: str | None = None
    """Condition that keeps the worker from starting models: `storage`; None if there is none."""


@dataclass(frozen=True)
class Workers:
    """The workers that sent a heartbeat within the last minutes."""

    workers: tuple[Worker, ...] = field(metadata=_all(Worker))
    pause: Pause | None = field(default=None, metadata=_as(Pause))
    """Pause of all workers; None if active workers start models."""

    def __iter__(self) -> Iterator[Worker]:
        return iter(self.workers)

    def __len__(self) -> int:
        return len(self.workers)


@dataclass(frozen=True)
class Health:
    """The state of the service."""

    status: str
    version: str = ""


@dataclass(frozen=True)
class Table(Sequence[Json]):
    """The models of a batch as a sequence of rows, each a dict by column."""

    columns: tuple[str, ...]
    """`id`, `status`, `seed`, pointers of varied parameters, `problem`, measures by dotted name."""
    rows: tuple[tuple[Any, ...], ...] = field(repr=False)
    """Cells; None for a value that a model does not have."""

    @overload
    def __getitem__(self, index: int) -> Json: ...
    @overload
    def __getitem__(self, index: slice) -> list[Json]: ...
    def __getitem__(self, index: int | slice) -> Json | list[Json]:
        if isinstance(index, slice):
            return [dict(zip(self.columns, row, strict=True)) for row in self.rows[index]]
        return dict(zip(self.columns, self.rows[index], strict=True))

    def __len__(self) -> int:
        return len(self.rows)

    def column(self, name: str) -> list[Any]:
        """Returns the cells of a column; raises KeyError if there is no such column."""
        if name not in self.columns:
            raise KeyError(name)
        at = self.columns.index(name)
        return [row[at] for row in self.rows]

    def to_pandas(self) -> pandas.DataFrame:
        """Returns a data frame.

        Raises ImportError without pandas (`pip install 'oviduct[pandas]'`).
        """
        import pandas

        return pandas.DataFrame(list(self.rows), columns=list(self.columns))


# Arguments of requests.

ModelRef = Model | str | UUID
BatchRef = Batch | str | UUID
FitRef = Fit | str | UUID
View = Literal["summary", "full"]
Labels = Mapping[str, str]


class ModelOptions(TypedDict, total=False):
    """Members that requests for models and for batches share."""

    preset: str
    """Name of a preset; `pig` by default."""
    spec: Mapping[str, Any]
    """Changes of the preset as a merge patch (RFC 7396): `{"collision": {"gap_um": 30}}`."""
    outputs: Sequence[str]
    """Formats: `glb` and `lod` by default.

    The others are `gltf`, `obj`, `stl`, `stl-ascii`, `ply`, `vtp`, `3mf`, `centreline` and
    `labels`. `sections.bin` and `report.json` are always written. A spec with `contraction.frames`
    also gives `frames.xdmf`, `frames.bin` and `animation.glb`.
    """
    bodies: Sequence[str]
    """The surfaces: `tissue` (the default), `lumen`, `regions` (both, with one shared wall)."""
    units: str
    """`m`, `mm` or `um`; by default metres in OBJ and glTF, millimetres in other formats."""
    labels: Labels
    """Names and values of your choice, to find models by."""
    backend: str
    """`auto` (the default), `gpu`, `cpu` or `cpu-single`."""
    priority: int
    """-100 to 100; workers claim queued models of higher priority first."""
    reuse: bool
    """True (the default) if the files of another model of the same spec and seed may be used."""


class FitFilter(TypedDict, total=False):
    """Conditions of a list of fits; a fit must match all of them."""

    status: str
    preset: str
    labels: Labels
    owner: str
    created_after: datetime.datetime | str
    """Earliest time of acceptance, included."""
    created_before: datetime.datetime | str
    """Latest time of acceptance, excluded."""


class ModelFilter(FitFilter, total=False):
    """Conditions of a list of models; a model must match all of them."""

    batch: BatchRef


class FitTarget(TypedDict, total=False):
    """A measure to reach: `value`, or `low` and `high`."""

    region: str
    """`isthmus`, `junction`, `ampulla`, `whole`, or `tube` for a measure of the whole tube."""
    quantity: str
    """Name of the measure in a model's report."""
    value: float
    """Value to reach; by default the middle of `low` and `high`."""
    low: float
    high: float
    """Upper end of the accepted range; by default the range is 5 % of the value on both sides."""
    source: str
    """Origin of the value."""


class SectionImage(TypedDict, total=False):
    """An image of a section to measure."""

    region: str
    image: bytes | str
    """Bytes of a PNG, TIFF, BMP, JPEG or GeoJSON file, or these in base64."""
    png: bytes | str
    """Former name of `image`."""
    pixel_um: float
    """Side of a pixel, micrometres; by default the one that the file states."""
    tissue: Sequence[int] | Literal["nonzero", "zero"]
    """Pixel values that mean tissue.

    By default all values except 0, if 0 and at most one other value occur.
    """
    threshold: int
    """Least value of tissue, for grey images."""
    quantities: Sequence[str]
    """Quantities that become targets."""
    tolerance: float
    """Accepted range as a fraction of the value on both sides; 0.1 by default."""


# `from` is a keyword, so it cannot be declared in a class.
FitVariable = TypedDict(
    "FitVariable",
    {"parameter": str, "end": Literal["isthmus", "ampulla"], "from": float, "to": float},
    total=False,
)


class FitOptions(TypedDict, total=False):
    """Members of a request for a fit; requires `targets`, `targets_csv` or `images`."""

    preset: str
    """Name of a preset; `pig` by default."""
    spec: Mapping[str, Any]
    """Spec at which the search starts, as a merge patch of the preset."""
    targets: Sequence[FitTarget]
    """Measures to reach."""
    targets_csv: str
    """Targets as CSV with the columns `region`, `quantity`, `value`, `low`, `high`."""
    images: Sequence[SectionImage]
    """Sections to measure as targets."""
    vary: Sequence[FitVariable]
    """Parameters to search; by default those that affect the targets."""
    evaluations: int
    """Maximum number of candidates; 70 by default."""
    seeds: int
    """Number of seeds per candidate, 4 by default; inexpensive measures use four times as many."""
    models: int
    """Number of full models of the result; 4 by default."""
    seed: int
    """First seed of the models, and seed of the search; 0 by default."""
    labels: Labels
    """Names and values of your choice, to find fits by."""
    priority: int
    """-100 to 100; workers claim queued models and fits of higher priority first."""


class Vary(TypedDict, total=False):
    """The design of a study (docs/studies.md of the service)."""

    design: Literal["grid", "zip", "lhs"]
    samples: int
    """Number of points; only with `lhs`."""
    seed: int
    """Seed of the design; only with `lhs`."""
    values: Mapping[str, Sequence[Any] | Mapping[str, Any]]
    """Values of each parameter, by JSON pointer into the spec."""
