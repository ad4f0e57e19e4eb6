"""Operations as steps, written once for the synchronous and the asynchronous client.

An operation is a generator. It yields steps (a request, a pause, …), receives their results, and
returns the result of the operation. The two loops in `_drive.py` run the steps.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import httpx

from .errors import ConnectionFailed, Problem, UnexpectedAnswer, problem_of

T = TypeVar("T")
# Maximum `Retry-After` for which an operation waits, seconds.
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
    """Sent as JSON unless it is None."""
    silence: float | None = None
    """Seconds without a byte after which the connection is lost; None: the client's timeout."""


@dataclass(frozen=True)
class Send:
    """Sends a request; the result is the response with its body."""

    request: Request


@dataclass(frozen=True)
class Open:
    """Sends a request; the result is the response.

    `Read` returns the body, except for an error status: then the response contains its body.
    """

    request: Request


@dataclass(frozen=True)
class Read:
    """Reads the response that was opened last; the result is the next bytes, or None at its end."""


@dataclass(frozen=True)
class Sleep:
    """Pauses."""

    seconds: float


@dataclass(frozen=True)
class Work:
    """Calls a function that computes or accesses files for some time; the result is its value."""

    call: Callable[[], Any]


@dataclass(frozen=True)
class Emit:
    """Passes a value to the caller's iteration."""

    value: Any


Step = Send | Open | Read | Sleep | Work | Emit
Steps = Generator[Step, Any, T]


def backoff(tries: int) -> float:
    """Returns the seconds to wait after some failed attempts: about 0.25, 0.5, 1, … up to 8."""
    # The exponent is limited, because a wait may need more than a thousand attempts and 2 ** 1024
    # overflows a float.
    return float(0.25 * 2 ** min(tries - 1, 5) * random.uniform(0.8, 1.2))


def delay(error: ConnectionFailed | Problem, tries: int) -> float | None:
    """Returns the seconds to wait before a retry, or None if a retry cannot succeed."""
    if isinstance(error, ConnectionFailed):
        return backoff(tries)
    if not error.is_transient:
        return None
    if error.retry_after is None:
        return backoff(tries)
    # The random part keeps clients that were refused together from retrying together.
    return error.retry_after + random.uniform(0, 0.25) if error.retry_after <= PATIENCE else None


def check(response: httpx.Response) -> httpx.Response:
    """Returns a successful response; raises Problem for an error status."""
    if response.status_code >= 400:
        raise problem_of(response)
    if not response.is_success:
        target = response.headers.get("location", "")
        raise UnexpectedAnswer(f"the answer is {response.status_code} {target}: is this the address of the service?")
    return response


def send(request: Request, retries: int) -> Steps[httpx.Response]:
    """Sends a request; retries after lost connections and transient problems.

    Every request of this package may be repeated: requests that create something carry an
        idempotency key.
    """
    tries, lost = 0, False
    while True:
        error: ConnectionFailed | Problem
        try:
            return check((yield Send(request)))
        except ConnectionFailed as failure:
            error, lost = failure, True
        except Problem as problem:
            # The deletion may have succeeded although its response was lost.
            if problem.status == 404 and lost and request.method == "DELETE":
                return httpx.Response(204)
            error = problem
        tries += 1
        pause = delay(error, tries)
        if pause is None or tries > retries:
            raise error
        yield Sleep(pause)


def call(request: Request, parse: Callable[[httpx.Response], T], retries: int) -> Steps[T]:
    """Sends a request; returns the parsed response."""
    return parse((yield from send(request, retries)))
