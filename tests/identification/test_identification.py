from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from conftest import real_log, small_robot
from scipy import stats

import bayesid
from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.fit.knowledge import Beliefs
from bayesid.identification import pipeline
from bayesid.identification.identification import Identification
from bayesid.identification.options import Preparation
from bayesid.identification.pipeline import identify_again
from bayesid.log.log import Log, read_log
from bayesid.log.segments import Cutting, Segments, find_segments
from bayesid.log.signals import signed_effort
from bayesid.model.catalogue import make_effect, make_terms
from bayesid.model.coefficients import base_coefficients
from bayesid.model.model import Model
from bayesid.model.robot import Robot, load_robot, robot_from_table
from bayesid.model.terms import STANDARD
from bayesid.motion import STANDSTILL, Motion
from bayesid.posterior.sampler import Sampling
from bayesid.progress import Progress
from bayesid.signs.rounds import crossings
from bayesid.signs.search.beam import Beam
from bayesid.signs.search.certified import Certified
from bayesid.signs.settling import settle_signs
from bayesid.simulation.exciting import exciting_trajectory
from bayesid.simulation.logs import simulate
from bayesid.simulation.paper import nominal_parameters, paper_model
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

identify = partial(pipeline.identify, complete="off", posterior=False)
"""What the catalogue has to say beyond the terms: tests/signs/test_completion.py."""
"""Draws have tests of their own, below and in the posterior's files."""
STRONG = 0.05
"""Samples count from this share of their joint's largest |effort| on."""
SMOOTH = tuple(name for name in STANDARD if name != "coulomb_friction")
"""Terms whose efforts a low-pass leaves as they are."""


@dataclass(frozen=True)
class Truth:
    """A simulated robot: a motion known at every instant, a model and its parameters."""

    at: Callable[[Array], Motion]
    model: Model
    theta: Array

    def effort(self, t: Array) -> Array:
        return self.model.effort(self.at(t), self.theta)

    def log(self, t: Array, noise: float = 0.05, signed: bool | list[bool] = False, seed: int = 0) -> Log:
        return simulate(self.model, self.theta, self.at(t), rng=np.random.default_rng(seed), noise=noise, signed=signed)

    def right_signs(self, result: Identification) -> float:
        """Share of the strong samples whose sign is right."""
        effort = self.effort(result.signals.motion.t)
        strong = np.abs(effort) >= STRONG * np.abs(effort).max(axis=0)
        return float(np.mean((np.sign(effort) == result.sample_signs)[strong]))

    def surprise(self, result: Identification) -> float:
        """Squared distance of the coefficients from the truth under their covariance: chi-square, r degrees."""
        off = result.fit.beta - result.coefficients.project(self.theta)
        return float(off @ np.linalg.solve(result.fit.covariance, off))


def arm(seed: int, robot: Robot | None = None, terms=STANDARD, duration: float = 8.0) -> Truth:
    robot = robot or small_robot(3)
    at = random_trajectory(robot.n_joints, duration, seed=seed).motion
    model = Model(robot, make_terms(terms, robot, at(grid(duration))))
    return Truth(at, model, random_parameters(model, np.random.default_rng(seed)))


def grid(duration: float = 8.0, rate: float = 100.0) -> Array:
    return np.arange(int(duration * rate) + 1) / rate


def plausible(result: Identification, chi_square: float) -> bool:
    """Whether a right method misses by so much at least once in ten thousand times."""
    return chi_square < stats.chi2.isf(1e-4, len(result.coefficients))


@pytest.fixture(scope="session")
def truth() -> Truth:
    return arm(4)


@pytest.fixture(scope="session")
def unsigned(truth) -> Identification:
    return identify(truth.model.robot, truth.log(grid()))


@pytest.fixture(scope="session")
def signed(truth) -> Identification:
    return identify(truth.model.robot, truth.log(grid(), signed=True))


# ---------------------------------------------------------------------------------------------------------------
# Signs, coefficients and what goes with them
# ---------------------------------------------------------------------------------------------------------------
def test_the_signs_come_back_and_the_coefficients_with_them(truth, unsigned):
    assert truth.right_signs(unsigned) == 1.0
    assert unsigned.warnings == ()
    assert plausible(unsigned, truth.surprise(unsigned))
    np.testing.assert_allclose(unsigned.fit.relative_residual, 0.05, atol=0.04)
    assert truth.model.cone.contains(unsigned.fit.theta)


@pytest.mark.parametrize("seed", [3, 5, 13])
def test_other_robots_and_motions(seed):
    truth = arm(seed, robot=small_robot(3, seed=seed))
    result = identify(truth.model.robot, truth.log(grid(), seed=seed))
    assert truth.right_signs(result) >= 0.999
    assert plausible(result, truth.surprise(result))


