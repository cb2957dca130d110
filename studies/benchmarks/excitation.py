"""Do designed motions help to find signs? Designs by the condition number against random motions of the same limits.

Random robots; logs so short and noisy that some signs are wrong. `python -m bayesid.studies.benchmarks.excitation
[TRIALS] [ROBOT ..]` prints the share of right signs by robot and kind of motion.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.excitation.design import ExcitationDesign, design_for_robot
from bayesid.excitation.settings import MotionSettings
from bayesid.identification.options import Preprocessing
from bayesid.identification.pipeline import identify
from bayesid.log.segments import Segmentation
from bayesid.motion import Motion
from bayesid.robot import Robot
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory
from bayesid.studies.simulated import STRONG


@dataclass(frozen=True)
class Case:
    """Settings for a robot; noise is relative to the RMS efforts."""

    terms: tuple[str, ...]
    noise: float
    duration: float = 3.0
    rate: float = 100.0
    cutoff: float = 4.0


CASES = {"kr5": Case(("rigid_body",), 1.0), "ur10e": Case(STANDARD, 1.0)}
_SEEDS = (0, 1, 2, 3)
"""Of the designs of each robot."""
_UNSEEN = 1000
"""Added to the seed of a trial, so that robots differ from those of the designs."""
_EVALUATIONS = 3000
"""Of a design's objective: half of the default."""
_BUDGET = 0.3
"""Nominal seconds of a proof: signs are scored, not proven."""
_COARSE = Segmentation(prominence=0.1)
"""Ignores minima of |effort| due to noise."""


def designs(robot: str, case: Case) -> list[ExcitationDesign]:
    """One design per seed."""
    settings = MotionSettings(duration=case.duration, rate=case.rate, changes=_EVALUATIONS)
    return [design_for_robot(robot, case.terms, settings=settings, seed=seed) for seed in _SEEDS]


def random_motions(design: ExcitationDesign) -> list[Motion]:
    """One motion per seed, within the limits of a design."""
    n, duration = design.model.robot.n_joints, float(design.motion.t[-1])
    made = [random_trajectory(n, duration, rng=seed, limits=design.limits) for seed in _SEEDS]
    return [trajectory.motion(design.motion.t) for trajectory in made]


def share_right(robot: Robot, motion: Motion, case: Case, seed: int) -> float:
    """Share of the strong samples of a log of the motion whose sign is right."""
    rng = np.random.default_rng(_UNSEEN + seed)
    model = Model(robot, make_terms(case.terms, robot, motion))
    theta = random_parameters(model, rng=rng)
    log = simulate(model, theta, motion, rng=rng, noise=case.noise)
    search, preprocessing = Certified(budget=_BUDGET), Preprocessing(cutoff=case.cutoff, prominence=_COARSE.prominence)
    result = identify(
        robot, log, case.terms, complete="off", search=search, posterior=False, preprocessing=preprocessing
    )
    effort = model.effort(motion, theta)
    strong = np.abs(effort) >= STRONG * np.abs(effort).max(axis=0)
    return float((result.sample_signs == np.sign(effort))[strong].mean())


def main(trials: int, robots: list[str]) -> None:
    """Prints shares of right signs; trials alternate between motions, with the same robots and noise for both kinds."""
    for name in robots:
        case = CASES[name]
        made = designs(name, case)
        robot = made[0].model.robot
        kinds = {"designed": [design.motion for design in made], "random": random_motions(made[0])}
        right = {
            kind: [share_right(robot, motions[k % len(motions)], case, k) for k in range(trials)]
            for kind, motions in kinds.items()
        }
        print(f"{name}: condition numbers of the designs {[round(design.reached.condition, 1) for design in made]}")
        for kind, shares in right.items():
            print(f"  {kind}: right {np.mean(shares):.3f}: {np.round(shares, 2).tolist()}", flush=True)
        gain = np.subtract(right["designed"], right["random"])
        print(f"{name}: gain {gain.mean():+.3f} +- {gain.std(ddof=1) / np.sqrt(trials):.3f}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 12, sys.argv[2:] or list(CASES))
