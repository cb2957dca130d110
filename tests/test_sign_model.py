from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import small_robot

from bayesid import identification, sign_model
from bayesid.coefficients import base_coefficients
from bayesid.distortions import make_distortion
from bayesid.excitation import random_trajectory
from bayesid.identification import identify
from bayesid.knowledge import Knowledge
from bayesid.model import Model
from bayesid.segments import find_segments
from bayesid.sign_model import Prior, restored, richer_model, settle_signs, structural_doubt, weight_against
from bayesid.signals import prepare, signed_effort
from bayesid.signs import SearchOptions
from bayesid.simulation import random_parameters, simulate
from bayesid.terms import DEFAULT, make_terms

T = np.arange(801) / 100.0
STRONG = 0.05
"""Samples count from this share of their joint's largest |effort| on."""
BUDGET = 0.5
"""s for the search's proof: a model that does not hold leaves thousands of assignments to look through."""
POOR = ("rigid_body", "rotor_inertia", "torque_offset")


class Simulated:
    """An arm of three joints; Coulomb friction `coulomb` times as large as all else, RMS; 0 leaves all effects out."""

    def __init__(self, coulomb, seed=4):
        self.robot = small_robot(3)
        self.motion = random_trajectory(3, 8.0, seed=seed).motion(T)
        self.model = Model(self.robot, make_terms(DEFAULT, self.robot, self.motion))
        names = [parameter.name for parameter in self.model.parameters]
        self.theta = random_parameters(self.model, np.random.default_rng(seed))
        friction = [names.index(f"Fc{j}") for j in (1, 2, 3)]
        if not coulomb:
            self.theta[30:] = 0.0
        else:
            columns = self.model.columns(self.motion)
            self.theta[friction] = 0.0
            rest = self.model.effort(self.motion, self.theta)
            for j, k in enumerate(friction):
                self.theta[k] = coulomb * rms(rest[:, j]) / rms(columns[:, j, k])

    def log(self, signed=False, noise=0.05):
        return simulate(
            self.model, self.theta, self.motion, rng=np.random.default_rng(7), noise=noise, signed=signed
        )

    def right(self, result):
        """(N, n) whether a sample's likelier sign is right, and whether the sample is strong."""
        effort = self.model.effort(self.motion, self.theta)
        return np.sign(effort) == result.sample_signs, np.abs(effort) >= STRONG * np.abs(effort).max(axis=0)


def rms(values):
    return np.sqrt(np.mean(values**2))


@pytest.fixture(scope="module")
def rough():
    return Simulated(1.5)


@pytest.fixture(scope="module")
def full(rough):
    return identify(rough.robot, rough.log(), search_budget=BUDGET, posterior=False)


@pytest.fixture(scope="module")
def poor(rough):
    """With as few draws as there can be: signs that the other model has settled are not for them to say."""
    return identify(rough.robot, rough.log(), POOR, search_budget=BUDGET, posterior_budget=0.0)


