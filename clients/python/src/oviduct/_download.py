"""Downloads files into temporary files, resumes broken transfers, and checks the result."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import re
import secrets
import tarfile
import zipfile
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import IO, Any, BinaryIO, TypeVar

import httpx

from . import _calls
from ._steps import Open, Read, Request, Sleep, Steps, Work, call, check, delay
from .errors import CheckFailed, ConnectionFailed, Problem
from .types import BatchRef, File, Model, ModelRef

T = TypeVar("T")
PathLike = str | os.PathLike[str]


def fetch(request: Request, sink: BinaryIO, file: File | None, retries: int) -> Steps[None]:
    """Writes the body of a response to a sink.

    With `file`, checks size and SHA-256, and resumes a broken transfer. Without `file`, starts a
    broken transfer again from the beginning. Gives up after `retries` consecutive attempts without
    new bytes.
    """
    tries = done = most = 0
    digest = hashlib.sha256()
    while True:
        error: ConnectionFailed | Problem
        resumed = {"range": f"bytes={done}-"} if file and done else {}
        opened = Request("GET", request.path, request.params, {**request.headers, **resumed})
        try:
            response: httpx.Response = check((yield Open(opened)))
            if _start(response) != done:
                # The response is the whole file although the request had a range.
                done, digest = 0, hashlib.sha256()
                sink.seek(0)
                sink.truncate()
            while (chunk := (yield Read())) is not None:
                sink.write(chunk)
                digest.update(chunk)
                done += len(chunk)
            if file is None or done >= file.bytes:
                break
            error = ConnectionFailed(f"{file.name} ended after {done} of {file.bytes} bytes")
        except ConnectionFailed as failure:
            error = failure
        except Problem as problem:
            error = problem
        if file and done >= file.bytes:
            break
        tries = 0 if done > most else tries
        most = max(most, done)
        tries += 1
        pause = delay(error, tries)
        if pause is None or tries > retries:
            raise error
        yield Sleep(pause)
    if file and done != file.bytes:
        raise CheckFailed(f"{file.name} has {done} bytes instead of {file.bytes}")
    if file and digest.hexdigest() != file.sha256:
        raise CheckFailed(f"{file.name} has the SHA-256 {digest.hexdigest()} instead of {file.sha256}")


def _start(response: httpx.Response) -> int:
    """Returns the offset in the file at which the body begins."""
    match = re.match(r"bytes (\d+)-", response.headers.get("content-range", ""))
    return int(match[1]) if response.status_code == 206 and match else 0


@contextlib.contextmanager
def replaced(path: Path) -> Iterator[BinaryIO]:
    """Opens a temporary file that replaces `path` on success and is deleted otherwise."""
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        with open(part, "x+b") as sink:
            yield sink
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def local(name: str) -> str:
    """Returns the name of a model's file as a local name; raises CheckFailed for an unsafe name."""
    # A backslash, a drive or a stream (`:`) has a meaning only on Windows, but every system refuses
    # it.
    if name.startswith(".") or not re.fullmatch(r"[^/\\:\x00-\x1f]+", name):
        raise CheckFailed(f"not a name for a file: {name!r}")
    return name


def _target(path: PathLike | None, name: str) -> Path:
    target = Path(local(name) if path is None else path)
    return target / local(name) if target.is_dir() else target


def named(ref: ModelRef, name: str, retries: int) -> Steps[File | None]:
    """Returns a file of a model from its record; None if the record has no such file."""
    model = ref if isinstance(ref, Model) and ref.files else (yield from call(*_calls.model(ref), retries))
    return next((file for file in model.files if file.name == name), None)


def _fetch_named(ref: ModelRef, name: str, sink: BinaryIO, retries: int) -> Steps[None]:
    # If the record has no such file, the response to the request explains why.
    file = yield from named(ref, name, retries)
    yield from fetch(_calls.file(ref, name), sink, file, retries)


def download(ref: ModelRef, name: str, path: PathLike | None, retries: int) -> Steps[Path]:
    """Saves a file of a model."""
    target = _target(path, name)
    with replaced(target) as sink:
        yield from _fetch_named(ref, name, sink, retries)
    return target


def download_all(ref: ModelRef, folder: PathLike, retries: int) -> Steps[list[Path]]:
    """Saves all files of a model."""
    model = yield from call(*_calls.model(ref), retries)
    # Check all names before writing any file.
    targets = [(file.name, Path(folder) / local(file.name)) for file in model.files]
    Path(folder).mkdir(parents=True, exist_ok=True)
    paths = []
    for name, target in targets:
        paths.append((yield from download(model, name, target, retries)))
    return paths


def content(ref: ModelRef, name: str, parse: Callable[[bytes], T], retries: int) -> Steps[T]:
    """Downloads a file of a model; returns its parsed content."""
    sink = io.BytesIO()
    yield from _fetch_named(ref, name, sink, retries)
    parsed: T = yield Work(lambda: parse(sink.getvalue()))
    return parsed


def archive(ref: BatchRef, path: PathLike, files: Sequence[str] | None, retries: int) -> Steps[Path]:
    """Saves an archive of a batch's files, and checks the archive with its manifest."""
    target = Path(path)
    form = "tar" if target.suffix == ".tar" else "zip"
    with replaced(target) as sink:
        yield from fetch(_calls.archive(ref, files, form), sink, None, retries)
        sink.flush()
        yield Work(lambda: check_archive(sink, form))
    return target


def check_archive(archive: BinaryIO, form: str) -> None:
    """Compares the files of an archive with its manifest; raises CheckFailed if they differ."""
    archive.seek(0)
    sums: dict[str, tuple[int, str]] = {}
    manifest: Any = None
    try:
        with contextlib.closing(_entries(archive, form)) as entries:
            for name, file in entries:
                if name == "manifest.json":
                    manifest = json.load(file)
                else:
                    sums[name] = _sum(file)
        listed = {
            file["path"]: (file["bytes"], file["sha256"]) for model in manifest["models"] for file in model["files"]
        }
    except (zipfile.BadZipFile, tarfile.TarError, EOFError, ValueError, KeyError, TypeError) as error:
        raise CheckFailed(f"the archive is damaged: {error!r}") from None
    for name in sorted(listed.keys() | sums.keys()):
        if listed.get(name) != sums.get(name):
            raise CheckFailed(f"{name} in the archive is not what its manifest says")


def _entries(archive: BinaryIO, form: str) -> Generator[tuple[str, IO[bytes]], None, None]:
    if form == "tar":
        with tarfile.open(fileobj=archive, mode="r:") as tar:
            for member in tar:
                file = tar.extractfile(member)
                if file is not None:
                    yield member.name, file
    else:
        with zipfile.ZipFile(archive) as zipped:
            for info in zipped.infolist():
                with zipped.open(info) as file:
                    yield info.filename, file


def _sum(file: IO[bytes]) -> tuple[int, str]:
    digest, size = hashlib.sha256(), 0
    while chunk := file.read(1 << 20):
        digest.update(chunk)
        size += len(chunk)
    return size, digest.hexdigest()
