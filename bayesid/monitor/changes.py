"""What changes while the robot runs: contacts, which are short, and changes of the robot, which last.

A contact is an external torque beyond its threshold. A change is tested for in each joint by itself, by cumulative sums
of the log likelihood ratio of residuals that are `_WIDER` times as wide as they should be (Page 1954)::

    S <- max(0, S + (z^2 / 2 (1 - 1 / w^2) - log w) / tau),

z the residual over its sd, and tau the samples that count as one. S reaches h by chance once in e^h such samples, at
most (Lorden 1971): h follows from the false alarms an hour that are accepted. A sum that has reached it, having grown
for `_LASTING` and often enough, is a change; what pushes for a moment does not last so long. Which kind of change it
looks like is then said by least squares (`bayesid.monitor.kinds`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtri

from bayesid.arrays import Array, Mask
from bayesid.monitor.observer import GAIN
from bayesid.regression.noise import Noise

_WIDER = 2.0
"""How many times as wide a residual is that is tested for: one that nobody would overlook. A round number; not
studied."""
_SQUARE, _SIZE = 0.5 * (1.0 - 1.0 / _WIDER**2), float(np.log(_WIDER))
"""What z^2 adds to a sum, and what each sample takes from it."""
_SHOWS = float(np.sqrt(_SIZE / _SQUARE))
"""z from which on a sum grows."""
_OTHER_MOTION = 2.0
"""Residual on another motion over that of the log a model was identified from. Set by hand; not studied."""
_LARGEST = 6.0
"""z beyond which a residual says no more: a single outlier is no change."""
_LASTING = 0.6
"""s of motion in which a change has shown, at least: three times as long as a push. A round number; not studied."""
_REACHED = 0.6
"""s over which a sum needs to grow to reach its limit, at least. Not studied."""
_OFTEN = 0.4
"""Share of the motion since it began in which a change has shown, at least: several pushes are none. Not studied."""
_SHORTEST = 0.05
"""s that count as one sample at least: what a model lacks changes with the motion, not from sample to sample."""
_RELEASE = 0.6
"""Share of its threshold below which an external torque has ended: it may flicker about it. Not studied."""
_HOUR = 3600.0
_HIGHEST = 1.25
"""Of the sums, in limits: so that they come down again when a change is over."""


@dataclass
class Sums:
    """State of the tests.

    Attributes:
        sums: (n,) S.
        since: (n,) s of motion since S was zero.
        shown: (n,) s of that in which S grew.
        began: (n,) when S left zero, s.
        pushed: (n,) whether an external torque is beyond its threshold.
        beyond: (n,) whether it was so at the last sample: a single one may be an outlier.
    """

    sums: Array
    since: Array
    shown: Array
    began: Array
    pushed: Mask
    beyond: Mask

    @classmethod
    def begin(cls, n: int) -> Sums:
        """Before the first sample."""
        return cls(*np.zeros((4, n)), *np.zeros((2, n), dtype=bool))


@dataclass(frozen=True)
class ChangeTest:
    """The tests, made ready.

    Attributes:
        noise: of the model's residual, N m.
        rate: of the samples, Hz.
        false_alarms: an hour, of the whole robot: contacts and changes each.
    """

    noise: Noise
    rate: float
    false_alarms: float

    @cached_property
    def lasting_square(self) -> Array:
        """(n,) variance of what the model lacks on another motion, (N m)^2."""
        return np.asarray((_OTHER_MOTION * self.noise.coloured) ** 2)

    @cached_property
    def deviations(self) -> float:
        """Standard deviations of its threshold beyond which an external torque counts.

        An observer of gain K has about K independent values a second.
        """
        values = _HOUR * GAIN * len(self.noise.white)
        return float(-ndtri(0.5 * min(0.5, self.false_alarms / values)))

    @cached_property
    def limit(self) -> float:
        """Of a sum, h."""
        return float(np.log(_HOUR * (self.rate * self.weight).sum() / self.false_alarms))

    @cached_property
    def weight(self) -> Array:
        """(n,) share of an effective sample that a sample of a joint is."""
        slow = (self.noise.coloured / self.noise.sigma) ** 2
        seconds = (1.0 - slow) / self.rate + slow * 2.0 * self.noise.correlation
        return np.minimum(1.0 / (np.maximum(seconds, _SHORTEST) * self.rate), 1.0)

    def width(self, doubt: Array) -> Array:
        """(n,) sd of the residual on another motion, N m, with what else is in doubt (n,) about it."""
        width: Array = np.sqrt(self.width_square + doubt * doubt)
        return width

    @cached_property
    def width_square(self) -> Array:
        """(n,) variance of the residual on another motion, (N m)^2."""
        return np.asarray((_OTHER_MOTION * self.noise.sigma) ** 2)

    def add(self, state: Sums, t: float, step: float, z: Array, moving: Mask) -> Mask:
        """(n,) which joints have changed, by one more sample; those at standstill say nothing.

        Args:
            state: is changed.
            t: the instant, s.
            step: since the sample before, s.
            z: (n,) residuals over their width.
            moving: (n,) False at standstill.
        """
        size = np.abs(z)
        if max(size.tolist()) <= _SHOWS and not any(state.sums.tolist()):
            return self._none
        size = np.minimum(size, _LARGEST)
        ratio = np.minimum((_SQUARE * size * size - _SIZE) * self.weight, self._most) * moving
        sums = np.minimum(np.maximum(state.sums + ratio, 0.0), _HIGHEST * self.limit)
        state.began = np.where(state.sums == 0.0, t, state.began)
        state.since = np.where(sums == 0.0, 0.0, state.since + step * moving)
        state.shown = np.where(sums == 0.0, 0.0, state.shown + step * (ratio > 0.0))
        state.sums = sums
        changed: Mask = (sums >= self.limit) & (state.shown >= np.maximum(_LASTING, _OFTEN * state.since))
        return changed

    def forget(self, state: Sums, joints: Mask) -> None:
        """Begins anew in some joints (n,): what shows again lasts."""
        state.sums, state.since, state.shown = (
            np.where(joints, 0.0, part) for part in (state.sums, state.since, state.shown)
        )

    @cached_property
    def _most(self) -> float:
        """That a sample adds to a sum: a push, which shows for twice its length, must not reach the limit."""
        return self.limit / (_REACHED * self.rate)

    @cached_property
    def _none(self) -> Mask:
        return np.zeros(len(self.noise.white), dtype=bool)

    def push(self, state: Sums, external: Array, threshold: Array) -> Mask:
        """(n,) which joints feel an external torque (n,), N m."""
        size = np.abs(external)
        beyond = size > threshold
        state.pushed = (beyond & state.beyond) | (state.pushed & (size > _RELEASE * threshold))
        state.beyond = beyond
        return state.pushed