@pytest.fixture(scope="module")
def alone(rough):
    """The poor model left to itself."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identification, "richer_model", lambda *_: None)
        return identify(rough.robot, rough.log(), POOR, search_budget=BUDGET, posterior=False)


def sure_samples(result):
    return np.maximum(result.probability, 1.0 - result.probability) >= 0.99


# ---------------------------------------------------------------------------------------------------------------
# Whole identifications
# ---------------------------------------------------------------------------------------------------------------
def test_a_model_without_friction_asks_another_one(rough, poor):
    assert set(poor.sign_terms) == set(DEFAULT)
    assert poor.sign_weight == 0.95
    assert [term.name for term in poor.model.terms] == list(POOR)
    (said,) = [warning for warning in poor.warnings if "lacks" in warning]
    assert "viscous_friction, coulomb_friction" in said
    assert not any(name in said for name in POOR)
    right, strong = rough.right(poor)
    assert right[strong].mean() >= 0.98


def test_its_confidences_are_rare_and_right(rough, poor, full):
    right, _ = rough.right(poor)
    sure = sure_samples(poor)
    assert sure.any()
    assert np.mean(~right[sure]) <= 0.005
    assert sure.mean() < 0.7 * sure_samples(full).mean()


def test_without_the_other_model_signs_would_be_wrong(rough, alone):
    """What the tests above are there for."""
    right, strong = rough.right(alone)
    assert right[strong].mean() < 0.9
    assert alone.sign_terms == POOR


def test_parameters_are_those_of_the_model_asked_for_under_the_others_signs(rough, poor, alone):
    """Its efforts are near those it would have learned from the true signs; the weight of 5 % pulls a little."""
    assert len(poor.fit.theta) == 36
    assert poor.model.cone.contains(poor.fit.theta, 1e-9)
    signed = identify(rough.robot, rough.log(signed=True), POOR, posterior=False).fit.predicted
    assert rms(poor.fit.predicted - signed) < 0.15 * rms(signed)
    assert rms(alone.fit.predicted - signed) > 0.5 * rms(signed)


def test_the_full_model_asks_nobody(full):
    assert full.sign_terms == DEFAULT
    assert full.sign_weight == 1.0
    assert not any("lacks" in warning for warning in full.warnings)


def test_a_signed_log_asks_nobody(rough):
    result = identify(rough.robot, rough.log(signed=True), POOR, posterior=False)
    assert result.sign_terms == POOR
    assert result.sign_weight == 1.0
    assert result.timings["second opinion"] < 0.05
    assert not any("lacks" in warning for warning in result.warnings)


def test_given_signs_stand_in_the_posterior_of_the_poor_model(poor):
    """Its draws must not find the wrong signs again that the other model has ruled out."""
    assert np.all(poor.posterior.moments.known != 0)
    np.testing.assert_array_equal(poor.posterior.moments.known, poor.search.signs)
    assert poor.posterior.elsewhere is None
    assert poor.posterior.branch_mass.size == 0
    assert any("not converged" in warning for warning in poor.warnings)


# ---------------------------------------------------------------------------------------------------------------
# A robot truly without friction
# ---------------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def smooth():
    return Simulated(0.0)


def settle(robot, log, terms, prior=None):
    signals = prepare(log)
    model = Model(robot, make_terms(terms, robot, signals.motion))
    segments = find_segments(signals, robot.actuators(signals.motion))
    options = SearchOptions("certified", BUDGET, 1e-3, 5, 5, None)
    return settle_signs(model, signals, segments, options, prior=prior), signals


def test_a_right_model_is_not_talked_over(smooth):
    result = identify(smooth.robot, smooth.log(), ["rigid_body"], search_budget=BUDGET, posterior=False)
    assert result.sign_terms == ("rigid_body",)
    assert result.sign_weight > 0.95
    right, strong = smooth.right(result)
    assert right[strong].all()
    assert not any("lacks" in warning for warning in result.warnings)


def test_twelve_more_parameters_are_not_worth_what_they_explain_of_white_noise(smooth, rough, asked):
    own, signals = settle(smooth.robot, smooth.log(), ["rigid_body"])
    rival, _ = settle(smooth.robot, smooth.log(), DEFAULT)
    assert richer_model(own, signals) is None or weight_against(rival, own) < 0.05
    assert weight_against(rival, own) < 0.05
    rival, _ = settle(rough.robot, rough.log(), DEFAULT)
    assert weight_against(rival, asked[0]) == 0.95


# ---------------------------------------------------------------------------------------------------------------
# When to ask
# ---------------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def asked(rough):
    return settle(rough.robot, rough.log(), POOR)


def with_residual(settled, coloured):
    residual = replace(settled.fit.residual, white=np.array([1.0, 2.0, 3.0]), coloured=np.array(coloured))
    return replace(settled, fit=replace(settled.fit, residual=residual))


def test_another_model_is_asked_where_a_residual_lasts(asked):
    """In one joint at least: coloured over white of a half."""
    settled, signals = asked
    assert richer_model(with_residual(settled, [0.49, 0.98, 1.47]), signals) is None
    model = richer_model(with_residual(settled, [0.49, 1.02, 1.47]), signals)
    assert [term.name for term in model.terms] == [*POOR, "viscous_friction", "coulomb_friction"]
    assert model.parameters[: len(settled.model.parameters)] == settled.model.parameters


def test_no_other_model_is_asked_where_all_signs_are_known_or_no_term_is_missing(rough, asked):
    settled, signals = asked
    lasting = with_residual(settled, [5.0, 5.0, 5.0])
    assert richer_model(lasting, replace(signals, signed=np.ones(3, bool))) is None
    assert richer_model(lasting, replace(signals, signed=np.array([True, True, False]))) is not None
    full = Model(rough.robot, make_terms(DEFAULT, rough.robot, rough.motion))
    assert richer_model(replace(lasting, model=full), signals) is None


# ---------------------------------------------------------------------------------------------------------------
# How much it has to say
# ---------------------------------------------------------------------------------------------------------------
def fake(sigma, time, coefficients, moving=(600, 300)):
    mask = np.arange(max(moving))[:, None] < np.array(moving)
    residual = SimpleNamespace(sigma=np.array(sigma), autocorrelation=np.array(time))
    return SimpleNamespace(fit=SimpleNamespace(residual=residual), coefficients=range(coefficients), fitted=mask)


def information_criterion(sigma, count, coefficients):
    """-2 log of the largest normal likelihood of `count` residuals of each joint, and the price of coefficients."""
    log_likelihood = -np.sum(count * (np.log(sigma) + 0.5 * np.log(2.0 * np.pi) + 0.5))
    return coefficients * np.log(np.sum(count)) - 2.0 * log_likelihood


@pytest.mark.parametrize("size", [9, 11, 12, 13, 16])
def test_the_weight_is_that_of_the_information_criterion(size):
    """600 and 300 samples whose longer autocorrelation times are 3 and 6: 200 and 50 count."""
    own, rival = fake([1.1, 2.0], [3.0, 5.0], 4), fake([1.0, 1.9], [2.0, 6.0], size)
    count = np.array([200.0, 50.0])
    criteria = [information_criterion(np.array(s), count, k) for s, k in (([1.1, 2.0], 4), ([1.0, 1.9], size))]
    odds = np.exp(-0.5 * (criteria[1] - criteria[0]))
    assert weight_against(rival, own) == pytest.approx(min(0.95, odds / (1.0 + odds)), rel=1e-9)


def test_the_weight_by_hand():
    """2 (200 ln 1.1 + 50 ln(2 / 1.9)) = 43.2535 against 8 ln 250 = 44.1717: 1 / (1 + exp(0.4591)) = 0.3872."""
    own, rival = fake([1.1, 2.0], [3.0, 5.0], 4), fake([1.0, 1.9], [2.0, 6.0], 12)
    assert weight_against(rival, own) == pytest.approx(0.3872, abs=2e-4)
    assert weight_against(fake([0.1, 1.9], [2.0, 6.0], 12), own) == 0.95


# ---------------------------------------------------------------------------------------------------------------
# Doubt about a poor model
# ---------------------------------------------------------------------------------------------------------------
def with_error(share, certified, signed=(False, False)):
    """Efforts of RMS 2 and 5 N m, and a model whose lasting error is these shares of them."""
    effort = np.array([2.0, 5.0]) * np.sqrt(2.0) * np.sin(np.linspace(0.0, 20.0 * np.pi, 2001))[:-1, None]
    effort[1000:] *= 3.0  # standstill, which does not count
    moving = np.arange(2000)[:, None] < np.array([1000, 1000])
    settled = SimpleNamespace(
        moving=moving, fitted=moving,
        fit=SimpleNamespace(noise=SimpleNamespace(coloured=np.array(share) * [2.0, 5.0])),
        found=SimpleNamespace(search=SimpleNamespace(certified=certified)),
    )
    return structural_doubt(settled, SimpleNamespace(raw_effort=effort, signed=np.array(signed)))


def test_a_small_error_casts_no_doubt_but_where_nothing_is_proven():
    assert (with_error([0.1, 0.29], True) == 0.0).all()
    np.testing.assert_allclose(with_error([0.02, 0.09], False), 0.0)
    np.testing.assert_allclose(with_error([0.2, 0.24], False), 0.5 * np.array([0.1, 0.14]) / 0.7, rtol=1e-6)


def test_a_large_error_makes_signs_guesses_in_all_joints_but_signed_ones():
    np.testing.assert_allclose(with_error([0.65, 0.1], True), 0.5 * np.array([0.35, 0.09]) / 0.7, rtol=1e-6)
    np.testing.assert_allclose(with_error([3.0, 0.1], True), 0.5)
    np.testing.assert_allclose(with_error([3.0, 0.1], True, (False, True)), [0.5, 0.0])


def test_an_effect_that_no_term_holds_lowers_confidences():
    """A spring of the joint's own size: many signs are wrong, and none of the confidences may be high."""
    robot = small_robot(3, 2)
    motion = random_trajectory(3, duration=8.0, seed=3).motion(np.arange(801) / 100.0)
    model = Model(robot, make_terms(DEFAULT, robot, motion))
    rng = np.random.default_rng(3)
    signed = simulate(model, random_parameters(model, rng), motion, rng=rng, noise=0.02, signed=True)
    spring = motion.q * rms(signed.effort) / rms(motion.q)
    log = replace(signed, effort=signed.effort + spring)
    result = identify(robot, log.rectified(), search_budget=2.0, posterior=False)
    confidence = np.maximum(result.probability, 1.0 - result.probability)
    wrong = result.sample_signs != np.sign(log.effort)
    sure = confidence >= 0.99
    assert sure.sum() == 0 or wrong[sure].mean() <= 0.005
    assert result.sign_doubt.max() > 0.05
    assert any("the model's own error is large" in warning for warning in result.warnings)