def test_standard_deviations_mean_what_they_say():
    """Over many logs, each with its own motion and noise: z-scores of unit variance, 5 sd never reached."""
    surprises, worst = [], 0.0
    for seed in range(12):
        truth = arm(4, terms=SMOOTH)
        truth = replace(truth, at=random_trajectory(3, 8.0, seed=seed).motion)
        result = identify(truth.model.robot, truth.log(grid(), signed=True, seed=seed), SMOOTH)
        z = (result.fit.beta - result.coefficients.project(truth.theta)) / result.fit.sd
        surprises.append(truth.surprise(result))
        worst = max(worst, np.abs(z).max())
    total = 12 * len(result.coefficients)
    assert stats.chi2.isf(1 - 1e-4, total) < np.sum(surprises) < 1.25 * stats.chi2.isf(1e-4, total)
    assert worst < 5.0


def test_the_parts_of_a_result_belong_together(unsigned):
    n_samples, n = unsigned.signals.effort.shape
    segments = unsigned.segments
    assert unsigned.probability.shape == unsigned.fit.predicted.shape == (n_samples, n)
    assert unsigned.probability.min() >= 0.0
    assert unsigned.probability.max() <= 1.0
    assert set(np.unique(unsigned.signs)) == {-1, 1}
    assert np.all((unsigned.confidence >= 0.5) & (unsigned.confidence <= 1.0))
    assert np.array_equal(np.bincount(segments.joint, weights=segments.end - segments.start), np.full(n, n_samples))
    assert unsigned.posterior is None
    assert set(unsigned.timings) == {"prepare", "search", "second opinion", "other readings"}
    assert min(unsigned.timings.values()) > 0.0
    np.testing.assert_allclose(unsigned.coefficients.project(unsigned.fit.theta), unsigned.fit.beta)
    predicted = unsigned.model.effort(unsigned.signals.motion, unsigned.fit.theta)
    np.testing.assert_allclose(predicted, unsigned.fit.predicted)


def test_confident_samples_are_right(truth, unsigned):
    effort = truth.effort(unsigned.signals.motion.t)
    for level, least in ((0.99, 0.9), (0.999, 0.75)):  # tails like Student's t: real residuals have outliers
        certain = np.maximum(unsigned.probability, 1.0 - unsigned.probability) > level
        right = (np.sign(effort) == unsigned.sample_signs)[certain]
        assert certain.mean() > least
        assert np.sum(~right) <= stats.poisson.isf(1e-4, (1.0 - level) * len(right))


@pytest.fixture(scope="module")
def again(truth) -> tuple[Identification, list[tuple[str, int, int]]]:
    """The same log once more, and how far it was meanwhile."""
    calls: list[tuple[str, int, int]] = []
    return identify(truth.model.robot, truth.log(grid()), progress=Progress(lambda *call: calls.append(call))), calls


def test_the_same_log_gives_the_same_result(unsigned, again):
    np.testing.assert_array_equal(again[0].probability, unsigned.probability)
    np.testing.assert_array_equal(again[0].fit.theta, unsigned.fit.theta)


def test_progress_is_reported(again):
    calls = again[1]
    assert [stage for stage, *_ in calls[:2]] == ["prepare", "search, round 1"]
    assert calls[-1] == ("other readings", 0, 1)
    assert all(0 <= done <= total for _, done, total in calls)


def test_without_noise_nothing_divides_by_zero(truth):
    with np.errstate(all="raise", under="ignore"):
        result = identify(truth.model.robot, truth.log(grid(), noise=0.0))
    assert truth.right_signs(result) == 1.0
    assert result.fit.relative_residual.max() < 0.02


# ---------------------------------------------------------------------------------------------------------------
# With draws
# ---------------------------------------------------------------------------------------------------------------
def test_without_noise_there_are_draws_too(truth):
    """No effort counts as known to better than a thousandth of its size: neither sampler nor start may break down."""
    result = bayesid.identify(truth.model.robot, truth.log(grid(), noise=0.0))
    assert result.posterior.converged
    assert truth.right_signs(result) == 1.0
    rms = result.posterior.moments.rms_effort(3)
    assert (result.posterior.noise.sigma > 0.99e-3 * rms).all()
    assert (np.exp(result.posterior.draws.log_scale.mean(axis=(0, 1, 2))) > 0.5).all()


@pytest.mark.filterwarnings("error::RuntimeWarning")  # efforts of links that are not there are rounding
def test_a_model_without_bodies_has_draws_too():
    terms = ("viscous_friction", "coulomb_friction", "torque_offset")
    truth = arm(2, terms=terms)
    result = bayesid.identify(truth.model.robot, truth.log(grid()), terms)
    assert result.posterior.converged
    assert np.abs((result.beta - result.coefficients.project(truth.theta)) / result.sd).max() < 5.0


@pytest.fixture(scope="module")
def drawn(truth) -> tuple[Identification, list[tuple[str, int, int]]]:
    """The same log, its posterior sampled, and how far it was meanwhile."""
    calls: list[tuple[str, int, int]] = []
    progress = Progress(lambda *call: calls.append(call))
    return identify(truth.model.robot, truth.log(grid()), posterior=True, progress=progress), calls


