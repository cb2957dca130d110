import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.stats import norm

from bayesid.cli.terminal import in_options
from bayesid.effects import RigidBody, ViscousFriction
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.excitation.assessment import assess_excitation
from bayesid.excitation.design import design_for_robot
from bayesid.excitation.resolvability import (
    JointFlips,
    SegmentFlips,
    flip_joints,
    flip_measured_segments,
    flip_segments,
    groups_of,
    joint_grams,
    noise_tolerance,
    plausible_robots,
    wrong_sign_probability,
)
from bayesid.excitation.settings import MotionSettings
from bayesid.log.segments import Segments
from bayesid.regression.normal_equations import normal_equations
from bayesid.report.motions import save_design
from bayesid.robot import robot_from_table
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import MotionLimits, condition_number, random_trajectory
from tests.conftest import real_log, small_robot, smooth_motion

LIMITS = MotionLimits(
    lower=(-1.4, -0.3, -2.0), upper=(0.9, 1.8, 2.2), velocity=(1.5, 2.5, 3.1), acceleration=(4.0, 9.0, 6.0)
)
TERMS = ("rigid_body", "viscous_friction")
SETTINGS = MotionSettings(duration=6.0, rate=50.0, periods=2, limits=LIMITS, changes=600)
QUICK = {"settings": SETTINGS, "seed": 4}


@pytest.fixture(scope="module")
def model():
    return Model(small_robot(3, seed=2), (RigidBody(), ViscousFriction()))


@pytest.fixture(scope="module")
def design(model):
    return design_for_robot(model.robot, TERMS, **QUICK)


@pytest.fixture(scope="module")
def problem(model):
    """Columns, efforts, speeds and noise of a motion; the noise differs between joints."""
    motion, coefficients = smooth_motion(3, 4.0, 60.0, seed=1), base_coefficients(model)
    columns = model.columns(motion)[:, :, coefficients.selected]
    beta = coefficients.project(random_parameters(model, rng=np.random.default_rng(3)))
    return columns, beta, motion, np.array([0.7, 0.2, 1.9])


def least_cost(columns, target, sigma):
    """Of all coefficients, by an SVD of all weighted rows."""
    rows = (columns / sigma[:, None]).reshape(-1, columns.shape[2])
    target = (target / sigma).ravel()
    rest = target - rows @ np.linalg.lstsq(rows, target, rcond=1e-13)[0]
    return float(rest @ rest)


def test_resolvability_of_segments_agrees_with_least_squares(problem):
    columns, beta, motion, sigma = problem
    effort = columns @ beta
    flips = flip_segments(columns, effort, motion.dq, sigma, weight=1.0)
    rounding = 1e-11 * np.sum((effort / sigma) ** 2)
    assert min(np.bincount(flips.joint)) > 2
    assert flips.share.sum() == pytest.approx(1.0)
    for k, (j, a, b) in enumerate(zip(flips.joint, flips.start, flips.end, strict=True)):
        signs = np.sign(effort[a:b, j]) * np.sign(motion.dq[a:b, j])
        assert len(set(signs)) == 1
        turned = effort.copy()
        turned[a:b, j] *= -1.0
        # (2) is a difference of energies: it keeps their rounding, 1e-16 times the square of the condition number
        assert flips.resolvability[k] == pytest.approx(least_cost(columns, turned, sigma), rel=1e-6, abs=rounding)
    covered = np.zeros(effort.shape, dtype=int)
    for j, a, b in zip(flips.joint, flips.start, flips.end, strict=True):
        covered[a:b, j] += 1
    assert np.all(covered == 1)


def test_resolvability_of_joints_agrees_with_least_squares(problem):
    columns, beta, _, sigma = problem
    groups = groups_of([0, 1, 2])
    assert groups == ((0,), (1,), (2,), (0, 1), (0, 2), (1, 2))
    flips = flip_joints(joint_grams(columns) / sigma[:, None, None] ** 2, beta, groups)
    for group, found in zip(groups, flips.resolvability, strict=True):
        turned = columns @ beta
        turned[:, list(group)] *= -1.0
        assert found == pytest.approx(least_cost(columns, turned, sigma), rel=1e-6)
    np.testing.assert_allclose(flips.resolvability[:3], flips.resolvability[5:2:-1], rtol=1e-6)  # complements
    energy = ((columns @ beta / sigma) ** 2).sum(axis=0)
    share = energy / energy.sum()
    np.testing.assert_allclose(flips.share[:3], np.minimum(share, 1.0 - share))


