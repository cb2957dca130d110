"""Gains as unknowns from log to result: simulated arms whose readings were made efforts by wrong gains."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import real_log
from simulated_arms import Simulated, T

import bayesid
from bayesid.effects import STANDARD
from bayesid.effects.friction import LoadDependentFriction
from bayesid.errors import InputError
from bayesid.identification.gains import BY_DATA, BY_PRIOR, GIVEN, IdentifiedGains
from bayesid.identification.model_file import load
from bayesid.identification.pipeline import identify, identify_again
from bayesid.log.gains import Gains
from bayesid.motion import Motion
from bayesid.posterior.sampler import Sampling
from bayesid.regression.knowledge import ParameterPrior
from bayesid.report.folders import save_identification
from bayesid.signs.model_selection import CompletedSigns
from bayesid.signs.search.certified import Certified
from bayesid.simulation.trajectories import random_trajectory

OFF = np.array([1.25, 0.8, 1.1])
SEARCH = Certified(budget=2.0)


def wrong(log, off=OFF, sd=0.2):
    """The log as wrong gains make it."""
    return replace(log.rescaled(off), gains=Gains(off, np.broadcast_to(sd, (3,))))


def identify_gains(arm, log, posterior=False, **options):
    return identify(arm.robot, log, STANDARD, complete="off", search=SEARCH, posterior=posterior, **options)


@pytest.fixture(scope="module")
def arm():
    return Simulated(coulomb=0.5)


@pytest.fixture(scope="module")
def known(arm):
    return identify_gains(arm, arm.log(noise=0.03))


@pytest.fixture(scope="module")
def found(arm):
    return identify_gains(arm, wrong(arm.log(noise=0.03)), Sampling(budget=20.0))


def test_gains_are_those_of_the_model_that_effects_are_left_out_of(arm, monkeypatch):
    """The posterior finds one of three effects consistent with nothing; a time limit for all searches is kept."""
    asked, limits = [], []

    def doubtful(self, theta, covariance):
        asked.append([effect.key for effect in self.model_selection.effects])
        return set(asked[-1][-1:]) if len(asked) == 2 else set()

    monkeypatch.setattr(CompletedSigns, "consistent_with_nothing", doubtful)
    limited = Certified.limited
    monkeypatch.setattr(Certified, "limited", lambda *given: (limits.append(given[-1]), limited(*given))[1])
    terms, brief = ("rigid_body", "viscous_friction"), Sampling(budget=0.0)
    result = identify(arm.robot, wrong(arm.log(noise=0.03)), terms, search=SEARCH, posterior=brief)
    assert (len(asked[1]), len(result.model_selection.effects)) == (3, 2)
    assert result.posterior.log_gain.shape[-1] == 3
    apart = dict(zip(result.coefficients.names, result.sd_apart.tolist(), strict=True))
    for effect in result.report_data().summary.complete.effects:
        sizes = {name: size["sd"] for name, size in effect.parameters.items() if name in apart}
        assert sizes == pytest.approx({name: apart[name] for name in sizes})
    assert np.abs(ratio_errors(result.gains, 1.0)).max() < 5.0
    assert limits == sorted(limits, reverse=True)
    assert len(set(limits)) > 4


def ratio_errors(gains, true):
    """(n,) of each gain over the others, in standard deviations of it."""
    log = np.log(gains.value / true)
    others = np.where(np.eye(len(log), dtype=bool), 0.0, gains.weights)
    return (log - (others / others.sum(axis=1, keepdims=True)) @ log) / gains.ratio_sd


def test_signs_do_not_suffer_from_wrong_gains(arm, known, found):
    np.testing.assert_allclose(found.log.effort, arm.log(noise=0.03).effort * found.gains.value, rtol=1e-9)
    with_true, with_wrong = arm.right_share(known), arm.right_share(found)
    assert with_true > 0.99
    assert with_wrong >= with_true - 0.002


def test_ratios_that_the_log_shows_come_out_and_the_rest_says_prior(found):
    gains = found.gains
    assert gains.converged
    assert gains.decided_by == (BY_DATA, BY_DATA, BY_PRIOR)  # the last link hardly loads its joint
    assert np.abs(ratio_errors(gains, 1.0)).max() < 3.5
    assert gains.ratio_sd[:2].max() < 0.05
    assert gains.factor_decided_by == BY_PRIOR
    assert gains.factor_sd > 0.1
    assert any("factor common to all gains" in warning for warning in found.warnings)


def test_every_coefficient_carries_the_gains(known, found):
    """No coefficient is known better than the common factor, and draws keep parameters and gains together."""
    relative = found.sd / np.abs(found.beta)
    assert relative.min() > 0.9 * found.gains.factor_sd
    posterior = found.posterior
    log_gain = posterior.log_gain.reshape(-1, 3)
    np.testing.assert_allclose(np.cov(log_gain.T), found.gains.covariance, atol=0.1 * found.gains.covariance.max())
    names = [parameter.name for parameter in found.model.parameters]
    friction = posterior.uncertain.theta.reshape(-1, len(names))[:, names.index("Fc3")]
    alone = posterior.draws.theta.reshape(-1, len(names))[:, names.index("Fc3")]
    assert np.corrcoef(np.log(friction / alone), log_gain[:, 2])[0, 1] > 0.99, (
        "friction of a joint scales with its gain"
    )


def test_the_common_factor_is_no_matter_of_the_coefficients(arm, known, found):
    """Nothing tells it here; apart from it the data decide nearly all coefficients, with draws or without."""
    unsampled = identify_gains(arm, wrong(arm.log(noise=0.03)))
    for result in (found, unsampled):
        heavy = result.sd > 3.0 * known.sd
        assert np.median(result.sd_apart[heavy] / result.sd[heavy]) < 0.5
        assert np.all(result.sd_apart >= 0.5 * known.sd)
    np.testing.assert_array_equal(known.sd_apart, known.sd)
    assert found.prior_sd[1].sum() >= len(found.sd) - 3
    content = found.report_data().summary.gains
    np.testing.assert_allclose(content.sd_of_coefficients, found.sd_apart)


def test_without_draws_the_common_factor_is_log_normal(arm):
    """Intervals of well-known coefficients are symmetric in the logarithm; none of a positive one reaches zero."""
    result = identify_gains(arm, wrong(arm.log(noise=0.03), sd=2.0))
    gains, (low, high) = result.gains, result.interval_95
    assert gains.factor_sd > 0.5
    known = result.sd_apart < 0.05 * np.abs(result.beta)
    assert known.sum() > 3
    ends = np.sort(np.abs([low, high]), axis=0)[:, known] / np.abs(result.beta[known])
    np.testing.assert_allclose(np.log(ends[1]), 1.96 * gains.factor_sd, rtol=0.02)
    np.testing.assert_allclose(np.log(ends[0]), -1.96 * gains.factor_sd, rtol=0.02)


@pytest.mark.parametrize("posterior", [False, Sampling(budget=0.0)])
def test_a_dimensionless_coefficient_does_not_scale_with_the_gains(arm, known, posterior):
    """Load-dependent friction is a share of the load: the common factor of the gains widens it by nothing."""
    links = tuple(known.theta[:30].tolist())
    terms = (*STANDARD, *(LoadDependentFriction(joints=(j,), smoothing=(0.02,), links=links) for j in (1, 2, 3)))
    options = {"complete": "off", "search": SEARCH, "posterior": posterior}
    result = identify(arm.robot, wrong(arm.log(noise=0.03), sd=2.0), terms, **options)
    share = np.array(result.coefficients.units) == "1"
    assert share.sum() == 3
    np.testing.assert_allclose(result.sd_apart[share], result.sd[share], rtol=0.1)
    assert np.all(result.sd_apart[~share] <= 1.01 * result.sd[~share])
    if not posterior:
        half = 0.5 * (result.interval_95[1] - result.interval_95[0])
        np.testing.assert_allclose(half[share], 1.96 * result.sd[share], rtol=0.01)


def test_a_validation_is_in_the_scale_of_the_gains_and_a_prediction_is_not(arm, known, found):
    other = Simulated(coulomb=0.5)
    other.motion = another_motion(9)
    log = other.log(noise=0.03).rescaled(found.gains.value)
    model = found.identified
    coverage = model.validate(log).coverage
    assert coverage.min() > 0.85
    assert coverage[:2].max() < 0.98, "bands hold no uncertainty of the gains"
    band = model.predict(other.motion, noise=False).sd
    narrow = known.predict(other.motion, noise=False).sd
    assert np.median(band / narrow) > 3.0


def another_motion(seed):
    return random_trajectory(3, 8.0, rng=seed).motion(T)


def test_one_trusted_gain_fixes_the_factor(arm):
    off = np.array([1.0, 0.8, 1.1])
    gains = identify_gains(arm, wrong(arm.log(noise=0.03), off, np.array([0.0, 0.2, 0.2]))).gains
    assert gains.value[0] == 1.0
    assert gains.decided_by[0] == GIVEN
    assert gains.factor_decided_by == GIVEN
    assert abs(np.log(gains.value[1])) < 3.5 * gains.relative_sd[1]
    assert gains.relative_sd[1] < 0.05


def test_a_payload_of_known_mass_fixes_the_factor(arm):
    """The other log is of the same arm with a body on its last link, made by a heavier last link."""
    loaded = Simulated(coulomb=0.5)
    loaded.motion = another_motion(11)
    body = np.array([0.09, 0.01, -0.02, 0.11, 0.015, 0.07, 0.2, -0.1, 0.3, 2.0])
    loaded.theta = loaded.theta.copy()
    loaded.theta[20:30] += body
    logs = [wrong(arm.log(noise=0.03)), wrong(loaded.log(noise=0.03)).carrying("tool")]
    prior = ParameterPrior(nominal={"m_tool": (2.0, 0.004)})
    gains = identify_gains(arm, bayesid.read_log(logs), prior=prior).gains
    assert gains.factor_decided_by == BY_DATA
    assert gains.factor_sd < 0.05, "a fifth of what is stated of each"
    assert abs(gains.weights @ np.log(gains.value)) < 3.5 * gains.factor_sd
    assert gains.factor == pytest.approx(np.exp(gains.weights @ np.log(gains.value / OFF)))


def test_gains_that_nobody_knows_are_found_from_readings_in_other_units(arm, known):
    """Readings in per mille of something: efforts come out in the size of a robot of its reach."""
    scale = np.array([0.02, 0.005, 0.03])
    log = replace(arm.log(noise=0.03).rescaled(scale), gains=Gains(np.ones(3), np.full(3, np.inf)))
    result = identify_gains(arm, log)
    assert arm.right_share(result) >= arm.right_share(known) - 0.002
    gains = result.gains
    assert gains.stated.text == "unknown,unknown,unknown"
    assert np.abs(ratio_errors(gains, 1.0 / scale)[:2]).max() < 3.5
    assert gains.factor_decided_by == BY_PRIOR
    assert gains.factor_sd > 0.5
    off = np.abs(np.log(gains.value * scale))[:2]
    assert off.max() < 3.0 * gains.factor_sd, "the masses of arms of its reach spread that far"


def test_the_result_folder_keeps_them(found, tmp_path):
    save_identification(found, tmp_path / "result", report=False)
    again = load(tmp_path / "result").gains
    assert isinstance(again, IdentifiedGains)
    np.testing.assert_allclose(again.value, found.gains.value)
    np.testing.assert_allclose(again.covariance, found.gains.covariance)
    assert again.decided_by == found.gains.decided_by
    assert again.found.exact.all()
    draws = load(tmp_path / "result").draws
    assert draws.log_gain.std(axis=0) == pytest.approx(found.gains.relative_sd, rel=0.1)


def test_beside_an_earlier_result_no_gain_is_an_unknown(arm, found):
    log = wrong(arm.log(noise=0.04))
    for use in (
        found.validate,
        lambda log: bayesid.find_discrepancy(found, log),
        lambda log: identify_again(found.model, log, found.knowledge, found.theta),
    ):
        with pytest.raises(InputError, match="was read with uncertain gains"):
            use(log)


@pytest.mark.long
@pytest.mark.real
@pytest.mark.parametrize("name", ["a_50s", "c_unloaded"])
def test_hidden_factors_on_a_real_log_come_out(name):
    """Joints 2 to 5 of a UR10e load their motors; the sixth does not, and says so."""
    log = bayesid.read_log(real_log(f"ur10e/{name}.csv")).rectified()
    hidden = np.array([1.31, 0.78, 1.12, 0.93, 1.22, 0.85])
    scrambled = replace(log.rescaled(hidden), gains=Gains(np.ones(6), np.full(6, 0.25)))
    gains = identify(str(real_log("ur10e/robot.toml")), scrambled, posterior=False).gains
    error = np.log(gains.value * hidden)
    error -= gains.weights @ error
    assert np.all((np.abs(error[:5]) < 0.05) | (np.abs(error[:5]) < 1.96 * gains.ratio_sd[:5])), error
    assert gains.decided_by[5] == BY_PRIOR


def test_friction_in_proportion_to_the_load_is_named_where_a_log_cannot_tell_it_from_a_gain(arm, found):
    """A joint that is driven one way only, by a load of one sign: what it drives is larger by a share for either."""
    assert found.gains.like_friction == (), "all joints move both ways"
    one_way = Simulated(coulomb=0.5)
    q, dq, ddq = 0.3 * arm.motion.q, 0.3 * arm.motion.dq, 0.3 * arm.motion.ddq
    q[:, 1], dq[:, 1], ddq[:, 1] = 1.7 + 0.1 * arm.motion.t, 0.1, 0.0
    one_way.motion = Motion(arm.motion.t, q, dq, ddq)
    links = np.where(np.arange(len(one_way.theta)) < 30, one_way.theta, 0.0)
    load = one_way.model.effort(one_way.motion, links)[:, 1]
    assert np.abs(load.mean()) > 2.0 * load.std(), "the case: a load of one sign"
    assert np.all(load > 0.0) or np.all(load < 0.0)
    gains = identify_gains(one_way, wrong(one_way.log(noise=0.01, signed=True))).gains
    assert 2 in gains.like_friction
    assert 3 not in gains.like_friction
