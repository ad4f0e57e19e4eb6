"""Builds the requests of the HTTP interface and parses their responses; sends nothing.

A call is a pair: a request, and a function that parses the response. docs/http.md and openapi.yaml
in the repository of the service describe the interface.
"""

from __future__ import annotations

import base64
import datetime
import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar
from urllib.parse import quote

import httpx

from . import types
from ._steps import Emit, Request, Sleep, Steps, call
from .errors import UnexpectedAnswer
from .sections import Cut, Section, cut_of, section_of
from .types import (
    Applied,
    Batch,
    BatchRef,
    BatchValidation,
    Fit,
    FitFilter,
    FitOptions,
    FitRef,
    FitValidation,
    Health,
    Json,
    Model,
    ModelFilter,
    ModelOptions,
    ModelRef,
    Operation,
    Preset,
    Table,
    Ticket,
    Validation,
    Worker,
    Workers,
    read,
    read_model,
)

T = TypeVar("T")
Call = tuple[Request, Callable[[httpx.Response], T]]
Params = tuple[tuple[str, str], ...]
# Number of models, batches or fits on a page of a list.
PAGE = 100
# Seconds between two requests for the state of an operation.
OPERATION_POLL = 1.0


def segment(text: str) -> str:
    """Returns a name as one path segment; raises ValueError if it would lead to another path."""
    if text in ("", ".", ".."):
        raise ValueError(f"not a name: {text!r}")
    return quote(text, safe="")


def key(ref: ModelRef | BatchRef | FitRef) -> str:
    """Returns the id of a model, a batch or a fit as a path segment."""
    return segment(str(ref.id if isinstance(ref, (Model, Batch, Fit)) else ref))


def json(response: httpx.Response) -> Any:
    """Returns the JSON body; raises UnexpectedAnswer if the body is not JSON."""
    try:
        return response.json()
    except ValueError:
        kind = response.headers.get("content-type", "no media type")
        raise UnexpectedAnswer(f"the answer is not JSON but {kind}: is this the address of the service?") from None


def _object(response: httpx.Response) -> Json:
    answer = json(response)
    if not isinstance(answer, dict):
        raise UnexpectedAnswer("the answer is not a JSON object")
    return answer


def _reads(kind: type[T]) -> Callable[[httpx.Response], T]:
    return lambda response: read(kind, json(response))


def _model(response: httpx.Response) -> Model:
    return read_model(json(response), str(response.url))


def _nothing(_: httpx.Response) -> None:
    return None


def _moment(time: datetime.datetime | str) -> str:
    """Returns a time in RFC 3339; a time without a zone is local time."""
    return time if isinstance(time, str) else time.astimezone(datetime.timezone.utc).isoformat()


def _labels(labels: types.Labels | None) -> Params:
    return tuple(("label", f"{name}:{value}") for name, value in (labels or {}).items())


def filter_params(given: Mapping[str, Any], kind: Any = ModelFilter) -> Params:
    """Returns the conditions of a filter as query parameters, without those that are None."""
    _known(given, kind)
    params = [(name, given.get(name)) for name in ("status", "preset", "owner")]
    batch = given.get("batch")
    params.append(("batch", None if batch is None else key(batch)))
    for name in ("created_after", "created_before"):
        time = given.get(name)
        params.append((name, None if time is None else _moment(time)))
    return tuple((name, str(value)) for name, value in params if value is not None) + _labels(given.get("labels"))


def _known(given: Mapping[str, Any], kind: Any) -> None:
    """Checks the names of keyword arguments, which Python does not check for a TypedDict."""
    for name in given:
        if name not in kind.__annotations__:
            raise TypeError(f"unexpected keyword argument {name!r}; there are {', '.join(kind.__annotations__)}")


def _given(members: Mapping[str, Any]) -> Json:
    return {name: value for name, value in members.items() if value is not None}


def _body(options: ModelOptions, **members: Any) -> Json:
    """Returns the body of a request, without members that are None."""
    _known(options, ModelOptions)
    body = _given({**options, **members})
    if "outputs" in body:
        body["outputs"] = [body["outputs"]] if isinstance(body["outputs"], str) else list(body["outputs"])
    if "bodies" in body:
        body["bodies"] = [body["bodies"]] if isinstance(body["bodies"], str) else list(body["bodies"])
    return body


