"""Candidates of a forward selection and logs for it, all made of sines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesid.regression.knowledge import InformationMatrix
from bayesid.regression.selection.columns import Columns, Whitening
from bayesid.regression.selection.fitted_effects import Observations

RATE = 50.0


@dataclass(frozen=True, eq=False)
class Made:
    """Anything that may explain efforts."""

    columns: Columns
    key: tuple[str, tuple[int, ...]]


def made(name, rows, sd, positive=False, shift=None):
    sides = np.broadcast_to(positive, len(sd)).copy()
    return Made(Columns(rows, shift or {}, np.asarray(sd, dtype=float), sides), (name, tuple(j + 1 for j in rows)))


def waves(rng, count, columns, joints=None, slowest=1.0, fastest=9.0):
    """Sines, one for every column."""
    shape = (columns,) if joints is None else (joints, columns)
    t = np.arange(count) / RATE
    return np.sin(np.multiply.outer(t, rng.uniform(slowest, fastest, shape)) + rng.uniform(0.0, 6.0, shape))


def observed(columns, effort, used=None):
    used = np.ones(effort.shape, dtype=bool) if used is None else used
    n = effort.shape[1]
    return Observations(
        whitening=Whitening(columns * used[:, :, None], used),
        effort=effort * used,
        information=InformationMatrix.none(columns.shape[2]),
        floor=np.ones(n),
        reliable=np.ones(n, dtype=bool),
        limits=np.full((n, 2), np.inf),
        rate=RATE,
    )
