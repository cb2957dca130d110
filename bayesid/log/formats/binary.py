"""Parquet files through pyarrow, and MATLAB files: version 5 and older through scipy, 7.3 (HDF5) through h5py.

They hold variables as in `bayesid.log.formats.memory`: `t` (N,), `q` (N, n) or (n, N), `tau` or `i` alike, `dq` if
measured, or vectors `q1..qn` and so on. MATLAB files may hold them as the fields of one struct, Parquet files as lists
of all joints (LeRobot). Sizes stated in a file are checked before a library allocates memory for them.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.errors import InputError, missing
from bayesid.files import bounded
from bayesid.log.formats import Format
from bayesid.log.formats.labels import WORDS, kind_of, read_labels, time_among
from bayesid.log.formats.memory import table_of, table_of_vectors
from bayesid.log.formats.table import Options, Table
from bayesid.log.tuning import TUNING

if TYPE_CHECKING:
    import pyarrow
    from pyarrow import parquet

_NEEDED = "save t (N x 1), q (N x n) and tau or i (N x n), or one struct that holds them, or give `columns`"


class ParquetFile(Format):
    """Columns named as in a CSV log; time may be a timestamp or a duration."""

    name = "a Parquet file"
    magic = (b"PAR1",)
    options = frozenset({"columns"})

    def read(self, path: Path, options: Options) -> Table:
        try:
            import pyarrow
            from pyarrow import parquet
        except ImportError:
            raise missing("pyarrow", "parquet", str(path)) from None
        try:
            file = parquet.ParquetFile(path)
            names = [field.name for field in file.schema_arrow if _may_be_numbers(field.type)]
            _check_parquet(file, names, str(path))
            columns = file.read(names)
        except (pyarrow.ArrowException, pyarrow.ArrowInvalid, OSError) as error:
            if isinstance(error, FileNotFoundError):
                raise
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(f"is damaged ({reason})", str(path), "write it again") from None
        vectors: dict[str, Any] = {}
        for name in names:
            vectors |= _vectors(columns.column(name), path, name)
        return table_of_vectors(vectors, str(path), options)


class MatlabFile(Format):
    """Variables, or the fields of one struct."""

    name = "a MATLAB file"
    magic = (b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file")
    extensions = (".mat",)
    options = frozenset({"columns"})
    order = 1

    def read(self, path: Path, options: Options) -> Table:
        with path.open("rb") as file:
            load = _load_hdf5 if file.read(10) == b"MATLAB 7.3" else _load_matlab
        try:
            variables = load(path)
        except Exception as error:  # a damaged file may raise any error
            what = f"cannot be read as a MATLAB file ({type(error).__name__})"
            raise InputError(what, str(path), "save it again with save(..., '-v7')") from None
        found = _log_of(variables, str(path), named=bool(options.columns))
        for kind in WORDS if not options.columns else ():
            if len(same := [name for name in found if kind_of(name) == kind]) > 1:
                raise InputError(f"variables {' and '.join(same)} may be the same", str(path), "save only one of them")
        return table_of(found, str(path), options)


# ---- Parquet ----
def _may_be_numbers(kind: pyarrow.DataType) -> bool:
    from pyarrow import types

    lists = types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)
    return types.is_floating(kind.value_type) if lists else not types.is_nested(kind)


def _check_parquet(file: parquet.ParquetFile, names: Sequence[str], where: str) -> None:
    """InputError if the columns unpack to too many values."""
    metadata, size = file.metadata, 0
    for k in range(metadata.num_row_groups):
        group = metadata.row_group(k)
        chunks = (group.column(j) for j in range(group.num_columns))
        used = [chunk for chunk in chunks if chunk.path_in_schema.partition(".")[0] in names]
        size += sum(max(8 * chunk.num_values, 8 * group.num_rows, chunk.total_uncompressed_size) for chunk in used)
    if size > bounded.MOST_UNPACKED or metadata.num_rows < 0:
        what = f"its columns unpack to more than {bounded.MOST_UNPACKED >> 30} GiB"
        raise InputError(what, where, "cut it into shorter logs and give them all")


def _vectors(column: pyarrow.ChunkedArray, path: Path, name: str) -> dict[str, Any]:
    """(N,) values, decimals as floats; each place of a list is a column, from 1: state1, state2, ..."""
    from pyarrow import compute, float64, types

    if not types.is_nested(column.type):
        return {name: (column.cast(float64()) if types.is_decimal(column.type) else column).to_numpy()}
    widths = np.unique(compute.list_value_length(column).to_numpy())
    if len(widths) > 1:
        what = f"holds lists of {widths.min():g} to {widths.max():g} values"
        raise InputError(what, f"{path}, column {name}", "write lists of one length in every row")
    width = int(widths[0]) if len(widths) and np.isfinite(widths[0]) else 0
    return {f"{name}{k + 1}": compute.list_element(column, k).to_numpy() for k in range(width)}


# ---- MATLAB ----
def _load_matlab(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    _check_matlab(path.read_bytes())
    variables: dict[str, Any] = loadmat(path, simplify_cells=True)
    return variables


def _load_hdf5(path: Path) -> dict[str, Any]:
    """The variables of a version 7.3 file: arrays are transposed, structs are groups, objects are under "#refs#"."""
    import h5py

    def plain(item: Any) -> Any:
        if isinstance(item, h5py.Group):
            return {name: plain(item[name]) for name in item}
        return np.squeeze(item[()]).T

    with h5py.File(path) as file:
        sizes: list[int] = []
        file.visititems(lambda _, item: sizes.append(item.nbytes) if isinstance(item, h5py.Dataset) else None)
        if sum(sizes) > bounded.MOST_UNPACKED:
            raise ValueError("its arrays are too large")
        return {name: plain(file[name]) for name in file if not name.startswith("#")}


def _log_of(variables: Mapping[str, Any], where: str, named: bool) -> Mapping[str, Any]:
    """The variables of the log: all, or the only struct with a time and positions, or any that are named."""
    if _is_log(variables):
        return variables
    candidates = {name: value for name, value in variables.items() if isinstance(value, Mapping)}
    structs = {name: value for name, value in candidates.items() if _is_log(value)}
    if named and not structs:
        return next(iter(candidates.values())) if len(candidates) == 1 else variables
    if len(structs) > 1:
        raise InputError(f"structs {' and '.join(structs)} both hold a log", where, "save only one of them")
    if not structs:
        names = ", ".join(name for name in variables if not name.startswith("__"))
        raise InputError(f"there is no t with a q among {names or 'no variables'}", where, _NEEDED)
    return next(iter(structs.values()))


def _is_log(variables: Mapping[str, Any]) -> bool:
    names = list(variables)
    positions = "q" in map(kind_of, names) or any(reading.kind == "q" for reading in read_labels(names))
    return positions and time_among(names) is not None


_HEADER, _TAG = 128, 8
"""Bytes of a MAT-file's header, and of the tag of each element (MAT-File Format, MathWorks)."""
_MATRIX, _COMPRESSED = 14, 15  # types of elements
_WHOLE = 1, 2, 3  # classes of matrices whose entries are elements: cells, structs and objects


