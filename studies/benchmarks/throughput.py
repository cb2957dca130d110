"""How many samples a second pass through regressor and moments; a sample is all joints at one instant.

And what the regressor takes over what Pinocchio takes for it, called sample by sample through the same wheel.

python -m bayesid.studies.benchmarks.throughput [--samples 50000]
"""

from __future__ import annotations

import argparse
import time
from statistics import median

import numpy as np
import pinocchio as pin

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.log.segments import Segments
from bayesid.regression.normal_equations import normal_equations
from bayesid.robot import Robot, load_robot
from bayesid.simulation.trajectories import random_trajectory

_SEGMENT = 100
"""Samples a segment."""
_CALLS, _RUNS = 10_000, 5
"""Samples of a regressor, and how often it is made."""


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
    normal_equations(model, coefficients, motion, effort, segments)
    rate = samples / (time.perf_counter() - began)
    return {"coefficients": len(coefficients), "samples_per_second": rate, "over_pinocchio": _over_pinocchio(robot)}


def _over_pinocchio(robot: Robot) -> float:
    """Processor time of a regressor over that of Pinocchio's calls alone, the median of some runs in turn."""
    model = robot.pinocchio
    motion = random_trajectory(robot.n_joints, 20.0).motion(np.linspace(0.0, 20.0, _CALLS))
    ratios = []
    for _ in range(_RUNS):
        data, began = model.createData(), time.process_time()
        for q, dq, ddq in zip(motion.q, motion.dq, motion.ddq, strict=True):
            pin.computeJointTorqueRegressor(model, data, q, dq, ddq)
        alone = time.process_time()
        robot.regressor(motion)
        ratios.append((time.process_time() - alone) / (alone - began))
    return median(ratios)


def main() -> None:
    """Prints a line for each of some robots: both conventions, six and seven joints, coupled motors."""
    parser = argparse.ArgumentParser(description="Throughput of regressor and moments.")
    parser.add_argument("--samples", type=int, default=50_000)
    options = parser.parse_args()
    for name in ROBOTS:
        row = study(name, options.samples)
        rate, ratio = row["samples_per_second"], row["over_pinocchio"]
        width = f"{row['coefficients']:.0f} coefficients"
        print(f"{name:<6} {width}  {rate:>9,.0f} samples/s  regressor {ratio:.2f} x Pinocchio")


if __name__ == "__main__":
    main()
