"""Decoding of readings that are never negative but hold a sign.

Unsigned registers of 8, 16 or 32 bits hold -1 as their largest number (two's complement). Servo buses set a bit for one
direction. Converters put zero at the middle of their scale. Some loggers write a column of directions. A code is
detected at sign changes: jumps by half the scale as recorded are continuous when decoded. Without jumps, a zero at the
middle of the scale is detected by readings that never come near zero.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bayesid.arrays import TINY, Array, Mask
from bayesid.errors import InputError
from bayesid.log.formats.labels import kind_part
from bayesid.log.formats.table import DIRECTION, Column, Table
from bayesid.log.tuning import TUNING

MAGNITUDE = "magnitude"
CODES = "twos:16, sign-bit:10, offset:2048 or direction:1"
"""Examples of stated encodings."""
TAKEN, DOUBT = "taken as |effort| as stated by `encoding`, but", "signs and model may be wrong"
"""Message about readings that do not look like the stated |effort|."""
WIDE = 2.0**63
"""A 64-bit number from here on is negative in two's complement; no effort reading is so large."""
_TEXT = re.compile(r"(magnitude)|(twos|sign-bit):([0-9]{1,2})|(offset|direction):([0-9.eE+-]{1,20})")


@dataclass(frozen=True)
class Encoding:
    """How readings hold their sign.

    Attributes:
        kind: "magnitude" if they do not; "twos", two's complement; "sign-bit"; "offset", zero in the middle; or
            "direction", a separate column.
        number: bits of the two's complement; bit, from 0, that is set for negative values; reading at zero; or
            direction of negative values.
    """

    kind: str
    number: float = 0.0

    @classmethod
    def parse(cls, text: str) -> Encoding:
        """An encoding from text: one of `CODES`, or magnitude."""
        found = _TEXT.fullmatch(text.strip())
        try:
            if found is not None and found[1]:
                return cls(MAGNITUDE)
            number = float((found[3] or found[5]) if found is not None else "nan")
        except ValueError:
            number = float("nan")
        kind = "" if found is None else found[2] or found[4]
        least, most = {"twos": (4, 64), "sign-bit": (3, 52)}.get(kind, (-np.inf, np.inf))
        if found is None or not np.isfinite(number) or not least <= number <= most:
            raise InputError(f"{text!r:.60} is not an encoding", field="encoding", remedy=f"give magnitude, {CODES}")
        return cls(kind, number)

    def __str__(self) -> str:
        return self.kind if self.kind == MAGNITUDE else f"{self.kind}:{self.number:.12g}"

    @property
    def description(self) -> str:
        """In words."""
        return {
            "twos": f"two's complement of {self.number:g} bits",
            "sign-bit": f"a sign in bit {self.number:g}",
            "offset": f"zero at {self.number:.12g}",
            "direction": f"a sign in the direction column ({self.number:g} is negative)",
        }[self.kind]

    def directed(self, readings: Array, direction: Array) -> Array:
        """Readings of any shape with the signs of directions."""
        return np.where(direction < 0.0 if self.number < 0.0 else direction == self.number, -readings, readings)

    def decoded(self, counts: Array) -> Array:
        """Signed readings of any shape, in counts; unchanged for a direction, which needs its column."""
        if self.kind == "twos":
            return counts - 2.0**self.number * (counts >= 2.0 ** (self.number - 1.0))
        if self.kind == "sign-bit":
            half = 2.0**self.number
            return np.where(counts >= half, half - counts, counts)
        return counts - self.number if self.kind == "offset" else counts


TWOS_64 = Encoding("twos", 64)
"""Decoded by the readers of files, as floats cannot hold 64 bits."""


