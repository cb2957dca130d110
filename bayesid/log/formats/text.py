"""Tables as text: a header with the names of a log's columns, then one row per instant.

Separators, decimal commas, encodings, quotes and a second row with units are detected.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.log.formats import Format
from bayesid.log.formats.encodings import TWOS_64, WIDE
from bayesid.log.formats.joint_names import by_cells, name_places, order_note
from bayesid.log.formats.labels import is_unit, kind_part, split_brackets
from bayesid.log.formats.names import choose
from bayesid.log.formats.stated import EFFORTS
from bayesid.log.formats.table import Chosen, Column, Options, SourceColumn, Table, of_64_bits
from bayesid.log.tuning import TUNING
from bayesid.parallel import quiet

_DAY = re.compile(r"(\d{1,4})([./-])(\d{1,2})\2(\d{1,4})[T ,]+(.+)")
_TIME = re.compile(
    r"(?:(?P<hours>\d{1,2}):)?(?P<minutes>\d{1,4}):(?P<seconds>\d{1,2}(?:[.,:]\d+)?)\s*(?P<half>[AP]M)?", re.IGNORECASE
)
_SEPARATORS = ",", ";", "\t", "|", " "  # column separators; any number of spaces counts as one
_WESTERN = re.compile(rb"[\t-\r\x20-\x7e\x80\x82-\x8c\x8e\x91-\x9c\x9e-\xfe]*")
"""Bytes of cp1252 text (Western Windows), without control and undefined characters."""
_COMMENTS = "#", "%"  # first character of a comment line
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(?:[.,'\u00a0\u202f ]\d{3})+(?:[.,]\d*)?")
"""Numbers with thousands separators, which are refused."""
_NO_VALUE = "#", "nan", "NaN", "NULL", "null", "None", "N/A", "n/a", "-", "?"
"""Beginnings of cells without a value: spreadsheet errors and words for nothing."""
_SIGNED_LOG = "t", "tau1", "p1", "q1", "log"
"""Columns of a `signed_log.csv` of several logs; the last one numbers the log of a row."""
_BOMS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


def clock_seconds(cell: str) -> float:
    """A date and time in s since 1970 (UTC by default), or a time of day in s since midnight; else a ValueError.

    Dates are ISO 8601, or day, month and year with points (3.2.2026) or with slashes, where day and month may be
    swapped: only differences matter. "12:03.4" is 12 minutes and 3.4 s, as in spreadsheets.
    """
    cell = cell.strip().strip('"')
    day = _DAY.fullmatch(cell)
    if day is None:
        return _since_midnight(cell) if "-" not in cell else _iso(cell)
    first, _, second, third, time = day.groups()
    if len(first) == 4:
        return _iso(f"{first}-{second:0>2}-{third:0>2}", time)
    month, of_month = (first, second) if day[2] == "/" and int(first) <= 12 else (second, first)
    return _iso(f"{third}-{month:0>2}-{of_month:0>2}", time)


def _iso(date: str, time: str | None = None) -> float:
    if time is not None and _TIME.fullmatch(time):
        return datetime.fromisoformat(date).replace(tzinfo=UTC).timestamp() + _since_midnight(time)
    moment = datetime.fromisoformat(date if time is None else f"{date}T{time}")
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _since_midnight(time: str) -> float:
    """Hours, minutes and seconds, or minutes and seconds; fractions after a point, a comma or a third colon."""
    found = _TIME.fullmatch(time.strip())
    if found is None:
        raise ValueError(f"{time!r} is not a time")
    seconds = float(re.sub("[,:]", ".", found["seconds"]))
    hours = int(found["hours"] or 0)
    if found["half"]:
        hours = hours % 12 + (12 if found["half"].upper() == "PM" else 0)
    return hours * 3600.0 + int(found["minutes"]) * 60.0 + seconds


class CsvFile(Format):
    """Any file that no other format recognises."""

    name = "a CSV table"
    options = frozenset({"columns", "joints"})
    order = 2

    def recognises(self, path: Path, head: bytes) -> bool:
        return True

    def read(self, path: Path, options: Options) -> Table:
        try:
            layout = layout_of(path)
            selected = select_columns(layout, str(path), options)
            places = [] if selected.joints else name_places(layout.header, selected.columns)
            if options.joints is not None and not selected.joints and not places:
                raise InputError(f"is {self.name}, which has no joints", str(path), "leave `joints` out")
            values = _read_values(path, layout, selected.columns)
        except (UnicodeDecodeError, csv.Error) as error:
            controls = rb"[\0-\x08\x0e-\x1f]"  # bytes that never occur in text
            if isinstance(error, UnicodeDecodeError) and not re.search(controls, path.read_bytes()):
                remedy = "save it as UTF-8; if it is Japanese: iconv -f SHIFT_JIS -t UTF-8 FILE > NEW"
                raise InputError(
                    "has an encoding other than UTF-8, UTF-16 and Windows-1252", str(path), remedy
                ) from None
            raise InputError("is not text", str(path), "give a CSV log (save a spreadsheet as CSV)") from None
        wide = _decode_64_bits(path, layout, selected.columns, values)
        columns = {used.name: Column(used.label, values[:, used.place], used.unit) for used in selected.columns}
        if set(_SIGNED_LOG) <= set(layout.header) and layout.header[-1] == _SIGNED_LOG[-1]:
            logs = [layout.cells(line)[-1] for _, line in _rows(path, layout)]
            numbers = {log: number for number, log in enumerate(dict.fromkeys(logs), start=1)}
            columns["part"] = Column(_SIGNED_LOG[-1], np.array([float(numbers[log]) for log in logs]), 1.0)

        def place(row: int) -> str:
            number, _ = next(islice(_rows(path, layout), row, None))
            return f"{path}, row {number}"

        notes, joints = selected.notes, selected.joints
        if places and len(values):
            cells = [[row[k] for k in places] for row in (layout.cells(line) for _, line in _rows(path, layout))]
            columns, named = by_cells(columns, cells, str(path), options)
            notes += (order_note(str(path), named.names),) if named.assumed else ()
            joints = () if named.assumed else named.names
        return Table(columns, str(path), place, notes, joints=joints, encoding=str(TWOS_64) if wide else None)


@dataclass(frozen=True)
class Layout:
    """The layout of a table in a file."""

    encoding: str
    separator: str = ","  #: column separator; a space stands for any number of spaces
    #: whether commas may be decimal marks; points always may
    decimal_comma: bool = False
    header: tuple[str, ...] = ()  #: column names, with units from a second header row in brackets
    header_row: int = 1  #: the header's line, from 1
    rows: int = 1  #: lines above the values: the header and those around it
    first: tuple[str, ...] = ()  #: the cells of the first row of values
    #: whether every line is quoted, as a spreadsheet writes a single column
    quoted_lines: bool = False

    def lines(self, file: Iterable[str]) -> Iterator[str]:
        """Lines of the file with decimal points; comment lines are blank."""
        return map(self._line, file)

    def cells(self, line: str) -> list[str]:
        """Cells of a line, with decimal points; empty for a blank line."""
        line = self._line(line)
        return _split(line, self.separator) if line.strip() else []

    def _line(self, line: str) -> str:
        empty = line.startswith(_COMMENTS) or not line.strip(
            f'{self.separator}" \t\r\n'
        )  # as spreadsheets write at the end
        line = "\n" if empty else line.replace("\N{MINUS SIGN}", "-")  # from word processors
        if self.quoted_lines:
            line = _unquoted(line)
        if not self.decimal_comma:
            return line
        if self.separator == ",":  # quoted commas are decimal marks
            return re.sub('"[^"]*"', lambda quoted: quoted[0].replace(",", "."), line)
        return line.replace(",", ".")


def layout_of(source: Path | bytes, whole: bool = True) -> Layout:
    """The layout of a table; UnicodeDecodeError or csv.Error if it is not text.

    The beginning of a file determines it, except for the encoding, which needs the whole file. Bytes may be the first
    of a stream.
    """

    def pieces() -> Iterator[bytes]:
        with io.BytesIO(source) if isinstance(source, bytes) else source.open("rb") as file:
            while piece := file.read(TUNING.header_bytes):
                yield piece

    encoding = _encoding(pieces, whole)
    text = codecs.getincrementaldecoder(encoding)().decode(next(pieces(), b""))
    lines = io.StringIO(text, newline="").readlines()
    if lines and "\0" in lines[0]:
        raise csv.Error("no text")
    quoted = _are_quoted(lines)
    lines = [_unquoted(line) for line in lines] if quoted else lines
    row = next((k for k in range(min(len(lines), TUNING.header_lines)) if _is_header(*_line_and_next(lines, k))), 0)
    line, beneath = _line_and_next(lines, row)
    separator = _separator(line, beneath)
    header, values, rows = _names(line, separator), _split(beneath, separator), row + 1
    if _are_units(values, header):
        rows = lines.index(beneath, row + 1) + 1
        header = [
            f"{name} [{_bare_unit(unit)}]" if unit and name and split_brackets(name).unit is None else name
            for name, unit in zip(header, values, strict=True)
        ]
        values = _split(_line_and_next(lines, rows - 1)[1], separator)
    if len(values) == len(header) + 1 and not values[-1]:  # every row but the header ends with a separator
        header = [*header, ""]
    comma = separator != "," or any('"' in line for line in lines[row + 1 :])
    return Layout(encoding, separator, comma, tuple(header), row + 1, rows, tuple(values), quoted)


def _is_clock(cell: str) -> bool:
    try:
        clock_seconds(cell)
    except ValueError:
        return False
    return ":" in cell


def select_columns(layout: Layout, source: str, options: Options) -> Chosen:
    """Columns that make a log, in the table's order, so that errors name the first bad one."""
    where, remedy = f"{source}, row {layout.header_row}", "begin it with t,q1..qn,tau1..taun"
    if not any(layout.header):
        raise InputError("does not begin with a header", source, remedy)
    if all(map(_is_number, layout.header)):
        remedy = _header_for(len(layout.header), options.n_joints)
        raise InputError("holds numbers instead of column names", where, remedy)
    selected = choose(layout.header, where, options)
    columns = sorted(selected.columns, key=lambda column: column.place)
    for k, column in enumerate(columns):
        if column.name == "t" and column.place < len(layout.first) and _is_clock(layout.first[column.place]):
            columns[k] = replace(column, unit=1.0, clock=True)
    return selected._replace(columns=tuple(columns))


