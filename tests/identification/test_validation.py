from dataclasses import replace

import numpy as np
import pytest
from conftest import small_robot

import bayesid
from bayesid.errors import InputError
from bayesid.fit.noise import Noise
from bayesid.identification.identified_model import IdentifiedModel, ParameterDraws
from bayesid.identification.pipeline import identify
from bayesid.identification.provenance import hashes
from bayesid.model.catalogue import make_terms
from bayesid.model.model import Model
from bayesid.model.robot import load_robot
from bayesid.model.terms import STANDARD
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

NOISE = 0.03
T = np.arange(601) / 100.0


def motion_of(seed, n=3):
    return random_trajectory(n, 6.0, seed=seed).motion(T)


@pytest.fixture(scope="session")
def model():
    robot = small_robot(3)
    return Model(robot, make_terms(STANDARD, robot, motion_of(0)))


@pytest.fixture(scope="session")
def theta(model):
    return random_parameters(model, np.random.default_rng(4))


@pytest.fixture(scope="session")
def new(model, theta):
    """Another motion, with its signs."""
    return simulate(model, theta, motion_of(21), rng=np.random.default_rng(21), noise=NOISE, signed=True)


@pytest.fixture(scope="session")
def effort(model, theta):
    """What the new motion takes, without noise."""
    return model.effort(motion_of(21), theta)


@pytest.fixture(scope="session")
def noise(model, theta):
    size = NOISE * rms(model.effort(motion_of(0), theta))
    return Noise(white=size, coloured=0.2 * size, correlation=np.full(3, 0.1), autocorrelation=np.ones(3))


def validate(model, theta, noise, log, cutoff=None, draws=None):
    """A model of which nothing but predictions is asked."""
    return IdentifiedModel(model, theta, noise, np.zeros((0, 0)), draws).validate(log, cutoff)


def hidden(log):
    return replace(log, effort=np.abs(log.effort), signed=np.zeros(log.n_joints, dtype=bool))


def rms(values):
    return np.sqrt(np.mean(values**2, axis=0))


@pytest.mark.parametrize("signs", ["known", "hidden"])
def test_the_true_model_predicts_a_new_log_within_its_noise(model, theta, noise, new, effort, signs):
    """The measured efforts pass a low-pass at a quarter of Nyquist's frequency, and so does a quarter of the noise."""
    result = validate(model, theta, noise, new if signs == "known" else hidden(new))
    np.testing.assert_allclose(result.predicted, effort, atol=0.03 * rms(effort).max())
    assert np.all(result.relative_residual < NOISE)
    assert np.all(result.relative_residual > 0.25 * NOISE)
    strong = np.abs(effort) >= 0.05 * np.abs(effort).max(axis=0)
    assert np.all(((result.probability >= 0.5) == (effort > 0.0))[strong])


def test_a_log_that_the_model_was_identified_from_is_marked(model, theta, noise, new):
    seen = IdentifiedModel(model, theta, noise, np.zeros((0, 0)), logs=hashes(new))
    assert seen.validate(new).seen
    assert not seen.validate(replace(new, effort=1.01 * new.effort)).seen
    assert not validate(model, theta, noise, new).seen


def test_the_errors_are_those_of_the_samples_in_motion(model, theta, noise, new):
    result = validate(model, theta, noise, new)
    speed = np.abs(result.signals.motion.dq)
    moving = speed > 0.01 * speed.max(axis=0)
    for j in range(3):
        error = (result.measured - result.predicted)[moving[:, j], j]
        assert result.rms_error[j] == pytest.approx(rms(error))
        assert result.relative_residual[j] == pytest.approx(rms(error) / rms(result.measured[moving[:, j], j]))


def test_an_identified_model_predicts_a_new_log(model, theta, new):
    log = simulate(model, theta, motion_of(0), rng=np.random.default_rng(5), noise=NOISE)
    result = identify(model.robot, log, posterior=False).validate(hidden(new))
    assert np.all(result.relative_residual < 1.5 * NOISE)


def test_signs_hardly_matter_to_a_right_model(model, theta, noise, new):
    known, unknown = (validate(model, theta, noise, log) for log in (new, hidden(new)))
    np.testing.assert_array_equal(known.predicted, unknown.predicted)
    np.testing.assert_allclose(known.relative_residual, unknown.relative_residual, rtol=0.05)
    np.testing.assert_array_equal(known.probability, new.effort >= 0.0)


def test_some_joints_may_be_signed(model, theta, noise, new):
    signed = np.array([False, True, False])
    mixed = replace(new, effort=np.where(signed, new.effort, np.abs(new.effort)), signed=signed)
    result, known = validate(model, theta, noise, mixed), validate(model, theta, noise, new)
    np.testing.assert_array_equal(result.probability[:, 1], new.effort[:, 1] >= 0.0)
    np.testing.assert_allclose(result.relative_residual, known.relative_residual, rtol=0.05)