def test_a_sampled_result_is_that_of_its_draws(truth, unsigned, drawn):
    result, calls = drawn
    assert result.posterior.converged
    assert result.warnings == ()
    every = result.posterior.draws.theta.reshape(-1, len(truth.theta))
    np.testing.assert_allclose(result.theta, every.mean(axis=0), rtol=1e-9, atol=1e-12)
    coefficients = every @ result.coefficients.projection.T
    np.testing.assert_allclose(result.beta, coefficients.mean(axis=0), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(result.sd, coefficients.std(axis=0), rtol=1e-3)
    assert truth.model.cone.contains(result.theta)
    assert set(result.timings) == {"prepare", "search", "second opinion", "other readings", "posterior", "smooth"}
    stages = list(dict.fromkeys(stage for stage, *_ in calls))
    assert stages[-4:] == ["posterior", "signs of segments", "signs of samples", "other readings"]
    assert calls[-1] == ("other readings", 0, 1)
    np.testing.assert_array_equal(result.fit.beta, unsigned.fit.beta)
    np.testing.assert_array_equal(unsigned.beta, unsigned.fit.beta)
    np.testing.assert_array_equal(unsigned.sd, unsigned.fit.sd)


def test_the_draws_are_about_the_truth(truth, unsigned, drawn):
    """And as wide as least squares says, but for the cone and the noise's own doubt."""
    result, _ = drawn
    off = result.beta - result.coefficients.project(truth.theta)
    assert plausible(result, float(off @ np.linalg.solve(result.covariance, off)))
    assert np.abs(off / result.sd).max() < 4.5
    ratio = result.sd / unsigned.sd
    assert 0.75 < np.median(ratio) < 1.25
    assert ratio.max() < 1.5
    assert np.abs((result.beta - unsigned.beta) / unsigned.sd).max() < 1.5


def test_averaged_over_draws_the_signs_are_right_and_less_certain_near_zero(truth, unsigned, drawn):
    result, _ = drawn
    assert truth.right_signs(result) == 1.0
    effort = truth.effort(result.signals.motion.t)
    sure = [np.maximum(each.probability, 1.0 - each.probability) for each in (result, unsigned)]
    right = (np.sign(effort) == result.sample_signs)[sure[0] > 0.99]
    assert (sure[0] > 0.99).mean() > 0.9
    assert np.sum(~right) <= stats.poisson.isf(1e-4, 0.01 * len(right))
    assert np.abs(sure[0] - sure[1]).max() < 0.5
    assert not np.array_equal(sure[0], sure[1])


def test_masses_of_the_assignments_sum_to_one(drawn):
    posterior = drawn[0].posterior
    assert len(posterior.branch_mass) == len(drawn[0].search.branches) >= 1
    assert posterior.branch_mass.sum() + posterior.elsewhere == pytest.approx(1.0, abs=1e-9)


def test_the_mass_of_an_assignment_that_nobody_doubts_is_one(drawn):
    """The search settles every sign of this log, and the draws agree; segments without inner samples have no say."""
    assert drawn[0].settled_share == 1.0
    assert drawn[0].posterior.branch_mass.max() > 0.9


# ---------------------------------------------------------------------------------------------------------------
# Known signs
# ---------------------------------------------------------------------------------------------------------------
def test_with_all_signs_known_it_is_ordinary_identification(signed, truth):
    """Against numpy's least squares on the rows in motion, weighted with the residuals of a first fit.

    The rows are those half a period of the cut-off inside both ends, the efforts those before the light filter.
    """
    assert not signed.fit.on_edge.any()
    effort = signed_effort(signed.signals, np.ones(3), filtered=False)
    difference = np.abs(ordinary_least_squares(signed, effort) - signed.fit.beta) / signed.fit.sd
    assert np.max(difference) < 0.01
    assert plausible(signed, truth.surprise(signed))


def ordinary_least_squares(result: Identification, effort: Array, counted: Array | bool = True) -> Array:
    motion, robot = result.signals.motion, result.model.robot
    slow = 0.01 * np.abs(motion.dq).max(axis=0)
    diagonals = [motion.dq, np.tanh(motion.dq / slow), np.ones_like(motion.dq), motion.ddq]
    columns = [robot.regressor(motion), *(np.einsum("ij,jk->ijk", diagonal, np.eye(3)) for diagonal in diagonals)]
    rows = np.concatenate(columns, axis=2)[:, :, result.coefficients.kept]
    ends = 0.5 / result.signals.cutoff
    inside = (motion.t >= motion.t[0] + ends) & (motion.t <= motion.t[-1] - ends)
    moving = (np.abs(motion.dq) > slow) & inside[:, None] & counted
    weight = 1.0 / rms(effort, moving)
    for _ in range(2):
        scaled, wanted = (rows * weight[:, None])[moving], (effort * weight)[moving]
        beta = np.linalg.lstsq(scaled, wanted, rcond=None)[0]
        weight = 1.0 / rms(effort - rows @ beta, moving)
    return beta


def rms(values: Array, used: Array) -> Array:
    return np.sqrt((values**2 * used).sum(axis=0) / used.sum(axis=0))


def test_hidden_signs_cost_little(signed, unsigned):
    """The same noise with and without signs: once the signs are right the fits agree."""
    assert np.max(np.abs(unsigned.fit.beta - signed.fit.beta) / signed.fit.sd) < 1.0
    np.testing.assert_allclose(unsigned.fit.sd, signed.fit.sd, rtol=0.1)


def test_friction_is_not_biased(truth):
    result = identify(truth.model.robot, truth.log(grid(), noise=0.002, signed=True))
    friction = [i for i, name in enumerate(result.coefficients.names) if name.startswith("F")]
    share = result.fit.beta[friction] / result.coefficients.project(truth.theta)[friction]
    np.testing.assert_allclose(share, 1.0, atol=0.005)


def test_some_joints_may_be_signed(truth):
    log = truth.log(grid(), signed=[True, False, True])
    result = identify(truth.model.robot, log)
    assert truth.right_signs(result) >= 0.999
    assert plausible(result, truth.surprise(result))
    np.testing.assert_array_equal(result.probability[:, [0, 2]], log.effort[:, [0, 2]] >= 0.0)
    assert set(result.segments.joint[result.segments.known == 0]) == {1}


@pytest.mark.parametrize("joints", [[0, 1, 2], [0], [1], [2]])
def test_no_feasible_robot_fits_flipped_signs(truth, signed, joints):
    """All signs flipped, or those of one joint: what |effort| cannot tell apart, the cone does."""
    log = truth.log(grid(), signed=True)
    effort = log.effort.copy()
    effort[:, joints] *= -1.0
    flipped = identify(truth.model.robot, replace(log, effort=effort))
    assert flipped.fit.relative_residual.max() > 5.0 * signed.fit.relative_residual.max()


# ---------------------------------------------------------------------------------------------------------------
# The sign convention, against the equations of a textbook
# ---------------------------------------------------------------------------------------------------------------
def two_links(motion: Motion) -> Array:
    """Torques of a planar arm in a vertical plane, x along the stretched arm, gravity along -y (Craig, chapter 6)."""
    (m1, m2), (l1, c1, c2), (i1, i2), g = (6.0, 3.0), (0.5, 0.2, 0.3), (0.2, 0.1), 9.81
    (q1, q2), (d1, d2), (a1, a2) = motion.q.T, motion.dq.T, motion.ddq.T
    coupling, weight2 = m2 * l1 * c2, m2 * c2 * g * np.cos(q1 + q2)
    m12 = i2 + m2 * c2**2 + coupling * np.cos(q2)
    m11 = i1 + m1 * c1**2 + m2 * l1**2 + m12 + coupling * np.cos(q2)
    tau1 = m11 * a1 + m12 * a2 - coupling * np.sin(q2) * (2 * d1 * d2 + d2**2) + (m1 * c1 + m2 * l1) * g * np.cos(q1)
    tau2 = m12 * a1 + (i2 + m2 * c2**2) * a2 + coupling * np.sin(q2) * d1**2
    return np.column_stack([tau1 + weight2 + 0.8 * d1, tau2 + weight2 + 0.4 * d2])


@pytest.mark.parametrize("upright", [True, False])
def test_a_planar_arm_of_the_textbook(upright):
    """Upright, the torque that holds the stretched arm is positive; with gravity upwards it is negative."""
    rows = [{"a": 0.5, "alpha": 0.0, "d": 0.0, "theta": 0.0}, {"a": 0.4, "alpha": 0.0, "d": 0.0, "theta": 0.0}]
    down = -9.81 if upright else 9.81
    robot = robot_from_table({"convention": "standard", "gravity": [0.0, down, 0.0], "joints": rows}, "test")
    at, turn = random_trajectory(2, 8.0, seed=1).motion, 0.0 if upright else np.pi
    rng = np.random.default_rng(3)

    def effort(motion: Motion) -> Array:  # gravity upwards is the same as a base turned by half a turn
        return two_links(replace(motion, q=motion.q + np.array([turn, 0.0])))

    expected = effort(at(grid()))
    noisy = expected + 0.02 * expected.std(axis=0) * rng.standard_normal(expected.shape)
    log = Log(grid(), at(grid()).q, np.abs(noisy), np.zeros(2, dtype=bool))
    result = identify(robot, log, ["rigid_body", "viscous_friction"])
    strong = np.abs(expected) >= STRONG * np.abs(expected).max(axis=0)
    assert np.all((np.sign(expected) == result.sample_signs)[strong])
    new = random_trajectory(2, 8.0, seed=2).motion(grid())
    error = result.model.effort(new, result.fit.theta) - effort(new)
    assert np.all(error.std(axis=0) < 0.01 * effort(new).std(axis=0))


# ---------------------------------------------------------------------------------------------------------------
# What a log may look like
# ---------------------------------------------------------------------------------------------------------------
def test_currents_with_gains_are_torques(truth, unsigned, tmp_path):
    """Gains of powers of two, so that nothing is rounded; a drive wired the other way round has a negative gain."""
    log, gains = truth.log(grid()), [16.0, 8.0, -4.0]
    header = "t,q1,q2,q3,i1,i2,i3"
    table = np.column_stack([log.t, log.q, log.effort / np.abs(gains)])
    np.savetxt(tmp_path / "currents.csv", table, "%.17g", ",", header=header, comments="")
    result = identify(truth.model.robot, read_log(tmp_path / "currents.csv", gains))
    np.testing.assert_allclose(result.fit.beta, unsigned.fit.beta, rtol=1e-9)
    np.testing.assert_allclose(result.probability, unsigned.probability, atol=1e-9)


def test_measured_velocities_are_used(truth, unsigned):
    log = replace(truth.log(grid()), dq=truth.at(grid()).dq)
    result = identify(truth.model.robot, log)
    assert truth.right_signs(result) == 1.0
    assert np.max(np.abs(result.fit.beta - unsigned.fit.beta) / unsigned.fit.sd) < 1.0


def test_jittered_time_and_repeated_rows(truth):
    """A controller that samples when it can and logs when it likes."""
    rng = np.random.default_rng(8)
    t = grid() + rng.uniform(-0.003, 0.003, len(grid()))
    log = truth.log(t)
    rows = np.sort(np.concatenate([np.arange(len(t)), rng.choice(len(t), 300, replace=False)]))
    later = t[rows] + 0.0004 * np.concatenate([[0], np.diff(rows) == 0])
    result = identify(truth.model.robot, replace(log, t=later, q=log.q[rows], effort=log.effort[rows]))
    assert result.signals.processing["repeated_rows_dropped"] == 300
    assert truth.right_signs(result) >= 0.999
    assert plausible(result, truth.surprise(result))


@pytest.mark.parametrize("rate", [50.0, 250.0])
def test_the_sampling_rate_does_not_matter(truth, rate):
    result = identify(truth.model.robot, truth.log(grid(rate=rate), noise=0.05 * np.sqrt(rate / 100.0)))
    assert truth.right_signs(result) >= 0.995
    assert plausible(result, truth.surprise(result))


def test_time_may_count_from_1970(truth, unsigned):
    log = truth.log(grid())
    result = identify(truth.model.robot, replace(log, t=log.t + 1.7e9))
    assert np.max(np.abs(result.fit.beta - unsigned.fit.beta) / unsigned.fit.sd) < 0.05
    assert np.all(result.sample_signs == unsigned.sample_signs)


def test_motors_that_are_coupled():
    truth = arm(2, robot=load_robot("tx40"), duration=12.0)
    result = identify(truth.model.robot, truth.log(grid(12.0), noise=0.03))
    assert truth.right_signs(result) >= 0.999
    new = random_trajectory(6, 8.0, seed=9).motion(grid())
    expected = truth.model.effort(new, truth.theta)
    error = result.model.effort(new, result.fit.theta) - expected
    assert np.all(error.std(axis=0) < 0.05 * expected.std(axis=0))


def point_to_point(n: int, moves: int, seed: int) -> Callable[[Array], Motion]:
    """Quintic moves of 0.8 s between random poses, with 0.4 s of rest after each."""
    poses = np.random.default_rng(seed).uniform(-1.5, 1.5, (moves + 1, n))

    def at(t: Array) -> Motion:
        k = np.minimum((t / 1.2).astype(int), moves - 1)
        s = np.minimum((t - 1.2 * k) / 0.8, 1.0)[:, None]
        step = poses[k + 1] - poses[k]
        q = poses[k] + step * (10 * s**3 - 15 * s**4 + 6 * s**5)
        return Motion(t, q, step * 30 * s**2 * (1 - s) ** 2 / 0.8, step * 60 * s * (1 - s) * (1 - 2 * s) / 0.64)

    return at


def test_rests_of_a_point_to_point_motion_get_their_signs():
    """At rest static friction holds some of the load, nobody knows how much: here up to half the Coulomb friction."""
    robot, moves = small_robot(3), 14
    at, t = point_to_point(3, moves, seed=5), grid(1.2 * moves)
    model = Model(robot, make_terms(STANDARD, robot, at(t)))
    theta = random_parameters(model, np.random.default_rng(4))
    truth = Truth(at, model, theta)
    coulomb = theta[[p.name.startswith("Fc") for p in model.parameters]]
    resting = np.abs(at(t).dq) < STANDSTILL * np.abs(at(t).dq).max(axis=0)
    held = np.repeat(np.random.default_rng(6).uniform(-0.5, 0.5, (moves, 3)), 120, axis=0)
    effort = truth.effort(t) + np.where(resting, coulomb * np.vstack([held, held[-1]]), 0.0)
    noisy = effort + 0.03 * effort.std(axis=0) * np.random.default_rng(7).standard_normal(effort.shape)
    result = identify(robot, Log(t, at(t).q, np.abs(noisy), np.zeros(3, dtype=bool)))
    strong = np.abs(effort) >= STRONG * np.abs(effort).max(axis=0)
    assert resting.mean() > 0.3
    right = np.sign(effort) == result.sample_signs
    assert right[strong & resting].mean() >= 0.999
    assert right[strong].mean() >= 0.999


# ---------------------------------------------------------------------------------------------------------------
# Small efforts left out, as in the paper
# ---------------------------------------------------------------------------------------------------------------
def cut_at(threshold: float) -> Preparation:
    return Preparation(cutting=Cutting(threshold=threshold))


def sample_mask(result: Identification, of_segments: Array) -> Array:
    return result.segments.per_sample(of_segments, *result.probability.shape) > 0


def test_the_papers_threshold_on_its_robot():
    """A fifth of the top leaves out a quarter of the samples, the paper's own threshold 36 %; they get signs too."""
    model, theta, t = paper_model(), nominal_parameters(), np.linspace(0.0, 13.33, 667)
    motion = exciting_trajectory(model, base_coefficients(model), 13.33, seed=0).motion(t)
    effort, log = model.effort(motion, theta), simulate(model, theta, motion, rng=np.random.default_rng(0), noise=0.05)
    share = {}
    for threshold in (0.0, 0.05, 0.2):
        result = identify(model.robot, log, ["rigid_body"], preparation=cut_at(threshold))
        moving, fitted = (sample_mask(result, of) for of in (result.segments.moving, result.segments.fitted))
        share[threshold] = 1.0 - fitted.sum() / moving.sum()
        right = result.sample_signs == np.sign(effort)
        assert right[np.abs(effort) >= STRONG * np.abs(effort).max(axis=0)].mean() >= 0.999
        off = result.fit.beta - result.coefficients.project(theta)
        assert plausible(result, float(off @ np.linalg.solve(result.fit.covariance, off)))
        assert result.searched.fitted.all()
        assert (result.searched.end - result.searched.start).sum() == fitted.sum()
    assert share[0.0] == 0.0 < share[0.05] < share[0.2]
    assert 0.2 < share[0.2] < 0.35
    weak = moving & ~fitted
    sure = np.maximum(result.probability, 1.0 - result.probability)
    assert right[weak].mean() > 0.98
    assert sure[weak].mean() > 0.9, "they move, so the model holds for them: nothing like a standstill"


def test_samples_under_the_threshold_have_no_say_in_the_fit(truth):
    """Against numpy's least squares on the others alone, with the true signs; the posterior has as many samples."""
    log = truth.log(grid())
    result = identify(truth.model.robot, log, posterior=Sampling(budget=0.0), preparation=cut_at(0.2))
    fitted, moving = (sample_mask(result, of) for of in (result.segments.fitted, result.segments.moving))
    top = np.percentile(result.signals.effort, 99, axis=0)
    assert np.array_equal(fitted, moving & (result.signals.effort >= 0.2 * top))
    assert 0.05 < 1.0 - fitted.sum() / moving.sum() < 0.6
    effort = np.sign(truth.effort(result.signals.motion.t)) * result.signals.raw_effort
    difference = ordinary_least_squares(result, effort, fitted) - result.fit.beta
    assert np.max(np.abs(difference) / result.fit.sd) < 0.1
    with_all = ordinary_least_squares(result, effort) - result.fit.beta
    assert np.max(np.abs(with_all) / result.fit.sd) > 0.2, "or the samples left out would say the same"
    assert truth.right_signs(result) == 1.0
    t, ends = result.signals.motion.t, 0.5 / result.signals.cutoff
    inside = (t >= t[0] + ends) & (t <= t[-1] - ends)
    assert result.posterior.moments.count.sum() == (fitted & inside[:, None]).sum()


def test_a_threshold_that_leaves_too_little_is_refused(truth):
    with pytest.raises(InputError, match="above the threshold"):
        identify(truth.model.robot, truth.log(grid()), preparation=cut_at(0.999))


# ---------------------------------------------------------------------------------------------------------------
# Splitting and searching again
# ---------------------------------------------------------------------------------------------------------------
def one_joint(*bounds: int, known: tuple[int, ...] | None = None) -> Segments:
    size = len(bounds) - 1
    return Segments(
        np.zeros(size, dtype=np.int64),
        np.array(bounds[:-1]),
        np.array(bounds[1:]),
        np.array(known or (0,) * size),
        np.ones(size, dtype=bool),
    )


def test_a_clear_crossing_is_cut_where_the_effort_is_least():
    predicted = np.linspace(1.0, -1.0, 101)[:, None]
    effort = np.abs(predicted) + 0.05
    effort[47] = 0.01
    sigma = np.array([0.1])
    assert crossings(one_joint(0, 101), predicted, effort, sigma) == [(0, 47)]
    cut = one_joint(0, 101).split([(0, 47)])
    assert (cut.start.tolist(), cut.end.tolist()) == ([0, 47], [47, 101])
    assert crossings(cut, predicted, effort, sigma) == []


def test_an_unclear_crossing_is_not_cut():
    t = np.linspace(0.0, 1.0, 101)[:, None]
    touches = np.where(t < 0.5, 1.0 - 2.0 * t, 2.0 * t - 1.0) - 0.15
    assert crossings(one_joint(0, 101), touches, np.abs(touches), np.array([0.1])) == []
    deeper = np.where(t < 0.5, 1.0 - 2.0 * t, 2.0 * t - 1.0) - 0.25
    assert len(crossings(one_joint(0, 101), deeper, np.abs(deeper), np.array([0.1]))) == 2


def test_known_signs_are_not_cut():
    predicted = np.linspace(1.0, -1.0, 101)[:, None]
    assert crossings(one_joint(0, 101, known=(1,)), predicted, np.abs(predicted), np.array([0.1])) == []


def test_where_a_segment_begins_already_it_is_not_cut_again():
    predicted = np.array([1.0, -1.0, -1.0, -1.0])[:, None]
    effort = np.array([0.1, 0.5, 1.0, 1.0])[:, None]
    assert crossings(one_joint(0, 4), predicted, effort, np.array([0.1])) == []


def test_each_joint_has_its_own_noise():
    predicted = np.linspace(1.0, -1.0, 101)[:, None] * [1.0, 1.0]
    segments = Segments(
        np.array([0, 1]), np.array([0, 0]), np.array([101, 101]), np.zeros(2, dtype=np.int64), np.ones(2, dtype=bool)
    )
    assert crossings(segments, predicted, np.abs(predicted), np.array([0.6, 0.1])) == [(1, 50)]


def test_a_cut_that_segmentation_missed_is_made_by_searching_again(truth, unsigned):
    """In each joint a segment of less than 0.4 s is glued to its neighbour of the other sign before the search."""
    cut, effort = find_segments(unsigned.signals, unsigned.signals.motion), truth.effort(unsigned.signals.motion.t)
    blunt = glued(cut, effort)
    assert len(blunt) == len(cut) - 3
    settled = settle_signs(unsigned.model, unsigned.signals, blunt, Certified())
    assert settled.signs.rounds > 1
    assert len(settled.signs.segments) > len(blunt)
    strong = np.abs(effort) >= STRONG * np.abs(effort).max(axis=0)
    assert np.mean(((settled.probability >= 0.5) == (effort > 0.0))[strong]) >= 0.999


def glued(segments: Segments, effort: Array) -> Segments:
    keep, end = np.ones(len(segments), dtype=bool), segments.end.copy()
    for j in range(3):
        for k in np.flatnonzero(segments.joint == j)[:-1]:
            first, second = (effort[segments.start[i] : segments.end[i], j].mean() for i in (k, k + 1))
            length = segments.end[k + 1] - segments.start[k + 1]
            if 10 < length < 40 and segments.moving[k : k + 2].all() and first * second < 0.0:
                end[k], keep[k + 1] = end[k + 1], False
                break
    return replace(segments, end=end)[keep]


# ---------------------------------------------------------------------------------------------------------------
# Refusals
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("change", "where", "what"),
    [
        (lambda: {"robot": "kr5"}, "simulated arm3", "3 joints"),
        (lambda: {"terms": ["rigid_body", "magic"]}, "--terms", "magic"),
        (lambda: {"terms": ["rigid_body", "rigid_body"]}, "--terms", "twice"),
        (lambda: {"search": Beam(width=0)}, "--beam-width", "0"),
        (lambda: {"search": Beam(initial_segments=0)}, "--initial-segments", "0"),
        (lambda: {"search": Beam(initial_segments=13)}, "--initial-segments", "13"),
        (lambda: {"preparation": Preparation(cutoff=0.0)}, "--cutoff", "0 Hz"),
        (lambda: {"preparation": Preparation(cutoff=51.0)}, "--cutoff", "51 Hz"),
        (lambda: {"posterior": Sampling(budget=-1.0)}, "--posterior-budget", "-1"),
        (lambda: {"posterior": Sampling(budget=np.nan)}, "--posterior-budget", "nan"),
        (lambda: {"posterior": Sampling(budget=np.inf)}, "--posterior-budget", "inf"),
        (lambda: {"beliefs": Beliefs(nominal={"m9": (1.0, 0.1)})}, "nominal", "m9"),
        (lambda: {"log": "nowhere.csv"}, "nowhere.csv", "no such file"),
        (lambda: {"robot": "nobody"}, "nobody", "no such robot"),
    ],
)
def test_bad_input_is_named(truth, change, where, what):
    with pytest.raises(InputError) as refusal:
        identify(**{"robot": truth.model.robot, "log": truth.log(grid()), **change()})
    assert where in refusal.value.where
    assert what in refusal.value.what
    assert refusal.value.remedy