def _post(path: str, body: Json, idempotency_key: str | None) -> Request:
    return Request("POST", path, headers={"idempotency-key": idempotency_key or str(uuid.uuid4())}, body=body)


# Models.


def submit(options: ModelOptions, seed: int | None, idempotency_key: str | None) -> Call[Model]:
    return _post("models", _body(options, seed=seed), idempotency_key), _model


def validate(options: ModelOptions, seed: int | None) -> Call[Validation]:
    return Request("POST", "models/validate", body=_body(options, seed=seed)), _reads(Validation)


def model(ref: ModelRef) -> Call[Model]:
    return Request("GET", f"models/{key(ref)}"), _model


def cancel(ref: ModelRef) -> Call[Model]:
    return Request("POST", f"models/{key(ref)}/cancel"), _model


def delete(ref: ModelRef) -> Call[None]:
    return Request("DELETE", f"models/{key(ref)}"), _nothing


def retry(ref: ModelRef, idempotency_key: str | None) -> Call[Model]:
    headers = {"idempotency-key": idempotency_key or str(uuid.uuid4())}
    return Request("POST", f"models/{key(ref)}/retry", headers=headers), _model


def _bulk(method: str, path: str, every: bool, dry_run: bool, given: ModelFilter, retries: int) -> Steps[Applied]:
    """Waits for the end of the operation if there is one, for more than 1,000 models."""
    flags = [(name, "true") for name, is_set in (("all", every), ("dry_run", dry_run)) if is_set]
    request = Request(method, path, params=(*filter_params(given), *flags))
    answer = yield from call(request, _object, retries)
    while "progress" in answer:
        found = read(Operation, answer)
        if found.finished_at is not None:
            return Applied(count=found.progress.changed)
        yield Sleep(OPERATION_POLL)
        answer = yield from call(Request("GET", f"operations/{segment(found.id)}"), _object, retries)
    return read(Applied, answer)


def cancel_models(every: bool, dry_run: bool, given: ModelFilter, retries: int) -> Steps[Applied]:
    return _bulk("POST", "models/cancel", every, dry_run, given, retries)


def delete_models(every: bool, dry_run: bool, given: ModelFilter, retries: int) -> Steps[Applied]:
    return _bulk("DELETE", "models", every, dry_run, given, retries)


def operation(id: str) -> Call[Operation]:
    return Request("GET", f"operations/{segment(id)}"), _reads(Operation)


def cancel_operation(id: str) -> Call[Operation]:
    return Request("POST", f"operations/{segment(id)}/cancel"), _reads(Operation)


def operations(retries: int) -> Steps[None]:
    return pages("operations", (), lambda item, _: read(Operation, item), retries)


def pages(path: str, params: Params, reads: Callable[[Any, str], Any], retries: int) -> Steps[None]:
    """Emits the items of all pages of a list."""
    cursor: str | None = None
    while True:
        at = (("cursor", cursor),) if cursor else ()
        request = Request("GET", path, params=(*params, ("limit", str(PAGE)), *at))
        url, page = yield from call(request, lambda response: (str(response.url), _object(response)), retries)
        for item in page.get(path, ()):
            yield Emit(reads(item, url))
        cursor = page.get("next")
        if not cursor:
            return


def models(spec: bool, given: ModelFilter, retries: int) -> Steps[None]:
    view = ("view", "full" if spec else "summary")
    return pages("models", (*filter_params(given), view), read_model, retries)


# Events.


def events(
    model: ModelRef | None = None,
    models: Iterable[ModelRef] | None = None,
    batch: BatchRef | None = None,
    labels: types.Labels | None = None,
    spec: bool = False,
) -> Request:
    view = (("view", "full"),) if spec else ()
    if model is not None:
        if models is not None or batch is not None or labels:
            raise TypeError("events of one model take no other conditions")
        return Request("GET", f"models/{key(model)}/events", params=view)
    ids = () if models is None else (("ids", ",".join(key(ref) for ref in models)),)
    of = () if batch is None else (("batch", key(batch)),)
    return Request("GET", "events", params=(*ids, *of, *_labels(labels), *view))


# Files.


def file(ref: ModelRef, name: str) -> Request:
    return Request("GET", f"models/{key(ref)}/files/{segment(name)}", headers={"accept-encoding": "identity"})


