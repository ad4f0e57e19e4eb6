"""The synchronous client."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx

from . import _calls, _download, _follow
from ._drive import Driver, Options
from ._progress import Display
from ._steps import call
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


class Client(Driver):
    """A client of one service, for any number of threads; also a context manager.

    Arguments for models, batches and fits are records or ids. Requests are retried after lost
    connections and after 429, 502, 503 and 504, as `Retry-After` says; no retry has an effect
    twice. Methods raise subclasses of `OviductError`: `Problem` for a response with an error
    status, `ConnectionFailed` if there is no response.
    """

    def __init__(
        self,
        url: str | None = None,
        *,
        key: str | None = None,
        timeout: float = 30.0,
        retries: int = 4,
        outage: float = 120.0,
        http: httpx.Client | None = None,
    ) -> None:
        """Creates a client without sending a request.

        Args:
            url: Address of the service, including the path under which a proxy serves it. By
                default the value of the variable `OVIDUCT_URL`, or `http://127.0.0.1:8080`.
            key: Secret of an API key; by default the value of the variable `OVIDUCT_KEY`. An empty
                string means no API key.
            timeout: Seconds without a byte after which a connection counts as lost.
            retries: Maximum number of retries of a request.
            outage: Seconds without contact after which waits and event streams give up.
            http: An httpx client to use, for example with a proxy or certificates. The client is
                not closed.
        """
        super().__init__(Options(url, key, timeout, retries, outage), http)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Client({self._options.shown!r})"

    def _call(self, made: Call[T]) -> T:
        return self._run(call(*made, self._options.retries))

    # Models.

    def submit(
        self, *, seed: int | None = None, idempotency_key: str | None = None, **options: Unpack[ModelOptions]
    ) -> Model:
        """Requests a model; returns its current state. `wait` waits for it.

        If a model of the same spec and seed exists or is being grown, the new model shares its
        files, unless `reuse` is False.

        Args:
            seed: 0 to 2^53 - 1; the same spec and seed give the same model. By default the service
                draws a seed.
            idempotency_key: The same key with the same request gives the same model; random by default.
            preset: Name of a preset; `pig` by default.
            spec: Changes of the preset, as a merge patch: `{"collision": {"gap_um": 30}}`.
            outputs: `glb` and `lod` (the default), `gltf`, `obj`, `stl`, `stl-ascii`, `ply`, `vtp`,
                `3mf`, `centreline`, `labels`.
            bodies: The surfaces in these files: `tissue` (the default), `lumen`, `regions` (both,
                with one shared wall).
            units: `m`, `mm` or `um`; by default metres in OBJ and glTF, millimetres in other
                formats.
            labels: Names and values of your choice, to find models by.
            backend: `auto` (the default), `gpu`, `cpu` or `cpu-single`.
            priority: -100 to 100; workers claim queued models of higher priority first.
            reuse: True (the default) if the files of another model of the same spec and seed may be
                used.

        Raises:
            InvalidRequest: The request has faults; `errors` lists each with its JSON pointer.
            CostLimit: The predicted cost exceeds a limit of the service.
            QuotaExceeded, QueueFull: There are too many models.
        """
        return self._call(_calls.submit(options, seed, idempotency_key))

    def validate(self, *, seed: int | None = None, **options: Unpack[ModelOptions]) -> Validation:
        """Validates a request of `submit` and predicts its cost; raises what `submit` raises."""
        return self._call(_calls.validate(options, seed))

    def model(self, model: ModelRef) -> Model:
        """Returns the current state of a model with its spec. Raises NotFound if there is none."""
        return self._call(_calls.model(model))

    def models(self, *, spec: bool = False, **given: Unpack[ModelFilter]) -> Iterator[Model]:
        """Iterates over models, newest first; reads a page at a time.

        Args:
            spec: True to include the specs, which are most of the bytes.
            status, preset, owner, batch: Only models with these values.
            labels: Only models with all of these labels.
            created_after, created_before: Only models accepted in this time, each a `datetime` or
                RFC 3339. The end is excluded.
        """
        return self._iterate(_calls.models(spec, given, self._options.retries))

    def wait(
        self, model: ModelRef, *, timeout: float | None = None, progress: bool | Callable[[Model], object] = False
    ) -> Model:
        """Waits until a model has succeeded. Survives restarts of the service.

        Args:
            timeout: Seconds to wait. Checked whenever bytes arrive, at least every 15 seconds.
            progress: True for a progress bar, or a function that is called with each state.

        Raises:
            ModelFailed, ModelCancelled, ModelDeleted: The model will not succeed.
            WaitTimeout: The model has not ended in time; the service keeps running it.
            ConnectionFailed: There was no contact for `outage` seconds.
        """
        display = Display(progress, _follow.figures)
        return self._run(_follow.wait_model(model, self._options, timeout, display))

    def cancel(self, model: ModelRef) -> Model:
        """Cancels a model. A model that has ended does not change."""
        return self._call(_calls.cancel(model))

    def delete(self, model: ModelRef) -> None:
        """Deletes a model and its files; cancels the model if it has not ended."""
        return self._call(_calls.delete(model))

    def retry(self, model: ModelRef, *, idempotency_key: str | None = None) -> Model:
        """Requests a failed model again, as a new one. Raises Conflict if it has not failed."""
        return self._call(_calls.retry(model, idempotency_key))

    def cancel_models(self, *, all: bool = False, dry_run: bool = False, **given: Unpack[ModelFilter]) -> Applied:
        """Cancels all models that match the conditions, which are those of `models`.

        The service changes many models in the background, as an operation. This method waits for
        its end; `operations` has its progress.

        Args:
            all: Must be True if there are no conditions.
            dry_run: True to only count the models.
        """
        return self._run(_calls.cancel_models(all, dry_run, given, self._options.retries))

    def delete_models(self, *, all: bool = False, dry_run: bool = False, **given: Unpack[ModelFilter]) -> Applied:
        """Deletes all matching models and their files; takes the arguments of `cancel_models`."""
        return self._run(_calls.delete_models(all, dry_run, given, self._options.retries))

    def operation(self, id: str) -> Operation:
        """Returns an operation on many models. The service keeps it for a week after its end."""
        return self._call(_calls.operation(id))

    def operations(self) -> Iterator[Operation]:
        """Iterates over operations on many models, newest first."""
        return self._iterate(_calls.operations(self._options.retries))

    def cancel_operation(self, id: str) -> Operation:
        """Cancels an operation on many models; models that it has changed stay so."""
        return self._call(_calls.cancel_operation(id))

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
    ) -> Iterator[Event]:
        """Iterates over events of one model, or of all models that match every condition.

        Each event contains the whole state of a model. With `model`, `models` or `batch`, the
        stream ends when these models have ended; otherwise it never ends. The stream opens when the
        first event is requested. It resumes after lost connections. After a restart of the service,
        states may be repeated.

        Args:
            models: At most 100 models.
            spec: True to include the specs.
            last_event_id: `id` of an event of an earlier stream with the same arguments; resumes
                after that event.
        """
        request = _calls.events(model, models, batch, labels, spec)
        of_one = model is not None
        return self._iterate(_follow.events(request, read_event, self._options, last_event_id, of_one=of_one))

    # Files.

    def download(self, model: ModelRef, name: str, path: _download.PathLike | None = None) -> Path:
        """Saves a file of a model, such as `model.glb`; returns its path.

        The file appears under its name only when it is complete and has the size and SHA-256 that
        the service states. A broken transfer resumes.

        Args:
            path: A file or an existing folder; by default the current folder.

        Raises:
            NotFound: There is no such model or file. A model has files only after it has succeeded.
            CheckFailed: The received bytes are not the file, or the name could lead out of the
                folder.
        """
        return self._run(_download.download(model, name, path, self._options.retries))

    def download_all(self, model: ModelRef, folder: _download.PathLike) -> list[Path]:
        """Saves all files of a model in a folder, created if necessary; returns their paths.

        Raises what `download` raises. If any name could lead out of the folder, nothing is saved.
        """
        return self._run(_download.download_all(model, folder, self._options.retries))

    def content(self, model: ModelRef, name: str) -> bytes:
        """Returns the bytes of a model's file, checked as by `download`."""
        return self._run(_download.content(model, name, bytes, self._options.retries))

    def report(self, model: ModelRef) -> Json:
        """Returns the report: `certificate`, `morphometry`, `comparison`, `summary`, `spec`, …"""
        return self._call(_calls.report(model))

    def course(self, model: ModelRef) -> Json:
        """Returns the centre line of a model: points with local frames, in millimetres.

        A point (x, y) of the cross section at `s_mm` lies at `position_mm` + x·`u` + y·`v` in the
        files of the model.
        """
        return self._call(_calls.course(model))

    def way(self, model: ModelRef) -> Json:
        """Read a way through the lumen that touches nothing, such as for a camera.

        `points` have `s_mm`, `position_mm`, `tangent` and `clearance_um`; every point of the
        straight lines between them keeps `clearance_um` from the surface.

        Raises:
            NotFound: No way was found (`way-not-found`), or the model has no surface
                (`file-not-found`).
        """
        return self._call(_calls.way(model))

    def manifest(self, model: ModelRef) -> Json:
        """Returns the manifest: bodies, units, patches, hashes, origin, licence and citation."""
        return self._call(_calls.manifest(model))

    def report_page(self, model: ModelRef) -> str:
        """Returns the report as a page to view or print: HTML that needs no other file."""
        return self._call(_calls.report_page(model))

    def sections(self, model: ModelRef) -> Sections:
        """Returns all cross sections of a model as numpy arrays, from its `sections.bin`."""
        return self._run(_download.content(model, "sections.bin", read_sections, self._options.retries))

    def section(self, model: ModelRef, index: int) -> Section:
        """Returns a cross section; 0 is the isthmus end. Raises NotFound if there is none."""
        return self._call(_calls.section(model, index))

    def section_svg(self, model: ModelRef, index: int) -> str:
        """Returns a cross section of a model as an SVG picture."""
        return self._call(_calls.section_svg(model, index))

    def section_png(self, model: ModelRef, index: int, *, size: int | None = None, labels: bool = False) -> bytes:
        """Returns a section as PNG: stained with haematoxylin and eosin, or as tissue labels.

        Args:
            size: Longer side in pixels, 32 to 2048; 1024 by default.
            labels: True for the tissue label of each pixel as a grey value: 0 outside, 1 lumen, 2
                epithelium, 3 lamina propria, 4 circular muscle, 5 longitudinal muscle, 6 serosa,
                7 subserosa, 8 inner longitudinal muscle, 9 vessel.
        """
        return self._call(_calls.section_png(model, index, size, labels))

    def cut(
        self,
        model: ModelRef,
        *,
        z_um: float | None = None,
        origin_um: Iterable[float] | None = None,
        normal: Iterable[float] | None = None,
    ) -> Cut:
        """Cuts the surface of a model with a plane; returns rings of points.

        Sections come from the simulation; cuts come from the surface. If the surface leans, cuts
        show islands.

        Args:
            z_um: Position along the tube of a plane across it, micrometres; u is x, v is y.
            origin_um: Instead of `z_um`, a point of any plane: x, y, z in micrometres. Requires
                `normal`.
            normal: Normal of the plane, of any length.

        Raises:
            NotFound: The plane does not intersect the model (`cut-not-found`), or the model has no
                surface that can be cut (`file-not-found`).
        """
        return self._call(_calls.cut(model, z_um, origin_um, normal))

    def cut_svg(
        self,
        model: ModelRef,
        *,
        z_um: float | None = None,
        origin_um: Iterable[float] | None = None,
        normal: Iterable[float] | None = None,
    ) -> str:
        """Returns a cut, as by `cut`, as an SVG picture."""
        return self._call(_calls.cut_svg(model, z_um, origin_um, normal))

    def cut_png(
        self,
        model: ModelRef,
        *,
        z_um: float | None = None,
        origin_um: Iterable[float] | None = None,
        normal: Iterable[float] | None = None,
        size: int | None = None,
        labels: bool = False,
    ) -> bytes:
        """Returns a cut as PNG: stained with haematoxylin and eosin, or as tissue labels.

        Args:
            size: Longer side in pixels, 32 to 2048; 1024 by default.
            labels: True for the tissue label of each pixel as a grey value, as by `section_png`.
        """
        return self._call(_calls.cut_png(model, z_um, origin_um, normal, size, labels))

    def preview(self, model: ModelRef, *, view: str | None = None, size: int | None = None) -> bytes:
        """Returns a picture of a model as PNG.

        Args:
            view: `opened` (cut open, the default), `whole`, `isthmus` or `ampulla`.
            size: Longest side in pixels, 32 to 2048; 1024 by default.
        """
        return self._call(_calls.preview(model, view, size))

    # Batches and studies.

    def submit_batch(
        self,
        *,
        seeds: Iterable[int] | None = None,
        count: int | None = None,
        idempotency_key: str | None = None,
        **options: Unpack[ModelOptions],
    ) -> Batch:
        """Requests several models of one spec; the service accepts all or none.

        Args:
            seeds: Seeds, one for each model.
            count: Instead of `seeds`, the number of models, with seeds that the service draws.

        The other arguments are those of `submit`.
        """
        return self._call(_calls.submit_batch(options, seeds, count, None, idempotency_key))

    def study(
        self,
        *,
        vary: Vary | Mapping[str, Any],
        seeds: Iterable[int] | None = None,
        count: int | None = None,
        idempotency_key: str | None = None,
        **options: Unpack[ModelOptions],
    ) -> Batch:
        """Requests a model for each point of a design; the service accepts all or none.

        Args:
            vary: The design and the values of each parameter: `{"design": "lhs", "samples": 50,
                "values": {"/collision/gap_um": {"from": 25, "to": 50}}}`. docs/studies.md of the
                service describes all options.
            seeds: Seeds with which each point is grown. By default all points have one seed, which
                the service draws.
            count: Instead of `seeds`, the number of seeds per point, which the service draws.

        The other arguments are those of `submit`.
        """
        return self._call(_calls.submit_batch(options, seeds, count, vary, idempotency_key))

    def validate_batch(
        self,
        *,
        vary: Vary | Mapping[str, Any] | None = None,
        seeds: Iterable[int] | None = None,
        count: int | None = None,
        **options: Unpack[ModelOptions],
    ) -> BatchValidation:
        """Validates a `submit_batch` or `study` and predicts its cost; raises what these raise."""
        return self._call(_calls.validate_batch(options, seeds, count, vary))

    def batch(self, batch: BatchRef) -> Batch:
        """Returns the current state of a batch. Raises NotFound if there is no such batch."""
        return self._call(_calls.batch(batch))

    def batches(
        self,
        *,
        owner: str | None = None,
        created_after: datetime.datetime | str | None = None,
        created_before: datetime.datetime | str | None = None,
    ) -> Iterator[Batch]:
        """Iterates over batches, newest first, without model ids; conditions as in `models`."""
        return self._iterate(_calls.batches(owner, created_after, created_before, self._options.retries))

    def wait_batch(
        self,
        batch: BatchRef,
        *,
        timeout: float | None = None,
        progress: bool | Callable[[BatchProgress], object] = False,
    ) -> Batch:
        """Waits until all models of a batch have ended; its `counts` tell how many succeeded.

        Arguments and errors are those of `wait`.
        """
        display = Display(progress, _follow.batch_figures)
        return self._run(_follow.wait_batch(batch, self._options, timeout, display))

    def cancel_batch(self, batch: BatchRef) -> Batch:
        """Cancels all models of a batch. Models that have ended do not change."""
        return self._call(_calls.cancel_batch(batch))

    def delete_batch(self, batch: BatchRef) -> None:
        """Deletes a batch with its models and their files."""
        return self._call(_calls.delete_batch(batch))

    def table(self, batch: BatchRef) -> Table:
        """Returns the models of a batch as a table: varied values, seed, status and measures."""
        return self._call(_calls.table(batch))

    def archive(self, batch: BatchRef, path: _download.PathLike, *, files: Sequence[str] | None = None) -> Path:
        """Saves files of all models of a batch as one archive.

        The archive is a tar file if the path ends in `.tar`, otherwise a zip file.

        The files are compared with the archive's `manifest.json`. A broken transfer starts again
        from the beginning.

        Args:
            files: File names per model, such as `["report.json", "model.glb"]`; all files by
                default.

        Raises:
            CheckFailed: The archive is damaged.
        """
        return self._run(_download.archive(batch, path, files, self._options.retries))

    # Fits.

    def submit_fit(self, *, idempotency_key: str | None = None, **options: Unpack[FitOptions]) -> Fit:
        """Requests a fit: a search for parameters whose models have given measures.

        `wait_fit` waits for the fit.

        Args:
            idempotency_key: The same key with the same request gives the same fit; random by default.
            targets: Measures to reach: `[{"region": "ampulla", "quantity": "folds_on_ring",
                "value": 30}]`. `low` and `high` state the accepted range if it is not 5 % on both
                sides. Regions are `isthmus`, `junction`, `ampulla`, `whole` and `tube`.
            targets_csv: Targets as CSV with the columns `region`, `quantity`, `value`, `low`,
                `high`.
            images: Sections to measure as targets: `[{"region": "isthmus", "image": bytes,
                "pixel_um": 2}]`.
            vary: Parameters to search: `[{"parameter": "/collision/gap_um", "from": 20, "to":
                60}]`. By default the parameters that affect the targets.
            preset: Name of a preset; `pig` by default.
            spec: Spec at which the search starts, as a merge patch of the preset.
            evaluations: Maximum number of candidates; 70 by default.
            seeds: Number of seeds per candidate, 4 by default; inexpensive measures use four times
                as many.
            models: Number of full models of the result; 4 by default.
            seed: First seed of the models, and seed of the search; 0 by default.
            labels: Names and values of your choice, to find fits by.
            priority: -100 to 100; workers claim queued fits of higher priority first.

        docs/fitting.md of the service describes targets and results. Raises what `submit` raises.
        """
        return self._call(_calls.submit_fit(options, idempotency_key))

    def validate_fit(self, **options: Unpack[FitOptions]) -> FitValidation:
        """Validates a request of `submit_fit`; raises what `submit_fit` raises.

        `request` of the result contains the targets measured in images and the parameters to vary.
        """
        return self._call(_calls.validate_fit(options))

    def fit(self, fit: FitRef) -> Fit:
        """Returns the current state of a fit. Raises NotFound if there is none."""
        return self._call(_calls.fit(fit))

    def fits(self, **given: Unpack[FitFilter]) -> Iterator[Fit]:
        """Iterates over fits, newest first, without their results; conditions as in `models`."""
        return self._iterate(_calls.fits(given, self._options.retries))

    def fit_events(self, fit: FitRef, *, last_event_id: str | None = None) -> Iterator[FitEvent]:
        """Iterates over events of a fit, each with its whole state except the request.

        The stream ends with the fit.

        Args:
            last_event_id: `id` of an event of an earlier stream of the fit; resumes after that
                event.
        """
        request = _calls.fit_events(fit)
        return self._iterate(_follow.events(request, read_fit_event, self._options, last_event_id))

    def wait_fit(
        self, fit: FitRef, *, timeout: float | None = None, progress: bool | Callable[[Fit], object] = False
    ) -> Fit:
        """Waits until a fit has succeeded. Survives restarts of the service.

        Arguments and errors are those of `wait`, with FitFailed, FitCancelled and FitDeleted if the
        fit will not succeed.
        """
        display = Display(progress, _follow.figures)
        return self._run(_follow.wait_fit(fit, self._options, timeout, display))

    def cancel_fit(self, fit: FitRef) -> Fit:
        """Cancels a fit. A fit that has ended does not change."""
        return self._call(_calls.cancel_fit(fit))

    def delete_fit(self, fit: FitRef) -> None:
        """Deletes a fit; cancels it if it has not ended."""
        return self._call(_calls.delete_fit(fit))

    # Presets, access and workers.

    def presets(self) -> tuple[Preset, ...]:
        """Returns the presets, the default first."""
        return self._call(_calls.presets())

    def preset(self, name: str) -> Json:
        """Returns a preset with units and sources. Raises NotFound if there is none."""
        return self._call(_calls.preset(name))

    def schema(self) -> Json:
        """Returns the JSON Schema of a spec: titles, units, bounds, defaults."""
        return self._call(_calls.schema())

    def health(self) -> Health:
        """Returns the state and version of the service; needs no API key."""
        return self._call(_calls.health())

    def ticket(self, path: str) -> Ticket:
        """Creates a ticket for one GET of a path, such as `/models/ID/events`, without a key."""
        return self._call(_calls.ticket(path, self._options.url))

    def workers(self) -> Workers:
        """Returns the workers that sent a heartbeat within the last minutes."""
        return self._call(_calls.workers())

    def pause_workers(self) -> Workers:
        """Pauses all workers, including future ones; running models continue. Scope: `admin`."""
        return self._call(_calls.change_workers("pause"))

    def resume_workers(self) -> Workers:
        """Ends the pause of all workers; individually paused workers stay paused."""
        return self._call(_calls.change_workers("resume"))

    def pause_worker(self, name: str) -> Worker:
        """Pauses a worker: it starts no models, and its running models continue."""
        return self._call(_calls.change_worker(name, "pause"))

    def resume_worker(self, name: str) -> Worker:
        """Resumes a worker that was paused or drained."""
        return self._call(_calls.change_worker(name, "resume"))

    def drain_worker(self, name: str) -> Worker:
        """Drains a worker: it starts no models, and is `drained` after its running models ended."""
        return self._call(_calls.change_worker(name, "drain"))