# ---------------------------------------------------------------------------------------------------------------
# What is known before the log
# ---------------------------------------------------------------------------------------------------------------
def prior_about(case, theta, spread):
    """Coefficients known to a share of their size, and parameters to settle signs under."""
    size = np.abs(base_coefficients(case.model).project(case.theta))
    return Prior(Knowledge(case.model, case.theta, np.diag(1.0 / (spread * size + 0.01) ** 2)), theta)


def right_share(case, settled):
    effort = case.model.effort(case.motion, case.theta)
    strong = np.abs(effort) >= STRONG * np.abs(effort).max(axis=0)
    return np.mean(((settled.probability >= 0.5) == (effort >= 0.0))[strong])


@pytest.fixture
def misled(monkeypatch):
    """A search that has found all signs the wrong way round."""
    run = sign_model.SignSearch.run

    def wrong(self, segments):
        found = run(self, segments)
        return replace(found, search=replace(found.search, signs=-found.search.signs, theta=-found.search.theta))

    monkeypatch.setattr(sign_model.SignSearch, "run", wrong)


def test_a_prior_stands_in_the_fit(rough):
    """Coefficients are those of both models, their information that of log and prior."""
    prior = prior_about(rough, rough.theta, 0.03)
    settled, _ = settle(rough.robot, rough.log(), DEFAULT, prior)
    assert right_share(rough, settled) >= 0.99
    assert settled.coefficients.names == prior.knowledge.coefficients(rough.model).names
    known = prior.knowledge.information(settled.model, settled.coefficients)
    np.testing.assert_allclose(settled.known.hessian, known.hessian)
    alone, _ = settle(rough.robot, rough.log(), DEFAULT)
    assert alone.known is None
    assert np.all(settled.fit.sd <= 1.001 * np.minimum(alone.fit.sd, 1.0 / np.sqrt(np.diag(known.hessian))))