def decode(table: Table, stated: str | None = None) -> Table:
    """A table with decoded signs, and a note about it.

    Args:
        table: as read, with columns dir1.. for directions.
        stated: an encoding stated by the user.

    Raises:
        InputError: readings seem to hold a sign in an ambiguous code, or do not fit the stated one.
    """
    plain = {name: column for name, column in table.columns.items() if kind_part(name) != DIRECTION}
    efforts = {name: column for name, column in plain.items() if kind_part(name) in ("tau", "i") and name != "t"}
    table, given = replace(table, columns=plain), table.columns
    chosen = None if stated is None else Encoding.parse(stated)
    if not efforts or not len(table.columns["t"].values):
        return table
    values, first = np.column_stack([column.values for column in efforts.values()]), next(iter(efforts.values())).label
    if table.encoding is not None:
        return _of_64_bits(table, first, chosen)
    if ((values >= WIDE) & (values <= 2.0 * WIDE)).any():
        what = f"readings such as {first} reach {values.max():.6g}, a rounded 64-bit number with a sign"
        raise InputError(what, table.source, "log them as integers, or with a sign")
    if not np.isfinite(values).all() or (values < 0.0).any():
        if chosen is not None and chosen.kind != MAGNITUDE and np.isfinite(values).all():
            raise InputError("holds negative efforts already", table.source, "leave `encoding` out")
        return table
    if chosen is not None and chosen.kind == MAGNITUDE:
        seen = _detect_code(values).seen
        return replace(table, repairs=(*table.repairs, f"{table.source}: {TAKEN} {seen}; {DOUBT}")) if seen else table
    directions = [column for name in efforts if (column := _direction_of(given, name)) is not None]
    if directions and (chosen is None or chosen.kind == "direction"):
        chosen, signed = _by_direction(table, values, np.column_stack([column.values for column in directions]), chosen)
    elif chosen is not None and chosen.kind == "direction":
        remedy = "leave `encoding` out, or name the columns direction1, direction2, .."
        raise InputError("has no direction columns", table.source, remedy)
    elif chosen is not None:
        signed = chosen.decoded(values)
        _check_stated(chosen, values, signed, table.source)
    else:
        hidden = _detect_code(values)
        if hidden.encoding is None and hidden.seen:
            raise InputError(hidden.seen, table.source, f"state the code with `encoding`, as in {hidden.codes}")
        chosen, signed = hidden.encoding, hidden.signed
    if chosen is None:
        return table
    columns = {name: replace(efforts[name], values=values) for name, values in zip(efforts, signed.T, strict=True)}
    repairs = table.repairs if stated is not None else (*table.repairs, _decoded(table, first, chosen))
    return replace(table, columns=plain | columns, repairs=repairs, encoding=str(chosen))


def _decoded(table: Table, label: str, encoding: Encoding) -> str:
    return f"{table.source}: readings such as {label} hold {encoding.description}: decoded"


def _of_64_bits(table: Table, label: str, stated: Encoding | None) -> Table:
    """A table whose readings the reader has already decoded, as floats cannot hold them."""
    held = Encoding.parse(str(table.encoding))
    if stated not in (None, held):
        raise InputError(f"readings such as {label} hold {held.description}", table.source, "leave `encoding` out")
    return replace(table, repairs=(*table.repairs, _decoded(table, label, held))) if stated is None else table


def _direction_of(given: Mapping[str, Column], name: str) -> Column | None:
    return given.get(f"{DIRECTION}{name.removeprefix(kind_part(name))}")


def _check_stated(encoding: Encoding, values: Array, signed: Array, source: str) -> None:
    """InputError for a code that makes all readings (N, n) positive or all negative, or discontinuous."""
    what = f"readings from {values.min():.6g} to {values.max():.6g} cannot hold {encoding.description}"
    if not (signed < 0.0).any() or not (signed > 0.0).any():
        side = "below" if not (signed < 0.0).any() else "above"
        raise InputError(f"{what}: none is {side} zero", source, "correct `encoding`, or leave it out")
    if encoding.kind != "offset" and (jumps := _jump_ratio(encoding, values)) > 1.0 and np.isfinite(jumps):
        raise InputError(f"{what}: decoding makes them discontinuous", source, "correct `encoding`")


