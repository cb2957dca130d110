"""A motion as a CSV table: trajectory.csv of a design, motion.csv of a planned motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayesid.files.writing import write_rows
from bayesid.motion import Motion


def write_motion(path: Path, motion: Motion) -> None:
    """t, q1..qn, dq1..dqn, ddq1..ddqn: s, rad, rad/s, rad/s^2 (m of prismatic joints), to nine decimals."""
    names = ["t", *(f"{prefix}{j}" for prefix in ("q", "dq", "ddq") for j in range(1, motion.n_joints + 1))]
    values = np.round(np.column_stack([motion.t, motion.q, motion.dq, motion.ddq]), 9) + 0.0  # no -0
    write_rows(path, names, ([f"{t:.9g}", *(f"{value:.9f}" for value in row)] for t, *row in values.tolist()))
