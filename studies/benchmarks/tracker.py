"""How many false alarms does a tracker raise, and how long does an update take? A simulated hour.

A Panda with the standard friction and white noise of 3 % of each joint's RMS effort is identified from 20 s without
signs. Then 30 other random motions of two minutes, with pauses of 1 s between them, are tracked at 100 Hz from
|effort|. `python -m bayesid.studies.benchmarks.tracker [MINUTES]` prints alarms, times of an update, and the growth of
Python's memory over 50,000 updates after the first 5,000.
"""

from __future__ import annotations

import sys
import tracemalloc

import numpy as np

from bayesid.arrays import Array
from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.identification.pipeline import identify
from bayesid.monitor.replay import StreamFigures, timed
from bayesid.monitor.tracker import SignTracker
from bayesid.motion import Motion
from bayesid.parallel import one_blas_thread
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory
from bayesid.studies.simulated import make_robot

_RATE, _LEARNED, _PERIOD, _NOISE = 100.0, 20.0, 20.0, 0.03
"""Hz; s of the identified log; s of a motion's period; noise relative to each joint's RMS effort."""
_MOTION, _PAUSE = 120.0, 1.0
"""s of a motion, and of the pause before the next."""
_ANOTHER = 3_000_000
"""Added to a motion's number for its seed."""


def _motion(robot_joints: int, seed: int, seconds: float) -> Motion:
    time = np.arange(round(seconds * _RATE)) / _RATE
    return random_trajectory(robot_joints, _PERIOD, rng=seed).motion(time)


@one_blas_thread
def track(known: IdentifiedModel, truth: Model, theta: Array, minutes: float) -> None:
    """Tracks some minutes, and prints alarms and times."""
    n, rng = truth.robot.n_joints, np.random.default_rng(7)
    tracker, figures = SignTracker(known, _RATE), StreamFigures.of_joints(n)
    motions = max(1, round(60.0 * minutes / _MOTION))
    for k in range(motions):
        motion = _motion(n, _ANOTHER + k, _MOTION)
        usual = truth.effort(motion, theta)
        effort = np.abs(usual + _NOISE * np.sqrt((usual**2).mean(axis=0)) * rng.standard_normal(usual.shape))
        for t, q, e in zip(motion.t + k * (_MOTION + _PAUSE), motion.q, effort, strict=True):
            timed(tracker, figures, float(t), q, e, None)
    counts, alarms = tracker.counts, tracker.alarms
    print(f"{counts.updates:,} updates of {n} joints, {counts.gaps} gaps: {len(alarms)} alarms in {minutes:g} min")
    print("\n".join(str(alarm) for alarm in alarms))
    median, late = (1e6 * figures.times.quantile(share) for share in (0.5, 0.999))
    print(f"an update: median {median:.0f} us, 99.9th percentile {late:.0f} us")
    print("largest external torque over its threshold:", np.round(figures.pushed, 2).tolist())


def memory(known: IdentifiedModel, warm: int = 5_000, updates: int = 50_000) -> int:
    """Growth of Python's memory over `updates`, bytes."""
    n = known.model.robot.n_joints
    motion = _motion(n, _ANOTHER, _PERIOD)
    effort = np.abs(known.model.effort(motion, known.theta))
    tracker, before = SignTracker(known, _RATE), 0
    tracemalloc.start()
    for k in range(warm + updates):
        if k == warm:
            before = tracemalloc.get_traced_memory()[0]
        tracker.update(k / _RATE, motion.q[k % len(motion)], effort[k % len(motion)])
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    return grown


def main(minutes: float = 60.0) -> None:
    """Identifies, tracks, and measures memory."""
    robot = make_robot("panda")
    learned = _motion(robot.n_joints, 0, _LEARNED)
    truth = Model(robot, make_terms(STANDARD, robot, learned))
    theta = random_parameters(truth, rng=np.random.default_rng(0))
    log = simulate(truth, theta, learned, rng=np.random.default_rng([0, 7]), noise=_NOISE)
    search = Certified(budget=3.0)
    known = identify(robot, log, STANDARD, complete="off", search=search, posterior=False).identified
    track(known, truth, theta, minutes)
    print(f"memory: growth of {memory(known):,} bytes over 50,000 updates")


if __name__ == "__main__":
    main(*map(float, sys.argv[1:2]))