def test_too_little_motion_is_refused(truth):
    """One short move in a second of rest: 20 samples a joint for 28 coefficients."""
    t = grid(1.2)
    log = replace(truth.log(t), q=point_to_point(3, 1, seed=0)(np.clip((t - 0.5) * 5.0, 0.0, 1.0)).q)
    with pytest.raises(InputError, match="samples in motion for 28 coefficients"):
        identify(truth.model.robot, log)


def test_a_robot_that_stands_still_is_refused(truth):
    log = truth.log(grid())
    with pytest.raises(InputError, match="no joint moves"):
        identify(truth.model.robot, replace(log, q=0.3 + 1e-6 * log.q))


def test_names_and_paths_are_taken_for_robots_and_logs(truth, unsigned, tmp_path):
    bayesid.write_log(tmp_path / "log.csv", truth.log(grid()))
    result = identify(truth.model.robot, str(tmp_path / "log.csv"))
    np.testing.assert_array_equal(result.fit.beta, unsigned.fit.beta)
    assert Path(result.log.source) == tmp_path / "log.csv"


# ---------------------------------------------------------------------------------------------------------------
# Real logs
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["ur10e/b_20s.csv", "tx40/a.csv"])
def test_real_logs_without_their_signs(name):
    path = real_log(name)
    log = read_log(path)
    hidden = replace(log, effort=np.abs(log.effort), signed=np.zeros(log.n_joints, dtype=bool))
    result = identify(path.with_name("robot.toml"), hidden, complete="auto")
    assert result.search.certified
    nearest = np.abs(log.t[:, None] - result.signals.motion.t[None, :]).argmin(axis=1)
    right = result.sample_signs[nearest] == np.sign(log.effort)
    sure = np.maximum(result.probability, 1.0 - result.probability)[nearest] >= 0.99
    strong = np.abs(log.effort) >= STRONG * np.abs(log.effort).max(axis=0)
    assert right[strong & sure].mean() >= 0.9995
    moving = result.segments.per_sample(result.segments.moving, *result.probability.shape)[nearest] > 0
    strong &= moving  # at standstill friction may go either way, and signs say so
    assert right[strong].mean() >= 0.997
    for j in range(log.n_joints):
        assert right[strong[:, j], j].mean() >= 0.985