# ---- A code in the reading ----
class _CodeEvidence(NamedTuple):
    """Evidence of a sign code in readings.

    The code if it is certain, and the decoded readings (N, n); a description of the evidence, and the possible codes as
    text.
    """

    encoding: Encoding | None
    signed: Array
    seen: str = ""
    codes: str = CODES


def _detect_code(values: Array) -> _CodeEvidence:
    """Evidence in readings (N, n), none of them negative."""
    steps = np.array([_count_size(column) for column in values.T])
    counts = values / np.where(steps > 0.0, steps, 1.0)
    if steps.all():
        top = float(counts.max())
        bits = max(1, int(np.floor(np.log2(max(top, 1.0)))) + 1)
        candidates = [Encoding("twos", bits), Encoding("sign-bit", bits - 1)] if bits >= TUNING.code_bits else []
        jumps = [_jump_ratio(encoding, counts) for encoding in candidates]
        sure = [encoding for encoding, jump in zip(candidates, jumps, strict=True) if jump <= TUNING.code_joins]
        if len(sure) == 1:
            return _CodeEvidence(sure[0], sure[0].decoded(counts) * steps, f"readings look like {sure[0].description}")
    if (banded := _two_bands(values)) is not None:
        joint, (least, low, high, most) = banded
        seen = f"readings of joint {joint + 1} lie in two bands, {least:.6g} to {low:.6g} and {high:.6g} to {most:.6g}"
        return _CodeEvidence(None, values, seen, _codes_of_bands(low, high, most))
    if np.all(steps == 1.0) and (zero := _offset_zero(counts)) is not None:
        return _CodeEvidence(Encoding("offset", zero), counts - zero, f"readings lie about {zero:g}, never near zero")
    return _CodeEvidence(None, values)


def _codes_of_bands(low: float, high: float, most: float) -> str:
    """Codes that would put two bands in opposite halves of their scale."""
    bits = int(np.ceil(np.log2(max(most, 1.0) + 1.0)))
    half = 2.0 ** (bits - 1)
    return f"twos:{bits} or sign-bit:{bits - 1}" if TUNING.code_bits <= bits <= 52 and low < half <= high else CODES


def _count_size(column: Array) -> float:
    """Size of a count: 1 for integers, 0 if readings are not multiples of one."""
    if np.array_equal(column, np.rint(column)):
        return 1.0
    distinct = np.unique(column)
    if len(distinct) < 3:
        return 0.0
    step = float(np.diff(distinct).min())
    multiples = np.rint(distinct / step)
    step = float(distinct @ multiples / (multiples @ multiples))
    return step if np.abs(distinct / step - np.rint(distinct / step)).max() < TUNING.count_rounding else 0.0


def _jump_ratio(encoding: Encoding, counts: Array) -> float:
    """Steps between both halves of the scale when decoded, over the same steps as recorded.

    The ninth decile; infinite if only one half is used.
    """
    half = 2.0 ** (encoding.number - (encoding.kind == "twos"))
    upper = counts >= half
    crossed = upper[1:] != upper[:-1]
    if crossed.sum() < TUNING.code_crossings or upper.mean() < TUNING.code_share:
        return np.inf
    recorded, decoded = (np.abs(np.diff(part, axis=0))[crossed] for part in (counts, encoding.decoded(counts)))
    return float(np.quantile(decoded / recorded, 0.9))


def _two_bands(values: Array) -> tuple[int, tuple[float, float, float, float]] | None:
    """A joint with the widest empty band in its readings, and the ends of the bands below and above."""
    for joint, column in enumerate(values.T):
        ordered = np.sort(column)
        gaps = np.diff(ordered)
        if not gaps.any() or gaps.max() < TUNING.empty_band * (ordered[-1] - ordered[0]):
            continue
        k = int(np.argmax(gaps)) + 1
        both, least = (ordered[:k], ordered[k:]), TUNING.code_share * len(ordered)
        if all(len(part) >= least and len(np.unique(part)) >= TUNING.band_values for part in both):
            return joint, (both[0][0], both[0][-1], both[1][0], both[1][-1])
    return None


