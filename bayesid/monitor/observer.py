"""External torques by the generalised momentum (De Luca and Mattone 2003; Haddadin, De Luca, Albu-Schaeffer 2017).

The momentum p = M(q) dq changes by what motors and surroundings do::

    p' = tau + C'dq - g - f + tau_ext,

f friction and the like. Its observer r' = K (p' - (tau + C'dq - g - f) - r) follows tau_ext with a lag of 1 / K, and
needs no acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan

import numpy as np

from bayesid.arrays import Array

GAIN = 35.0
"""1/s, K: a step is followed to 63 % in 29 ms. Haddadin et al. use 25 to 100; not studied beyond `bayesid study
tracking`."""


@dataclass
class Observed:
    """State of the observer.

    Attributes:
        external: (n,) r, N m.
        momentum: (n,) p at the last sample; nan before the first one.
        lasting: (n,) sd of what lasts in r, N m: model error and what the motion leaves open.
        fast: (n,) variance of what the readings' noise leaves in r, (N m)^2.
        bounded: (n,) what friction of unknown direction leaves in r at most, N m.
    """

    external: Array
    momentum: Array
    lasting: Array
    fast: Array
    bounded: Array

    @classmethod
    def begin(cls, n: int) -> Observed:
        """Before the first sample."""
        return cls(np.zeros(n), np.full(n, np.nan), *np.zeros((3, n)))


@dataclass(frozen=True)
class Doubt:
    """What may be wrong with the torques that drive the joints.

    Attributes:
        lasting: (n,) sd of what is wrong for a while, N m.
        white: (n,) and from sample to sample.
        bounded: (n,) largest error of friction whose direction is not known, N m.
    """

    lasting: Array
    white: Array
    bounded: Array

    def in_joints(self, to_joints: Array) -> Doubt:
        """The same of joints, by the matrix (n, n) that brings efforts of actuators there."""
        square = to_joints * to_joints
        lasting, white = (np.sqrt(square @ (part * part)) for part in (self.lasting, self.white))
        return Doubt(lasting, white, np.abs(to_joints) @ self.bounded)


def observe(state: Observed, step: float, momentum: Array, driving: Array, doubt: Doubt) -> None:
    """One more sample: implicit in r, so that no step is too long.

    Args:
        state: is changed.
        step: since the last sample, s.
        momentum: (n,) p, N m s.
        driving: (n,) tau + C'dq - g - f, N m.
        doubt: about that.
    """
    share = GAIN * step / (1.0 + GAIN * step)
    if isnan(state.momentum[0]):
        state.lasting, state.bounded = doubt.lasting, doubt.bounded
    else:
        change = momentum - state.momentum - step * driving
        state.external = (1.0 - share) * (state.external + GAIN * change)
        state.lasting = state.lasting + share * (doubt.lasting - state.lasting)
        state.bounded = state.bounded + share * (doubt.bounded - state.bounded)
        white = share * doubt.white
        state.fast = (1.0 - share) ** 2 * state.fast + white * white
    state.momentum = momentum


def threshold(state: Observed, deviations: float) -> Array:
    """(n,) size of an external torque that is no error, N m: so many standard deviations, and what friction may do."""
    size: Array = deviations * np.sqrt(state.lasting * state.lasting + state.fast) + state.bounded
    return size
