"""Runs the steps of an operation over httpx: one loop for threads, one for asyncio."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import AsyncGenerator, AsyncIterator, Generator, Iterator
from typing import Any, TypeVar

import httpx

from ._steps import Emit, Open, Read, Request, Send, Sleep, Step, Steps, Work
from ._version import VERSION
from .errors import ConnectionFailed

T = TypeVar("T")
_HEADERS = {"user-agent": f"oviduct-python/{VERSION}"}


class _Key(httpx.Auth):
    """Sends the API key and never shows it; httpx drops it on a redirect to another host."""

    def __init__(self, key: str) -> None:
        key = key.strip()
        # The error of httpx would contain the API key.
        if not key or not all("!" <= character <= "~" for character in key):
            raise ValueError("the key must consist of visible ASCII characters")
        self._key = key

    def auth_flow(self, request: httpx.Request) -> Generator[httpx.Request, httpx.Response, None]:
        request.headers["authorization"] = f"Bearer {self._key}"
        yield request

    def __repr__(self) -> str:
        return "<key>"


class Options:
    """Settings of both clients: address, API key and limits."""

    def __init__(self, url: str | None, key: str | None, timeout: float, retries: int, outage: float) -> None:
        url = url or os.environ.get("OVIDUCT_URL") or "http://127.0.0.1:8080"
        address = httpx.URL(url)
        if address.scheme not in ("http", "https") or not address.host:
            raise ValueError(f"not an http or https URL: {address!r}")
        if address.query or address.fragment:
            raise ValueError("the URL of the service has no query and no fragment")
        key = os.environ.get("OVIDUCT_KEY") if key is None else key
        self.address = address.copy_with(path=address.path.rstrip("/") + "/")
        self.auth = _Key(key) if key else None
        # The address without user name and password, for messages.
        self.shown = str(self.address.copy_with(userinfo=b""))
        self.timeout, self.retries, self.outage = timeout, retries, outage

    def url(self, path: str) -> str:
        """Returns the URL of a path of the service."""
        return str(self.address) + path

    def request(self, http: httpx.Client | httpx.AsyncClient, request: Request) -> httpx.Request:
        silence = self.timeout if request.silence is None else request.silence
        return http.build_request(
            request.method,
            self.url(request.path),
            params=request.params or None,
            headers={**_HEADERS, **request.headers},
            json=request.body,
            timeout=httpx.Timeout(self.timeout, read=silence),
        )

    def how(self, request: Request) -> dict[str, Any]:
        # The service may redirect downloads to the artifact store. Any other redirect means that
        # the address is wrong.
        return {"auth": self.auth, "follow_redirects": request.method == "GET"}


def _lost(error: httpx.RequestError) -> ConnectionFailed:
    # Raise a new exception, because the exception of httpx refers to the request and thereby to the
    # API key.
    text = str(error) or "no answer in time"
    return ConnectionFailed(f"{type(error).__name__}: {text}")


class _Result:
    """The result of an operation's steps."""

    def __init__(self, value: Any) -> None:
        self.value = value


class _Exchange:
    """Runs the steps of one operation; keeps the open response between the steps."""

    def __init__(self, http: httpx.Client, options: Options) -> None:
        self._http, self._options = http, options
        self._response: httpx.Response | None = None
        self._chunks: Iterator[bytes] = iter(())

    def do(self, step: Step) -> Any:
        if isinstance(step, Sleep):
            return time.sleep(step.seconds)
        if isinstance(step, Work):
            return step.call()
        if isinstance(step, Read):
            return next(self._chunks, None)
        assert isinstance(step, (Send, Open))
        self.close()
        request = self._options.request(self._http, step.request)
        response = self._http.send(request, stream=True, **self._options.how(step.request))
        self._response, self._chunks = response, response.iter_bytes()
        if isinstance(step, Send) or response.status_code >= 400:
            response.read()
        return response

    def close(self) -> None:
        if self._response is not None:
            self._response.close()