# ---------------------------------------------------------------------------------------------------------------
# Once more, given what an earlier log has shown
# ---------------------------------------------------------------------------------------------------------------
BODY = np.array([0.05, 0.004, -0.006, 0.06, 0.003, 0.04, 0.13, -0.07, 0.19, 1.9])
"""A payload of 1.9 kg."""


def later(model, theta, seed=31, noise=0.02):
    """Another motion of the robot as it has become, signs hidden."""
    motion = random_trajectory(3, 8.0, seed=seed).motion(grid())
    return simulate(model, theta, motion, rng=np.random.default_rng(seed), noise=noise)


def test_knowledge_is_what_a_result_says_of_its_coefficients(signed, drawn):
    """Without draws the information matrix; with draws the inverse of their covariance, whatever the units."""
    assert signed.knowledge.model is signed.model
    np.testing.assert_array_equal(signed.knowledge.precision, signed.fit.information)
    np.testing.assert_array_equal(signed.knowledge.theta, signed.fit.theta)
    result = drawn[0]
    scale = np.sqrt(np.outer(np.diag(result.covariance), np.diag(result.covariance)))
    unit = (result.knowledge.precision * scale) @ (result.covariance / scale)
    np.testing.assert_allclose(unit, np.eye(len(unit)), atol=1e-6)
    np.testing.assert_array_equal(result.knowledge.theta, result.theta)


