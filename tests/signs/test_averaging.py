"""Averaging with a second model, and lower confidence if the model does not fit the robot."""

import itertools
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import scipy
from sign_problems import synthetic
from simulated_arms import BUDGET, arm_with_friction, rms, signs_of

from bayesid.effects import STANDARD
from bayesid.identification import pipeline
from bayesid.posterior.sampler import Sampling
from bayesid.regression.noise import times_of
from bayesid.signs.averaging import arbitrary_sign_probability, richer_model, rises_by_joint, weight_against
from bayesid.signs.search.certified import Certified

identify = partial(pipeline.identify, complete="off")
SEARCH = Certified(budget=BUDGET)
POOR = ("rigid_body", "rotor_inertia", "torque_offset")


@pytest.fixture(scope="module")
def rough():
    return arm_with_friction(1.5)


@pytest.fixture(scope="module")
def full(rough):
    return identify(rough.robot, rough.log(), search=SEARCH, posterior=False)


@pytest.fixture(scope="module")
def poor(rough):
    """With the fewest draws, as the other model's signs are fixed."""
    return identify(rough.robot, rough.log(), POOR, search=SEARCH, posterior=Sampling(budget=0.0))


def sure_samples(result):
    return np.maximum(result.probability, 1.0 - result.probability) >= 0.99


def test_a_model_without_friction_is_averaged_and_its_high_confidences_are_right(rough, poor, full):
    assert set(poor.sign_terms) == set(STANDARD)
    assert poor.completed_model_weight == 0.95
    assert [term.name for term in poor.model.terms] == list(POOR)
    (said,) = [warning for warning in poor.warnings if "lacks" in warning]
    assert "viscous_friction, coulomb_friction" in said
    assert not any(name in said for name in POOR)
    right, strong = rough.right(poor)
    assert right[strong].mean() >= 0.98
    sure = sure_samples(poor)
    assert sure.any()
    assert np.mean(~right[sure]) <= 0.005
    assert sure.mean() < 0.7 * sure_samples(full).mean()


def test_a_full_model_and_a_signed_log_need_no_second_model(rough, full):
    signed = identify(rough.robot, rough.log(signed=True), POOR, posterior=False)
    for result, terms in ((full, STANDARD), (signed, POOR)):
        assert result.sign_terms == terms
        assert result.completed_model_weight == 1.0
        assert not any("lacks" in warning for warning in result.warnings)


def test_parameters_are_those_of_the_model_asked_for_under_the_others_signs(rough, poor):
    """Its efforts are near those it would have learned from the true signs; the weight of 5 % pulls a little."""
    assert len(poor.fit.theta) == 36
    assert poor.model.cone.contains(poor.fit.theta, 1e-9)
    signed = identify(rough.robot, rough.log(signed=True), POOR, posterior=False).fit.predicted
    assert rms(poor.fit.predicted - signed) < 0.15 * rms(signed)


def test_given_signs_stand_in_the_posterior_of_the_poor_model(poor):
    """Its draws must not return to wrong signs that the other model has excluded."""
    np.testing.assert_array_equal(np.abs(poor.posterior.normal_equations.known), 1)
    np.testing.assert_array_equal(poor.posterior.normal_equations.known, poor.search.signs)
    assert poor.posterior.elsewhere is None


def test_a_right_model_keeps_its_signs():
    smooth = arm_with_friction(0.0)
    result = identify(smooth.robot, smooth.log(), ["rigid_body"], search=SEARCH, posterior=False)
    assert result.sign_terms == ("rigid_body",)
    assert result.completed_model_weight > 0.95
    right, strong = smooth.right(result)
    assert right[strong].all()
    assert not any("lacks" in warning for warning in result.warnings)


@pytest.fixture(scope="module")
def asked(rough):
    """The signs under the poor model alone."""
    return signs_of(rough.robot, rough.log(), POOR)


def with_residual(sign_solution, coloured):
    residual = replace(sign_solution.fit.residual, white=np.array([1.0, 2.0, 3.0]), coloured=np.array(coloured))
    return replace(sign_solution, fit=replace(sign_solution.fit, residual=residual))


def test_a_second_model_is_used_if_a_residual_is_correlated(asked):
    """In one joint at least: coloured over white of a half."""
    assert richer_model(with_residual(asked, [0.49, 0.98, 1.47])) is None
    model = richer_model(with_residual(asked, [0.49, 1.02, 1.47]))
    assert [term.name for term in model.terms] == [*POOR, "viscous_friction", "coulomb_friction"]
    assert model.parameters[: len(asked.model.parameters)] == asked.model.parameters