def _header_for(count: int, n_joints: int) -> str:
    """Headers for a table of so many columns: positions and efforts, perhaps with velocities between.

    A known number of joints of the robot (else 0) excludes other headers.
    """
    headers = []
    for kinds in (("q", "tau"), ("q", "dq", "tau")):
        n, remainder = divmod(count - 1, len(kinds))
        if n > 0 and not remainder and n_joints in (0, n):
            headers.append(",".join(["t", *(f"{kind}{j}" for kind in kinds for j in range(1, n + 1))]))
    if not headers:
        return f"add a header with {count} names: t,q1..qn[,dq1..dqn],tau1..taun, and any names for other columns"
    return f"add a header, as {' or '.join(headers)} (i1.. for currents)"


# ---- How a file is written ----
def _encoding(pieces: Callable[[], Iterable[bytes]], whole: bool) -> str:
    """Encoding by the first bytes, else UTF-8 if valid, else Western Windows (cp1252)."""
    first = next(iter(pieces()), b"")
    for bom, encoding in _BOMS.items():
        if first.startswith(bom):
            return encoding
    for place, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):  # every other byte of plain text is zero
        if len(first) > 1 and not any(first[place:64:2]):
            return encoding
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        for piece in pieces():
            decoder.decode(piece)
        decoder.decode(b"", final=whole)
    except UnicodeDecodeError:
        if not all(map(_WESTERN.fullmatch, pieces())):
            raise
        return "cp1252"
    return "utf-8"


