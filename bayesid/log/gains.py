"""Drive gains: what makes efforts of what a controller shows, and how well they are known.

A gain is believed to be log-normal about its value: 12~20% is 12 N m/A with a standard deviation of 0.2 of its
logarithm. Gains that nobody knows are infinitely uncertain here; what a robot's masses say of them is found where the
robot is known (`bayesid.regression.gains`).
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayesid.arrays import Array, Integers, Mask, frozen
from bayesid.errors import InputError
from bayesid.files.bounded import read_source
from bayesid.log.tuning import TUNING

UNKNOWN = "unknown"
_REMEDY = (
    f"give one gain a joint, as in 12,16~20%,{UNKNOWN}, or '{UNKNOWN}' for all, or a CSV file with the columns gain,sd"
)


@dataclass(frozen=True)
class Gains:
    """The gains of n joints by which readings were made efforts.

    Attributes:
        value: (n,) N m (N of a sliding joint) per unit of the reading.
        sd: (n,) standard deviation of each one's logarithm: 0 where it is exact, inf where nobody knows it.
        of_torques: whether the readings were called torques already: the gains then are factors without a unit.
        unit: of the readings, where the log says it: A, mA, %, whatever it is.

    Example:
        >>> gains = bayesid.types.Gains(value=[12.0, 16.0, 10.0], sd=[0.2, 0.2, 0.0])
        >>> gains.text
        '12~20%,16~20%,10'
    """

    value: Array
    sd: Array
    of_torques: bool = False
    unit: str = "A"

    def __post_init__(self) -> None:
        value, sd = np.array(self.value, dtype=float), np.array(self.sd, dtype=float)
        if not np.all((np.abs(value) < TUNING.absurd) & (value != 0.0)):
            raise InputError("a gain is zero or not finite", field="gains", remedy="give one gain per joint, N m/A")
        object.__setattr__(self, "value", frozen(value, (None,), "gains"))
        if sd.shape != self.value.shape or not np.all(sd >= 0.0):
            raise InputError("the gains' sd are not one number a joint, 0 or more", field="gains", remedy=_REMEDY)
        sd.setflags(write=False)
        object.__setattr__(self, "sd", sd)

    @property
    def exact(self) -> Mask:
        """(n,) whether a gain is taken as exact."""
        exact: Mask = self.sd == 0.0
        return exact

    @property
    def unknown(self) -> Mask:
        """(n,) whether nobody knows a gain."""
        return np.isinf(self.sd)

    @property
    def text(self) -> str:
        """As on the command line; what `read_log` takes."""
        words = (
            UNKNOWN if math.isinf(sd) else f"{value:.12g}" if sd == 0.0 else f"{value:.12g}~{100.0 * sd:.6g}%"
            for value, sd in zip(self.value.tolist(), self.sd.tolist(), strict=True)
        )
        return ",".join(words)

    @property
    def unit_of_gain(self) -> str:
        """What the values are in, as N m/A."""
        return "N m per N m as logged" if self.of_torques else f"N m/{self.unit}"

    def ordered(self, order: Integers) -> Gains:
        """Those of the joints with these indices, in their order."""
        return replace(self, value=self.value[order], sd=self.sd[order])

    def times(self, factor: Array) -> Gains:
        """With each value multiplied by its factor (n,)."""
        return replace(self, value=self.value * factor)


def gains_of(stated: Gains | Sequence[float] | str | Path, n: int) -> Gains:
    """Gains of n joints as they were stated, or an InputError where they are none.

    Text is as on the command line: 12,16~20%,unknown, or `unknown` for all, or the name of a CSV file with the columns
    gain and sd, one row a joint.
    """
    if isinstance(stated, str | Path):
        text = str(stated)
        if text.strip() == UNKNOWN:
            gains = Gains(np.ones(n), np.full(n, np.inf))
        elif Path(text).suffix == ".csv":
            gains = _of_file(text)
        else:
            gains = Gains(*np.transpose([_pair(word.strip(), text) for word in text.split(",")]))
    elif isinstance(stated, Gains):
        gains = stated
    else:
        gains = Gains(np.array(stated, dtype=float), np.zeros(len(stated)))
    if len(gains.value) != n:
        said = f"{len(gains.value)} gains for {n} joints"
        raise InputError(said, field="gains", remedy="give one gain per joint, N m/A")
    return gains


def _pair(word: str, text: str) -> tuple[float, float]:
    if word == UNKNOWN:
        return 1.0, math.inf
    number, uncertain, spread = word.partition("~")
    try:
        value = float(number)
        relative = 0.0
        if uncertain:
            relative = float(spread[:-1]) / 100.0 if spread.endswith("%") else float(spread) / abs(value)
    except (ValueError, ZeroDivisionError):
        raise InputError(f"{text!r} is not a list of gains", field="gains", remedy=_REMEDY) from None
    if not 0.0 <= relative <= TUNING.most_uncertain_gain:
        remedy = f"give 0 to {100.0 * TUNING.most_uncertain_gain:.0f} %, or {UNKNOWN}"
        said = f"{word} is uncertain by {100.0 * relative:.3g} %"
        raise InputError(said, field="gains", remedy=remedy)
    return value, relative


def _of_file(path: str) -> Gains:
    text = read_source(path, _REMEDY)
    rows = list(csv.DictReader(io.StringIO(text, newline="")))
    if not rows or not {"gain", "sd"} <= set(rows[0]):
        raise InputError("has no columns gain, sd", path, _REMEDY)
    pairs = []
    for line, row in enumerate(rows, start=2):
        gain, sd = (str(row[key] or "").strip() for key in ("gain", "sd"))
        try:
            pairs.append(_pair(f"{gain}~{sd}" if sd else gain, ""))
        except InputError:
            seen = f"{gain!r}, {sd!r} are no gain with its sd, in its unit or %"
            raise InputError(seen, f"{path}, line {line}", _REMEDY) from None
    return Gains(*np.transpose(pairs))