def fake(error, coefficients, moving=(600, 300)):
    mask = np.arange(max(moving))[:, None] < np.array(moving)
    log_data = SimpleNamespace(coefficients=range(coefficients), used=mask, signals=SimpleNamespace(rate=100.0))
    return SimpleNamespace(error=error, log_data=log_data)


def information_criterion(sigma, count, coefficients):
    """-2 log of the largest normal likelihood of `count` residuals of each joint, and the price of coefficients."""
    log_likelihood = -np.sum(count * (np.log(sigma) + 0.5 * np.log(2.0 * np.pi) + 0.5))
    return coefficients * np.log(np.sum(count)) - 2.0 * log_likelihood


def test_the_weight_is_that_of_the_information_criterion():
    """600 and 300 samples, by the longer of two autocorrelation times."""
    errors = [coloured_errors(seed, moving=(600, 300)) for seed in (3, 8)]
    asked = fake(1.1 * errors[0], 4)
    time = np.max([times_of(error, asked.log_data.used, 100.0) for error in errors], axis=0)
    sizes = [[np.sqrt(np.mean(e[:n, j] ** 2)) for j, n in enumerate((600, 300))] for e in (1.1 * errors[0], errors[1])]
    for more in (5, 7, 8, 9, 12):
        rival, count = fake(errors[1], 4 + more), np.array([600, 300]) / time
        criteria = [information_criterion(np.array(s), count, k) for s, k in zip(sizes, (4, 4 + more), strict=True)]
        odds = np.exp(-0.5 * (criteria[1] - criteria[0]))
        assert weight_against(rival, asked) == pytest.approx(min(0.95, odds / (1.0 + odds)), rel=1e-9)


def coloured_errors(seed, moving):
    """Of memory 0.6 and 0.3; anything where nothing moves."""
    white = np.random.default_rng(seed).normal(size=(max(moving), 2))
    return np.stack([scipy.signal.lfilter([1.0], [1.0, -m], white[:, j]) for j, m in enumerate((0.6, 0.3))], axis=1)


def test_a_joint_is_doubted_for_its_own_error_and_for_the_worst_one_unless_its_other_side_needs_more():
    for error, error_if_flipped, proven, expected in (
        ([0.1, 0.29], [0.0, 0.0], True, [0.0, 0.0]),
        ([0.02, 0.09], [0.0, 0.0], False, [0.0, 0.0]),
        ([0.2, 0.24], [9.0, 9.0], False, [0.1, 0.14]),
        ([0.65, 0.1], [0.1, 0.1], True, [0.35, 0.39 - 0.3]),
        ([0.65, 0.1], [0.1, 0.39], True, [0.35, 0.39 - 0.3]),
        ([0.65, 0.1], [0.1, 0.45], True, [0.35, 0.33 - 0.3]),
        ([0.65, 0.1], [0.1, 0.79], True, [0.35, 0.0]),
        ([0.1, 3.0], [0.2, 9.0], True, [0.7, 0.7]),
        ([0.1, 3.0], [3.5, 9.0], True, [0.0, 0.7]),
    ):
        found = arbitrary_sign_probability(np.array(error), np.array(error_if_flipped), proven=proven)
        np.testing.assert_allclose(found, 0.5 * np.array(expected) / 0.7, atol=1e-12)


def test_the_cost_of_a_flipped_joint_is_its_rows_residual():
    """Row by row, by ordinary least squares: three joints that share their coefficients, in every set of them."""
    problem = synthetic(5, 14, joints=3, cone="free", size=5, noise=0.2, longest=9)
    joint, known = problem.normal_equations.joint, problem.normal_equations.known
    signs = problem.assignments[int(np.argmin(problem.costs))]
    columns = np.concatenate([y for y, _ in problem.rows])
    of_row = np.repeat(np.arange(len(joint)), [len(e) for _, e in problem.rows])

    def residuals(assignment):
        effort = np.concatenate([s * e for s, (_, e) in zip(assignment, problem.rows, strict=True)])
        left = effort - columns @ np.linalg.lstsq(columns, effort, rcond=None)[0]
        return np.bincount(joint[of_row], weights=left**2, minlength=3)

    sets = []
    for turned, rise in rises_by_joint(problem.normal_equations, problem.solver(), signs, 3):
        sets.append(tuple(turned))
        expected = residuals(np.where(np.isin(joint, turned) & (known == 0), -signs, signs)) - residuals(signs)
        np.testing.assert_allclose(rise, expected, atol=2e-3 * problem.energy)
    assert sorted(sets) == sorted(s for k in (1, 2, 3) for s in itertools.combinations(range(3), k))
