"""What binary files say of their own sizes, checked before a library takes memory by it."""

from __future__ import annotations

import math
import sqlite3
import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import quote

from bayesid.files.bounded import DEEPEST, MOST_UNPACKED, fits_memory
from bayesid.log.tuning import TUNING

if TYPE_CHECKING:
    import h5py

_HEADER, _TAG = 128, 8
"""Bytes of a MAT-file's header, and of the tag before each of its elements (MAT-File Format, MathWorks)."""
_MATRIX, _COMPRESSED = 14, 15
"""Types of elements."""
_SIZES_4 = {0: 8, 1: 4, 2: 4, 3: 2, 4: 2, 5: 1}
"""Bytes of a number of version 4, by the second digit of its matrix's type."""
_WHOLE = 1, 2, 3
"""Classes of matrices whose entries are elements: cells, structs and objects."""

_MCAP, _ZSTD, _SQLITE = b"\x89MCAP0\r\n", b"\x28\xb5\x2f\xfd", b"SQLite format 3\0"
"""First bytes of such files and frames."""
_RECORD, _CHUNK, _CHUNK_HEAD = struct.Struct("<BQ"), 6, struct.Struct("<QQQII")
"""Of an MCAP file: kind and size of a record, the kind of chunks, and what these begin with, to the codec's letters."""


class _Element(NamedTuple):
    """An element of a MAT-file: its type, where its content begins and ends."""

    kind: int
    start: int
    end: int


def check_matlab(path: Path) -> None:
    """Refuses, by ValueError, a MAT-file that unpacks to too much, or whose matrices nest or claim too much."""
    content = path.read_bytes()
    if len(content) < _HEADER or content[126:128] not in (b"IM", b"MI"):  # of version 4, which packs nothing
        _check_version_4(content)
        return
    order = "<" if content[126:128] == b"IM" else ">"
    left, objects = MOST_UNPACKED, [0]
    for kind, start, end in _elements(content, _HEADER, len(content), order):
        inner = content[start:end]
        if kind == _COMPRESSED:
            unpacking = zlib.decompressobj()
            inner = unpacking.decompress(inner, left)
            if unpacking.unconsumed_tail:
                raise ValueError("unpacks to too much")
            left -= len(inner)
            for inner_kind, first, last in _elements(inner, 0, len(inner), order):
                _check_matrix(inner, _Element(inner_kind, first, last), order, 0, objects)
        else:
            _check_matrix(content, _Element(kind, start, end), order, 0, objects)


def _elements(content: bytes, start: int, end: int, order: str) -> Iterator[_Element]:
    """The elements one after the other; the last may end early."""
    while start + _TAG <= end:
        kind, size = struct.unpack_from(f"{order}II", content, start)
        if kind >> 16:  # a small one, its content in its tag
            yield _Element(kind & 0xFFFF, start + 4, start + _TAG)
            start += _TAG
            continue
        first = start + _TAG
        if first + size > end:
            raise ValueError("an element is longer than the file")
        yield _Element(kind, first, first + size)
        start = first + size + (-size % 8 if kind != _COMPRESSED else 0)


def _check_matrix(content: bytes, element: _Element, order: str, depth: int, objects: list[int]) -> None:
    """A matrix of elements has no more of them than its bytes can hold, nor do they nest too deep."""
    objects[0] += 1
    if depth > DEEPEST or objects[0] > TUNING.most_objects:
        raise ValueError("holds too much in one another")
    if element.kind != _MATRIX or element.end == element.start:
        return
    parts = list(_elements(content, element.start, element.end, order))
    if len(parts) > 1 and content[parts[0].start : parts[0].end]:
        flags = struct.unpack_from(f"{order}I", content, parts[0].start)[0]
        sizes = struct.unpack_from(f"{order}{(parts[1].end - parts[1].start) // 4}i", content, parts[1].start)
        count = math.prod(abs(size) for size in sizes)
        if flags & 0xFF in _WHOLE and _TAG * count > element.end - element.start:
            raise ValueError("holds fewer entries than it says")
    for part in parts:
        if part.kind == _MATRIX:
            _check_matrix(content, part, order, depth + 1, objects)


