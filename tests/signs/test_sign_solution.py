"""Signs under one model, with and without an earlier log; logs corrected for sensors."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from simulated_arms import BUDGET, arm_with_friction, signs_of, solution_of_standard_terms

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_effect
from bayesid.effects.coefficients import base_coefficients
from bayesid.log.signals import prepare, signed_effort
from bayesid.progress import SILENT
from bayesid.regression.knowledge import CoefficientPrior
from bayesid.signs.search.certified import Certified
from bayesid.signs.sign_solution import Earlier, restored
from bayesid.signs.tuning import TUNING
from bayesid.simulation.logs import simulate


@dataclass(frozen=True, kw_only=True)
class Misled(Certified):
    """A search whose final result has all signs flipped."""

    def certify(self, problem, progress=SILENT):
        result = super().certify(problem, progress)
        return replace(result, signs=-result.signs, theta=-result.theta)


@pytest.fixture(scope="module")
def rough():
    return arm_with_friction(1.5)


def earlier_about(case, theta, spread):
    """Coefficients known to a share of their size, and parameters that determine signs."""
    size = np.abs(base_coefficients(case.model).project(case.theta))
    return Earlier(CoefficientPrior(case.model, case.theta, np.diag(1.0 / (spread * size + 0.01) ** 2)), theta)


def test_information_of_an_earlier_log_enters_the_fit(rough):
    """Coefficients are those of both models, their information that of both logs."""
    alone = solution_of_standard_terms(1.5)
    earlier = earlier_about(rough, rough.theta, 0.03)
    sign_solution = signs_of(rough.robot, rough.log(), STANDARD, earlier=earlier)
    assert rough.right_share(sign_solution) >= 0.99
    assert sign_solution.log_data.coefficients.names == earlier.knowledge.coefficients(rough.model).names
    known = earlier.knowledge.information(sign_solution.model, sign_solution.log_data.coefficients)
    np.testing.assert_allclose(sign_solution.log_data.information.hessian, known.hessian)
    assert alone.log_data.information is None
    assert np.all(sign_solution.fit.sd <= 1.001 * np.minimum(alone.fit.sd, 1.0 / np.sqrt(np.diag(known.hessian))))


@pytest.mark.parametrize("spread", [0.03, 1.0])
def test_known_parameters_correct_wrong_signs_of_a_search(rough, spread, monkeypatch):
    """Even with a wide prior, as the residuals decide then.

    By itself a poor fit falls back on the direction of motion, which is right here.
    """
    assert rough.right_share(signs_of(rough.robot, rough.log(), STANDARD, Misled(budget=BUDGET))) > 0.95
    monkeypatch.setattr("bayesid.signs.sign_solution.TUNING", replace(TUNING, friction_odds=1e-300))
    assert rough.right_share(signs_of(rough.robot, rough.log(), STANDARD, Misled(budget=BUDGET))) < 0.2
    earlier = earlier_about(rough, rough.theta, spread)
    saved = signs_of(rough.robot, rough.log(), STANDARD, Misled(budget=BUDGET), earlier)
    assert rough.right_share(saved) >= 0.99
    wrong = signs_of(rough.robot, rough.log(), STANDARD, earlier=earlier_about(rough, -rough.theta, spread))
    assert rough.right_share(wrong) >= 0.99, "nor does wrong knowledge spoil what a search has found"


@pytest.mark.parametrize("signed", [(False, False, False), (True, False, True)])
def test_a_restored_log_is_one_of_the_efforts_themselves(signed):
    """Joint 1 lacks 0.4 N m of every effort, joint 3 is cut off; what the readings cannot tell is not measured."""
    smooth = arm_with_friction(0.0)
    motion = smooth.motion
    effort = smooth.model.effort(motion, smooth.theta)
    limit = 0.7 * np.abs(effort[:, 2]).max()
    model = smooth.model.extend(make_effect("dead_zone.shrinking", {"joints": (1,), "width": (0.4,)}))
    model = model.extend(make_effect("clipping", {"joints": (3,), "limit": (limit,)}))
    log = simulate(model, smooth.theta, motion, rng=np.random.default_rng(0), noise=0.0, signed=signed)
    signals = prepare(log)
    measured = signals.measured.copy()
    measured[100:130, 1] = False
    invert_sensor = restored(model, replace(signals, measured=measured))
    expected = np.where(signed, effort, np.abs(effort))
    np.testing.assert_allclose(
        invert_sensor.raw_effort[invert_sensor.measured], expected[invert_sensor.measured], atol=1e-6
    )
    np.testing.assert_array_equal(invert_sensor.measured[:, 1], measured[:, 1])
    size = np.abs(effort)
    assert not invert_sensor.measured[size[:, 0] < 0.4, 0].any()
    assert invert_sensor.measured[size[:, 0] > 0.6, 0].all()
    assert not invert_sensor.measured[size[:, 2] >= limit, 2].any()
    assert invert_sensor.measured[size[:, 2] < 0.9 * limit, 2].all()
    np.testing.assert_allclose(invert_sensor.effort, signed_effort(invert_sensor, np.ones_like(effort)))
    plain = restored(smooth.model, signals)
    np.testing.assert_array_equal(plain.raw_effort, signals.raw_effort)
    np.testing.assert_array_equal(plain.measured, signals.measured)
