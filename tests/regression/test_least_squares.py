import numpy as np
import pytest
from conftest import small_robot, smooth_motion

from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.log.signals import Signals
from bayesid.regression.knowledge import InformationMatrix
from bayesid.regression.least_squares import fit_signed
from bayesid.regression.log_data import LogData
from bayesid.regression.noise import Noise

RATE = 100.0
VALUES = {"J1xx": 0.9, "J1yy": 0.7, "J1zz": 1.1, "m1": 3.0, "mc1x": 0.05, "mc1y": -0.04, "Fv1": 0.8, "offset1": 0.3}
"""Far inside the cone: in this arm with one joint nothing but J1zz > 0 and Fv1 > 0 limits the coefficients."""


class Arm:
    """One joint, its motion, and the efforts without noise."""

    def __init__(self, duration=6.0):
        robot, self.motion = small_robot(1), smooth_motion(1, duration, RATE, seed=3)
        self.model = Model(robot, make_terms(["rigid_body", "viscous_friction", "torque_offset"], robot, self.motion))
        self.coefficients = base_coefficients(self.model)
        names = [parameter.name for parameter in self.model.parameters]
        self.theta = np.array([VALUES.get(name, 0.0) for name in names])
        self.beta = self.coefficients.project(self.theta)
        self.effort = self.model.effort(self.motion, self.theta)
        self.size = float(np.sqrt(np.mean(self.effort**2)))

    def signals(self, effort, signed=False):
        """The log as it would be after filters that cost nothing: the motion is exact."""
        every = np.ones_like(effort, dtype=bool)
        return Signals(self.motion, effort, effort, np.array([signed]), RATE, 20.0, {}, every)

    def log_data(self, effort, signed=False, information=None):
        moving = np.ones_like(effort, dtype=bool)
        return LogData(self.model, self.coefficients, self.signals(effort, signed), moving, moving, information)

    def fit(self, effort, signs, signed=False, information=None):
        return fit_signed(self.log_data(effort, signed, information), signs)


@pytest.fixture(scope="module")
def arm():
    return Arm()


def z_scores(estimates, truth):
    """(r,) of the mean of estimates (K, r)."""
    estimates = np.array(estimates)
    return (estimates.mean(axis=0) - truth) / (estimates.std(axis=0, ddof=1) / np.sqrt(len(estimates)))


def test_expected_signs_do_not_bias_and_likelier_signs_do(arm):
    """Noise as large as the effort. |x| = a of x ~ N(mu, sigma^2) has the expected sign tanh(a mu / sigma^2)."""
    expected, likelier = [], []
    for seed in range(30):
        noise = arm.size * np.random.default_rng(seed).standard_normal(arm.effort.shape)
        rectified = np.abs(arm.effort + noise)
        expected.append(arm.fit(rectified, np.tanh(rectified * arm.effort / arm.size**2)).beta)
        if seed < 10:
            likelier.append(arm.fit(rectified, np.sign(arm.effort)).beta)
    assert np.abs(z_scores(expected, arm.beta)).max() < 4.5  # t of 29 degrees, five coefficients: once in 2000 times
    assert np.abs(z_scores(likelier, arm.beta)).max() > 8.0
    inertia = arm.coefficients.names.index("J1zz")
    assert np.mean(likelier, axis=0)[inertia] > 1.15 * VALUES["J1zz"]
    assert np.mean(expected, axis=0)[inertia] == pytest.approx(VALUES["J1zz"], rel=0.03)


def test_known_signs_are_ordinary_least_squares(arm):
    """Against numpy, in the samples that count; the unfiltered efforts are fitted."""
    noise = 0.2 * arm.size * np.random.default_rng(1).standard_normal(arm.effort.shape)
    signs = np.random.default_rng(2).choice([-1.0, 1.0], arm.effort.shape)  # of no consequence: the log has its own
    found = arm.fit(arm.effort + noise, signs, signed=True)
    inside = arm.signals(arm.effort).inner[:, 0]
    assert inside.sum() == len(inside) - 2 * int(np.ceil(0.5 / 20.0 * RATE))
    columns = arm.model.columns(arm.motion)[:, 0, arm.coefficients.selected]
    expected = np.linalg.lstsq(columns[inside], (arm.effort + noise)[inside, 0], rcond=None)[0]
    assert np.abs((found.beta - expected) / found.sd).max() < 0.01
    half = arm.fit(np.abs(arm.effort), 0.5 * np.sign(arm.effort))
    np.testing.assert_allclose(half.beta, 0.5 * arm.beta, atol=1e-3)


COLOURED = Noise(np.array([0.2]), np.array([0.6]), np.array([-0.01 / np.log(0.9)]), np.ones(1))


def noisy_fit(arm, seed, signed=True, **options):
    effort = arm.effort + COLOURED.draw(len(arm.effort), 1, RATE, np.random.default_rng(seed))[:, :, 0]
    return fit_signed(arm.log_data(effort if signed else np.abs(effort), signed), np.sign(arm.effort), **options)


