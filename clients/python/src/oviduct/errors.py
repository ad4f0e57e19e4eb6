"""Exceptions of this package, all subclasses of `OviductError`."""

from __future__ import annotations

import contextlib
import datetime
import email.utils
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

import httpx

if TYPE_CHECKING:
    from .types import Fit, Model

_PREFIX = "urn:oviduct:problem:"


class OviductError(Exception):
    """Base of all errors of this package."""


class ConnectionFailed(OviductError):
    """The service could not be reached, or the connection was lost, at every attempt."""


class UnexpectedAnswer(OviductError):
    """The response is not one of the oviduct service, but for example the page of a proxy."""


class CheckFailed(OviductError):
    """A file has the wrong size, hash or format, or an unsafe name."""


class WaitTimeout(OviductError, TimeoutError):
    """The model, batch or fit did not end in time. The service keeps running it."""


def _failure(what: str, failed: Model | Fit) -> str:
    problem = failed.problem
    return f"{what} {failed.id} failed" + (f": {problem.title}: {problem.detail}" if problem else "")


class ModelFailed(OviductError):
    """A model failed.

    `model.problem` has the problem type, such as `urn:oviduct:problem:certificate`.
    """

    def __init__(self, model: Model) -> None:
        super().__init__(_failure("model", model))
        self.model = model


class ModelCancelled(OviductError):
    """A model was cancelled."""

    def __init__(self, model: Model) -> None:
        super().__init__(f"model {model.id} was cancelled")
        self.model = model


class ModelDeleted(OviductError):
    """A model was deleted during the wait."""

    def __init__(self, model_id: str) -> None:
        super().__init__(f"model {model_id} was deleted")
        self.model_id = model_id


class FitFailed(OviductError):
    """A fit failed. `fit.problem` has the problem type."""

    def __init__(self, fit: Fit) -> None:
        super().__init__(_failure("fit", fit))
        self.fit = fit


class FitCancelled(OviductError):
    """A fit was cancelled."""

    def __init__(self, fit: Fit) -> None:
        super().__init__(f"fit {fit.id} was cancelled")
        self.fit = fit


class FitDeleted(OviductError):
    """A fit was deleted during the wait."""

    def __init__(self, fit_id: str) -> None:
        super().__init__(f"fit {fit_id} was deleted")
        self.fit_id = fit_id


@dataclass(frozen=True)
class Fault:
    """One fault of a request: its place and a description."""

    detail: str
    pointer: str | None = None
    """JSON pointer into the request body, such as `/spec/collision/gap_um`."""
    parameter: str | None = None
    """Name of a query parameter."""
    header: str | None = None
    """Name of a request header."""

    @property
    def place(self) -> str:
        """The JSON pointer, or the name of the parameter or header."""
        return self.pointer if self.pointer is not None else self.parameter or self.header or ""


def _faults(errors: Any) -> Iterator[Fault]:
    """Yields the faults in the member `errors` of a problem; skips values of other types."""
    for error in errors if isinstance(errors, list) else ():
        if not isinstance(error, dict):
            continue
        detail = error.get("detail", "")
        places = [error.get(name) for name in ("pointer", "parameter", "header")]
        if isinstance(detail, str) and all(place is None or isinstance(place, str) for place in places):
            yield Fault(detail, *places)


