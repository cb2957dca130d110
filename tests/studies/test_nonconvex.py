"""Rules that are not convex, on top of an identification."""

from functools import cache

import numpy as np
import pytest

from bayesid.identification.pipeline import identify
from bayesid.studies.alternatives import TERMS, simulated
from bayesid.studies.nonconvex import retrieve
from bayesid.studies.pbpr import Annealing, Bodies, Constraint, make_bounds

QUICK = Annealing(evaluations=300)


@cache
def identified():
    """An arm of two links with a light second link, as stated."""
    model, theta, log = simulated()
    most = 1.1 * theta[:20].reshape(2, 10)[:, 9].sum()
    result = identify(
        model.robot, log, TERMS, complete="off", constraints=lambda p: p.total_mass <= most, posterior=False
    )
    return result, most


def test_a_rule_that_the_log_cannot_tell_costs_nothing_and_what_was_stated_holds():
    result, most = identified()
    mass = Bodies(result.fit.theta, result.model.cone).mass
    product = Constraint("product", lambda bodies: bodies.mass[0] * bodies.mass[1] - 0.5 * mass.prod())
    either = Constraint("either", lambda bodies: min(bodies.mass[0] - 0.1 * mass[0], 0.5 * mass[1] - bodies.mass[1]))
    found = retrieve(result, [product, either], make_bounds(result.model, mass=2.0 * most), QUICK)
    assert found.before["product"] == pytest.approx(0.5 * mass.prod())
    assert found.satisfied
    assert found.cost < 0.02
    bodies = Bodies(found.theta, result.model.cone)
    assert bodies.mass.sum() <= most + 1e-5
    assert bodies.mass.prod() <= 0.5 * mass.prod() + 1e-5
    assert result.model.cone.contains(found.theta)


def test_a_rule_against_the_log_costs_the_square_of_the_distance_in_sds():
    result, most = identified()
    place = result.coefficients.names.index("Fc2")
    sd = np.sqrt(np.linalg.inv(result.fit.information)[place, place])

    def away(bodies):
        return 2.0 - abs(result.coefficients.project(bodies.theta)[place] - result.fit.beta[place]) / sd

    found = retrieve(result, [Constraint("away", away)], make_bounds(result.model, mass=2.0 * most), QUICK)
    assert found.satisfied
    assert found.cost == pytest.approx(4.0, rel=0.1)
    assert found.before["away"] == pytest.approx(2.0)


def test_rules_that_cannot_hold_are_not_called_satisfied():
    result, most = identified()
    heavy = Constraint("heavy", lambda bodies: 1.2 * most - bodies.mass.sum())
    found = retrieve(result, [heavy], make_bounds(result.model, mass=2.0 * most), Annealing(runs=4, evaluations=100))
    assert not found.satisfied
    assert max(found.after["heavy"], found.after["stated"]) > 0.01
