"""Logs with payloads on the command line, and files that list logs."""

import csv
import json

import numpy as np
import pytest
from command_line import ARM, run

from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.robot import load_robot
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

TOOL = np.array([0.06, 0.004, -0.006, 0.05, 0.01, 0.04, 0.1, -0.16, 0.24, 2.0])
"""A body of 2 kg, 0.15 m from the flange, beside its axis."""
QUICK = "--no-posterior", "--no-report", "--complete", "off", "--terms", "rigid_body,viscous_friction"


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    """An arm, and logs of it without and with the tool, which is a part of the last link of another arm there."""
    place = tmp_path_factory.mktemp("shop")
    (place / "arm.toml").write_text(ARM)
    robot = load_robot(place / "arm.toml")
    for seed, (name, extra) in enumerate([("plain.csv", 0.0), ("loaded.csv", 1.0), ("again.csv", 1.0)], start=1):
        motion = random_trajectory(3, 6.0, rng=seed).motion(np.arange(301) / 50.0)
        model = Model(robot, make_terms(["rigid_body", "viscous_friction"], robot, motion))
        theta = random_parameters(model, rng=np.random.default_rng(5))
        theta[20:30] += extra * TOOL
        simulate(model, theta, motion, rng=np.random.default_rng(seed), noise=0.02).save(place / name)
    return place


@pytest.fixture
def place(shop, tmp_path, monkeypatch):
    for file in shop.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def summary(folder):
    return json.loads((folder / "summary.json").read_text())


def carried(folder):
    """Name of each log's file to what it carried."""
    return {one["source"].rsplit("/", 1)[-1]: one.get("payload") for one in summary(folder)["logs"]}


def test_payload_of_unknown_mass(place, capsys):
    log = ("--payload", "tool1@loaded.csv", "--payload", "tool1@again.csv")
    assert run("identify", "plain.csv", "--robot", "arm.toml", *log, *QUICK, "--out", "result") == 0
    assert carried(place / "result") == {"plain.csv": None, "loaded.csv": "tool1", "again.csv": "tool1"}
    found = summary(place / "result")["payloads"]
    assert list(found) == ["tool1"]
    with (place / "result" / "coefficients.csv").open() as file:
        mass = next(row for row in csv.DictReader(file) if row["name"] == "m_tool1")
    assert abs(float(mass["mean"]) - TOOL[9]) < 5.0 * float(mass["sd"])
    assert float(mass["sd"]) < 0.1
    assert found["tool1"]["mass"]["value"] == pytest.approx(float(mass["mean"]), abs=float(mass["sd"]))
    np.testing.assert_allclose([x["value"] for x in found["tool1"]["com"]], TOOL[6:9] / TOOL[9], atol=0.03)
    assert len(found["tool1"]["inertia"]) == 6
    printed = capsys.readouterr().out
    assert "loaded.csv: 301 rows, tool1" in printed
    assert "plain.csv: 301 rows, no payload" in printed
    assert f"tool1: {found['tool1']['mass']['value']:.1f}" in printed


def test_known_mass_is_a_prior(place):
    """The sd where none is given is that which the help says; two masses, two payloads."""
    payloads = ("--payload", "2.0~0.01@loaded.csv", "--payload", "b:2@again.csv")
    options = ("--no-report", "--complete", "off", "--terms", "rigid_body,viscous_friction", "--posterior-budget", 0)
    assert run("identify", "plain.csv", "--robot", "arm.toml", *payloads, *options, "--out", "result", "--quiet") == 0
    assert carried(place / "result") == {"plain.csv": None, "loaded.csv": "payload", "again.csv": "b"}
    with (place / "result" / "coefficients.csv").open() as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    assert [float(rows[name]["prior_sd"]) for name in ("m_payload", "m_b")] == [0.01, 0.002]
    assert [float(rows[name]["nominal"]) for name in ("m_payload", "m_b")] == [2.0, 2.0]
    assert float(rows["m_b"]["sd"]) <= 0.0021


def test_file_that_lists_logs(place):
    """Paths are relative to the file, wherever the command is run."""
    (place / "runs").mkdir()
    (place / "loaded.csv").rename(place / "runs" / "loaded.csv")
    (place / "runs" / "setup.toml").write_text(
        '[[logs]]\nfile = "../plain.csv"\n[[logs]]\nfile = "loaded.csv"\npayload = "tool1"\nmass = [2.0, 0.01]\n'
        '[[logs]]\nfile = "../again.csv"\nmass = 2\n'
    )
    assert run("identify", "runs/setup.toml", "--robot", "arm.toml", *QUICK, "--quiet") == 0
    assert carried(place / "bayesid-setup") == {"plain.csv": None, "loaded.csv": "tool1", "again.csv": "payload"}
