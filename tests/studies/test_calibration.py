"""The study of calibration: classes match their names, figures their definitions."""

from dataclasses import replace

import numpy as np
import pytest

from bayesid.effects import STANDARD, RigidBody
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.identification.pipeline import identify
from bayesid.robot import load_robot
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import exciting_trajectory
from bayesid.studies.calibration import CLASSES, bins, trial
from bayesid.studies.calibration_report import EDGES, at_least, calibration_error, coverage, quantiles, underconfidence
from bayesid.studies.hidden import make_case

KINDS = {kind.name: kind for kind in CLASSES}
DEGREE = np.pi / 180.0


def case_of(name, seed=3):
    kind = KINDS[name]
    return make_case(replace(kind, robot=kind.robot or "kr5"), seed)


def test_a_delay_is_of_twenty_milliseconds():
    joints = set()
    for seed in range(4):
        late, right = quiet("delay", seed), quiet("right", seed)
        ((effect, where),) = late.hidden
        assert effect == "delay"
        joints.add(where)
        column = slice(None) if where == () else where[0] - 1
        np.testing.assert_allclose(late.log.effort[2:, column], right.log.effort[:-2, column], atol=1e-6)
        others = np.delete(late.log.effort, column, axis=1) - np.delete(right.log.effort, column, axis=1)
        assert np.abs(others).max(initial=0.0) < 1e-6
    assert len(joints) > 1


def quiet(name, seed=3):
    """Next to no noise."""
    return make_case(replace(KINDS[name], robot="kr5", noise_range=(1e-9, 2e-9)), seed)


def test_bins_count_what_is_right_and_what_was_claimed():
    confidence = np.array([0.5, 0.55, 0.97, 0.985, 0.999, 1.0])
    found = np.array(bins(confidence, np.array([True, False, True, False, True, False])))
    expected = np.zeros((len(EDGES), 3))
    expected[0], expected[5], expected[7] = (2, 1, 1.05), (2, 1, 1.955), (2, 1, 1.999)
    np.testing.assert_allclose(found, expected)
    assert at_least(found, 0.999) == (2, 1)
    assert at_least(found, 0.95) == (4, 2)
    other = bins(np.array([0.8, 0.9]), np.array([True, True]))
    less, error = underconfidence([{"samples": found.tolist()}, {"samples": other}], "samples")
    assert less == pytest.approx((3.0 - 5.004 + 2.0 - 1.7) / 8.0)
    left = np.array([-2.004 - 6 * less, 0.3 - 2 * less])  # what each log's sum is off the common mean
    assert error == pytest.approx(np.sqrt(2.0 * np.sum(left**2)) / 8.0)
    made = np.array([[10.0, 6.0, 5.5], [0.0, 0.0, 0.0], [30.0, 24.0, 27.0]])
    assert calibration_error(made) == pytest.approx((0.5 + 3.0) / 40.0)


def test_coverage_and_its_error():
    """By hand, and by redrawing logs of different size with correlated coefficients."""
    counts = [(90, 100), (98, 100), (100, 100), (60, 100)]
    rows = [{"inside": inside, "coefficients": count} for inside, count in counts]
    assert coverage(rows) == pytest.approx((0.87, np.std([0.9, 0.98, 1.0, 0.6], ddof=1) / 2.0))
    assert quantiles(rows) == pytest.approx((0.69, 0.94))
    assert np.isnan(coverage(rows[:1])[1])
    rng = np.random.default_rng(0)

    def study(logs=200):
        sizes = zip(rng.integers(20, 80, logs), rng.beta(9, 1, logs), strict=True)
        return [{"inside": int(rng.binomial(m, p)), "coefficients": int(m)} for m, p in sizes]

    shares, errors = np.array([coverage(study()) for _ in range(400)]).T
    assert errors.mean() == pytest.approx(shares.std(), rel=0.15)
    naive = np.sqrt(0.9 * 0.1 / (200 * 50))
    assert errors.mean() > 2.0 * naive


def test_a_log_of_a_class_is_scored():
    """A single joint, for it takes but seconds."""
    row = trial(KINDS["pendulum"], 0)
    assert 3 <= row["coefficients"] <= 7
    assert row["inside"] + len(row["missed"]) == row["coefficients"]
    assert len(row["missed"]) == len(row["missed_by"])
    assert sum(count for count, _, _ in row["samples"]) == 2400
    assert sum(right for _, right, _ in row["samples"]) == pytest.approx(2400 * row["right"])
    assert sum(count for count, _, _ in row["rest"]) < 240
    assert row["preference"] < 1e3


def test_a_log_on_which_the_solver_stalled_is_solved_to_a_tolerance_that_is_named():
    """All six attempts of before ended with a NumericalError; the costs and their bounds are duality's all the same."""
    robot, seed, t = load_robot("ur10e"), 214, np.arange(301) / 100.0
    bodies = Model(robot, (RigidBody(),))
    motion = exciting_trajectory(bodies, base_coefficients(bodies), 3.0, seed=seed).motion(t)
    model, rng = Model(robot, make_terms(STANDARD, robot, motion)), np.random.default_rng(seed)
    log = simulate(model, random_parameters(model, rng=rng), motion, rng=rng, noise=0.02, colour=0.9, signed=True)
    result = identify("ur10e", log.rectified(), complete="off", search=Certified(), posterior=False)
    assert result.search.certified
    assert 1e-6 <= result.search.tolerance <= 1e-2  # where it stalls depends on the processor
