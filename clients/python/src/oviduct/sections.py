"""Cross sections and cuts as numpy arrays, and the reader of `sections.bin`.

docs/sections-bin.md of the service describes the file.
"""

from __future__ import annotations

import hashlib
import json
import os
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, overload

import numpy as np
import numpy.typing as npt
import zstandard

from .errors import CheckFailed, UnexpectedAnswer

_ENTRY = np.dtype(
    [("offset", "<u8"), ("length", "<u4"), ("inner", "<u4"), ("outer", "<u4"), ("added", "<u4"), ("step", "<f8"),
     ("z_um", "<f8"), ("checksum", "V8")]
)  # fmt: skip
_TRAILER = struct.Struct("<QQ8s32s8s")
_HEADER_MAX, _POINTS_MAX = 1 << 20, 1 << 24


@dataclass(frozen=True, eq=False)
class Ring:
    """A closed contour, counter-clockwise; the last point connects to the first."""

    ids: npt.NDArray[np.uint32]
    """Particle ids, shape (n,). A particle has the same id in every section."""
    points: npt.NDArray[np.float32]
    """Points, shape (n, 2), micrometres."""

    def __len__(self) -> int:
        return len(self.ids)

    def __repr__(self) -> str:
        return f"Ring({len(self)} points)"


@dataclass(frozen=True, eq=False)
class Section:
    """A cross section."""

    index: int
    """Index, 0 at the isthmus end."""
    z_um: float
    """Position along the tube, micrometres."""
    step: float
    """Time step; fractional for a section that was added to mend a slab."""
    added: bool
    """True for a section that was added to mend a slab."""
    inner: Ring
    """Boundary of the lumen."""
    outer: Ring
    """Boundary of the tissue."""


def section_of(answer: Any) -> Section:
    """Parses a section from JSON; raises UnexpectedAnswer for other JSON."""

    def ring(part: Any) -> Ring:
        points = np.asarray(part["points"], np.float32).reshape(-1, 2)
        return Ring(np.asarray(part["ids"], np.uint32), points)

    try:
        return Section(
            answer["index"],
            answer["z_um"],
            answer["step"],
            answer["added"],
            ring(answer["inner"]),
            ring(answer["outer"]),
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise UnexpectedAnswer(f"the answer is not a section: {error!r}") from None


@dataclass(frozen=True)
class Plane:
    """A plane with coordinates u and v; lengths in micrometres."""

    origin_um: tuple[float, float, float]
    """Point at which u and v are 0."""
    normal: tuple[float, float, float]
    """Unit normal."""
    u: tuple[float, float, float]
    """Unit vector of u."""
    v: tuple[float, float, float]
    """Unit vector of v."""


@dataclass(frozen=True, eq=False)
class CutRing:
    """A closed ring of a cut; the last point connects to the first."""

    kind: str
    """`tissue`, `lumen`, `island` or `pocket`.

    `lumen` is the largest hole of the tissue, `island` is tissue that this plane separates from the
    wall, and `pocket` is lumen that this plane separates from the rest.
    """
    parent: int | None
    """Index of the ring that directly surrounds this ring."""
    area_um2: float
    """Area within the ring, including everything that the ring surrounds."""
    perimeter_um: float
    """Length of the ring."""
    points: npt.NDArray[np.float64] = field(repr=False)
    """u and v, shape (n, 2), micrometres.

    Counter-clockwise around tissue and islands, clockwise around lumen and pockets.
    """

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, eq=False)
class Cut:
    """A planar cut of the surface of a model."""

    file: str
    """Name of the file that was cut."""
    plane: Plane
    """The plane."""
    tissue_area_um2: float
    """Area of the tissue, including islands."""
    lumen_area_um2: float
    """Area of lumen and pockets, without islands."""
    islands: int
    """Number of islands."""
    pockets: int
    """Number of pockets."""
    rings: tuple[CutRing, ...] = field(repr=False)
    """The rings, each after the ring that surrounds it."""


