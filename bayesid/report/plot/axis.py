"""One axis of a panel: its ends, round numbers between them, and what room their text needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from bayesid.arrays import Array

_ROUND = (1.0, 2.0, 2.5, 5.0)
"""Steps between numbers, times a power of ten; as matplotlib's."""
_MOST = 9
"""Steps of an axis, however long."""
_LARGE, _SMALL = 1e5, 1e-4
"""Numbers from and below which a power of ten is written beside the axis."""
_SAME = 1e-12
"""Relative distance at which the ends of an axis are one value, and room is made around it."""
_NARROW = frozenset("ijl.,:;'|!()[]1 ")
"""Letters that are half as broad as the others."""


def text_width(text: str, size: float) -> float:
    """Points that a line of text is about broad, in a font that is broader than most; size in points."""
    return size * sum(0.36 if letter in _NARROW else 0.64 for letter in text)


def round_numbers(low: float, high: float, room: int) -> Array:
    """Multiples of a round step from low to high: `room` steps at most, but two numbers at least."""
    power = 10.0 ** np.floor(np.log10((high - low) / room))
    steps = [one * power * ten for ten in (0.1, 1.0, 10.0) for one in _ROUND]
    fitting = next(k for k, step in enumerate(steps) if step >= (high - low) / room * (1.0 - 1e-9))
    for step in reversed(steps[: fitting + 1]):
        first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
        if last > first:
            break
    return step * np.arange(first, last + 1.0)


def number_texts(numbers: Array) -> tuple[list[str], str]:
    """Numbers that are evenly spaced, to as many digits as tell them apart, and the power of ten that they lack."""
    largest = float(np.abs(numbers).max(initial=0.0))
    power = int(np.floor(np.log10(largest))) if largest and not _SMALL <= largest < _LARGE else 0
    scaled = numbers / 10.0**power
    step = min((b - a for a, b in pairwise(scaled.tolist())), default=1.0)
    digits = next((d for d in range(12) if abs(step * 10**d - round(step * 10**d)) < 1e-6 * step * 10**d), 12)
    texts = [f"{0.0 if abs(one) < 1e-9 * step else one:.{digits}f}".replace("-", "\N{MINUS SIGN}") for one in scaled]
    return texts, f"1e{power}".replace("-", "\N{MINUS SIGN}") if power else ""


@dataclass
class Axis:
    """What is known of an axis while a panel is drawn on.

    Attributes:
        margin: free at each end, as a share of what the data take.
        inverted: whether it runs the other way.
    """

    margin: float = 0.05
    inverted: bool = False
    _data: list[float] = field(default_factory=list)
    _base: list[float] = field(default_factory=list)
    _limits: tuple[float, float] | None = None
    _numbers: tuple[Array, list[str]] | None = None

    def take(self, values: ArrayLike, base: bool = False) -> None:
        """Makes room for data; on a base, as that of bars, an end may lie without a margin."""
        finite = np.asarray(values, dtype=float)
        finite = finite[np.isfinite(finite)]
        if finite.size:
            self._data += [float(finite.min()), float(finite.max())]
            self._base += self._data[-2:] if base else []

    def limit(self, first: float, last: float) -> None:
        """Its ends, whatever the data."""
        self._limits = float(first), float(last)

    def number(self, places: ArrayLike, texts: Sequence[str] | None) -> None:
        """What stands at which places, in place of round numbers."""
        array = np.asarray(places, dtype=float)
        self._numbers = array, [f"{place:g}" for place in array] if texts is None else list(texts)

    @property
    def ends(self) -> tuple[float, float]:
        """Left and right, or bottom and top."""
        first, last = self._limits or self._around_data()
        if abs(last - first) <= _SAME * max(abs(first), abs(last)):
            room = 0.05 * abs(first) or 0.05
            first, last = first - room, last + room
        return (last, first) if self.inverted else (first, last)

    def _around_data(self) -> tuple[float, float]:
        low, high = min(self._data, default=0.0), max(self._data, default=1.0)
        room = self.margin * (high - low)
        return low - room * (low not in self._base), high + room * (high not in self._base)

    def share(self, values: ArrayLike) -> Array:
        """Where values stand: 0 at the left or the bottom, 1 at the other end."""
        first, last = self.ends
        return (np.asarray(values, dtype=float) - first) / (last - first)

    def numbers(self, length: float, apart: float) -> tuple[Array, list[str], str]:
        """Where on it what stands, and the power of ten; of an axis of a length, with steps of about `apart` points."""
        low, high = sorted(self.ends)
        if self._numbers is None:
            places = round_numbers(low, high, int(np.clip(length // apart, 1, _MOST)))
            texts, power = number_texts(places)
        else:
            (places, texts), power = self._numbers, ""
        share = self.share(places)
        shown = (share > -1e-9) & (share < 1.0 + 1e-9)
        return share[shown], [text for text, here in zip(texts, shown, strict=True) if here], power
