"""Coefficients whose intervals are too narrow if the robot has what the log cannot tell from them.

A counterbalance that balances gravity well is gravity to a log: whatever share of an effect the model's columns stand
for, its coefficients take, and no residual shows it. Of a geometry that is far off its table the derivatives are no
longer enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.regression.selection.hypotheses import EffectKey
from bayesid.regression.selection.kinematics import KINEMATICS

_MOVED = 2.0
"""Standard deviations, half an interval of 95 %, by which an effect moves a coefficient."""
_FAR_OFF = 2.0
"""Times the tolerance from which on the geometry is not what it was believed to be: two standard deviations."""


@dataclass(frozen=True)
class TooNarrow:
    """Coefficients whose intervals are too narrow if one of several effects is there.

    Attributes:
        effects: any of which would look like these coefficients.
        joints: from 1; none: the whole robot.
        coefficients: those that would be off, the most first.
        times: as far as believed, if the log shows that it is there: the geometry.
    """

    effects: tuple[str, ...]
    joints: tuple[int, ...]
    coefficients: tuple[str, ...]
    times: float | None = None


def too_narrow(
    stood_for: Sequence[tuple[EffectKey, Array]], names: Sequence[str], sd: Array, of_links: Mask
) -> tuple[TooNarrow, ...]:
    """Effects that would mostly look like the links, joint by joint: those of friction only share its name.

    Args:
        stood_for: effects and by how much they move the r coefficients.
        names: (r,) of the coefficients.
        sd: (r,) their standard deviations.
        of_links: (r,) whether links have a part in them.
    """
    moved: dict[tuple[int, ...], tuple[list[str], Array]] = {}
    known = np.isfinite(sd) & (sd > 0.0)
    for (effect, joints), size in stood_for:
        times = np.where(known, size / np.where(known, sd, 1.0), 0.0)
        if times.max(initial=0.0) <= _MOVED or not of_links[times.argmax()]:
            continue
        effects, most = moved.setdefault(joints, ([], np.zeros(len(names))))
        effects.append(effect)
        np.maximum(most, times, out=most)
    return tuple(
        TooNarrow(tuple(sorted(set(effects))), joints, _named(names, most)) for joints, (effects, most) in moved.items()
    )


def geometry_far_off(scale: float, by_geometry: Array, names: Sequence[str], sd: Array) -> tuple[TooNarrow, ...]:
    """What a geometry off by `scale` times what was believed makes doubtful; nothing where it is as believed.

    Args:
        scale: of the geometry's error.
        by_geometry: (r,) sd that this adds to the coefficients.
        names: (r,) of the coefficients.
        sd: (r,) their standard deviations without anything unseen.
    """
    if scale <= _FAR_OFF:
        return ()
    known = np.isfinite(sd) & (sd > 0.0)
    times = np.where(known, by_geometry / np.where(known, sd, 1.0), 0.0)
    named = _named(names, times)
    return (TooNarrow((KINEMATICS[0],), (), named, scale),) if named else ()


def _named(names: Sequence[str], times: Array) -> tuple[str, ...]:
    order = np.argsort(-times, kind="stable")
    return tuple(names[k] for k in order.tolist() if times[k] > _MOVED)
