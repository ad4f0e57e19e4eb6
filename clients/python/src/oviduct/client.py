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
    """A client of a service. It may be used by several threads, and as a context manager.

    Models, batches and fits are given as records or by their ids. Requests are repeated after lost connections and
    after 429, 502, 503 and 504, as `Retry-After` says; none is done twice. Methods raise subclasses of `OviductError`:
    `Problem` for an answer with an error status, `ConnectionFailed` without an answer.
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
        """Makes a client; nothing is sent yet.

        Args:
            url: Address of the service, with the path under which a proxy serves it, if any; by default that in the
                variable `OVIDUCT_URL`, or else `http://127.0.0.1:8080`.
            key: Secret of a key; by default that in the variable `OVIDUCT_KEY`. An empty one means no key.
            timeout: Seconds without a byte after which a connection counts as lost.
            retries: How often a request is repeated.
            outage: Seconds without contact after which waits and event streams are given up.
            http: An httpx client to use, such as one with a proxy or with certificates. It is not closed.
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
        """Requests a model, and returns its present state; `wait` waits for it.

        A model of the same spec and seed is reused, at once or when it ends, unless `reuse` is False.

        Args:
            seed: 0 to 2^53 - 1; the same spec and seed give the same model. By default the service draws one.
            idempotency_key: The same key with the same request returns the same model; by default a new one is made.
            preset: Name of a preset; `pig` by default.
            spec: Changes of the preset, as a merge patch: `{"collision": {"gap_um": 30}}`.
            outputs: `glb` and `lod` (the default), `gltf`, `obj`, `stl`, `stl-ascii`, `ply`, `vtp`, `centreline`,
                `labels`.
            bodies: The surfaces in these files: `tissue` (the default), `lumen`, `regions` (both, their wall once).
            units: `m`, `mm` or `um`; by default metres in OBJ and glTF, millimetres in the others.
            labels: Names and values of your own, to find models by.
            backend: `auto` (the default), `gpu`, `cpu` or `cpu-single`.
            priority: -100 to 100.
            reuse: Whether another model may be reused; True by default.

        Raises:
            InvalidRequest: `errors` has each fault, with its JSON pointer.
            CostLimit: The predicted cost exceeds a limit of the service.
            QuotaExceeded, QueueFull: There are too many models.
        """
        return self._call(_calls.submit(options, seed, idempotency_key))

    def validate(self, *, seed: int | None = None, **options: Unpack[ModelOptions]) -> Validation:
        """Checks what `submit` would request, and predicts its cost; raises what it would raise."""
        return self._call(_calls.validate(options, seed))

    def model(self, model: ModelRef) -> Model:
        """The present state of a model, with its spec. Raises NotFound if there is none."""
        return self._call(_calls.model(model))

    def models(self, *, spec: bool = False, **given: Unpack[ModelFilter]) -> Iterator[Model]:
        """Models, newest first, read page by page as they are taken.

        Args:
            spec: Whether they come with their specs, which are most of the bytes.
            status, preset, owner, batch: Only models with these.
            labels: Only models with all of these labels.
            created_after, created_before: Only models accepted in this time, a `datetime` or RFC 3339; the end is not
                included.
        """
        return self._iterate(_calls.models(spec, given, self._options.retries))

    def wait(
        self, model: ModelRef, *, timeout: float | None = None, progress: bool | Callable[[Model], object] = False
    ) -> Model:
        """Waits until a model has succeeded, also through restarts of the service.

        Args:
            timeout: Seconds to wait; checked when something is received, which is at least every 15 seconds.
            progress: Whether to show a progress bar, or a function that gets each state.

        Raises:
            ModelFailed, ModelCancelled, ModelDeleted: It will not succeed.
            WaitTimeout: It has not ended in time.
            ConnectionFailed: There was no contact for `outage` seconds.
        """
        display = Display(progress, _follow.figures)
        return self._run(_follow.wait_model(model, self._options, timeout, display))

    def cancel(self, model: ModelRef) -> Model:
        """Cancels a model; one that has ended does not change."""
        return self._call(_calls.cancel(model))

    def delete(self, model: ModelRef) -> None:
        """Deletes a model and its files; it is cancelled if it has not ended."""
        return self._call(_calls.delete(model))

    def retry(self, model: ModelRef, *, idempotency_key: str | None = None) -> Model:
        """Requests a failed model again, as a new model. Raises Conflict if it has not failed."""
        return self._call(_calls.retry(model, idempotency_key))

    def cancel_models(self, *, all: bool = False, dry_run: bool = False, **given: Unpack[ModelFilter]) -> Applied:
        """Cancels all models that match the conditions, those of `models`.

        Args:
            all: Must be True if there are no conditions.
            dry_run: Whether to only count them.
        """
        return self._call(_calls.cancel_models(all, dry_run, given))

    def delete_models(self, *, all: bool = False, dry_run: bool = False, **given: Unpack[ModelFilter]) -> Applied:
        """Deletes all models that match the conditions, and their files; the arguments are those of `cancel_models`."""
        return self._call(_calls.delete_models(all, dry_run, given))

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
        """Events of one model, or of the models that match all conditions; without any, of all models.

        Each event has the whole state of a model. The stream ends when the models in `model`, `models` or `batch` have
        ended, and else never. It is opened when the first event is taken. Lost connections are resumed; after a restart
        of the service states may come again.

        Args:
            models: At most 100.
            spec: Whether events have the spec.
            last_event_id: `id` of an event of an earlier stream with the same arguments, to go on after it.
        """
        request = _calls.events(model, models, batch, labels, spec)
        of_one = model is not None
        return self._iterate(_follow.events(request, read_event, self._options, last_event_id, of_one=of_one))

    # Files.

    def download(self, model: ModelRef, name: str, path: _download.PathLike | None = None) -> Path:
        """Saves a file of a model, such as `model.glb`; returns its path.

        The file appears under its name only when it is complete and has the size and the SHA-256 that the service
        states. A broken transfer goes on where it broke.

        Args:
            path: File or existing folder; by default the current folder.

        Raises:
            NotFound: There is no such model or file; a model has its files once it has succeeded.
            CheckFailed: What was received is not the file, or the name could lead out of the folder.
        """
        return self._run(_download.download(model, name, path, self._options.retries))

    def download_all(self, model: ModelRef, folder: _download.PathLike) -> list[Path]:
        """Saves all files of a model in a folder, which is made if needed; returns their paths.

        Raises what `download` raises. Nothing is saved if any of the names could lead out of the folder.
        """
        return self._run(_download.download_all(model, folder, self._options.retries))

    def content(self, model: ModelRef, name: str) -> bytes:
        """The bytes of a file of a model, received and checked as by `download`."""
        return self._run(_download.content(model, name, bytes, self._options.retries))

    def report(self, model: ModelRef) -> Json:
        """The report of a model: `certificate`, `morphometry`, `comparison`, `summary`, `spec`, `backend`, …"""
        return self._call(_calls.report(model))

    def course(self, model: ModelRef) -> Json:
        """The centre line that a model follows: points with frames, in millimetres.

        A point (x, y) of the cross section at `s_mm` is at `position_mm` + x·`u` + y·`v` in the files of the model.
        """
        return self._call(_calls.course(model))

    def manifest(self, model: ModelRef) -> Json:
        """What the files of a model are (bodies, units, patches, hashes), its origin, licence and how to cite."""
        return self._call(_calls.manifest(model))

    def report_page(self, model: ModelRef) -> str:
        """The report as a page to show or to print: HTML that needs no other file."""
        return self._call(_calls.report_page(model))

    def sections(self, model: ModelRef) -> Sections:
        """All cross sections of a model as numpy arrays, from its `sections.bin`."""
        return self._run(_download.content(model, "sections.bin", read_sections, self._options.retries))

    def section(self, model: ModelRef, index: int) -> Section:
        """One cross section of a model, counted from 0 at the isthmus end. Raises NotFound if there is none."""
        return self._call(_calls.section(model, index))

    def section_svg(self, model: ModelRef, index: int) -> str:
        """One cross section of a model as a picture in SVG."""
        return self._call(_calls.section_svg(model, index))

    def section_png(self, model: ModelRef, index: int, *, size: int | None = None, labels: bool = False) -> bytes:
        """One cross section of a model as PNG, stained with haematoxylin and eosin, or its labels.

        Args:
            size: The longer side in pixels, 32 to 2048; 1024 by default.
            labels: The tissue of each pixel as a grey value instead: 0 outside, 1 lumen, 2 epithelium,
                3 lamina propria, 4 circular muscle, 5 longitudinal muscle, 6 serosa.
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
        """The surface of a model cut by a plane, as rings of points.

        Sections are those of the simulation; a surface that leans has islands in such cuts.

        Args:
            z_um: Place along the tube of a plane across it, micrometres; u is x, v is y.
            origin_um: A point of any plane instead: x, y, z in micrometres; with `normal`.
            normal: Normal of the plane, of any length.

        Raises:
            NotFound: The plane misses the model (`cut-not-found`), or the model has no surface that can be cut
                (`file-not-found`).
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
        """A cut, as by `cut`, as a picture in SVG."""
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
        """A cut, as by `cut`, as PNG, stained with haematoxylin and eosin, or its labels.

        Args:
            size: The longer side in pixels, 32 to 2048; 1024 by default.
            labels: The tissue of each pixel as a grey value instead, as by `section_png`.
        """
        return self._call(_calls.cut_png(model, z_um, origin_um, normal, size, labels))

    def preview(self, model: ModelRef, *, view: str | None = None, size: int | None = None) -> bytes:
        """A picture of a model as PNG.

        Args:
            view: `opened` (cut open, the default), `whole`, `isthmus` or `ampulla`.
            size: The longest side in pixels, 32 to 2048; 1024 by default.
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
        """Requests models of one spec, all or none.

        Args:
            seeds: One model for each of these.
            count: Number of models, with seeds that the service draws; instead of `seeds`.

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
        """Requests a model for each point of a design, all or none.

        Args:
            vary: The design and the values of each parameter: `{"design": "lhs", "samples": 50, "values":
                {"/collision/gap_um": {"from": 25, "to": 50}}}`. docs/studies.md of the service describes all of it.
            seeds: Each point is grown with each of these; by default all have one seed that the service draws.
            count: Each point is grown with this number of seeds that the service draws; instead of `seeds`.

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
        """Checks what `submit_batch` or `study` would request, and predicts its cost; raises what they would raise."""
        return self._call(_calls.validate_batch(options, seeds, count, vary))

    def batch(self, batch: BatchRef) -> Batch:
        """The present state of a batch. Raises NotFound if there is none."""
        return self._call(_calls.batch(batch))

    def batches(
        self,
        *,
        owner: str | None = None,
        created_after: datetime.datetime | str | None = None,
        created_before: datetime.datetime | str | None = None,
    ) -> Iterator[Batch]:
        """Batches, newest first, without the ids of their models; the conditions are those of `models`."""
        return self._iterate(_calls.batches(owner, created_after, created_before, self._options.retries))

    def wait_batch(
        self,
        batch: BatchRef,
        *,
        timeout: float | None = None,
        progress: bool | Callable[[BatchProgress], object] = False,
    ) -> Batch:
        """Waits until all models of a batch have ended, in whatever way: `counts` of the batch tells.

        Arguments and errors are those of `wait`.
        """
        display = Display(progress, _follow.batch_figures)
        return self._run(_follow.wait_batch(batch, self._options, timeout, display))

    def cancel_batch(self, batch: BatchRef) -> Batch:
        """Cancels all models of a batch; those that have ended do not change."""
        return self._call(_calls.cancel_batch(batch))

    def delete_batch(self, batch: BatchRef) -> None:
        """Deletes a batch with its models and their files."""
        return self._call(_calls.delete_batch(batch))

    def table(self, batch: BatchRef) -> Table:
        """The models of a batch as a table: varied values, seed, status and figures."""
        return self._call(_calls.table(batch))

    def archive(self, batch: BatchRef, path: _download.PathLike, *, files: Sequence[str] | None = None) -> Path:
        """Saves files of all models of a batch as one archive; a path that ends in `.tar` makes a tar, any other a zip.

        Its files are compared with its `manifest.json`. A broken transfer begins anew.

        Args:
            files: Names of files of each model, such as `["report.json", "model.glb"]`; all by default.

        Raises:
            CheckFailed: The archive is damaged.
        """
        return self._run(_download.archive(batch, path, files, self._options.retries))

    # Fits.

    def submit_fit(self, *, idempotency_key: str | None = None, **options: Unpack[FitOptions]) -> Fit:
        """Requests a fit, a search for parameters whose models have given measures; `wait_fit` waits for it.

        Args:
            idempotency_key: The same key with the same request returns the same fit; by default a new one is made.
            targets: Measures to be reached: `[{"region": "ampulla", "quantity": "folds_on_ring", "value": 30}]`, with
                `low` and `high` if the accepted range is not 5 % to both sides. Regions are `isthmus`, `junction`,
                `ampulla`, `whole` and `tube`.
            targets_csv: The same as CSV with the columns `region`, `quantity`, `value`, `low`, `high`.
            images: Sections to be measured as targets: `[{"region": "isthmus", "png": bytes, "pixel_um": 2}]`.
            vary: The parameters to search for: `[{"parameter": "/collision/gap_um", "from": 20, "to": 60}]`; by default
                those that the targets depend on.
            preset: Name of a preset; `pig` by default.
            spec: The spec that the search starts from, as a merge patch of the preset.
            evaluations: Candidates at most; 70 by default.
            seeds: Number of seeds of each candidate, four times as many for measures that cost little; 4 by default.
            models: Models of the result that are grown in full; 4 by default.
            seed: First of the seeds, and the seed of the search; 0 by default.
            labels: Names and values of your own, to find fits by.
            priority: -100 to 100.

        docs/fitting.md of the service describes targets and results. Raises what `submit` raises.
        """
        return self._call(_calls.submit_fit(options, idempotency_key))

    def validate_fit(self, **options: Unpack[FitOptions]) -> FitValidation:
        """Checks what `submit_fit` would request: `request` of the answer has the targets measured in images, and the
        parameters that would be varied. Raises what `submit_fit` would raise."""
        return self._call(_calls.validate_fit(options))

    def fit(self, fit: FitRef) -> Fit:
        """The present state of a fit, with its request and its result. Raises NotFound if there is none."""
        return self._call(_calls.fit(fit))

    def fits(self, **given: Unpack[FitFilter]) -> Iterator[Fit]:
        """Fits, newest first, without requests and results; the conditions are those of `models`, but for `batch`."""
        return self._iterate(_calls.fits(given, self._options.retries))

    def fit_events(self, fit: FitRef, *, last_event_id: str | None = None) -> Iterator[FitEvent]:
        """Events of a fit, each with its whole state but the request. The stream ends with the fit.

        Args:
            last_event_id: `id` of an event of an earlier stream of the fit, to go on after it.
        """
        request = _calls.fit_events(fit)
        return self._iterate(_follow.events(request, read_fit_event, self._options, last_event_id))

    def wait_fit(
        self, fit: FitRef, *, timeout: float | None = None, progress: bool | Callable[[Fit], object] = False
    ) -> Fit:
        """Waits until a fit has succeeded, also through restarts of the service.

        Arguments and errors are those of `wait`; FitFailed, FitCancelled or FitDeleted if it will not succeed.
        """
        display = Display(progress, _follow.figures)
        return self._run(_follow.wait_fit(fit, self._options, timeout, display))

    def cancel_fit(self, fit: FitRef) -> Fit:
        """Cancels a fit; one that has ended does not change."""
        return self._call(_calls.cancel_fit(fit))

    def delete_fit(self, fit: FitRef) -> None:
        """Deletes a fit; it is cancelled if it has not ended."""
        return self._call(_calls.delete_fit(fit))

    # Presets, access and workers.

    def presets(self) -> tuple[Preset, ...]:
        """The presets; the default comes first."""
        return self._call(_calls.presets())

    def preset(self, name: str) -> Json:
        """A preset: its values, each with unit and source. Raises NotFound if there is none."""
        return self._call(_calls.preset(name))

    def schema(self) -> Json:
        """The JSON Schema of a spec: titles, units, bounds, defaults."""
        return self._call(_calls.schema())

    def health(self) -> Health:
        """State and version of the service; needs no key."""
        return self._call(_calls.health())

    def ticket(self, path: str) -> Ticket:
        """A ticket for one GET of a path of the service, such as `/models/ID/events`, without a key."""
        return self._call(_calls.ticket(path, self._options.url))

    def workers(self) -> Workers:
        """The workers that sent a heartbeat within the last minutes."""
        return self._call(_calls.workers())

    def pause_workers(self) -> Workers:
        """Pauses all workers, also those that start later: they start no more models. Needs the scope `admin`."""
        return self._call(_calls.change_workers("pause"))

    def resume_workers(self) -> Workers:
        """Ends the pause of all workers; those that are paused one by one remain so."""
        return self._call(_calls.change_workers("resume"))

    def pause_worker(self, name: str) -> Worker:
        """Pauses a worker: it starts no more models; those that it grows go on."""
        return self._call(_calls.change_worker(name, "pause"))

    def resume_worker(self, name: str) -> Worker:
        """Lets a worker that was paused or drained start models again."""
        return self._call(_calls.change_worker(name, "resume"))

    def drain_worker(self, name: str) -> Worker:
        """Drains a worker: it starts no more models, ends those that it grows, and is `drained` then."""
        return self._call(_calls.change_worker(name, "drain"))
