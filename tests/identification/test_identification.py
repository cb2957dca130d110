from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
from conftest import real_log, small_robot
from scipy import stats

import bayesid
from bayesid.arrays import Array
from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.identification import pipeline
from bayesid.identification.identification import Identification
from bayesid.identification.options import Preprocessing
from bayesid.log.log import Log
from bayesid.log.reading import read_log
from bayesid.log.segments import Segments, find_segments
from bayesid.log.signals import signed_effort
from bayesid.motion import STANDSTILL, Motion
from bayesid.posterior.sampler import Sampling
from bayesid.progress import Progress
from bayesid.regression.knowledge import ParameterPrior
from bayesid.robot import Robot, load_robot, robot_from_table
from bayesid.signs.rounds import crossings
from bayesid.signs.search.certified import Certified
from bayesid.signs.sign_solution import find_signs
from bayesid.simulation.logs import simulate, simulate_log
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

identify = partial(pipeline.identify, complete="off", posterior=False)
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
    at = random_trajectory(robot.n_joints, duration, rng=seed).motion
    model = Model(robot, make_terms(terms, robot, at(grid(duration))))
    return Truth(at, model, random_parameters(model, rng=np.random.default_rng(seed)))


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


def test_the_signs_come_back_and_the_coefficients_with_them(truth, unsigned):
    assert truth.right_signs(unsigned) == 1.0
    assert unsigned.warnings == ()
    assert plausible(unsigned, truth.surprise(unsigned))
    np.testing.assert_allclose(unsigned.fit.relative_residual, 0.05, atol=0.04)
    assert truth.model.cone.contains(unsigned.fit.theta)


def test_standard_deviations_mean_what_they_say():
    """Over many logs, each with its own motion and noise: z-scores of unit variance, 5 sd never reached."""
    surprises, worst = [], 0.0
    for seed in range(12):
        truth = arm(4, terms=SMOOTH)
        truth = replace(truth, at=random_trajectory(3, 8.0, rng=seed).motion)
        result = identify(truth.model.robot, truth.log(grid(), signed=True, seed=seed), SMOOTH)
        z = (result.fit.beta - result.coefficients.project(truth.theta)) / result.fit.sd
        surprises.append(truth.surprise(result))
        worst = max(worst, np.abs(z).max())
    total = 12 * len(result.coefficients)
    assert stats.chi2.isf(1 - 1e-4, total) < np.sum(surprises) < 1.25 * stats.chi2.isf(1e-4, total)
    assert worst < 5.0


def test_without_noise_there_are_draws_too(truth):
    """No effort counts as known to better than a thousandth of its size: neither sampler nor start may break down."""
    result = bayesid.identify(truth.model.robot, truth.log(grid(), noise=0.0))
    assert result.posterior.converged
    assert truth.right_signs(result) == 1.0
    rms = result.posterior.normal_equations.rms_effort(3)
    assert (result.posterior.noise.sigma > 0.99e-3 * rms).all()
    assert (np.exp(result.posterior.draws.log_scale.mean(axis=(0, 1, 2))) > 0.5).all()


@pytest.mark.filterwarnings("error::RuntimeWarning")  # efforts of links that are not there are rounding
def test_a_model_without_bodies_has_draws_too():
    terms = ("viscous_friction", "coulomb_friction", "torque_offset")
    truth = arm(2, terms=terms)
    result = identify(truth.model.robot, truth.log(grid()), terms, posterior=Sampling(budget=1.0))
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
    assert stages[-4:] == [
        "sampling",
        "probability of the segments' signs",
        "probability of the samples' signs",
        "input diagnosis",
    ]
    assert calls[-1] == ("input diagnosis", 1, 1)
    assert all(0 <= done <= total for _, done, total in calls)
    assert sum(done == 0 and total == 1 for _, done, total in calls) == sum(done == total for _, done, total in calls)
    np.testing.assert_array_equal(result.fit.beta, unsigned.fit.beta, "the same log gives the same result")
    np.testing.assert_array_equal(unsigned.beta, unsigned.fit.beta)
    np.testing.assert_array_equal(unsigned.sd, unsigned.fit.sd)
    posterior = result.posterior
    assert len(posterior.branch_mass) == len(result.search.branches) >= 1
    assert posterior.branch_mass.sum() + posterior.elsewhere == pytest.approx(1.0, abs=1e-9)
    assert result.persistent_share == 1.0
    assert posterior.branch_mass.max() > 0.9, "nobody doubts it"