def test_a_payload_is_identified_from_an_earlier_log_and_a_later_one(truth, signed):
    model, theta = truth.model.extend(make_effect("payload", {})), np.concatenate([truth.theta, BODY])
    log = later(model, theta)
    begin = np.concatenate([signed.theta, 0.7 * BODY])
    found = identify_again(model, log, signed.knowledge, begin)
    assert found.model == model
    assert found.coefficients.names == signed.knowledge.coefficients(model).names
    off = found.beta - found.coefficients.project(theta)
    assert plausible(found, float(off @ np.linalg.solve(found.fit.covariance, off)))
    effort = model.effort(found.signals.motion, theta)
    strong = np.abs(effort) >= STRONG * np.abs(effort).max(axis=0)
    assert np.mean((np.sign(effort) == found.sample_signs)[strong]) >= 0.99
    mass = [parameter.name for parameter in model.parameters].index("mp3")
    sd, decided = found.parameter_sd
    assert decided[mass]
    assert sd[mass] < 0.3
    assert found.theta[mass] == pytest.approx(1.9, abs=4.5 * sd[mass])
    assert not decided[[parameter.name for parameter in model.parameters].index("m3")]
    again = found.knowledge
    assert again.model == model
    own = base_coefficients(model)
    turn = own.projection @ np.linalg.pinv(found.coefficients.projection)
    covariance = turn @ found.covariance @ turn.T
    scale = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    np.testing.assert_allclose((again.precision * scale) @ (covariance / scale), np.eye(len(own)), atol=1e-4)


def test_a_sensor_is_in_the_model_but_not_in_the_rows(truth, signed):
    """A reading that lacks 1.1 N m in joint 2: the fit is one of the efforts before it."""
    model = truth.model.extend(make_effect("dead_zone.shrinking", {"joints": (2,), "width": (1.1,)}))
    log = later(model, truth.theta)
    found = identify_again(model, log, signed.knowledge, signed.theta)
    assert found.model.distortions == model.distortions
    np.testing.assert_array_equal(found.signals.raw_effort, bayesid.log.signals.prepare(log).raw_effort)
    expected = truth.model.effort(found.signals.motion, truth.theta)
    assert overall(found.fit.predicted - expected) < 0.03 * overall(expected)
    plain = identify_again(truth.model, log, signed.knowledge, signed.theta)
    assert found.fit.noise.sigma[1] < 0.8 * plain.fit.noise.sigma[1]


def overall(values):
    return np.sqrt(np.mean(values**2))