def cut_of(answer: Any) -> Cut:
    """Parses a cut from JSON; raises UnexpectedAnswer for other JSON."""

    def vector(part: Any) -> tuple[float, float, float]:
        x, y, z = (float(value) for value in part)
        return x, y, z

    def ring(part: Any) -> CutRing:
        points = np.asarray(part["points"], np.float64).reshape(-1, 2)
        return CutRing(part["kind"], part["parent"], part["area_um2"], part["perimeter_um"], points)

    try:
        plane = answer["plane"]
        return Cut(
            answer["file"],
            Plane(vector(plane["origin_um"]), vector(plane["normal"]), vector(plane["u"]), vector(plane["v"])),
            answer["tissue_area_um2"],
            answer["lumen_area_um2"],
            answer["islands"],
            answer["pockets"],
            tuple(ring(part) for part in answer["rings"]),
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise UnexpectedAnswer(f"the answer is not a cut: {error!r}") from None


@dataclass(frozen=True, eq=False)
class Sections(Sequence[Section]):
    """All cross sections of a model, isthmus end first; each is decoded on access."""

    header: dict[str, Any]
    """`units`, `engine`, `preset`, `seed`, `digest`, `length_mm`."""
    z_um: npt.NDArray[np.float64] = field(repr=False)
    """Positions along the tube, shape (number of sections,), micrometres."""
    step: npt.NDArray[np.float64] = field(repr=False)
    """Time steps, shape (number of sections,)."""
    added: npt.NDArray[np.bool_] = field(repr=False)
    """True for sections that were added to mend a slab, shape (number of sections,)."""
    points: npt.NDArray[np.int64] = field(repr=False)
    """Numbers of points of the inner and the outer contour, shape (number of sections, 2)."""
    _data: bytes = field(repr=False)
    _index: npt.NDArray[Any] = field(repr=False)

    def __len__(self) -> int:
        return len(self._index)

    @overload
    def __getitem__(self, index: int) -> Section: ...
    @overload
    def __getitem__(self, index: slice) -> list[Section]: ...
    def __getitem__(self, index: int | slice) -> Section | list[Section]:
        if isinstance(index, slice):
            return [self._section(k) for k in range(*index.indices(len(self)))]
        at = index + len(self) if index < 0 else index
        if not 0 <= at < len(self):
            raise IndexError(f"there are {len(self)} sections")
        return self._section(at)

    def __iter__(self) -> Iterator[Section]:
        return (self._section(k) for k in range(len(self)))

    def _section(self, k: int) -> Section:
        entry = self._index[k]
        frame = self._data[int(entry["offset"]) : int(entry["offset"]) + int(entry["length"])]
        if hashlib.sha256(frame).digest()[:8] != bytes(entry["checksum"]):
            raise CheckFailed(f"sections.bin: the checksum of section {k} is wrong")
        inner, outer = (int(n) for n in self.points[k])
        size = 12 * (inner + outer)
        try:
            with zstandard.ZstdDecompressor().stream_reader(frame) as reader:
                planes = reader.read(size + 1)
        except zstandard.ZstdError as error:
            raise CheckFailed(f"sections.bin: section {k} is damaged: {error}") from None
        if len(planes) != size:
            raise CheckFailed(f"sections.bin: section {k} has not the size of its {inner + outer} points")
        rings = _ring(planes[: 12 * inner], inner), _ring(planes[12 * inner :], outer)
        return Section(k, float(self.z_um[k]), float(self.step[k]), bool(self.added[k]), *rings)


def _ring(planes: bytes, n: int) -> Ring:
    """Decodes a ring from three planes of differences, least significant bytes first."""
    lanes = np.frombuffer(planes, np.uint8).reshape(3, 4, n)
    mapped = np.ascontiguousarray(lanes.transpose(0, 2, 1)).view("<u4").reshape(3, n).astype(np.uint32)
    differences = (mapped >> np.uint32(1)) ^ -(mapped & np.uint32(1)).astype(np.uint32)
    numbers = np.cumsum(differences, axis=1, dtype=np.uint32)
    return Ring(numbers[0], np.ascontiguousarray(numbers[1:].view(np.float32).T))


def read_sections(source: bytes | str | os.PathLike[str]) -> Sections:
    """Reads `sections.bin` from bytes or a path.

    Raises CheckFailed for a damaged file or another version.
    """
    if isinstance(source, bytes):
        data = source
    else:
        with open(source, "rb") as file:
            data = file.read()
    try:
        return _read(data)
    except (struct.error, ValueError, IndexError) as error:
        raise CheckFailed(f"sections.bin is damaged: {error}") from None


def _read(data: bytes) -> Sections:
    def require(is_so: bool, fault: str) -> None:
        if not is_so:
            raise CheckFailed(f"sections.bin: {fault}")

    require(len(data) >= 16 + _TRAILER.size and data.startswith(b"OVISECT\n"), "not a file of sections")
    version, header_length = struct.unpack_from("<II", data, 8)
    require(version == 1, f"version {version} is not known")
    end = len(data) - _TRAILER.size
    offset, count, checksum, digest, magic = _TRAILER.unpack_from(data, end)
    require(magic == b"OVISEND\n", "the end is missing")
    require(header_length <= _HEADER_MAX and 16 + header_length <= offset <= end, "the header is damaged")
    require(offset + count * _ENTRY.itemsize == end, "the index does not fill the file")
    require(hashlib.sha256(data[: end + 24]).digest() == digest, "the hash is wrong")
    require(hashlib.sha256(data[offset:end]).digest()[:8] == checksum, "the checksum of the index is wrong")
    header = json.loads(data[16 : 16 + header_length])
    index = np.frombuffer(data, _ENTRY, count, offset)
    starts = index["offset"].astype(np.int64)
    ends = np.append(16 + header_length, starts + index["length"])
    require(bool((starts == ends[:-1]).all()) and int(ends[-1]) == offset, "the sections do not fill the file")
    points = np.stack([index["inner"], index["outer"]], axis=1).astype(np.int64)
    require(bool((points <= _POINTS_MAX).all()), "a section has too many points")
    return Sections(header, index["z_um"].copy(), index["step"].copy(), index["added"] != 0, points, data, index)