def report(ref: ModelRef) -> Call[Json]:
    return Request("GET", f"models/{key(ref)}/report"), _object


def report_page(ref: ModelRef) -> Call[str]:
    return Request("GET", f"models/{key(ref)}/report.html"), lambda response: response.text


def course(ref: ModelRef) -> Call[Json]:
    return Request("GET", f"models/{key(ref)}/course"), _object


def way(ref: ModelRef) -> Call[Json]:
    return Request("GET", f"models/{key(ref)}/way"), _object


def manifest(ref: ModelRef) -> Call[Json]:
    return Request("GET", f"models/{key(ref)}/manifest.json"), _object


def section(ref: ModelRef, index: int) -> Call[Section]:
    request = Request("GET", f"models/{key(ref)}/sections/{index}", headers={"accept": "application/json"})
    return request, lambda response: section_of(json(response))


def section_svg(ref: ModelRef, index: int) -> Call[str]:
    request = Request("GET", f"models/{key(ref)}/sections/{index}", headers={"accept": "image/svg+xml"})
    return request, lambda response: response.text


def section_png(ref: ModelRef, index: int, size: int | None, labels: bool) -> Call[bytes]:
    request = Request("GET", f"models/{key(ref)}/sections/{index}", params=_picture(size, labels))
    return request, lambda response: response.content


def _picture(size: int | None, labels: bool) -> Params:
    params = [("format", "png")]
    if labels:
        params.append(("labels", "true"))
    if size is not None:
        params.append(("size", str(size)))
    return tuple(params)


def _plane(z_um: float | None, origin_um: Iterable[float] | None, normal: Iterable[float] | None) -> Params:
    params = [] if z_um is None else [("z_um", repr(float(z_um)))]
    vectors = (("origin_um", origin_um), ("normal", normal))
    params += [(name, ",".join(repr(float(x)) for x in vector)) for name, vector in vectors if vector is not None]
    return tuple(params)


def _cut(ref: ModelRef, plane: Params, params: Params = (), accept: str = "application/json") -> Request:
    return Request("GET", f"models/{key(ref)}/cut", params=(*plane, *params), headers={"accept": accept})


def cut(
    ref: ModelRef, z_um: float | None, origin_um: Iterable[float] | None, normal: Iterable[float] | None
) -> Call[Cut]:
    return _cut(ref, _plane(z_um, origin_um, normal)), lambda response: cut_of(json(response))


def cut_svg(
    ref: ModelRef, z_um: float | None, origin_um: Iterable[float] | None, normal: Iterable[float] | None
) -> Call[str]:
    return _cut(ref, _plane(z_um, origin_um, normal), accept="image/svg+xml"), lambda response: response.text


def cut_png(
    ref: ModelRef,
    z_um: float | None,
    origin_um: Iterable[float] | None,
    normal: Iterable[float] | None,
    size: int | None,
    labels: bool,
) -> Call[bytes]:
    request = _cut(ref, _plane(z_um, origin_um, normal), _picture(size, labels), "image/png")
    return request, lambda response: response.content


def preview(ref: ModelRef, view: str | None, size: int | None) -> Call[bytes]:
    params = tuple((name, str(value)) for name, value in (("view", view), ("size", size)) if value is not None)
    return Request("GET", f"models/{key(ref)}/preview.png", params=params), lambda response: response.content


# Batches.


def _batch_body(
    options: ModelOptions, seeds: Iterable[int] | None, count: int | None, vary: Mapping[str, Any] | None
) -> Json:
    return _body(options, seeds=None if seeds is None else list(seeds), count=count, vary=vary)


def submit_batch(
    options: ModelOptions,
    seeds: Iterable[int] | None,
    count: int | None,
    vary: Mapping[str, Any] | None,
    idempotency_key: str | None,
) -> Call[Batch]:
    return _post("batches", _batch_body(options, seeds, count, vary), idempotency_key), _reads(Batch)


def validate_batch(
    options: ModelOptions, seeds: Iterable[int] | None, count: int | None, vary: Mapping[str, Any] | None
) -> Call[BatchValidation]:
    body = _batch_body(options, seeds, count, vary)
    return Request("POST", "batches/validate", body=body), _reads(BatchValidation)


