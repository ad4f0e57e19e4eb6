"""The asynchronous client, for asyncio."""

from __future__ import annotations

import datetime
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx

from . import _calls, _download, _follow
from ._drive import AsyncDriver, Options
from ._progress import Display
from ._steps import call
from .client import Client
from .sections import Cut, Section, Sections, read_sections
from .types import (
    Applied,
    Batch,
    BatchRef,
    BatchValidation,
    Event,
    Fit,
    FitEvent,
    FitFilter,
    FitOptions,
    FitRef,
    FitValidation,
    Health,
    Json,
    Labels,
    Model,
    ModelFilter,
    ModelOptions,
    ModelRef,
    Operation,
    Preset,
    Table,
    Ticket,
    Validation,
    Vary,
    Worker,
    Workers,
    read_event,
    read_fit_event,
)

if TYPE_CHECKING:
    from typing_extensions import Self, Unpack

    from ._calls import Call, T
    from ._follow import BatchProgress


class AsyncClient(AsyncDriver):
    """`Client` for asyncio: the same methods with the same arguments. Iterators are asynchronous.

    Long computations, such as the check of an archive, run in a thread.
    """

    def __init__(
        self,
        url: str | None = None,
        *,
        key: str | None = None,
        timeout: float = 30.0,
        retries: int = 4,
        outage: float = 120.0,
        http: httpx.AsyncClient | None = None,
    ) -> None:
        super().__init__(Options(url, key, timeout, retries, outage), http)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.aclose()

    def __repr__(self) -> str:
        return f"AsyncClient({self._options.shown!r})"

    async def _call(self, made: Call[T]) -> T:
        return await self._run(call(*made, self._options.retries))

    # Models.

    async def submit(
        self, *, seed: int | None = None, idempotency_key: str | None = None, **options: Unpack[ModelOptions]
    ) -> Model:
        return await self._call(_calls.submit(options, seed, idempotency_key))

    async def validate(self, *, seed: int | None = None, **options: Unpack[ModelOptions]) -> Validation:
        return await self._call(_calls.validate(options, seed))

    async def model(self, model: ModelRef) -> Model:
        return await self._call(_calls.model(model))

    def models(self, *, spec: bool = False, **given: Unpack[ModelFilter]) -> AsyncIterator[Model]:
        return self._iterate(_calls.models(spec, given, self._options.retries))

    async def wait(
        self, model: ModelRef, *, timeout: float | None = None, progress: bool | Callable[[Model], object] = False
    ) -> Model:
        display = Display(progress, _follow.figures)
        return await self._run(_follow.wait_model(model, self._options, timeout, display))

    async def cancel(self, model: ModelRef) -> Model:
        return await self._call(_calls.cancel(model))

    async def delete(self, model: ModelRef) -> None:
        return await self._call(_calls.delete(model))

    async def retry(self, model: ModelRef, *, idempotency_key: str | None = None) -> Model:
        return await self._call(_calls.retry(model, idempotency_key))

    async def cancel_models(self, *, all: bool = False, dry_run: bool = False, **given: Unpack[ModelFilter]) -> Applied:
        return await self._run(_calls.cancel_models(all, dry_run, given, self._options.retries))

    async def delete_models(self, *, all: bool = False, dry_run: bool = False, **given: Unpack[ModelFilter]) -> Applied:
        return await self._run(_calls.delete_models(all, dry_run, given, self._options.retries))

    async def operation(self, id: str) -> Operation:
        return await self._call(_calls.operation(id))

    def operations(self) -> AsyncIterator[Operation]:
        return self._iterate(_calls.operations(self._options.retries))

    async def cancel_operation(self, id: str) -> Operation:
        return await self._call(_calls.cancel_operation(id))

    # Events.

    def events(
        self,
        model: ModelRef | None = None,
        *,
        models: Iterable[ModelRef] | None = None,
        batch: BatchRef | None = None,
        labels: Labels | None = None,
        spec: bool = False,
        last_event_id: str | None = None,
    ) -> AsyncIterator[Event]:
        request = _calls.events(model, models, batch, labels, spec)
        of_one = model is not None
        return self._iterate(_follow.events(request, read_event, self._options, last_event_id, of_one=of_one))

    # Files.

    async def download(self, model: ModelRef, name: str, path: _download.PathLike | None = None) -> Path:
        return await self._run(_download.download(model, name, path, self._options.retries))

    async def download_all(self, model: ModelRef, folder: _download.PathLike) -> list[Path]:
        return await self._run(_download.download_all(model, folder, self._options.retries))

    async def content(self, model: ModelRef, name: str) -> bytes:
        return await self._run(_download.content(model, name, bytes, self._options.retries))

    async def report(self, model: ModelRef) -> Json:
        return await self._call(_calls.report(model))

    async def course(self, model: ModelRef) -> Json:
        return await self._call(_calls.course(model))

    async def way(self, model: ModelRef) -> Json:
        return await self._call(_calls.way(model))

    async def manifest(self, model: ModelRef) -> Json:
        return await self._call(_calls.manifest(model))

    async def report_page(self, model: ModelRef) -> str:
        return await self._call(_calls.report_page(model))

    async def sections(self, model: ModelRef) -> Sections:
        return await self._run(_download.content(model, "sections.bin", read_sections, self._options.retries))

    async def section(self, model: ModelRef, index: int) -> Section:
        return await self._call(_calls.section(model, index))

    async def section_svg(self, model: ModelRef, index: int) -> str:
        return await self._call(_calls.section_svg(model, index))

    async def section_png(self, model: ModelRef, index: int, *, size: int | None = None, labels: bool = False) -> bytes:
        return await self._call(_calls.section_png(model, index, size, labels))

    async def cut(
        self,
        model: ModelRef,
        *,
        z_um: float | None = None,
        origin_um: Iterable[float] | None = None,
        normal: Iterable[float] | None = None,
    ) -> Cut:
        return await self._call(_calls.cut(model, z_um, origin_um, normal))

    async def cut_svg(
        self,
        model: ModelRef,
        *,
        z_um: float | None = None,
        origin_um: Iterable[float] | None = None,
        normal: Iterable[float] | None = None,
    ) -> str:
        return await self._call(_calls.cut_svg(model, z_um, origin_um, normal))

    async def cut_png(
        self,
        model: ModelRef,
        *,
        z_um: float | None = None,
        origin_um: Iterable[float] | None = None,
        normal: Iterable[float] | None = None,
        size: int | None = None,
        labels: bool = False,
    ) -> bytes:
        return await self._call(_calls.cut_png(model, z_um, origin_um, normal, size, labels))

    async def preview(self, model: ModelRef, *, view: str | None = None, size: int | None = None) -> bytes:
        return await self._call(_calls.preview(model, view, size))

    # Batches and studies.

    async def submit_batch(
        self,
        *,
        seeds: Iterable[int] | None = None,
        count: int | None = None,
        idempotency_key: str | None = None,
        **options: Unpack[ModelOptions],
    ) -> Batch:
        return await self._call(_calls.submit_batch(options, seeds, count, None, idempotency_key))

    async def study(
        self,
        *,
        vary: Vary | Mapping[str, Any],
        seeds: Iterable[int] | None = None,
        count: int | None = None,
        idempotency_key: str | None = None,
        **options: Unpack[ModelOptions],
    ) -> Batch:
        return await self._call(_calls.submit_batch(options, seeds, count, vary, idempotency_key))

    async def validate_batch(
        self,
        *,
        vary: Vary | Mapping[str, Any] | None = None,
        seeds: Iterable[int] | None = None,
        count: int | None = None,
        **options: Unpack[ModelOptions],
    ) -> BatchValidation:
        return await self._call(_calls.validate_batch(options, seeds, count, vary))

    async def batch(self, batch: BatchRef) -> Batch:
        return await self._call(_calls.batch(batch))

    def batches(
        self,
        *,
        owner: str | None = None,
        created_after: datetime.datetime | str | None = None,
        created_before: datetime.datetime | str | None = None,
    ) -> AsyncIterator[Batch]:
        return self._iterate(_calls.batches(owner, created_after, created_before, self._options.retries))

    async def wait_batch(
        self,
        batch: BatchRef,
        *,
        timeout: float | None = None,
        progress: bool | Callable[[BatchProgress], object] = False,
    ) -> Batch:
        display = Display(progress, _follow.batch_figures)
        return await self._run(_follow.wait_batch(batch, self._options, timeout, display))

    async def cancel_batch(self, batch: BatchRef) -> Batch:
        return await self._call(_calls.cancel_batch(batch))

    async def delete_batch(self, batch: BatchRef) -> None:
        return await self._call(_calls.delete_batch(batch))

    async def table(self, batch: BatchRef) -> Table:
        return await self._call(_calls.table(batch))

    async def archive(self, batch: BatchRef, path: _download.PathLike, *, files: Sequence[str] | None = None) -> Path:
        return await self._run(_download.archive(batch, path, files, self._options.retries))

    # Fits.

    async def submit_fit(self, *, idempotency_key: str | None = None, **options: Unpack[FitOptions]) -> Fit:
        return await self._call(_calls.submit_fit(options, idempotency_key))

    async def validate_fit(self, **options: Unpack[FitOptions]) -> FitValidation:
        return await self._call(_calls.validate_fit(options))

    async def fit(self, fit: FitRef) -> Fit:
        return await self._call(_calls.fit(fit))

    def fits(self, **given: Unpack[FitFilter]) -> AsyncIterator[Fit]:
        return self._iterate(_calls.fits(given, self._options.retries))

    def fit_events(self, fit: FitRef, *, last_event_id: str | None = None) -> AsyncIterator[FitEvent]:
        request = _calls.fit_events(fit)
        return self._iterate(_follow.events(request, read_fit_event, self._options, last_event_id))

    async def wait_fit(
        self, fit: FitRef, *, timeout: float | None = None, progress: bool | Callable[[Fit], object] = False
    ) -> Fit:
        display = Display(progress, _follow.figures)
        return await self._run(_follow.wait_fit(fit, self._options, timeout, display))

    async def cancel_fit(self, fit: FitRef) -> Fit:
        return await self._call(_calls.cancel_fit(fit))

    async def delete_fit(self, fit: FitRef) -> None:
        return await self._call(_calls.delete_fit(fit))

    # Presets, access and workers.

    async def presets(self) -> tuple[Preset, ...]:
        return await self._call(_calls.presets())

    async def preset(self, name: str) -> Json:
        return await self._call(_calls.preset(name))

    async def schema(self) -> Json:
        return await self._call(_calls.schema())

    async def health(self) -> Health:
        return await self._call(_calls.health())

    async def ticket(self, path: str) -> Ticket:
        return await self._call(_calls.ticket(path, self._options.url))

    async def workers(self) -> Workers:
        return await self._call(_calls.workers())

    async def pause_workers(self) -> Workers:
        return await self._call(_calls.change_workers("pause"))

    async def resume_workers(self) -> Workers:
        return await self._call(_calls.change_workers("resume"))

    async def pause_worker(self, name: str) -> Worker:
        return await self._call(_calls.change_worker(name, "pause"))

    async def resume_worker(self, name: str) -> Worker:
        return await self._call(_calls.change_worker(name, "resume"))

    async def drain_worker(self, name: str) -> Worker:
        return await self._call(_calls.change_worker(name, "drain"))


# Type checkers and editors read the signatures above. Both clients share the docstrings.
for _name, _method in vars(AsyncClient).items():
    if callable(_method) and not _method.__doc__:
        _method.__doc__ = getattr(getattr(Client, _name, None), "__doc__", None)