@pytest.mark.parametrize("name", ["m3", "Fc1", "Fv2", "offset3", "mc2x"])
def test_a_wrong_parameter_is_seen(model, theta, noise, new, name):
    """Ten noise sd of wrong effort in some joint, whatever the signs."""
    k = [parameter.name for parameter in model.parameters].index(name)
    column = model.columns(motion_of(21))[:, :, k]
    wrong = theta.copy()
    wrong[k] += 10.0 / np.max(rms(column) / (NOISE * rms(model.effort(motion_of(21), theta))))
    right = validate(model, theta, noise, new).relative_residual
    for log in (new, hidden(new)):
        assert np.max(validate(model, wrong, noise, log).relative_residual / right) > 5.0


def test_a_model_without_friction_is_seen(model, theta, noise, new):
    rigid = Model(model.robot, make_terms(["rigid_body"], model.robot, motion_of(0)))
    assert validate(rigid, theta[:30], noise, hidden(new)).relative_residual.max() > 2.0 * NOISE


def test_a_model_with_the_wrong_signs_does_not_pass(model, theta, noise, new):
    """|effort| of -theta is that of theta: only signs, or the cone while identifying, tell them apart."""
    plus, minus = (validate(model, values, noise, hidden(new)) for values in (theta, -theta))
    np.testing.assert_allclose(minus.relative_residual, plus.relative_residual, rtol=1e-6)
    np.testing.assert_allclose(minus.probability, 1.0 - plus.probability, atol=1e-5)  # beliefs are single numbers
    assert validate(model, -theta, noise, new).relative_residual.min() > 1.5


@pytest.mark.filterwarnings("ignore:invalid value")
def test_half_a_robot_has_probabilities_too(model, theta, noise, new):
    """A model sure of itself and far off: every link half as heavy as it should be, a tenth of the noise."""
    sure = replace(noise, white=0.1 * noise.white, coloured=0.1 * noise.coloured)
    result = validate(model, 0.5 * theta, sure, hidden(new))
    assert np.isfinite(result.probability).all()
    np.testing.assert_allclose(result.relative_residual, 0.5, atol=0.1)


def test_the_smoothing_of_friction_is_the_models_own(model, theta, noise):
    """A log at half the speed is predicted with the friction steps that the model was identified with."""
    slow = random_trajectory(3, 12.0, seed=3).motion(np.arange(1201) / 100.0)
    log = simulate(model, theta, slow, rng=np.random.default_rng(1), noise=NOISE)
    assert np.all(validate(model, theta, noise, log).relative_residual < NOISE)


def test_a_cutoff_may_be_given(model, theta, noise, new):
    assert validate(model, theta, noise, new, cutoff=12.0).signals.cutoff == 12.0
    with pytest.raises(InputError, match="cutoff: "):
        validate(model, theta, noise, new, cutoff=60.0)


def test_coupled_motors():
    robot = load_robot("tx40")
    motion = motion_of(2, n=6)
    model = Model(robot, make_terms(STANDARD, robot, motion))
    theta = random_parameters(model, np.random.default_rng(2))
    log = simulate(model, theta, motion, rng=np.random.default_rng(2), noise=NOISE)
    size = NOISE * rms(model.effort(motion, theta))
    noise = Noise(white=size, coloured=0.2 * size, correlation=np.full(6, 0.1), autocorrelation=np.ones(6))
    assert np.all(validate(model, theta, noise, log).relative_residual < NOISE)


def test_a_log_of_another_robot_is_refused(model, theta, noise):
    other = small_robot(2)
    two, rng = Model(other, make_terms(STANDARD, other, motion_of(0, n=2))), np.random.default_rng(0)
    log = simulate(two, random_parameters(two, rng), motion_of(0, n=2), rng=rng)
    with pytest.raises(InputError) as refusal:
        validate(model, theta, noise, log)
    assert "2 joints" in refusal.value.what
    assert "arm3 has 3" in refusal.value.what
    assert refusal.value.where == log.source


def test_an_identification_reads_the_log_itself(model, theta, new, tmp_path):
    log = simulate(model, theta, motion_of(0), rng=np.random.default_rng(5), noise=NOISE, signed=True)
    result = identify(model.robot, log, posterior=False)
    bayesid.write_log(tmp_path / "new.csv", new)
    found, expected = result.validate(str(tmp_path / "new.csv")), result.validate(new)
    np.testing.assert_array_equal(found.relative_residual, expected.relative_residual)
    assert result.validate(new, cutoff=15.0).signals.cutoff == 15.0


# ---------------------------------------------------------------------------------------------------------------
# Bands
# ---------------------------------------------------------------------------------------------------------------
def in_motion(result):
    speed = np.abs(result.signals.motion.dq)
    return speed > 0.01 * speed.max(axis=0)