def _are_quoted(lines: Sequence[str]) -> bool:
    whole = re.compile('"(?:[^"]|"")*"')
    first = [line.strip() for line in lines[:2]]
    return len(first) == 2 and all(whole.fullmatch(line) and max(map(line.count, _SEPARATORS)) > 1 for line in first)


def _unquoted(line: str) -> str:
    return line.strip().removeprefix('"').removesuffix('"').replace('""', '"') + "\n"


def _line_and_next(lines: Sequence[str], row: int) -> tuple[str, str]:
    """A line, counted from 0, and the next one that is not blank; empty after the last."""
    return "".join(lines[row : row + 1]), next((line for line in lines[row + 1 :] if line.strip()), "")


def _is_header(line: str, beneath: str) -> bool:
    """Whether a line names columns, and the next has as many values or units; lines above may be anything."""
    separator = _separator(line, beneath)
    names, cells = _names(line, separator), _split(beneath, separator)
    if len(names) < 3 or len(cells) not in (len(names), len(names) + 1) or any(map(_is_number, names)):
        return False
    return any(map(_is_number, cells)) or _are_units(cells, names)


def _names(line: str, separator: str) -> list[str]:
    """Names of a header, perhaps after a comment sign."""
    return _split(line.lstrip("#% "), separator)


