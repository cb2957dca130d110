"""Dry friction near standstill: how it turns round there no term says, and no effect should be named for it alone.

A term smooths the turn of friction as tanh(u' / v), with v the speed below which a log hardly shows its direction. A
friction that turns round at once differs from it by tanh(k u' / v) - tanh(u' / v), up to half of it at speeds about
v: on a log with little noise enough for the evidence of an effect that acts at low speed (study `complete`, 8 bit).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.effects.coulomb_friction import DryTerm
from bayesid.effects.model import Model
from bayesid.motion import Motion
from bayesid.regression.selection.columns import NO_COLUMNS, Columns
from bayesid.regression.selection.hypotheses import usual_amplitudes

_SHARPER = 4.0
"""k: below a quarter of the speed at which friction's direction is no longer shown a turn is as good as none. A round
number."""


def near_standstill(model: Model, motion: Motion, size: Array, used: Mask) -> Columns:
    """What a model's dry friction may be wrong by where it turns round.

    Args:
        model: whose terms of dry friction are looked at.
        motion: N instants.
        size: (n,) RMS effort of each joint, N m.
        used: (N, n) samples that count.
    """
    columns = [_turning_at_once(model, term, motion) for term in model.terms if isinstance(term, DryTerm)]
    if not columns:
        return NO_COLUMNS
    together = np.concatenate(columns, axis=2)
    rows = {j: together[:, j] for j in range(len(size))}
    return Columns(rows, {}, usual_amplitudes(rows, size, used), np.zeros(together.shape[2], dtype=bool))


def _turning_at_once(model: Model, term: DryTerm, motion: Motion) -> Array:
    """(N, n, p) what would come on top of a term whose friction turns round at once."""
    at_once = replace(term, smoothing=tuple(speed / _SHARPER for speed in term.smoothing))
    return at_once.columns(model.robot, motion) - term.columns(model.robot, motion)