def test_segments_of_a_log_agree_with_expected_segments(problem, model):
    columns, beta, motion, sigma = problem
    effort = columns @ beta
    want = flip_segments(columns, effort, motion.dq, sigma, weight=0.3)
    known = np.zeros(len(want.joint), dtype=np.int64)
    known[2] = 1
    segments = Segments(want.joint, want.start, want.end, known, np.ones(len(known), dtype=bool))
    found = normal_equations(
        model, base_coefficients(model), motion, np.abs(effort), segments, most_individual=0
    ).scaled(sigma)
    have = flip_measured_segments(found, segments.start, segments.end, weight=0.3)
    np.testing.assert_allclose(have.resolvability, np.delete(want.resolvability, 2), rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(have.start, np.delete(want.start, 2))
    np.testing.assert_allclose(have.share, np.delete(want.share, 2))


def test_probability_of_a_wrong_sign_agrees_with_draws_of_noise():
    """4000 draws of noise; the formula is of first order, a wrong factor in its argument would change it by 0.1."""
    rng = np.random.default_rng(8)
    columns, beta = rng.normal(size=(120, 1, 2)), np.array([0.4, -0.15])
    tau = columns[:, 0] @ beta
    turned = tau.copy()
    turned[30:43] *= -1.0
    rows = columns[:, 0]
    rest = np.eye(120) - rows @ np.linalg.pinv(rows)
    found = turned @ rest @ turned
    assert 4.0 < found < 12.0
    noise = rng.normal(size=(4000, 120))
    side = np.sign(tau) * np.sign(turned)
    true, other = (tau + noise) @ rest, (side * (tau + noise)) @ rest
    wrong = np.mean((other**2).sum(axis=1) < (true**2).sum(axis=1))
    assert wrong == pytest.approx(float(wrong_sign_probability(np.array([found]))[0]), abs=0.025)


def test_a_tenth_of_the_energy_is_wrong_at_the_noise_tolerance():
    joints = JointFlips(((0,), (1,)), np.array([0.3, 0.3]), np.array([900.0, 2500.0]))
    segments = SegmentFlips(*np.zeros((3, 3), dtype=int), np.array([0.5, 0.3, 0.2]), np.array([1e4, 400.0, 25.0]))
    found = noise_tolerance(joints, segments, noise=0.07)
    roots = [np.sqrt(one.resolvability) * 0.07 / found / 2 for one in (joints, segments)]
    wrong = joints.share @ norm.sf(roots[0]) + segments.share @ norm.sf(roots[1])
    assert wrong == pytest.approx(0.1, abs=1e-5)
    louder = [replace(one, resolvability=one.resolvability / 4.0) for one in (joints, segments)]
    assert noise_tolerance(*louder, noise=0.14) == pytest.approx(found, rel=1e-5)


def test_uncertainty_is_that_of_a_bayesian_linear_regression(problem, model):
    columns, _, _, _ = problem
    expectation = plausible_robots(model, 2)
    grams = joint_grams(columns)
    sd = expectation.uncertainty(grams, expectation.sigma(grams, len(columns), noise=3.0), weight=0.25)
    rms = np.sqrt(np.mean([np.mean((columns @ beta) ** 2, axis=0) for beta in expectation.betas], axis=0))
    rows = (columns / (3.0 * rms)[:, None]).reshape(-1, columns.shape[2]) * 0.5
    stacked = np.vstack([rows, np.diag(1.0 / expectation.size)])
    _, values, vectors = np.linalg.svd(stacked * expectation.size, full_matrices=False)
    np.testing.assert_allclose(sd, np.linalg.norm(vectors.T / values, axis=1), rtol=1e-6)
    assert 0.05 < sd.min() < sd.max() < 1.0


def test_a_design_keeps_its_limits_and_ends_where_it_starts(design):
    fine = design.trajectory.motion(np.linspace(0.0, 3.0, 10 * len(design.motion)))
    assert design.reached.condition < 0.8 * design.start.condition
    assert np.all((fine.q >= LIMITS.lower) & (fine.q <= LIMITS.upper))
    assert np.all(np.abs(fine.dq) <= LIMITS.velocity)
    assert np.all(np.abs(fine.ddq) <= LIMITS.acceleration)
    assert design.reached.condition == pytest.approx(condition_number(design.model, design.coefficients, design.motion))
    motion = design.motion
    assert motion.t[-1] == 6.0
    np.testing.assert_allclose(motion.q[150:], motion.q[:151], atol=1e-12, err_msg="two periods")
    np.testing.assert_allclose(motion.dq[[0, -1]], 0.0, atol=1e-11)
    np.testing.assert_allclose(motion.ddq[[0, -1]], 0.0, atol=1e-10)


def test_options_that_cannot_be_used_are_named(model):
    for wrong, where in (
        ({"duration": 0.1}, "--duration"),
        ({"duration": float("nan")}, "--duration"),
        ({"rate": 3.0}, "--rate"),
        ({"rate": 1e9}, "--rate"),
        ({"harmonics": 1}, "--harmonics"),
        ({"periods": 0}, "--periods"),
        ({"noise": 0.0}, "--noise"),
        ({"limits": MotionLimits(velocity=(1.0, 2.0))}, "--limits"),
        ({"terms": ("gravity",)}, "--terms"),
    ):
        options = {"duration": 6.0, "terms": TERMS, **wrong}
        terms = options.pop("terms")
        with pytest.raises(InputError) as caught:
            design_for_robot(model.robot, terms, settings=MotionSettings(**options))
        assert where in in_options(str(caught.value))


def test_a_folder_holds_the_motion_and_the_spline_that_makes_it(design, tmp_path):
    folder = save_design(design, tmp_path / "out")
    assert sorted(path.name for path in folder.iterdir()) == ["design.json", "excitation.svg", "trajectory.csv"]
    lines = (folder / "trajectory.csv").read_text().splitlines()
    assert lines[0] == "t,q1,q2,q3,dq1,dq2,dq3,ddq1,ddq2,ddq3"
    rows = np.array([line.split(",") for line in lines[1:]], dtype=float)
    assert np.all(rows[[0, -1], 4:] == 0.0)
    written = json.loads((folder / "design.json").read_text())
    spline = written["spline"]
    again = BSpline(np.array(spline["knots"]), np.array(spline["control_points"]), spline["degree"])
    t = rows[:, 0] % spline["period"]
    np.testing.assert_allclose(rows[:, 1:], np.hstack([again(t), again(t, 1), again(t, 2)]), atol=2e-7)
    assert written["limits"]["given"]["upper"] == [0.9, 1.8, 2.2]
    reached = written["limits"]["reached"]
    assert reached["velocity"] == pytest.approx(np.abs(rows[:, 4:7]).max(axis=0).tolist(), rel=1e-6)
    assert written["reached"]["condition_number"] < written["start"]["condition_number"]


def test_a_prismatic_joint_needs_limits():
    rows = [{"a": 0.1, "alpha": 0.3, "d": 0.2, "theta": 0.0, "type": kind} for kind in ("revolute", "prismatic")]
    robot = robot_from_table({"name": "slider", "convention": "standard", "joints": rows}, "test")
    with pytest.raises(InputError, match="prismatic joint 2"):
        design_for_robot(robot, settings=MotionSettings(duration=5.0))


def log_of(model, trajectory, duration=20.0, rate=50.0, signed=False):
    motion = trajectory.motion(np.arange(round(duration * rate) + 1) / rate)
    rng = np.random.default_rng(7)
    return simulate(model, random_parameters(model, rng=rng), motion, rng=rng, noise=0.02, signed=signed)


def test_a_good_log_is_good_and_a_joint_that_hardly_moves_is_bad(model):
    series = random_trajectory(3, 20.0, rng=2, periods=4, limits=LIMITS)
    good = assess_excitation(model.robot, log_of(model, series), TERMS)
    assert good.state == "good"
    exact = condition_number(model, good.coefficients, series.motion(np.arange(1001) / 50.0))
    assert good.condition == pytest.approx(exact, rel=0.05)
    assert good.doubtful.max() < 0.05
    still = np.array([1.0, 0.02, 1.0])[:, None]
    bad = assess_excitation(
        model.robot, log_of(model, replace(series, sine=still * series.sine, cosine=still * series.cosine)), TERMS
    )
    assert bad.state == "bad"
    assert bad.reach[1] < 0.1
    assert [remark[:7] for remark in bad.remarks if " covers" in remark] == ["joint 2"]
    assert len(bad.undecided) > 0
    assert bad.condition > 10.0 * good.condition
    log = log_of(model, series)
    held = {name: np.pad(getattr(log, name), ((0, 1500), (0, 0)), "edge") for name in ("q", "effort")}
    resting = assess_excitation(model.robot, replace(log, t=np.arange(len(log) + 1500) / 50.0, **held), TERMS)
    np.testing.assert_allclose(resting.idle, 0.6, atol=0.05)
    assert [remark[:7] for remark in resting.remarks if " at standstill" in remark] == ["joint 1", "joint 2", "joint 3"]


def test_a_joint_that_can_be_flipped_as_a_whole_is_bad():
    model = Model(small_robot(1, seed=5), (RigidBody(), ViscousFriction()))
    trajectory = random_trajectory(1, 20.0, rng=3, periods=3)
    judgement = assess_excitation(model.robot, log_of(model, trajectory), TERMS)
    assert judgement.state == "bad"
    assert any("flipping all signs of joint 1" in remark for remark in judgement.remarks)
    signed = assess_excitation(model.robot, log_of(model, trajectory, signed=True), TERMS)
    assert signed.joints is None
    assert len(signed.segments.joint) == 0
    assert signed.state == "good"


@pytest.mark.real
def test_a_real_log_of_the_ur10e_excites_well():
    judgement = assess_excitation("ur10e", real_log("ur10e/a_50s.csv"))
    assert judgement.state == "good"
    assert 5.0 < judgement.condition < 30.0
