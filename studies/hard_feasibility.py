"""Does a hard feasibility check of every node prune the right signs? A real log, its signs hidden.

    python -m bayesid.studies.hard_feasibility [ROBOT LOG]

Algorithm 1 runs on the same segments with three rules: infeasible nodes cost more, by the cone; nodes with an
infeasible OLS estimate are pruned; nodes are pruned whose extra cost is significant in a chi-square test of the
residuals. Where a rule prunes all nodes of a depth, the cheapest one is kept. The command prints the number of depths
at which OLS with the right signs is feasible, the number of feasible nodes, the cost of the best leaf, and its wrong
signs. Right signs are those of the sums of the logged efforts, in segments with at least 5 % of the energy of their
joint's strongest one.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.log.reading import read_log
from bayesid.log.segments import find_segments
from bayesid.log.signals import prepare
from bayesid.parallel import one_blas_thread
from bayesid.regression.feasibility import FeasibilityCheck, decided_rows
from bayesid.regression.normal_equations import normal_equations
from bayesid.robot import load_robot
from bayesid.signs.search.algorithm1 import Candidates, Refusal, algorithm1
from bayesid.signs.search.protocol import SignProblem
from bayesid.signs.tuning import TUNING
from bayesid.studies.real import DATA

CHANCE = 0.999
"""Confidence of the chi-square test."""


def problem_of(robot: str, path: Path) -> tuple[SignProblem, Integers]:
    """The sign problem of the first round, and (S,) the signs of the sums of the logged efforts."""
    arm, log = load_robot(robot), read_log(path)
    signals = prepare(log.rectified())
    model = Model(arm, make_terms(STANDARD, arm, signals.motion))
    segments = find_segments(signals, arm.actuators(signals.motion))
    segments = segments[segments.fitted]
    coefficients = base_coefficients(model)
    raw = normal_equations(model, coefficients, signals.motion, signals.effort, segments)
    scaled = raw.scaled(TUNING.first_noise * raw.rms_effort(arm.n_joints))
    truth = np.where(segments.sums(prepare(log).raw_effort) >= 0.0, 1, -1)
    return SignProblem(scaled, model.cone, coefficients), truth


@one_blas_thread
def main(robot: str, path: Path) -> None:
    """Prints the results of all three rules."""
    problem, truth = problem_of(robot, path)
    m = problem.normal_equations
    margins = _along(problem, truth)
    feasible = int((margins >= 0.0).sum())
    print(
        f"{path.name}, {len(m)} segments: least squares with the right signs is feasible at {feasible} of "
        f"{len(margins)} depths"
    )
    strongest = np.zeros(int(m.joint.max()) + 1)
    np.maximum.at(strongest, m.joint, m.energy)
    strong = m.energy >= TUNING.strong * strongest[m.joint]

    def too_costly(nodes: Candidates) -> Mask:
        """Chi-square test with as many degrees of freedom as determined coefficients."""
        decided = len(decided_rows(nodes.hessian)[0])
        samples = int(m.count[nodes.decided].sum())
        variance = max(1.0, float(nodes.ols_costs.min()) / max(samples - decided, 1))
        return (nodes.cone_costs - nodes.ols_costs) / variance > chi2.ppf(CHANCE, decided)

    rules: dict[str, Refusal | None] = {
        "infeasible nodes cost more": None,
        "infeasible nodes are pruned": lambda nodes: nodes.margins < 0.0,
        f"nodes with a significant extra cost ({100 * CHANCE:.1f} %) are pruned": too_costly,
    }
    for rule, refuse in rules.items():
        result, nodes = algorithm1(problem, refuse=refuse)
        wrong, among = int(np.sum((result.signs != truth) & strong)), sum(node.feasible for node in nodes)
        print(
            f"  {rule}: {among} of {len(nodes)} nodes feasible, cost {result.cost:.0f}, {wrong} of "
            f"{int(strong.sum())} strong segments wrong",
            flush=True,
        )


def _along(problem: SignProblem, truth: Integers) -> Array:
    """Feasibility margins of the right signs at each depth from the fifth."""
    check, m, found = FeasibilityCheck(problem.cone, problem.coefficients.projection), problem.normal_equations, []
    order = np.argsort(-m.energy, kind="stable")
    for depth in range(5, len(order) + 1):
        decided = order[:depth]
        found.append(check.margins(m.hessian_of(decided), (truth[decided] @ m.gradient[decided])[None])[0])
    return np.array(found)


if __name__ == "__main__":
    words = sys.argv[1:] or ["ur10e", str(DATA / "ur10e" / "b_20s.csv")]
    main(words[0], Path(words[1]))
