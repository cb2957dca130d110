"""A log whose columns are mixed up: joints exchanged or a position reversed, said with what would mend it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.discrepancy.compare import Trial
from bayesid.errors import InputError
from bayesid.log.log import Log
from bayesid.motion import Motion

_SAMPLES = 400
"""On which every mix-up is tried, spread evenly; a round number."""
_SUSPECT = 0.25
"""Mean squared error of a joint, over what its measured efforts vary by, from which on mix-ups are tried; a round
number, trying costs little."""
_MENDED = 0.1
"""Share of the error in such joints that a mix-up may leave at most once it is mended: no effect of a robot is undone
by exchanging columns. A round number; not studied."""


@dataclass(frozen=True)
class _MixUp:
    """What may have happened to the columns of a log.

    Attributes:
        said: what it looks like, and
        remedy: what to do.
        positions: (n,) which column holds the position of each joint, and
        sides: (n,) 1 or -1, by what it is multiplied.
        efforts: (n,) which column holds the effort of each joint.
    """

    said: str
    remedy: str
    positions: Integers
    sides: Array
    efforts: Integers

    def motion(self, motion: Motion) -> Motion:
        """Mended."""
        q, dq, ddq = (x[:, self.positions] * self.sides for x in (motion.q, motion.dq, motion.ddq))
        return replace(motion, q=q, dq=dq, ddq=ddq)


def check_columns(effort_of: Callable[[Motion], Array], trial: Trial, log: Log) -> None:
    """The log's columns belong to the joints that they name, as far as the model can tell.

    Only where the model explains some joint badly are mix-ups tried; one is said if mending it mends these joints.

    Args:
        effort_of: the model's effort (N, n) in a motion, N m.
        trial: the log.
        log: named in the error.

    Raises:
        InputError: two joints, or two columns of positions or efforts, are exchanged, or a position is reversed.
    """
    some = np.unique(np.linspace(0, len(trial.used) - 1, _SAMPLES).astype(int))
    motion, n = trial.signals.motion[some], trial.used.shape[1]

    def errors(mix_up: _MixUp) -> Array:
        """(n,) mean squared, over what the measured efforts vary by; 0 of a joint that hardly moves."""
        measured, used = trial.magnitude[some][:, mix_up.efforts], trial.used[some][:, mix_up.positions]
        misses = (measured - np.abs(effort_of(mix_up.motion(motion)))) ** 2
        ratio = np.zeros(n)
        for j in np.flatnonzero(used.any(axis=0)):
            ratio[j] = misses[used[:, j], j].mean() / max(float(measured[used[:, j], j].var()), np.finfo(float).tiny)
        return ratio

    as_is = errors(_as_is(n))
    if not (suspect := as_is > _SUSPECT).any():
        return
    tried = [(errors(one), one) for one in _mix_ups(n)]
    left, best = min(tried, key=lambda pair: float(pair[0].sum()))
    if left[suspect].sum() < _MENDED * as_is[suspect].sum():
        raise InputError(f"{best.said}: as it is the model does not explain the log", log.source, best.remedy)


def _as_is(n: int) -> _MixUp:
    return _MixUp("", "", np.arange(n), np.ones(n), np.arange(n))


def _mix_ups(n: int) -> Iterator[_MixUp]:
    """Every one that is tried: of one joint or two."""
    own = np.arange(n)
    for j in range(n):
        sides = np.where(own == j, -1.0, 1.0)
        said = f"the positions of joint {j + 1} look reversed"
        yield _MixUp(said, f"multiply column q{j + 1} (and dq{j + 1}) by -1", own, sides, own)
    for i, j in combinations(range(n), 2):
        other, ones = own.copy(), np.ones(n)
        other[[i, j]] = j, i
        pair = f"joints {i + 1} and {j + 1}"
        q, tau = (f"columns {symbol}{i + 1} and {symbol}{j + 1}" for symbol in ("q", "tau"))
        yield _MixUp(f"{pair} look swapped", f"exchange {q}, and {tau}", other, ones, other)
        yield _MixUp(f"the positions of {pair} look swapped", f"exchange {q} (and dq)", other, ones, own)
        yield _MixUp(f"the efforts of {pair} look swapped", f"exchange {tau}", own, ones, other)
