"""Follows models, batches and fits with event streams that survive lost connections, and waits."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import httpx

from . import _calls
from ._progress import Display
from ._sse import Parser
from ._steps import Emit, Open, Read, Request, Send, Sleep, Steps, backoff, call, check, delay
from .errors import (
    ConnectionFailed,
    FitCancelled,
    FitDeleted,
    FitFailed,
    ModelCancelled,
    ModelDeleted,
    ModelFailed,
    Problem,
    UnexpectedAnswer,
    WaitTimeout,
)
from .types import Batch, BatchRef, Event, Fit, FitEvent, FitRef, Model, ModelRef, read_event, read_fit_event

# A model or a fit, and an event of a model or a fit.
S = TypeVar("S", Model, Fit)
E = TypeVar("E", Event, FitEvent)
ReadEvent = Callable[[str, Any, str | None, str], E]

# Maximum silence of an event stream, seconds. The service sends at least a comment every 15
# seconds.
SILENCE = 45.0


class Limits(Protocol):
    """Limits for attempts to reach the service."""

    @property
    def retries(self) -> int: ...
    @property
    def outage(self) -> float:
        """Seconds without contact after which an event stream is given up."""
        ...


@dataclass(frozen=True)
class BatchProgress:
    """Progress of a batch."""

    ended: int
    """Number of models that have ended."""
    total: int
    """Number of all models."""
    fraction: float
    """Mean progress of the models, 0 to 1."""


def figures(state: Model | Fit) -> tuple[float, str]:
    """Returns fraction and text for the progress bar of a model or a fit."""
    if state.has_ended:
        return 1.0, state.status
    if state.status == "running" and state.progress:
        return state.progress.fraction, state.progress.stage
    ahead = state.queue.position
    return 0.0, f"{state.status}, {ahead} ahead" if ahead else state.status


def batch_figures(progress: BatchProgress) -> tuple[float, str]:
    """Returns fraction and text for the progress bar of a batch."""
    return progress.fraction, f"{progress.ended} of {progress.total} models"


class Deadline:
    """The end of a wait."""

    def __init__(self, seconds: float | None) -> None:
        self._seconds = seconds
        self._end = None if seconds is None else time.monotonic() + seconds

    def left(self) -> float:
        """Returns the remaining seconds; raises WaitTimeout after the end."""
        if self._end is None:
            return float("inf")
        left = self._end - time.monotonic()
        if left <= 0:
            raise WaitTimeout(f"not ended after {self._seconds:g} s")
        return left


def follow(
    request: Request,
    reads: ReadEvent[E],
    limits: Limits,
    *,
    last_id: str | None = None,
    handle: Callable[[E], Steps[bool]],
    look: Callable[[], Steps[bool | None]] | None = None,
    deadline: Deadline | None = None,
) -> Steps[None]:
    """Follows an event stream until the service ends it or `handle` returns True for an event.

    After a lost connection, calls `look` and reconnects with the id of the last event. `look`
    returns whether the followed model, batch or fit has ended, or None if the service did not
    respond.
    """
    away: float | None = None  # Time since which there was no contact.
    tries = 0
    while True:
        error: ConnectionFailed | Problem = ConnectionFailed("the stream was closed before its end")
        silence = min(SILENCE, deadline.left()) if deadline else SILENCE
        headers = {"accept": "text/event-stream", **({"last-event-id": last_id} if last_id else {})}
        opened = Request("GET", request.path, request.params, headers, silence=silence)
        try:
            response: httpx.Response = check((yield Open(opened)))
            if response.status_code == 204:
                return
            if not response.headers.get("content-type", "").startswith("text/event-stream"):
                raise UnexpectedAnswer("the answer is not a stream of events")
            parser = Parser(last_id)
            while (chunk := (yield Read())) is not None:
                away = None
                if deadline:
                    deadline.left()
                for message in parser.feed(chunk):
                    tries = 0
                    event = reads(message.name, message.json(), message.id, str(response.url))
                    if (yield from handle(event)):
                        return
                last_id = parser.last_id
        except ConnectionFailed as failure:
            error = failure
        except Problem as problem:
            if not problem.is_transient:
                raise
            error = problem
        tries += 1
        over = (yield from look()) if look else None
        if over:
            return
        now = time.monotonic()
        away = None if over is False else away or now
        if away and now - away >= limits.outage:
            raise error
        pause = delay(error, tries)
        pause = backoff(tries) if pause is None else pause
        yield Sleep(min(pause, deadline.left()) if deadline else pause)


def events(
    request: Request, reads: ReadEvent[E], limits: Limits, last_id: str | None, *, of_one: bool = True
) -> Steps[None]:
    """Emits the events of a stream. The stream of one model or fit ends with its `end` event."""

    def handle(event: E) -> Steps[bool]:
        yield Emit(event)
        return of_one and event.name == "end"

    return follow(request, reads, limits, last_id=last_id, handle=handle)


def _asked(request: Request, parse: Callable[[httpx.Response], Any]) -> Steps[Any]:
    """Sends one request; returns the parsed response, or None if the service is unavailable."""
    try:
        return parse(check((yield Send(request))))
    except ConnectionFailed:
        return None
    except Problem as problem:
        if not problem.is_transient:
            raise
        return None


def _wait(
    record: _calls.Call[S],
    request: Request,
    reads: ReadEvent[E],
    state_of: Callable[[E], S],
    limits: Limits,
    timeout: float | None,
    display: Display[S],
) -> Steps[S]:
    """Waits until a model or a fit has ended; `state_of` raises for the event of a deletion."""
    deadline = Deadline(timeout)

    def handle(event: E) -> Steps[bool]:
        yield from ()
        display.show(state_of(event))
        return event.name == "end"

    def look() -> Steps[bool | None]:
        state: S | None = yield from _asked(*record)
        if state is None:
            return None
        display.show(state)
        return state.has_ended

    with display:
        yield from follow(request, reads, limits, handle=handle, look=look, deadline=deadline)
        # The events omit the spec of a model and the request of a fit.
        state = yield from call(*record, limits.retries)
        display.show(state)
    return state


def _model_of(event: Event) -> Model:
    if event.model is None:
        raise ModelDeleted(event.model_id)
    return event.model


def _fit_of(event: FitEvent) -> Fit:
    if event.fit is None:
        raise FitDeleted(event.fit_id)
    return event.fit


def wait_model(ref: ModelRef, limits: Limits, timeout: float | None, display: Display[Model]) -> Steps[Model]:
    """Waits until a model has succeeded."""
    record, request = _calls.model(ref), _calls.events(ref)
    model = yield from _wait(record, request, read_event, _model_of, limits, timeout, display)
    if model.status == "failed":
        raise ModelFailed(model)
    if model.status == "cancelled":
        raise ModelCancelled(model)
    return model


def wait_fit(ref: FitRef, limits: Limits, timeout: float | None, display: Display[Fit]) -> Steps[Fit]:
    """Waits until a fit has succeeded."""
    record, request = _calls.fit(ref), _calls.fit_events(ref)
    fit = yield from _wait(record, request, read_fit_event, _fit_of, limits, timeout, display)
    if fit.status == "failed":
        raise FitFailed(fit)
    if fit.status == "cancelled":
        raise FitCancelled(fit)
    return fit


def wait_batch(ref: BatchRef, limits: Limits, timeout: float | None, display: Display[BatchProgress]) -> Steps[Batch]:
    """Waits until all models of a batch have ended."""
    record = _calls.batch(ref)
    deadline = Deadline(timeout)
    parts: dict[str, float] = {}
    total = 0

    def show(ended: int) -> None:
        display.show(BatchProgress(ended, total, sum(parts.values()) / total if total else 1.0))

    def handle(event: Event) -> Steps[bool]:
        yield from ()
        if event.name == "end":
            parts[event.model_id] = 1.0
        elif event.model and event.model.progress:
            # Just below 1, because 1 marks models that have ended.
            parts[event.model_id] = min(event.model.progress.fraction, 0.999)
        show(sum(part == 1.0 for part in parts.values()))
        return False

    def look() -> Steps[bool | None]:
        batch: Batch | None = yield from _asked(*record)
        return None if batch is None else batch.has_ended

    with display:
        batch = yield from call(*record, limits.retries)
        total = batch.counts.total
        while not batch.has_ended:
            request = _calls.events(batch=ref)
            yield from follow(request, read_event, limits, handle=handle, look=look, deadline=deadline)
            batch = yield from call(*record, limits.retries)
        parts = dict.fromkeys(batch.models, 1.0)
        total = batch.counts.total
        show(batch.counts.ended)
    return batch
