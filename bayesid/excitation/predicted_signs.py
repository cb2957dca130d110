"""How many signs a recording will leave certain, predicted before it is made."""

from __future__ import annotations

import numpy as np

from bayesid.excitation.known import Known, inverse
from bayesid.excitation.resolvability import mistaken, resolvability
from bayesid.identification.identification import SURE
from bayesid.motion import Motion

_TINY = 1e-300
"""Guard of a division."""


def certain_share(known: Known, motion: Motion, period: float) -> float:
    """Share of the |effort| in motion, each joint alike, in segments whose sign will be sure to 99 %.

    A segment's sign is doubtful where turning it costs little (:eq:`resolvability`), all that is known beforehand
    counted as data. Segments end where effort or speed change their sign, and are turned one by one.

    Args:
        known: the result.
        motion: N samples of the recording, one a period.
        period: s.
    """
    columns, weights = known.columns(motion), known.weights(motion, period)
    effort = columns[:, :, : len(known.coefficients)] @ known.mean[: len(known.coefficients)]
    speed = known.model.robot.actuators(motion).dq
    n_samples, n = effort.shape
    state = 2 * (effort > 0.0) + (speed > 0.0) + 4 * (weights > 0.0)
    first = np.flatnonzero(np.vstack([np.ones((1, n), dtype=bool), state[1:] != state[:-1]]).T)
    rows = (columns * (weights * effort)[:, :, None]).swapaxes(0, 1).reshape(n * n_samples, -1)
    gradient = np.add.reduceat(rows, first)
    energy = np.add.reduceat((weights * effort**2).T.ravel(), first)
    left = inverse(known.precision + known.information(motion, period))
    certain = mistaken(resolvability(left, gradient, energy)) <= 1.0 - SURE
    size = np.add.reduceat((np.abs(effort) * (weights > 0.0)).T.ravel(), first)
    joint = first // n_samples
    whole = np.bincount(joint, size, n)
    shares = np.bincount(joint, size * certain, n)[whole > 0.0] / np.maximum(whole[whole > 0.0], _TINY)
    return float(shares.mean()) if len(shares) else 0.0
