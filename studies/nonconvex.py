"""Non-convex constraints after an identification: PBPR by annealing from its feasible parameters.

    python -m bayesid.studies.nonconvex

A log of the paper's KR5 is simulated, its signs hidden, and identified with a convex constraint on the total mass.
Annealing then finds feasible parameters that also satisfy two non-convex rules. For each set of rules the command
prints whether they are satisfied before and after; the cost, phi1 with the information matrix as weight, by
which the coefficients differ from the identified ones; and the seconds.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.arrays import Array
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.regression.stated import StatedParameters
from bayesid.simulation.logs import simulate
from bayesid.simulation.paper import nominal_parameters, paper_model
from bayesid.simulation.trajectories import random_trajectory
from bayesid.studies.pbpr import (
    TOLERANCE,
    Annealing,
    Bodies,
    Bounds,
    Constraint,
    coefficient_error,
    feasible_inertia,
    make_bounds,
    retrieve_by_annealing,
    stated,
)


@dataclass(frozen=True)
class Retrieved:
    """Parameters that satisfy rules.

    Attributes:
        theta: (P,) parameters.
        cost: squared distance of their coefficients from the identified ones; 13.8 is 1000 times less likely.
        before: violation of each constraint by the identified parameters, by name; 0 if satisfied.
        after: the same for theta.
        seconds: of wall time.
    """

    theta: Array
    cost: float
    before: dict[str, float]
    after: dict[str, float]
    seconds: float

    @property
    def satisfied(self) -> bool:
        """Whether theta satisfies all rules."""
        return max(self.after.values()) <= TOLERANCE


def retrieve(
    result: Identification, rules: Sequence[Constraint], bounds: Bounds, annealing: Annealing | None = None
) -> Retrieved:
    """Feasible parameters that satisfy rules, and the constraints of the result, near the result's coefficients.

    Raises:
        InputError: a rule's violation is not a finite number, or two rules share a name.
        SolverError: the distance could not be minimised in the box.
    """
    cone, start = result.model.cone, result.fit.theta
    constraints = [feasible_inertia(), *([] if cone.stated is None else [stated(cone.stated)]), *rules]
    error = coefficient_error(result.coefficients, result.fit.beta, result.fit.information)
    began = time.perf_counter()
    found = retrieve_by_annealing(error, cone, bounds, constraints, annealing, start)
    seconds = time.perf_counter() - began
    before = {c.name: max(float(c.violation(Bodies(start, cone))), 0.0) for c in constraints}
    return Retrieved(found.theta, max(found.phi, 0.0), before, dict(found.violations), seconds)


def conditional(bodies: Bodies) -> float:
    """If link 3 has half of link 2's mass or more, its centre of mass is within 0.1 m of its frame's origin."""
    return float(min(bodies.mass[2] - 0.5 * bodies.mass[1], np.linalg.norm(bodies.center_of_mass[2]) - 0.1))


def product(bodies: Bodies) -> float:
    """The masses of links 4 and 5 multiply to at most 2 kg^2."""
    return float(bodies.mass[3] * bodies.mass[4] - 2.0)


RULES = (Constraint("m3 < m2 / 2 or |c3| <= 0.1", conditional), Constraint("m4 * m5 <= 2", product))
"""The simulated arm satisfies both."""


def weight(p: StatedParameters) -> list[object]:
    """Total mass, kg; that of the simulated arm is 28."""
    return [p.total_mass >= 26, p.total_mass <= 30]


def identified() -> Identification:
    """Identification of the KR5's log without signs."""
    model = paper_model()
    motion = random_trajectory(6, 13.33, rng=0).motion(np.arange(667) / 50.0)
    log = simulate(model, nominal_parameters(), motion, rng=np.random.default_rng(0), noise=0.05)
    return identify(model.robot, log, ["rigid_body"], complete="off", constraints=weight, posterior=False)


def box(result: Identification) -> Bounds:
    """Masses up to 20 kg, lengths up to 0.5 m."""
    return make_bounds(result.model, mass=20.0, reach=0.5)


def main() -> None:
    """Prints one line for each rule alone, and one for both together."""
    result = identified()
    print(f"{'rules':<44}{'before':>8}{'after':>8}{'cost':>12}{'seconds':>9}")
    for rules in (RULES[:1], RULES[1:], RULES):
        found = retrieve(result, rules, box(result), Annealing(evaluations=500))
        names = [rule.name for rule in rules]
        kept = max(found.before[name] for name in names) <= TOLERANCE
        print(
            f"{', '.join(names):<44}{'yes' if kept else 'no':>8}{'yes' if found.satisfied else 'no':>8}"
            f"{found.cost:12.4f}{found.seconds:9.1f}"
        )


if __name__ == "__main__":
    main()