def test_draws_are_about_the_truth_and_signs_averaged_over_them_are_right(truth, unsigned, drawn):
    """As wide as least squares says, but for the cone and the noise's own doubt."""
    result, _ = drawn
    off = result.beta - result.coefficients.project(truth.theta)
    assert plausible(result, float(off @ np.linalg.solve(result.covariance, off)))
    ratio = result.sd / unsigned.sd
    assert 0.75 < np.median(ratio) < 1.25
    assert ratio.max() < 1.5
    assert np.abs((result.beta - unsigned.beta) / unsigned.sd).max() < 1.5
    assert truth.right_signs(result) == 1.0
    sure = np.maximum(result.probability, 1.0 - result.probability) > 0.99
    right = (np.sign(truth.effort(result.signals.motion.t)) == result.sample_signs)[sure]
    assert sure.mean() > 0.9
    assert np.sum(~right) <= stats.poisson.isf(1e-4, 0.01 * len(right))
    assert not np.array_equal(result.probability, unsigned.probability)


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
    rows = np.concatenate(columns, axis=2)[:, :, result.coefficients.selected]
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


def test_some_joints_may_be_signed(truth):
    log = truth.log(grid(), signed=[True, False, True])
    result = identify(truth.model.robot, log)
    assert truth.right_signs(result) >= 0.999
    assert plausible(result, truth.surprise(result))
    np.testing.assert_array_equal(result.probability[:, [0, 2]], log.effort[:, [0, 2]] >= 0.0)
    assert set(result.segments.joint[result.segments.known == 0]) == {1}


@pytest.mark.parametrize("joints", [[0, 1, 2], [1]])
def test_no_feasible_robot_fits_flipped_signs(truth, signed, joints):
    """All signs flipped, or those of one joint: what |effort| cannot tell apart, the cone does."""
    log = truth.log(grid(), signed=True)
    effort = log.effort.copy()
    effort[:, joints] *= -1.0
    flipped = identify(truth.model.robot, replace(log, effort=effort), anyway=True)
    assert flipped.better_reading.kind == "direction"
    assert flipped.fit.relative_residual.max() > 5.0 * signed.fit.relative_residual.max()


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
    at, turn = random_trajectory(2, 8.0, rng=1).motion, 0.0 if upright else np.pi
    rng = np.random.default_rng(3)

    def effort(motion: Motion) -> Array:  # gravity upwards is the same as a base turned by half a turn
        return two_links(replace(motion, q=motion.q + np.array([turn, 0.0])))

    expected = effort(at(grid()))
    noisy = expected + 0.02 * expected.std(axis=0) * rng.standard_normal(expected.shape)
    log = Log(grid(), at(grid()).q, np.abs(noisy), np.zeros(2, dtype=bool))
    result = identify(robot, log, ["rigid_body", "viscous_friction"])
    strong = np.abs(expected) >= STRONG * np.abs(expected).max(axis=0)
    assert np.all((np.sign(expected) == result.sample_signs)[strong])
    new = random_trajectory(2, 8.0, rng=2).motion(grid())
    error = result.model.effort(new, result.fit.theta) - effort(new)
    assert np.all(error.std(axis=0) < 0.01 * effort(new).std(axis=0))


def test_motors_that_are_coupled():
    truth = arm(2, robot=load_robot("tx40"), duration=12.0)
    result = identify(truth.model.robot, truth.log(grid(12.0), noise=0.03))
    assert truth.right_signs(result) >= 0.999
    new = random_trajectory(6, 8.0, rng=9).motion(grid())
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
    theta = random_parameters(model, rng=np.random.default_rng(4))
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


def cut_at(threshold: float) -> Preprocessing:
    return Preprocessing(threshold=threshold)


def sample_mask(result: Identification, of_segments: Array) -> Array:
    return result.segments.per_sample(of_segments, *result.probability.shape) > 0


def test_samples_under_the_threshold_have_no_say_in_the_fit(truth):
    """Against numpy's least squares on the others alone, with the true signs; the posterior has as many samples."""
    log = truth.log(grid())
    result = identify(truth.model.robot, log, posterior=Sampling(budget=0.0), preprocessing=cut_at(0.2))
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
    assert result.posterior.normal_equations.count.sum() == (fitted & inside[:, None]).sum()