def test_the_noise_is_corrected_for_the_fit_and_the_residual_is_not():
    """Two seconds, five coefficients: the residual is smaller and faster than the noise; `noise` makes up for it."""
    arm, truth = Arm(2.0), COLOURED.with_time_of_model(RATE)
    fits = [noisy_fit(arm, seed) for seed in range(16)]
    sizes = {name: np.array([getattr(each, name).sigma[0] for each in fits]) for name in ("noise", "residual")}
    times = {
        name: np.log([getattr(each, name).with_time_of_model(RATE).autocorrelation[0] for each in fits])
        for name in ("noise", "residual")
    }
    error = {name: values.std(ddof=1) / 4.0 for name, values in sizes.items()}
    assert sizes["residual"].mean() < truth.sigma[0] - 3.0 * error["residual"]
    assert sizes["noise"].mean() == pytest.approx(truth.sigma[0], abs=3.5 * error["noise"] + 0.06)
    assert np.all(sizes["noise"] > sizes["residual"])
    assert times["residual"].mean() < np.log(0.75 * truth.autocorrelation[0])
    spread = times["noise"].std(ddof=1) / 4.0
    assert times["noise"].mean() == pytest.approx(np.log(truth.autocorrelation[0]), abs=3.5 * spread)


def test_a_long_log_is_not_corrected(arm):
    short = noisy_fit(arm, 5)
    long = noisy_fit(arm, 5, most_corrected=len(arm.effort) - 1)
    expected = long.residual.with_time_of_model(RATE)
    for name in ("white", "coloured", "correlation", "autocorrelation"):
        np.testing.assert_array_equal(getattr(long.noise, name), getattr(expected, name))
        np.testing.assert_array_equal(getattr(long.residual, name), getattr(short.residual, name))
    assert np.abs(short.noise.sigma / long.noise.sigma - 1.0) > 0.01
    just = noisy_fit(arm, 5, most_corrected=len(arm.effort))
    np.testing.assert_array_equal(just.noise.sigma, short.noise.sigma)


def earlier_log(arm, spread):
    """Columns and efforts of another motion, in units of their noise, and their information."""
    motion = smooth_motion(1, 3.0, RATE, seed=17)
    columns = arm.model.columns(motion)[:, 0, arm.coefficients.selected] / spread
    effort = columns @ arm.beta + np.random.default_rng(8).standard_normal(len(motion))
    return columns, effort, InformationMatrix(columns.T @ columns, columns.T @ effort, float(effort @ effort))


def joint_fit(arm, earlier, effort, spread):
    """Least squares on both logs, stacked."""
    inside = arm.signals(effort).inner[:, 0]
    columns = arm.model.columns(arm.motion)[inside, 0][:, arm.coefficients.selected] / spread
    rows = np.vstack([earlier[0], columns])
    return np.linalg.lstsq(rows, np.concatenate([earlier[1], effort[inside, 0] / spread]), rcond=None)[0], rows


def test_the_later_log_weighs_by_its_residual_and_by_its_autocorrelation(arm):
    """Noise that lasts: a few of its samples count as one beside what is known."""
    noise = Noise(np.array([0.2]), np.array([0.8]), np.array([0.05]), np.ones(1))
    effort = arm.effort + noise.draw(len(arm.effort), 1, RATE, np.random.default_rng(11))[:, :, 0]
    earlier = earlier_log(arm, 0.5 * arm.size)
    found = arm.fit(effort, np.sign(arm.effort), True, earlier[2])
    assert found.residual.autocorrelation[0] > 3.0
    spread = float(found.residual.sigma[0] * np.sqrt(found.residual.autocorrelation[0]))
    expected, rows = joint_fit(arm, earlier, effort, spread)
    sd = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    assert np.abs((found.beta - expected) / sd).max() < 0.05
    each = joint_fit(arm, earlier, effort, float(found.residual.sigma[0]))[0]
    assert np.abs((found.beta - each) / sd).max() > 0.1


def test_the_information_of_both_logs_adds(arm):
    """Of the later one with its noise before the fit, as without the earlier one."""
    effort = arm.effort + 0.2 * arm.size * np.random.default_rng(9).standard_normal(arm.effort.shape)
    known = earlier_log(arm, 0.5 * arm.size)[2]
    found = arm.fit(effort, np.sign(arm.effort), True, known)
    columns = arm.model.columns(arm.motion)[arm.signals(effort).inner[:, 0], 0][:, arm.coefficients.selected]
    later = columns.T @ columns / found.noise.sigma[0] ** 2 / found.noise.autocorrelation[0]
    np.testing.assert_allclose(found.information, later + known.hessian, rtol=1e-9)
    assert_inverse(found.covariance, found.information)


def assert_inverse(covariance, information):
    scale = np.sqrt(np.outer(np.diag(information), np.diag(information)))
    np.testing.assert_allclose(covariance * scale, np.linalg.inv(information / scale), rtol=1e-6, atol=1e-6)
