"""`bayesid floor`: what two recordings of one motion differ by, beside differences that are known."""

import json
import shlex

import numpy as np
import pytest
from command_line import assert_refused, run
from conftest import small_robot, smooth_motion

import bayesid
from bayesid.discrepancy.repeatability import repeatability
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.files.config import CONFIG
from bayesid.log.log import Log
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters

TERMS = ["rigid_body", "viscous_friction"]
ROBOT = small_robot(2)
AMPLITUDE = np.array([0.8, 0.05])
"""N m, of a slow wave that is in the second recording alone."""


def recording(seed, rate=100.0, ahead=0.0, wave=0.0, signed=True):
    """A noise-free log whose clock begins `ahead` s within the motion, with a wave on its efforts."""
    motion = smooth_motion(2, 12.0, rate, seed=seed)
    model = Model(ROBOT, make_terms(TERMS, ROBOT, motion))
    theta = random_parameters(model, rng=np.random.default_rng(2))
    log = simulate(model, theta, motion, rng=np.random.default_rng(0), noise=0.0, signed=True)
    rows = log.t >= ahead
    effort = log.effort + wave * AMPLITUDE * np.sin(2.0 * np.pi * 0.5 * log.t)[:, None]
    found = Log(log.t[rows] - ahead + 5.0, log.q[rows], effort[rows], np.ones(2, dtype=bool), source=f"log {seed}")
    return found if signed else found.rectified()


def test_the_floor_is_that_of_a_known_difference():
    """Of a sine the RMS is the amplitude over root 2; half of the variance of a difference is each recording's."""
    log = recording(1)
    found = repeatability(ROBOT, log, recording(1, rate=125.0, ahead=1.3, wave=1.0))
    np.testing.assert_allclose(found.difference, AMPLITUDE / np.sqrt(2.0), rtol=0.06)
    np.testing.assert_allclose(found.floor, AMPLITUDE / 2.0, rtol=0.06)
    size = np.sqrt(np.mean(log.effort**2, axis=0))
    np.testing.assert_allclose(found.relative, AMPLITUDE / 2.0 / size, rtol=0.15)
    assert found.shift == pytest.approx(-1.3, abs=2e-3)
    assert found.position.max() < 1e-3
    assert found.signed.all()
    same = repeatability(ROBOT, log, recording(1))
    assert np.all(same.relative < 1e-6)


def test_hidden_signs_compare_magnitudes():
    """Of a joint whose sign one recording hides; elsewhere a wrong sign is a difference."""
    log, hidden = recording(1), recording(1, wave=1.0, signed=False)
    found = repeatability(ROBOT, log, hidden)
    assert not found.signed.any()
    magnitude = repeatability(ROBOT, log.rectified(), hidden)
    np.testing.assert_array_equal(found.difference, magnitude.difference)
    assert np.all(found.difference <= 1.06 * AMPLITUDE / np.sqrt(2.0))
    turned = Log(log.t, log.q, -log.effort, log.signed)
    assert np.all(repeatability(ROBOT, log, turned).relative > 1.0)
    assert np.all(repeatability(ROBOT, log.rectified(), turned).relative < 1e-6)


def test_another_motion_is_refused():
    with pytest.raises(InputError, match=r"log 2: positions of joint \d differ from those of log 1"):
        repeatability(ROBOT, recording(1), recording(2))


def test_the_command_prints_a_table_and_the_next_command(arm_place, capfd):
    log = bayesid.read_log("log.csv")
    bayesid.Log(log.t + 3.0, log.q, 1.02 * log.effort, log.signed).save("again.csv")
    assert run("floor", "log.csv", "again.csv", "--robot", "arm.toml", "--out", "floor.json", "--strict") == 0
    out, err = capfd.readouterr()
    assert (err, "Verdict: good. " in out) == ("", True)
    assert out.splitlines()[-1].endswith("next: bayesid identify log.csv again.csv --robot arm.toml")
    shares = [float(line.split()[3].rstrip("%")) for line in out.splitlines()[1:4]]
    np.testing.assert_allclose(shares, 2.0 / np.sqrt(2.0), atol=0.05)
    np.testing.assert_allclose(
        100.0 * np.array(json.loads((arm_place / "floor.json").read_text())["relative"]), shares, atol=0.01
    )
    assert_refused(capfd, ("floor", "log.csv", "log.csv", "--robot", "arm.toml"), ["twice"])
    other = "simulate", "--robot", "arm.toml", "--duration", 6, "--seed", 5, "--out", "other.csv", "--quiet"
    assert run(*other) == 0
    assert_refused(capfd, ("floor", "log.csv", "other.csv", "--robot", "arm.toml"), ["other.csv", "same motion"])


def test_recordings_are_read_as_those_of_a_result_and_what_differs_is_looked_for(arm_place, capfd):
    """The folder's bayesid.toml names robot and columns; efforts that differ by a quarter are not pooled."""
    log = bayesid.read_log("log.csv")
    names = ["Zeit", *(f"Lage{j}" for j in (1, 2, 3)), *(f"Moment{j}" for j in (1, 2, 3))]
    for name, times in (("one.csv", 1.0), ("two.csv", 1.5)):
        values = np.column_stack([log.t, log.q, times * log.effort])
        np.savetxt(name, values, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    (arm_place / "result").mkdir()
    columns = {"t": "Zeit", "q": "Lage{}", "tau": "Moment{}"}
    text = f"robot = '../arm.toml'\ncolumns = {{{', '.join(f'{key} = {name!r}' for key, name in columns.items())}}}\n"
    (arm_place / "result" / CONFIG).write_text(text)
    assert run("floor", "one.csv", "two.csv", "--config", "result") == 0
    out = capfd.readouterr().out
    assert "Verdict: bad. " in out
    last = out.splitlines()[-1]
    assert last.startswith("next: bayesid discrepancy one.csv two.csv --robot result/../arm.toml --columns ")
    assert "'t=Zeit,q=Lage{},tau=Moment{}'" in last
    assert run(*shlex.split(last)[2:], "--help") == 0