def _check_version_4(content: bytes) -> None:
    """Each matrix of version 4 begins with five numbers: its type, rows, columns, parts and letters of its name."""
    start = 0
    while start + 20 <= len(content):
        little = 0 <= struct.unpack_from("<i", content, start)[0] < 5000
        kind, rows, columns, parts, letters = struct.unpack_from(f"{'<' if little else '>'}5i", content, start)
        size = _SIZES_4.get(kind // 10 % 10)
        if size is None or min(rows, columns, parts, letters) < 0:
            raise ValueError("is no matrix of version 4")
        start += 20 + letters + size * rows * columns * (2 if parts else 1)
    if start > len(content):
        raise ValueError("holds fewer numbers than it says")


def check_hdf5(file: h5py.File, names: Sequence[str]) -> None:
    """Refuses, by ValueError, an HDF5 file whose arrays claim too much, or whose groups nest too deep or circle."""
    import h5py

    waiting, size, objects = [(file, name, 1) for name in names], 0, 0
    while waiting:
        group, name, depth = waiting.pop()
        objects += 1
        if (
            depth > DEEPEST
            or objects > TUNING.most_objects
            or not isinstance(group.get(name, getlink=True), h5py.HardLink)
        ):
            raise ValueError("holds groups in a circle, too deep, or of another file")
        item = group[name]
        if isinstance(item, h5py.Group):
            waiting += [(item, inner, depth + 1) for inner in item]
            continue
        size += math.prod(item.shape or ()) * item.dtype.itemsize
        if not fits_memory(size, 1):
            raise ValueError("its arrays are too large")


def check_bag(path: Path) -> None:
    """Refuses, by ValueError, a bag (folder or file) of which a packed file, chunk or message unpacks to too much."""
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        with file.open("rb") as content:
            head = content.read(len(_SQLITE))
        if head.startswith(_MCAP):
            for packed, codec in _chunks(file):
                _check_unpacked(packed, codec)
        elif head.startswith(_ZSTD):
            _check_unpacked(file, "zstd")
        elif head == _SQLITE:
            with closing(sqlite3.connect(f"file:{quote(str(file))}?mode=ro", uri=True)) as bag:
                for (message,) in bag.execute("SELECT data FROM messages"):
                    if isinstance(message, bytes) and message.startswith(_ZSTD):
                        _check_unpacked(message, "zstd")


def _chunks(path: Path) -> Iterator[tuple[bytes, str]]:
    """The packed chunks of an MCAP file (mcap.dev/spec, 'Chunk'), each with its codec."""
    with path.open("rb") as file:
        file.seek(len(_MCAP))
        while len(head := file.read(_RECORD.size)) == _RECORD.size:
            kind, size = _RECORD.unpack(head)
            end = file.tell() + size
            if kind == _CHUNK:
                fixed = file.read(_CHUNK_HEAD.size)
                if len(fixed) < _CHUNK_HEAD.size:
                    return
                codec = file.read(min(_CHUNK_HEAD.unpack(fixed)[-1], size)).decode(errors="replace")
                file.read(8)  # the size of what follows
                if codec in ("zstd", "lz4") and (left := end - file.tell()) > 0:
                    yield file.read(left), codec
            file.seek(min(end, (1 << 63) - 1))


def _check_unpacked(packed: bytes | Path, codec: str) -> None:
    import pyarrow as pa

    source = str(packed) if isinstance(packed, Path) else pa.BufferReader(packed)
    with pa.CompressedInputStream(source, codec) as unpacking:
        size = 0
        while part := unpacking.read(1 << 20):
            size += len(part)
            if not fits_memory(size, 1):
                raise ValueError("unpacks to too much")