@pytest.mark.parametrize(("colour", "time"), [(0.0, 1.0), (0.8, 1.8 / 0.2)])
def test_the_band_of_the_true_model_holds_what_it_promises(model, theta, noise, colour, time):
    """The right noise, white or AR(1): 95 % of four logs' samples, as many of which count as the noise's memory allows.

    Memory of indicators is shorter than that of the noise itself: the error is no larger than this.
    """
    inside, count = np.zeros(3), np.zeros(3)
    size = NOISE * rms(model.effort(motion_of(21), theta))
    own = replace(noise, white=0.8 * size, coloured=0.6 * size)
    for seed in range(4):
        log = simulate(
            model, theta, motion_of(21), rng=np.random.default_rng(seed), noise=NOISE, colour=colour, signed=True
        )
        result = validate(model, theta, own, log)
        assert result.band == "noise alone"
        np.testing.assert_allclose(result.upper - result.predicted, np.tile(1.959964 * size, (601, 1)), rtol=1e-6)
        np.testing.assert_allclose(result.predicted - result.lower, np.tile(1.959964 * size, (601, 1)), rtol=1e-6)
        within = (log.effort >= result.lower) & (log.effort <= result.upper) & in_motion(result)
        np.testing.assert_allclose(result.coverage, within.sum(axis=0) / in_motion(result).sum(axis=0))
        inside, count = inside + within.sum(axis=0), count + in_motion(result).sum(axis=0) / time
    error = np.sqrt(0.05 * 0.95 / count)
    assert np.all(np.abs(inside / (time * count) - 0.95) < 4.0 * error)
    assert np.all(4.0 * error < 0.06), "a band of 99.5 or 85 % would be seen"


def test_a_band_is_of_the_unfiltered_efforts(model, theta, noise, new):
    """The filtered ones are quieter: nearly all of them lie in it."""
    result = validate(model, theta, replace(noise, white=0.98 * noise.white), new)
    moving = in_motion(result)
    filtered = (result.measured >= result.lower) & (result.measured <= result.upper)
    more = (filtered & moving).sum(axis=0) / moving.sum(axis=0) - result.coverage
    assert more.min() > 0.01
    assert more.mean() > 0.025


def test_a_band_widens_with_the_doubt_about_parameters(model, theta, noise, new):
    """One doubtful parameter: sd^2 of the noise plus column^2 times its variance, at every sample."""
    names = [parameter.name for parameter in model.parameters]
    k, rng = names.index("Fv2"), np.random.default_rng(3)
    draws = np.tile(theta, (200, 1))
    draws[:, k] += 0.4 + 0.3 * theta[k] * rng.standard_normal(200)
    sigma = np.abs(rng.normal(1.0, 0.2, (200, 3))) * noise.sigma
    result = validate(model, theta, noise, new, draws=ParameterDraws(draws, sigma))
    assert result.band == "parameters and noise, by the posterior"
    column = model.columns(result.signals.motion)[:, :, k]
    sd = np.sqrt((column * draws[:, k].std()) ** 2 + (sigma**2).mean(axis=0))
    np.testing.assert_allclose(result.upper - result.lower, 2.0 * 1.959964 * sd, rtol=1e-6)
    np.testing.assert_allclose(0.5 * (result.upper + result.lower), result.predicted, atol=1e-9)
    alone = validate(model, theta, noise, new)
    assert (result.upper - alone.upper)[:, 1].max() > 0.5 * noise.sigma[1]
    np.testing.assert_array_equal(result.relative_residual, alone.relative_residual)


def test_an_identified_models_band_holds_a_new_log(model, theta, effort, new):
    """Six noisy seconds: the band of another motion, its noise the same in N m, holds 95 % of its samples."""
    size = 4.0 * NOISE * rms(model.effort(motion_of(0), theta))
    log = simulate(model, theta, motion_of(0), rng=np.random.default_rng(5), noise=4.0 * NOISE, signed=True)
    sampled = identify(model.robot, log)
    draws = sampled.identified.draws
    np.testing.assert_allclose(draws.sigma.mean(axis=0), size, rtol=0.2)
    noisy = effort + size * np.random.default_rng(22).standard_normal(effort.shape)
    result = sampled.validate(replace(new, effort=noisy))
    assert result.band == "parameters and noise, by the posterior"
    binomial = np.sqrt(0.05 * 0.95 / in_motion(result).sum(axis=0))
    np.testing.assert_array_less(np.abs(result.coverage - 0.95), 4.0 * binomial)
    certain = ParameterDraws(np.tile(sampled.theta, (len(draws.theta), 1)), draws.sigma)
    narrow = validate(sampled.model, sampled.theta, sampled.fit.noise, replace(new, effort=noisy), draws=certain)
    wider = (result.upper - result.lower) / (narrow.upper - narrow.lower)
    assert wider.min() > 1.0
    assert np.all(wider.max(axis=0) > 1.01)
    np.testing.assert_array_equal(result.predicted, narrow.predicted)