@pytest.mark.parametrize("spread", [0.03, 1.0])
def test_parameters_that_are_known_save_signs_that_a_search_has_lost(rough, misled, spread):
    """However vaguely: where knowledge does not decide, the residuals do."""
    alone, _ = settle(rough.robot, rough.log(), DEFAULT)
    assert right_share(rough, alone) < 0.2
    saved, _ = settle(rough.robot, rough.log(), DEFAULT, prior_about(rough, rough.theta, spread))
    assert right_share(rough, saved) >= 0.99


@pytest.mark.parametrize("spread", [0.03, 1.0])
def test_parameters_that_are_wrong_do_not_spoil_what_a_search_has_found(rough, spread):
    settled, _ = settle(rough.robot, rough.log(), DEFAULT, prior_about(rough, -rough.theta, spread))
    assert right_share(rough, settled) >= 0.99


# ---------------------------------------------------------------------------------------------------------------
# Sensors
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("signed", [(False, False, False), (True, False, True)])
def test_a_restored_log_is_one_of_the_efforts_themselves(smooth, signed):
    """Joint 1 lacks 0.4 N m of every effort, joint 3 is cut off; what the readings cannot tell is not measured."""
    motion = smooth.motion
    effort = smooth.model.effort(motion, smooth.theta)
    limit = 0.7 * np.abs(effort[:, 2]).max()
    model = smooth.model.distort(make_distortion("dead_zone.shrinking", {"joints": (1,), "width": (0.4,)}))
    model = model.distort(make_distortion("clipping", {"joints": (3,), "limit": (limit,)}))
    log = simulate(model, smooth.theta, motion, rng=np.random.default_rng(0), noise=0.0, signed=signed)
    signals = prepare(log)
    measured = signals.measured.copy()
    measured[100:130, 1] = False
    found = restored(model, replace(signals, measured=measured))
    own = np.where(signed, effort, np.abs(effort))
    np.testing.assert_allclose(found.raw_effort[found.measured], own[found.measured], atol=1e-6)
    np.testing.assert_array_equal(found.measured[:, 1], measured[:, 1])
    size = np.abs(effort)
    assert not found.measured[size[:, 0] < 0.4, 0].any()
    assert found.measured[size[:, 0] > 0.6, 0].all()
    assert not found.measured[size[:, 2] >= limit, 2].any()
    assert found.measured[size[:, 2] < 0.9 * limit, 2].all()
    np.testing.assert_allclose(found.effort, signed_effort(found, np.ones_like(effort)))
    plain = restored(smooth.model, signals)
    np.testing.assert_array_equal(plain.raw_effort, signals.raw_effort)
    np.testing.assert_array_equal(plain.measured, signals.measured)
