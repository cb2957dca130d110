"""Drive gains, which convert readings into efforts, and their uncertainty.

A gain has a log-normal prior: 12~20% is 12 N m/A with a standard deviation of 0.2 of its logarithm. An unknown gain has
infinite uncertainty; `bayesid.regression.gains` estimates it with the robot's masses.
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
_REMEDY = f"give one gain per joint, as in 12,16~20%,{UNKNOWN}, '{UNKNOWN}' for all, or a CSV file with columns gain,sd"


@dataclass(frozen=True)
class Gains:
    """The gains of n joints.

    Attributes:
        value: (n,) N m (N of a prismatic joint) per unit of the reading.
        sd: (n,) standard deviation of the logarithm: 0 if exact, inf if unknown.
        of_torques: whether the readings are torques; the gains are then factors without a unit.
        unit: unit of the readings, as in the log: A, mA, %, counts.

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
        if not np.all((np.abs(value) < TUNING.largest_reading) & (value != 0.0)):
            raise InputError(
                "a gain is zero or not finite", field="gains", remedy="give one nonzero gain per joint, N m/A"
            )
        object.__setattr__(self, "value", frozen(value, (None,), "gains"))
        if sd.shape != self.value.shape or not np.all(sd >= 0.0):
            raise InputError("the gains' sd must be one number per joint, 0 or more", field="gains", remedy=_REMEDY)
        sd.setflags(write=False)
        object.__setattr__(self, "sd", sd)

    @property
    def exact(self) -> Mask:
        """(n,) whether a gain is exact."""
        exact: Mask = self.sd == 0.0
        return exact

    @property
    def unknown(self) -> Mask:
        """(n,) whether a gain is unknown."""
        return np.isinf(self.sd)

    @property
    def text(self) -> str:
        """As on the command line and for `read_log`."""
        words = (
            UNKNOWN if math.isinf(sd) else f"{value:.12g}" if sd == 0.0 else f"{value:.12g}~{100.0 * sd:.6g}%"
            for value, sd in zip(self.value.tolist(), self.sd.tolist(), strict=True)
        )
        return ",".join(words)

    @property
    def unit_of_gain(self) -> str:
        """Unit of the values, as in N m/A."""
        return "N m per N m as logged" if self.of_torques else f"N m/{self.unit}"

    def ordered(self, order: Integers) -> Gains:
        """The gains of the joints with these indices, in this order."""
        return replace(self, value=self.value[order], sd=self.sd[order])

    def times(self, factor: Array) -> Gains:
        """The gains with each value multiplied by its factor (n,)."""
        return replace(self, value=self.value * factor)


def gains_of(stated: Gains | Sequence[float] | str | Path, n: int) -> Gains:
    """Gains of n joints from any of their forms; InputError if they are not valid.

    Text is as on the command line: 12,16~20%,unknown, or `unknown` for all, or the name of a CSV file with the columns
    gain and sd, one row per joint.
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
        what = f"{len(gains.value)} gains for {n} joints"
        raise InputError(what, field="gains", remedy="give one gain per joint, N m/A")
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
        raise InputError(f"{word} is uncertain by {100.0 * relative:.3g} %", field="gains", remedy=remedy)
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
            seen = f"{gain!r}, {sd!r} are not a gain and its sd (in the gain's unit or %)"
            raise InputError(seen, f"{path}, line {line}", _REMEDY) from None
    return Gains(*np.transpose(pairs))