def _offset_zero(counts: Array) -> float | None:
    """The power of two around which the integers of most joints lie, if none comes near zero."""
    moving = np.ptp(counts, axis=0) > 0.0
    inner = counts[:, moving]
    if inner.shape[1] < 2 or not far_from_zero(inner).all():
        return None
    low, middle, high = np.percentile(inner, [1, 50, 99], axis=0)
    zero = 2.0 ** np.rint(np.log2(max(float(np.median(middle)), 1.0)))
    between = (low < zero) & (zero < high)
    off = float(np.median(np.abs(middle - zero) / np.maximum(high - low, 1.0)))  # the zero of a code is a power of two
    fits = np.log2(zero) >= TUNING.code_bits - 1 and inner.max() < 2.0 * zero and 2 * between.sum() > len(between)
    fits = fits and off < TUNING.off_middle
    return float(zero) if fits and between.sum() >= 2 else None


def far_from_zero(effort: Array) -> Mask:
    """(n,) whether nonnegative readings (N, n) never come near zero."""
    far: Mask = effort.min(axis=0) > TUNING.near_zero * effort.max(axis=0)
    return far


def offset_share(effort: Array) -> Array:
    """(n,) offset of readings (N, n) over their variation."""
    low, high = np.percentile(effort, [1, 99], axis=0)
    share: Array = low / np.maximum(high - low, TINY)
    return share


# ---- A direction in a column of its own ----
def _by_direction(
    table: Table, values: Array, direction: Array, stated: Encoding | None
) -> tuple[Encoding | None, Array]:
    """The encoding and the readings (N, n) with the signs of directions; unchanged if directions are not used."""
    kinds = np.unique(direction).tolist()
    if len(kinds) < 2 and stated is None:
        return None, values
    signs = kinds[0] < 0.0 < kinds[-1] and kinds[1:-1] in ([], [0.0])
    if signs and (stated is None or stated.number == kinds[0]):
        encoding = Encoding("direction", kinds[0])
        return encoding, encoding.directed(values, direction)
    if len(kinds) > 2:
        what = f"direction columns hold {', '.join(f'{kind:g}' for kind in kinds[:5])}"
        raise InputError(what, table.source, "write them as -1 and 1")
    if stated is None:
        work = _mean_work(table, np.where(direction == kinds[1], -values, values))
        if work is None or abs(work) < TUNING.least_work:
            remedy = f"give `encoding` direction:{kinds[1]:g} ({kinds[1]:g} is negative) or direction:{kinds[0]:g}"
            what = f"direction columns hold {kinds[0]:g} and {kinds[1]:g}; it is not clear which is negative"
            raise InputError(what, table.source, remedy)
        stated = Encoding("direction", kinds[int(work > 0.0)])
    elif stated.number not in kinds:
        what = f"direction columns hold {' and '.join(f'{kind:g}' for kind in kinds)}, not {stated.number:g}"
        raise InputError(what, table.source, "correct `encoding`")
    return stated, stated.directed(values, direction)


def _mean_work(table: Table, effort: Array) -> float | None:
    """Mean correlation of efforts (N, n) with velocities; positive because drives lose work to friction.

    None without positions, or if the total work has the other sign.
    """
    if not all(f"q{j + 1}" in table.columns for j in range(effort.shape[1])):
        return None
    q = np.column_stack([table.columns[f"q{j + 1}"].values for j in range(effort.shape[1])])
    speed = np.gradient(q, axis=0)
    power = np.linalg.norm(effort, axis=0) * np.linalg.norm(speed, axis=0)
    moves, work = power > 0.0, (effort * speed).sum(axis=0)
    mean = float(np.mean(work[moves] / power[moves])) if moves.any() else 0.0
    return mean if mean * work.sum() > 0.0 else None
