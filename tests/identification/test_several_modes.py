"""A log that allows two models: the pendulum hangs or stands, and moves too slowly to show its inertia."""

import json
from functools import cache

import arviz as az
import numpy as np
import pytest

from bayesid.cli import main
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.identification.model_file import load
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.log.signals import signed_effort
from bayesid.motion import Motion
from bayesid.posterior.sampler import Sampling
from bayesid.report.folders import save_identification
from bayesid.report.report_data import report_data
from bayesid.report.verdicts import check_findings
from bayesid.robot import load_robot
from bayesid.signs.search.certified import Certified

TABLE = """name = "pendulum"
convention = "standard"
gravity = [0.0, -9.81, 0.0]
[[joints]]
a = 0.0
alpha = 0.0
d = 0.0
theta = 0.0
"""
TRUTH = {"m1": 3.0, "mc1x": 0.3, "mc1y": 2.0, "J1xx": 2.0, "J1yy": 2.0, "J1zz": 1.6}
SLOW, NOISE = 0.2, 0.3
"""rad/s, and the noise relative to the effort: turning the pendulum round costs next to nothing."""


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "pendulum.toml"
    path.write_text(TABLE)
    return path


def made_log(path, slow=SLOW, noise=NOISE, seed=2):
    t = np.arange(0.0, 40.0, 0.02)
    waves = ((0.6, slow, 0.0), (0.1, 2.3 * slow, 1.0))
    q = sum(a * np.sin(w * t + p) for a, w, p in waves)[:, None]
    dq = sum(a * w * np.cos(w * t + p) for a, w, p in waves)[:, None]
    ddq = sum(-a * w * w * np.sin(w * t + p) for a, w, p in waves)[:, None]
    motion, robot = Motion(t, q, dq, ddq), load_robot(path)
    model = Model(robot, make_terms(["rigid_body"], robot, motion))
    effort = model.effort(motion, np.array([TRUTH.get(p.name, 0.0) for p in model.parameters]))
    error = noise * np.sqrt(np.mean(effort**2)) * np.random.default_rng(seed).standard_normal(effort.shape)
    return Log(t, q, np.abs(effort + error), np.array([False]))


@cache
def identified(path, mode=1):
    sampling = Sampling(mode=mode)
    search = Certified()
    return identify(path, made_log(path), ["rigid_body"], complete="off", search=search, posterior=sampling)


def test_the_model_is_one_of_them_and_no_point_between(robot):
    result = identified(robot)
    first, second = result.posterior.modes[:2]
    assert 0.05 < second.weight < 0.5
    value = dict(zip(result.coefficients.names, result.beta.tolist(), strict=True))
    assert abs(abs(value["mc1y"]) - TRUTH["mc1y"]) < 0.15
    of_mode = first.draws.beta.reshape(-1, len(result.beta)).mean(axis=0)
    np.testing.assert_allclose(result.beta, of_mode, rtol=1e-9)
    assert np.all(result.sd[1:] > 1.5 * np.abs(result.beta[1:]) * np.sqrt(second.weight))  # the other is 2 mc away
    (said,) = [warning for warning in result.warnings if "separate modes" in warning]
    assert "signs of joint 1 flipped" in said
    assert np.average(result.confidence) < 1.2 * first.weight


def test_fit_signs_and_residual_are_those_of_the_mode_that_is_written(robot):
    for mode in (1, 2):
        result = identified(robot, mode)
        predicted = result.model.effort(result.signals.motion, result.theta)
        effort = signed_effort(result.signals, np.where(predicted >= 0.0, 1.0, -1.0))
        share = np.sqrt(np.mean((effort - predicted) ** 2) / np.mean(effort**2))
        assert result.fit.relative_residual[0] == pytest.approx(share, rel=0.1)
        assert np.sign(result.fit.beta[2]) == np.sign(result.beta[2])
    assert identified(robot, 1).beta[2] * identified(robot, 2).beta[2] < 0.0


def test_checks_and_summary_name_the_other_model(robot, tmp_path):
    result = identified(robot)
    (check,) = [check for check in check_findings(report_data(result)) if check.name == "Modes"]
    assert check.state == "bad"
    assert "signs of joint 1 flipped" in check.message
    assert "mc1y" in check.message
    save_identification(result, tmp_path / "out", report=False)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    weights = [mode.weight for mode in result.posterior.modes]
    assert [mode["weight"] for mode in summary["modes"]] == pytest.approx(weights)
    assert [mode["turned_joints"] for mode in summary["modes"][:2]] == [[], [1]]
    np.testing.assert_allclose(load(tmp_path / "out").theta, result.theta)
    drawn = az.from_netcdf(tmp_path / "out" / "posterior.nc").posterior
    sides = np.sign(drawn["beta"].sel(coefficient="mc1y"))
    side = np.sign(result.beta[2])
    assert bool(((drawn["mode"] == 1) == (sides == side)).all())
    assert float((drawn["mode"] == 2).mean()) == pytest.approx(weights[1], abs=0.05)  # a dozen sweeps are kept


def test_the_command_writes_the_other_one(robot, tmp_path, capsys):
    made_log(robot).save(tmp_path / "log.csv")
    options = ["--terms", "rigid_body", "--complete", "off", "--no-report", "--mode", "2"]
    command = ["identify", str(tmp_path / "log.csv"), "--robot", str(robot), *options]
    assert main([*command, "--out", str(tmp_path / "two")]) == 0
    np.testing.assert_allclose(load(tmp_path / "two").theta, identified(robot, 2).theta, rtol=1e-6)
    printed = capsys.readouterr()
    assert "mode 2" in printed.out + printed.err, "as a warning, or with the verdict"
    assert main([*command[:-1], "0"]) == 2


def test_without_a_posterior_a_near_tie_is_as_sure_as_its_mode_weighs(robot):
    """Slower and clearer than above: chi-square differs by 3, and both halves are listed."""
    log = made_log(robot, slow=0.05, noise=0.01, seed=1)
    quick = identify(robot, log, ["rigid_body"], complete="off", posterior=False)
    sampled = identify(robot, log, ["rigid_body"], complete="off", posterior=Sampling(rng=1))
    assert [len(result.search.branches) for result in (quick, sampled)] == [2, 2]
    assert len(sampled.posterior.modes) == 2
    strong = log.effort[:, 0] > 0.3 * log.effort.max()
    of_mode = sampled.posterior.modes[0].weight
    for result in (quick, sampled):
        confidence = np.maximum(result.probability, 1.0 - result.probability)[strong, 0]
        assert confidence.mean() == pytest.approx(of_mode, abs=0.03)
    assert 0.7 < of_mode < 0.9, "neither a tie nor clear"
