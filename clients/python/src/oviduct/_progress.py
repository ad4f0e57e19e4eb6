"""Shows the progress of a wait: with tqdm if installed, with a line on stderr, or by a callback."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any, Generic, Protocol, TypeVar

S = TypeVar("S")
# Seconds between lines on an output that cannot rewrite its last line.
PAUSE = 5.0


class _Bar(Protocol):
    def update(self, fraction: float, text: str) -> None: ...
    def close(self) -> None: ...


class _Tqdm:
    """A tqdm bar; in a notebook, a widget."""

    def __init__(self, tqdm: Any) -> None:
        self._bar = tqdm(total=100, bar_format="{desc} {percentage:3.0f}%|{bar}| {elapsed}")

    def update(self, fraction: float, text: str) -> None:
        self._bar.n = round(100 * fraction, 1)
        self._bar.set_description_str(text)

    def close(self) -> None:
        self._bar.close()


class _Line:
    """A line on stderr, which a terminal rewrites."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._text = self._written = ""
        self._at = float("-inf")

    def update(self, fraction: float, text: str) -> None:
        self._text = f"{100 * fraction:3.0f} % {text}"
        if self._terminal or time.monotonic() - self._at >= PAUSE:
            self._write()

    def _write(self) -> None:
        if self._text == self._written:
            return
        start, end = ("\r\x1b[K", "") if self._terminal else ("", "\n")
        print(f"{start}{self._text}", end=end, file=sys.stderr, flush=True)
        self._written, self._at = self._text, time.monotonic()

    def close(self) -> None:
        self._write()
        if self._terminal and self._written:
            print(file=sys.stderr)


def _bar() -> _Bar:
    try:
        from tqdm.auto import tqdm
    except ImportError:
        return _Line()
    return _Tqdm(tqdm)


class Display(Generic[S]):
    """Shows states; `progress` is True, False, or a function that is called with each state."""

    def __init__(self, progress: bool | Callable[[S], object], figures: Callable[[S], tuple[float, str]]) -> None:
        self._progress, self._figures = progress, figures
        self._bar: _Bar | None = None

    def show(self, state: S) -> None:
        """Shows a state."""
        if callable(self._progress):
            self._progress(state)
        elif self._progress:
            self._bar = self._bar or _bar()
            self._bar.update(*self._figures(state))

    def __enter__(self) -> Display[S]:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar:
            self._bar.close()