class Problem(OviductError):
    """A response with an error status (RFC 9457). Subclasses distinguish the common cases."""

    def __init__(self, status: int, members: Mapping[str, Any], *, retry_after: float | None = None) -> None:
        self.status = status
        """HTTP status."""
        self.type = str(members.get("type", "about:blank"))
        """`urn:oviduct:problem:` and a stable name; `about:blank` for other responses."""
        self.title = str(members.get("title", ""))
        """Title, equal for all problems of the type."""
        self.detail = str(members.get("detail", ""))
        """Description of this occurrence."""
        self.errors = tuple(_faults(members.get("errors")))
        """Faults of the request."""
        self.request_id: str | None = members.get("request_id")
        """Id of the request, to quote in a report."""
        self.retry_after = retry_after
        """Seconds after which a retry may succeed."""
        self.members = dict(members)
        """All members of the problem, such as `limit` and `prediction`."""
        super().__init__(str(self))

    def __reduce__(self) -> tuple[Any, ...]:
        return _problem_again, (type(self), self.status, self.members, self.retry_after)

    @property
    def name(self) -> str:
        """The type without its prefix, such as `model-not-found`."""
        return self.type.removeprefix(_PREFIX)

    @property
    def is_transient(self) -> bool:
        """True if the same request may succeed later."""
        return self.status in (429, 502, 503, 504)

    def __str__(self) -> str:
        text = f"{self.status} {self.title}: {self.detail}"
        text += "".join(f"\n  {fault.place}: {fault.detail}" for fault in self.errors)
        return text + (f" (request {self.request_id})" if self.request_id and not self.errors else "")


def _problem_again(kind: type[Problem], status: int, members: Mapping[str, Any], retry_after: float | None) -> Problem:
    return kind(status, members, retry_after=retry_after)


class Unauthorized(Problem):
    """401: the request needs a valid API key."""


class Forbidden(Problem):
    """403: the API key lacks the required scope."""


class NotFound(Problem):
    """404: the resource does not exist or belongs to another owner."""


class Conflict(Problem):
    """409: the state forbids the operation, such as a retry of a model that has not failed."""


class InvalidRequest(Problem):
    """422 `invalid-request`: `errors` lists each fault with its place."""


class CostLimit(Problem):
    """422 `cost-limit`: the predicted cost exceeds a limit of the service."""


class TooManyRequests(Problem):
    """429: a limit is reached; `retry_after` is the time to wait, in seconds."""


class RateLimited(TooManyRequests):
    """429 `rate-limited`: too many requests with this API key."""


class QuotaExceeded(TooManyRequests):
    """429 `quota-exceeded`: the owner has too many unfinished models or too many bytes of files."""


class QueueFull(TooManyRequests):
    """429 `queue-full`: too many models are queued."""


class ServerError(Problem):
    """5xx: the service, or a proxy in front of it, failed or is unavailable."""


_BY_NAME: dict[str, type[Problem]] = {
    "cost-limit": CostLimit,
    "rate-limited": RateLimited,
    "quota-exceeded": QuotaExceeded,
    "queue-full": QueueFull,
}
_BY_STATUS: dict[int, type[Problem]] = {
    401: Unauthorized,
    403: Forbidden,
    404: NotFound,
    409: Conflict,
    429: TooManyRequests,
}


def retry_after(response: httpx.Response) -> float | None:
    """Returns the seconds of `Retry-After`, which may also be a date (RFC 9110, section 10.2.3)."""
    text = response.headers.get("retry-after", "").strip()
    if text.isascii() and text.isdigit():
        return float(text)
    try:
        date = email.utils.parsedate_to_datetime(text)
        if date.tzinfo is None:
            date = date.replace(tzinfo=datetime.timezone.utc)
        return max(0.0, (date - datetime.datetime.now(datetime.timezone.utc)).total_seconds())
    except (TypeError, ValueError, OverflowError):
        return None


def problem_of(response: httpx.Response) -> Problem:
    """Returns the problem in an error response whose body has been read."""
    status = response.status_code
    members: Any = None
    if "json" in response.headers.get("content-type", ""):
        with contextlib.suppress(ValueError):
            members = response.json()
    if not isinstance(members, dict):
        try:
            title = HTTPStatus(status).phrase
        except ValueError:
            title = "error"
        members = {"title": title, "detail": response.text[:200].strip()}
    name = str(members.get("type", "")).removeprefix(_PREFIX)
    kind = _BY_NAME.get(name) or _BY_STATUS.get(status)
    if kind is None and status == 422 and name in ("", "invalid-request"):
        kind = InvalidRequest
    if kind is None:
        kind = ServerError if status >= 500 else Problem
    return kind(status, members, retry_after=retry_after(response))
