"""Operations as steps, written once for the synchronous and the asynchronous client.

An operation is a generator. It yields what is to be done (a request, a pause, …), is sent the result, and returns the
result of the whole. `_drive.py` has the two loops that do these things.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import httpx

from .errors import ConnectionFailed, Problem, UnexpectedAnswer, problem_of

T = TypeVar("T")
# Longest `Retry-After` that is waited for, in seconds.
PATIENCE = 60.0


@dataclass(frozen=True)
class Request:
    """A request to the service."""

    method: str
    path: str
    """Path below the address of the service, without a leading slash."""
    params: tuple[tuple[str, str], ...] = ()
    headers: Mapping[str, str] = field(default_factory=dict)
    body: Any = None
    """Sent as JSON, if it is not None."""
    silence: float | None = None
    """Seconds without a byte after which the connection counts as lost; None: the timeout of the client."""


@dataclass(frozen=True)
class Send:
    """Send a request; the result is the answer with its body."""

    request: Request


@dataclass(frozen=True)
class Open:
    """Send a request; the result is the answer, whose body `Read` gets unless the status is one of an error."""

    request: Request


@dataclass(frozen=True)
class Read:
    """The result is the next bytes of the answer that was opened last, or None at its end."""


@dataclass(frozen=True)
class Sleep:
    """Pause."""

    seconds: float


@dataclass(frozen=True)
class Work:
    """Call a function that computes, or reads and writes files, for some time; the result is its value."""

    call: Callable[[], Any]


@dataclass(frozen=True)
class Emit:
    """Hand a value to the caller, who iterates."""

    value: Any


Step = Send | Open | Read | Sleep | Work | Emit
Steps = Generator[Step, Any, T]


def backoff(tries: int) -> float:
    """Seconds to wait after so many failed tries: about 0.25, 0.5, 1, … up to 8."""
    # The exponent is bounded: a wait may try more than a thousand times, and 2 ** 1024 is too large for a float.
    return float(0.25 * 2 ** min(tries - 1, 5) * random.uniform(0.8, 1.2))


def delay(error: ConnectionFailed | Problem, tries: int) -> float | None:
    """Seconds to wait before the next try after an error; None if none would help."""
    if isinstance(error, ConnectionFailed):
        return backoff(tries)
    if not error.is_transient:
        return None
    if error.retry_after is None:
        return backoff(tries)
    # With some randomness, so that clients that were refused together do not come back together.
    return error.retry_after + random.uniform(0, 0.25) if error.retry_after <= PATIENCE else None


def check(response: httpx.Response) -> httpx.Response:
    """The answer, if its status is one of success; raises Problem if it is not."""
    if response.status_code >= 400:
        raise problem_of(response)
    if not response.is_success:
        target = response.headers.get("location", "")
        raise UnexpectedAnswer(f"the answer is {response.status_code} {target}: is this the address of the service?")
    return response


def send(request: Request, retries: int) -> Steps[httpx.Response]:
    """Sends a request, and again after lost connections and transient problems.

    Every request of this package may be repeated: those that make something carry an idempotency key.
    """
    tries, lost = 0, False
    while True:
        error: ConnectionFailed | Problem
        try:
            return check((yield Send(request)))
        except ConnectionFailed as failure:
            error, lost = failure, True
        except Problem as problem:
            # A deletion whose answer was lost may have been done.
            if problem.status == 404 and lost and request.method == "DELETE":
                return httpx.Response(204)
            error = problem
        tries += 1
        pause = delay(error, tries)
        if pause is None or tries > retries:
            raise error
        yield Sleep(pause)


def call(request: Request, parse: Callable[[httpx.Response], T], retries: int) -> Steps[T]:
    """Sends a request; the result is what `parse` makes of the answer."""
    return parse((yield from send(request, retries)))