def _check_matlab(content: bytes) -> None:
    """ValueError for a MAT-file that unpacks to too much, or with matrices that are too deep or too large."""
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None:  # version 4 is not compressed
        return
    budget, objects = bounded.MOST_UNPACKED, 0
    waiting = [(content[_HEADER:], 0)]  # with the depth of nesting
    while waiting:
        elements, depth = waiting.pop()
        for kind, inner in _elements(elements, order):
            objects += 1
            if depth > bounded.DEEPEST or objects > TUNING.most_objects:
                raise ValueError("is nested too deeply")
            if kind == _COMPRESSED:
                unpacking = zlib.decompressobj()
                unpacked = unpacking.decompress(inner, budget)
                if unpacking.unconsumed_tail:
                    raise ValueError("unpacks to too much")
                budget -= len(unpacked)
                waiting.append((unpacked, depth))
            elif kind == _MATRIX and inner:
                _check_matrix(inner, order)
                waiting.append((inner, depth + 1))


def _elements(content: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    start = 0
    while start + _TAG <= len(content):
        kind, size = struct.unpack_from(f"{order}II", content, start)
        if kind >> 16:  # a small element is stored in its tag
            yield kind & 0xFFFF, content[start + 4 : start + _TAG]
            start += _TAG
            continue
        first = start + _TAG
        if first + size > len(content):
            raise ValueError("an element is longer than the file")
        yield kind, content[first : first + size]
        start = first + size + (-size % 8 if kind != _COMPRESSED else 0)


def _check_matrix(content: bytes, order: str) -> None:
    """ValueError if a matrix claims more elements than its bytes can hold."""
    (_, flags), (_, sizes), *_ = [*_elements(content, order), (0, b""), (0, b"")]
    if flags and struct.unpack_from(f"{order}I", flags)[0] & 0xFF in _WHOLE:
        count = math.prod(map(abs, struct.unpack(f"{order}{len(sizes) // 4}i", sizes[: len(sizes) // 4 * 4])))
        if _TAG * count > len(content):
            raise ValueError("holds fewer entries than stated")