def batch(ref: BatchRef) -> Call[Batch]:
    return Request("GET", f"batches/{key(ref)}"), _reads(Batch)


def cancel_batch(ref: BatchRef) -> Call[Batch]:
    return Request("POST", f"batches/{key(ref)}/cancel"), _reads(Batch)


def delete_batch(ref: BatchRef) -> Call[None]:
    return Request("DELETE", f"batches/{key(ref)}"), _nothing


def batches(
    owner: str | None,
    created_after: datetime.datetime | str | None,
    created_before: datetime.datetime | str | None,
    retries: int,
) -> Steps[None]:
    params = [] if owner is None else [("owner", owner)]
    times = (("created_after", created_after), ("created_before", created_before))
    params += [(name, _moment(time)) for name, time in times if time is not None]
    return pages("batches", tuple(params), lambda item, _: read(Batch, item), retries)


def table(ref: BatchRef) -> Call[Table]:
    def parse(response: httpx.Response) -> Table:
        answer = _object(response)
        return Table(tuple(answer.get("columns", ())), tuple(tuple(row) for row in answer.get("rows", ())))

    return Request("GET", f"batches/{key(ref)}/table", headers={"accept": "application/json"}), parse


def archive(ref: BatchRef, files: Sequence[str] | None, form: str) -> Request:
    names = () if files is None else (("files", ",".join([files] if isinstance(files, str) else files)),)
    return Request("GET", f"batches/{key(ref)}/archive", params=(*names, ("format", form)))


# Fits.


def _image(image: types.SectionImage) -> Json:
    encoded = {name: base64.b64encode(value).decode() for name, value in image.items() if isinstance(value, bytes)}
    return {**image, **encoded}


def _fit_body(options: FitOptions) -> Json:
    _known(options, FitOptions)
    body = _given(options)
    if "images" in body:
        body["images"] = [_image(image) for image in body["images"]]
    return body


def submit_fit(options: FitOptions, idempotency_key: str | None) -> Call[Fit]:
    return _post("fits", _fit_body(options), idempotency_key), _reads(Fit)


def validate_fit(options: FitOptions) -> Call[FitValidation]:
    return Request("POST", "fits/validate", body=_fit_body(options)), _reads(FitValidation)


def fit(ref: FitRef) -> Call[Fit]:
    return Request("GET", f"fits/{key(ref)}"), _reads(Fit)


def cancel_fit(ref: FitRef) -> Call[Fit]:
    return Request("POST", f"fits/{key(ref)}/cancel"), _reads(Fit)


def delete_fit(ref: FitRef) -> Call[None]:
    return Request("DELETE", f"fits/{key(ref)}"), _nothing


def fits(given: FitFilter, retries: int) -> Steps[None]:
    return pages("fits", filter_params(given, FitFilter), lambda item, _: read(Fit, item), retries)


def fit_events(ref: FitRef) -> Request:
    return Request("GET", f"fits/{key(ref)}/events")


# Presets, access and workers.


def presets() -> Call[tuple[Preset, ...]]:
    def parse(response: httpx.Response) -> tuple[Preset, ...]:
        return tuple(read(Preset, item) for item in _object(response).get("presets", ()))

    return Request("GET", "presets"), parse


def preset(name: str) -> Call[Json]:
    return Request("GET", f"presets/{segment(name)}"), _object


def schema() -> Call[Json]:
    return Request("GET", "schema"), _object


def health() -> Call[Health]:
    return Request("GET", "healthz"), _reads(Health)


def ticket(path: str, url: Callable[[str], str]) -> Call[Ticket]:
    def parse(response: httpx.Response) -> Ticket:
        answer = _object(response)
        full = f"{url(path.lstrip('/'))}?ticket={quote(str(answer.get('ticket', '')), safe='')}"
        return read(Ticket, {**answer, "url": full})

    return Request("POST", "tickets", body={"path": path}), parse


def workers() -> Call[Workers]:
    return Request("GET", "workers"), _reads(Workers)


def change_workers(verb: str) -> Call[Workers]:
    return Request("POST", f"workers/{verb}"), _reads(Workers)


def change_worker(name: str, verb: str) -> Call[Worker]:
    return Request("POST", f"workers/{segment(name)}/{verb}"), _reads(Worker)