def test_a_cut_that_segmentation_missed_is_made_by_searching_again(truth, unsigned):
    """In each joint a segment of less than 0.4 s is glued to its neighbour of the other sign before the search."""
    cut, effort = find_segments(unsigned.signals, unsigned.signals.motion), truth.effort(unsigned.signals.motion.t)
    blunt = glued(cut, effort)
    assert len(blunt) == len(cut) - 3
    sign_solution = find_signs(unsigned.model, unsigned.signals, blunt, Certified())
    assert sign_solution.signs.rounds > 1
    assert len(sign_solution.signs.segments) > len(blunt)
    strong = np.abs(effort) >= STRONG * np.abs(effort).max(axis=0)
    assert np.mean(((sign_solution.probability >= 0.5) == (effort > 0.0))[strong]) >= 0.999


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


def test_bad_input_is_named(truth, tmp_path):
    given = {"robot": truth.model.robot, "log": truth.log(grid())}
    t = grid(1.2)  # one short move in a second of rest
    short = replace(truth.log(t), q=point_to_point(3, 1, seed=0)(np.clip((t - 0.5) * 5.0, 0.0, 1.0)).q)
    for change, where, what in (
        (lambda: {"robot": "kr5"}, "simulated arm3", "3 joints"),
        (lambda: {"terms": ["rigid_body", "magic"]}, "terms", "magic"),
        (lambda: {"terms": ["rigid_body", "rigid_body"]}, "terms", "twice"),
        (lambda: {"preprocessing": Preprocessing(cutoff=0.0)}, "cutoff", "0 Hz"),
        (lambda: {"preprocessing": Preprocessing(cutoff=51.0)}, "cutoff", "51 Hz"),
        (lambda: {"preprocessing": cut_at(0.999)}, "simulated arm3", "above the threshold"),
        (lambda: {"posterior": Sampling(budget=-1.0)}, "Sampling.budget", "-1"),
        (lambda: {"posterior": Sampling(budget=np.nan)}, "Sampling.budget", "nan"),
        (lambda: {"prior": ParameterPrior(nominal={"m9": (1.0, 0.1)})}, "nominal", "m9"),
        (lambda: {"log": "nowhere.csv"}, "nowhere.csv", "no such file"),
        (lambda: {"log": str(tmp_path)}, str(tmp_path), "is a folder"),
        (lambda: {"robot": "nobody"}, "nobody", "no such robot"),
        (lambda: {"log": replace(given["log"], q=0.3 + 1e-6 * given["log"].q)}, "simulated arm3", "no joint moves"),
        (lambda: {"log": short}, "simulated arm3", "samples in motion for 28 coefficients"),
    ):
        with pytest.raises(InputError) as refusal:
            identify(**{**given, **change()})
        assert where in (refusal.value.field or refusal.value.where)
        assert what in refusal.value.what
        assert refusal.value.remedy


@pytest.mark.real
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


def one_joint(known: int = 0) -> Segments:
    """All of 101 samples as one."""
    return Segments(*(np.array([value]) for value in (0, 0, 101, known, True)))


def test_a_clear_crossing_is_cut_where_the_effort_is_least_unless_the_sign_is_known():
    predicted, sigma = np.linspace(1.0, -1.0, 101)[:, None], np.array([0.1])
    effort = np.abs(predicted) + 0.05
    effort[47] = 0.01
    assert crossings(one_joint(), predicted, effort, sigma) == [(0, 47)]
    cut = one_joint().split([(0, 47)])
    assert (cut.start.tolist(), cut.end.tolist()) == ([0, 47], [47, 101])
    assert crossings(cut, predicted, effort, sigma) == []
    assert crossings(one_joint(known=1), predicted, effort, sigma) == []
    assert crossings(one_joint(), predicted, np.abs(predicted), 6.0 * sigma) == [], "not clear"


def test_fewer_rows_than_coefficients_are_refused_before_the_search():
    log = simulate_log(load_robot("kr5"), 1.0, 50.0, 0.02, (), seed=0)[0]
    with pytest.raises(InputError, match=r"too short to identify \d\d coefficients from 51 rows"):
        identify("kr5", log)