def _separator(line: str, first: str) -> str:
    """The separator with most columns in the header, preferably as many as in the first row; else spaces."""
    found: dict[str, tuple[bool, bool, int]] = {}
    for separator in _SEPARATORS:
        if (count := len(_names(line, separator))) > 1:
            found[separator] = separator != " ", count == len(_split(first, separator)), count
    return max(found, key=lambda separator: found[separator], default=",")


def _split(line: str, separator: str) -> list[str]:
    line = line.strip(" \r\n") if separator == " " else line
    cells = next(csv.reader([line], delimiter=separator, skipinitialspace=separator == " "), [])
    return [cell.strip() for cell in cells]


def _are_units(cells: Sequence[str], header: Sequence[str]) -> bool:
    """Whether a row under the header holds units and no value."""
    inner = [_bare_unit(cell) for cell in cells]
    values = any(_is_number(cell, comma=False) for cell in inner)
    return len(cells) == len(header) and any(map(is_unit, inner)) and not values


def _bare_unit(cell: str) -> str:
    return cell[1:-1].strip() if cell[:1] + cell[-1:] in ("[]", "()") else cell


# ---- What it holds ----
def _read_values(path: Path, layout: Layout, used: Sequence[SourceColumn]) -> Array:
    """(N, columns) numbers of the used columns, clock times in s; the other columns are 0."""
    n, places = len(layout.header), {column.place for column in used}
    converters: dict[int | str, Callable[[str], float]] = {i: lambda _: 0.0 for i in range(n) if i not in places}
    converters |= {column.place: clock_seconds for column in used if column.clock}
    with path.open(newline="", encoding=layout.encoding) as file, quiet(UserWarning):  # empty files are refused later
        try:
            values: Array = np.loadtxt(
                layout.lines(file),
                delimiter=None if layout.separator == " " else layout.separator,
                quotechar='"',
                comments=None,
                skiprows=layout.rows,
                ndmin=2,
                converters=converters,
            )
        except UnicodeDecodeError:
            raise
        except ValueError:
            filled = _with_blanks(path, layout, used)
            if filled is None:
                raise _first_bad_row(path, layout, used) from None
            values = filled
    if len(values) == 0:
        return np.empty((0, n))
    if values.shape[1] != n:
        remedy = _semicolons(layout, values.shape[1]) or "give every column exactly one name"
        raise InputError(f"has {n} names for {values.shape[1]} columns", f"{path}, row {layout.header_row}", remedy)
    return values


