"""How many samples a second pass through regressor and moments; a sample is all joints at one instant.

python -m bayesid.studies.benchmarks.throughput [--samples 50000]
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from bayesid.fit.moments import moments
from bayesid.log.segments import Segments
from bayesid.model.catalogue import make_terms
from bayesid.model.coefficients import base_coefficients
from bayesid.model.model import Model
from bayesid.model.robot import load_robot
from bayesid.model.terms import STANDARD
from bayesid.simulation.trajectories import random_trajectory

_SEGMENT = 100
"""Samples a segment."""


ROBOTS = ("kr5", "ur10e", "panda", "tx40")


def study(robot_name: str, samples: int) -> dict[str, float]:
    """Samples a second of one robot with all default terms."""
    robot = load_robot(robot_name)
    n = robot.n_joints
    motion = random_trajectory(n, 20.0).motion(np.linspace(0.0, samples * 1e-3, samples))
    model = Model(robot, make_terms(STANDARD, robot, motion))
    coefficients = base_coefficients(model)
    starts = np.arange(0, samples, _SEGMENT)
    ends = np.minimum(starts + _SEGMENT, samples)
    unknown, moving = np.zeros(n * len(starts), dtype=np.int64), np.ones(n * len(starts), dtype=bool)
    joints = np.repeat(np.arange(n), len(starts))
    segments = Segments(joints, np.tile(starts, n), np.tile(ends, n), unknown, moving)
    effort = np.abs(motion.ddq)
    began = time.perf_counter()
    moments(model, coefficients, motion, effort, segments)
    return {"coefficients": len(coefficients), "samples_per_second": samples / (time.perf_counter() - began)}


def main() -> None:
    """Prints a line for each of some robots: both conventions, six and seven joints, coupled motors."""
    parser = argparse.ArgumentParser(description="Throughput of regressor and moments.")
    parser.add_argument("--samples", type=int, default=50_000)
    options = parser.parse_args()
    for name in ROBOTS:
        row = study(name, options.samples)
        print(f"{name:<6} {row['coefficients']:.0f} coefficients  {row['samples_per_second']:>9,.0f} samples/s")


if __name__ == "__main__":
    main()