class Driver:
    """Runs the steps of operations in the calling thread."""

    def __init__(self, options: Options, http: httpx.Client | None) -> None:
        self._options = options
        self._owned = http is None
        self._http = http or httpx.Client()

    def close(self) -> None:
        """Closes the connections, unless the caller passed the httpx client."""
        if self._owned:
            self._http.close()

    def _run(self, steps: Steps[T]) -> T:
        """Runs the steps; returns their result."""
        with contextlib.closing(self._drive(steps)) as drive:
            result = next(value.value for value in drive if isinstance(value, _Result))
        return result  # type: ignore[no-any-return]

    def _iterate(self, steps: Steps[None]) -> Iterator[Any]:
        """Runs the steps; yields the values that they emit."""
        with contextlib.closing(self._drive(steps)) as drive:
            for value in drive:
                if not isinstance(value, _Result):
                    yield value

    def _drive(self, steps: Steps[Any]) -> Generator[Any, None, None]:
        """Runs the steps; yields the values that they emit, then their result."""
        exchange = _Exchange(self._http, self._options)
        answer: Any = None
        failure: ConnectionFailed | None = None
        try:
            while True:
                try:
                    step = steps.send(answer) if failure is None else steps.throw(failure)
                except StopIteration as end:
                    yield _Result(end.value)
                    return
                answer = failure = None
                if isinstance(step, Emit):
                    yield step.value
                    continue
                try:
                    answer = exchange.do(step)
                except httpx.RequestError as error:
                    failure = _lost(error)
        finally:
            steps.close()
            exchange.close()


class _AsyncExchange:
    """Runs the steps of one operation; keeps the open response between the steps."""

    def __init__(self, http: httpx.AsyncClient, options: Options) -> None:
        self._http, self._options = http, options
        self._response: httpx.Response | None = None
        self._chunks: AsyncIterator[bytes] | None = None

    async def do(self, step: Step) -> Any:
        if isinstance(step, Sleep):
            return await asyncio.sleep(step.seconds)
        if isinstance(step, Work):
            return await asyncio.to_thread(step.call)
        if isinstance(step, Read):
            return await anext(self._chunks, None) if self._chunks else None
        assert isinstance(step, (Send, Open))
        await self.close()
        request = self._options.request(self._http, step.request)
        response = await self._http.send(request, stream=True, **self._options.how(step.request))
        self._response, self._chunks = response, response.aiter_bytes()
        if isinstance(step, Send) or response.status_code >= 400:
            await response.aread()
        return response

    async def close(self) -> None:
        if self._response is not None:
            await self._response.aclose()


class AsyncDriver:
    """Runs the steps of operations as part of an asyncio task."""

    def __init__(self, options: Options, http: httpx.AsyncClient | None) -> None:
        self._options = options
        self._owned = http is None
        self._http = http or httpx.AsyncClient()

    async def aclose(self) -> None:
        """Closes the connections, unless the caller passed the httpx client."""
        if self._owned:
            await self._http.aclose()

    async def _run(self, steps: Steps[T]) -> T:
        """Runs the steps; returns their result."""
        async with contextlib.aclosing(self._drive(steps)) as drive:
            async for value in drive:
                if isinstance(value, _Result):
                    return value.value  # type: ignore[no-any-return]
        raise AssertionError("steps end with a result")

    async def _iterate(self, steps: Steps[None]) -> AsyncIterator[Any]:
        """Runs the steps; yields the values that they emit."""
        async with contextlib.aclosing(self._drive(steps)) as drive:
            async for value in drive:
                if not isinstance(value, _Result):
                    yield value

    async def _drive(self, steps: Steps[Any]) -> AsyncGenerator[Any, None]:
        """Runs the steps; yields the values that they emit, then their result."""
        exchange = _AsyncExchange(self._http, self._options)
        answer: Any = None
        failure: ConnectionFailed | None = None
        try:
            while True:
                try:
                    step = steps.send(answer) if failure is None else steps.throw(failure)
                except StopIteration as end:
                    yield _Result(end.value)
                    return
                answer = failure = None
                if isinstance(step, Emit):
                    yield step.value
                    continue
                try:
                    answer = await exchange.do(step)
                except httpx.RequestError as error:
                    failure = _lost(error)
        finally:
            steps.close()
            await exchange.close()