def _decode_64_bits(path: Path, layout: Layout, used: Sequence[SourceColumn], values: Array) -> bool:
    """Whether efforts are unsigned 64-bit integers with a two's complement; replaces them in `values`."""
    places = [column.place for column in used if kind_part(column.name) in EFFORTS]
    places = [place for place in places if (values[:, place] >= WIDE).any()]
    for place in places:
        try:
            values[:, place] = of_64_bits([int(layout.cells(line)[place]) for _, line in _rows(path, layout)])
        except (OverflowError, ValueError):  # not integers: refused later
            return False
    return bool(places)


def _with_blanks(path: Path, layout: Layout, used: Sequence[SourceColumn]) -> Array | None:
    """The same with blank cells as nan; None if a row holds something else that is not a number."""
    rows = []
    for _, line in _rows(path, layout):
        cells, values = _split(line, layout.separator), np.zeros(len(layout.header))
        if len(cells) != len(layout.header):
            return None
        for column in used:
            try:
                values[column.place] = _number(cells[column.place], column)
            except ValueError:
                return None
        rows.append(values)
    return np.array(rows) if rows else None


def _number(cell: str, column: SourceColumn) -> float:
    """A cell's number, s for a clock; nan if it is blank or a word for nothing."""
    if not cell or cell.startswith(_NO_VALUE[:-2]) or cell in _NO_VALUE:
        return np.nan
    if column.clock:
        return clock_seconds(cell)
    if "_" in cell:
        raise ValueError("no number")
    return float(cell)


def _rows(path: Path, layout: Layout) -> Iterator[tuple[int, str]]:
    """Numbered lines of values; the first line of the file is row 1, and blank lines count."""
    with path.open(newline="", encoding=layout.encoding) as file:
        for number, line in enumerate(layout.lines(file), start=1):
            if number > layout.rows and line.strip():
                yield number, line


def _first_bad_row(path: Path, layout: Layout, used: Sequence[SourceColumn]) -> InputError:
    for number, line in _rows(path, layout):
        cells, where = _split(line, layout.separator), f"{path}, row {number}"
        if tuple(cells) == layout.header:
            remedy = "remove the row; if another recording begins there, split the log into two files and give both"
            return InputError("holds the header again", where, remedy)
        if len(cells) != len(layout.header):
            what = f"holds {len(cells)} values, but the header has {len(layout.header)} names"
            remedy = _semicolons(layout, len(cells)) if number == layout.rows + 1 else ""
            return InputError(what, where, remedy or "remove the row (the last row is often truncated) or complete it")
        for column in used:
            cell = cells[column.place]
            if _is_clock(cell) if column.clock else _is_number(cell, comma=False):
                continue
            remedy = "correct the value"
            if _THOUSANDS.fullmatch(cell):
                remedy = "write numbers without thousands separators"
            elif not cell or cell.startswith(_NO_VALUE):
                remedy = "remove the row (gaps are allowed), or fill in the value"
            what = f"column {column.label} holds {cell!r}, not a {'time' if column.clock else 'number'}"
            return InputError(what, where, remedy)
    return InputError("cannot be read as a table of numbers", str(path), "give a comma-separated file")


def _semicolons(layout: Layout, cells: int) -> str:
    """Remedy for rows that are too long because of decimal commas; else empty."""
    doubled = layout.separator == "," and cells > len(layout.header) + 1
    return "if numbers have decimal commas, separate columns by semicolons" if doubled else ""


def _is_number(cell: str, comma: bool = True) -> bool:
    """Whether a cell is a number with a decimal point or, if allowed, a comma."""
    try:
        float(cell.replace(",", ".") if comma else cell)
    except ValueError:
        return False
    return "_" not in cell
