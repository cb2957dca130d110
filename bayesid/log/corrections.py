"""Corrections of a log's joints, as in q1=q3,q3=q1,tau2=-tau2,q5=q5+1.5708,tau3=0.001*tau3.

Positions `q2` or efforts `tau2` (`i2`) are a recorded joint times a factor; positions may get an offset, rad. Without a
number the entry is for all joints: tau=-tau. Velocities follow positions.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.errors import InputError
from bayesid.log.tuning import TUNING

_NUMBER = r"[0-9]+(?:\.[0-9]*)?(?:[eE][+-]?[0-9]+)?|\.[0-9]+"
_ENTRY = re.compile(
    rf"(?P<kind>q|tau|i)(?P<joint>[1-9][0-9]{{0,2}})?\s*=\s*(?P<sign>[+-]?)\s*(?:(?P<factor>{_NUMBER})\s*\*\s*)?"
    rf"(?P<of>q|tau|i)(?P<other>[1-9][0-9]{{0,2}})?\s*(?:(?P<shift>[+-])\s*(?P<zero>{_NUMBER})\s*(?P<unit>deg|rad)?)?"
)
_REMEDY = "give entries as in q1=q3,q3=q1,tau2=-tau2,q5=q5+1.5708 (rad), q5=q5+90deg or tau3=0.001*tau3"


@dataclass(frozen=True)
class Corrected:
    """How the n joints follow from the recorded ones.

    Attributes:
        order: (n,) recorded joint of each joint, 0-based.
        factor: (n,) factor on the recorded values.
        zero: (n,) offset added after the factor, rad.
    """

    order: Integers
    factor: Array
    zero: Array

    def of(self, values: Array, *, zero: bool = False) -> Array:
        """(N, n) corrected values from recorded ones, with or without the offsets."""
        corrected: Array = values[:, self.order] * self.factor
        return corrected + self.zero if zero else corrected

    def recorded(self, values: Array, *, zero: bool = False) -> Array:
        """(N, n) recorded values from corrected ones; the inverse of `of`."""
        shifted = values - self.zero if zero else values
        recorded: Array = (shifted / self.factor)[:, np.argsort(self.order)]
        return recorded

    def recorded_probability(self, positive: Array) -> Array:
        """(N, n) probability that the recorded value is positive, from that of the corrected value."""
        return np.where(self.factor < 0.0, 1.0 - positive, positive)[:, np.argsort(self.order)]


def corrections(text: str | None, n: int) -> tuple[Corrected, Corrected]:
    """Corrections of the positions and of the efforts of n joints, as on the command line; None corrects nothing.

    Raises:
        InputError: an entry is not valid, or names a joint that does not exist.
    """
    made = {kind: Corrected(np.arange(n), np.ones(n), np.zeros(n)) for kind in ("q", "tau")}
    seen: set[tuple[str, int]] = set()
    for entry in text.split(",") if text is not None else ():
        found = _ENTRY.fullmatch(entry.strip())
        kinds = [] if found is None else ["tau" if found[key] == "i" else found[key] for key in ("kind", "of")]
        if found is None or kinds[0] != kinds[1] or (found["joint"] is None) != (found["other"] is None):
            raise InputError(f"{entry.strip()!r:.60} is not a correction", field="correct", remedy=_REMEDY)
        if found["zero"] and kinds[0] == "tau":
            raise InputError(
                f"{entry.strip()!r:.60} adds an offset to an effort; only positions may have one",
                field="correct",
                remedy=_REMEDY,
            )
        factor = (-1.0 if found["sign"] == "-" else 1.0) * float(found["factor"] or 1.0)
        zero = (-1.0 if found["shift"] == "-" else 1.0) * float(found["zero"] or 0.0)
        zero = math.radians(zero) if found["unit"] == "deg" else zero
        if not (0.0 < abs(factor) < TUNING.largest_reading and math.isfinite(zero)):
            raise InputError(f"{entry.strip()!r:.60} has a zero or too large number", field="correct", remedy=_REMEDY)
        pairs = [(j, j) for j in range(n)]
        if found["joint"] is not None:
            pairs = [(int(found["joint"]) - 1, int(found["other"]) - 1)]
        target = made[kinds[0]]
        for joint, other in pairs:
            if max(joint, other) >= n:
                remedy = f"give joints from 1 to {n}"
                raise InputError(f"{entry.strip()!r:.60}: the log has {n} joints", field="correct", remedy=remedy)
            if (kinds[0], joint) in seen:
                raise InputError(f"{kinds[0]}{joint + 1} is given twice", field="correct", remedy="give it once")
            seen.add((kinds[0], joint))
            target.order[joint], target.factor[joint], target.zero[joint] = other, factor, zero
    for kind, target in made.items():
        _check_exchange(kind, target.order.tolist(), {joint for of, joint in seen if of == kind})
    return made["q"], made["tau"]


def _check_exchange(kind: str, order: list[int], given: set[int]) -> None:
    """InputError unless every recorded joint is used exactly once."""
    lost = [j for j in range(len(order)) if j not in order]
    if lost:
        twice = [j for j in range(len(order)) if j not in given and order.count(j) > 1]
        exchange = [(joint, order[joint]) for joint in sorted(given)] + list(zip(twice, lost, strict=False))
        whole = ",".join(f"{kind}{joint + 1}={kind}{of + 1}" for joint, of in exchange if joint != of)
        what = f"{kind}{order[min(given)] + 1} is used for two joints, {kind}{lost[0] + 1} for none"
        raise InputError(what, field="correct", remedy=f"give the whole exchange, as in {whole}")
