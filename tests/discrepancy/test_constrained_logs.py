"""Constraints on a robot are valid for every later log: discrepancy, comparison of logs, payload, each log alone."""

from functools import cache

import numpy as np
import pytest
import tomli_w

import bayesid
from bayesid.cli import main
from bayesid.effects import STANDARD
from bayesid.effects.bodies import Payload
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.identification.model_file import load
from bayesid.posterior.sampler import Sampling
from bayesid.report.folders import save_identification
from bayesid.robot import load_robot
from bayesid.simulation.logs import simulate
from bayesid.simulation.paper import nominal_parameters
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

ROBOT = load_robot("kr5-paper")


def motion_of(seed):
    return random_trajectory(6, 8.0, rng=seed).motion(np.arange(801) / 100.0)


MODEL = Model(ROBOT, make_terms(STANDARD, ROBOT, motion_of(0)))
NAMES = [parameter.name for parameter in MODEL.parameters]
THETA = random_parameters(MODEL, rng=np.random.default_rng(1))
THETA[:60] = nominal_parameters()
TRUE = dict(zip(NAMES, THETA.tolist(), strict=True))
TOTAL = sum(TRUE[f"m{k}"] for k in range(1, 7))
BODY = np.array([0.03, 0.0, 0.0, 0.03, 0.0, 0.02, 0.0, 0.0, 0.2, 3.0])  # 3 kg in front of the flange
LABELS = ("total_mass", "bounds.Fc2", "bounds.m6")


@cache
def log_of(seed, worn=1.0, payload=False):
    theta = THETA.copy()
    theta[NAMES.index("Fv3")] *= worn
    model, theta = (MODEL.extend(Payload()), np.append(theta, BODY)) if payload else (MODEL, theta)
    return simulate(model, theta, motion_of(seed), rng=np.random.default_rng(seed), noise=0.03)


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """A wrong upper bound of the friction of joint 2, and approximate masses."""
    path = tmp_path_factory.mktemp("stated") / "known.toml"
    bounds = {"Fc2": [0.0, 0.97 * TRUE["Fc2"]], "m6": [0.5 * TRUE["m6"], 1.5 * TRUE["m6"]]}
    path.write_text(tomli_w.dumps({"total_mass": [0.9 * TOTAL, 1.02 * TOTAL], "bounds": bounds}))
    return path


def binds(result):
    """All labels are there, parameters and draws are feasible, and the fit is on the wrong bound."""
    stated, free = result.model.cone.stated, dict(zip(NAMES, result.fit.theta, strict=False))
    assert stated.labels == LABELS
    assert stated.contains(result.theta, 1e-6)
    assert stated.contains(result.fit.theta, 1e-4)
    assert free["Fc2"] == pytest.approx(0.97 * TRUE["Fc2"], rel=0.015)
    if result.posterior is not None:
        for draws in (result.posterior.draws.theta, result.posterior.uncertain.theta):
            assert all(stated.contains(theta, 1e-9) for theta in draws.reshape(-1, draws.shape[-1])[::9])
    return True


@pytest.fixture(scope="module")
def earlier(known, tmp_path_factory):
    result = bayesid.identify(ROBOT, log_of(0), constraints=known, complete="off", posterior=False)
    assert binds(result)
    folder = tmp_path_factory.mktemp("earlier") / "result"
    save_identification(result, folder, report=False)
    return load(folder)


def test_a_discrepancy_is_found_inside_them(earlier):
    found = bayesid.find_discrepancy(earlier, log_of(5, worn=1.6), posterior=Sampling(budget=0.0))
    assert [(one.effect, one.joints) for one in found.added] == [("viscous_friction", (3,))]
    assert binds(found.identification)


def test_a_payload_is_estimated_inside_them_without_being_constrained(earlier):
    reading = bayesid.identify_payload(earlier, log_of(6, payload=True), posterior=Sampling(budget=0.0))
    assert binds(reading.identification)
    assert reading.body.mass.value == pytest.approx(BODY[9], rel=0.05)


def test_logs_are_compared_inside_them_but_links_with_a_payload_are_not(known):
    loaded = bayesid.find_discrepancy(ROBOT, [log_of(0), log_of(6, payload=True)], constraints=known, posterior=False)
    assert [one.name for one in loaded.of("changed")] == ["payload"]
    assert all(binds(one) for one in (loaded.earlier, loaded.found[0].identification, loaded.runs[0]))
    assert loaded.runs[1].model.constraints.labels == ("bounds.Fc2",), "mass of the last link holds the payload"
    assert loaded.runs[1].model.cone.stated.contains(loaded.runs[1].theta, 1e-6)


def test_each_log_alone_and_the_command_keep_them(known, tmp_path, capsys):
    logs = [tmp_path / f"{name}.csv" for name in ("monday", "friday")]
    for path, log in zip(logs, (log_of(0), log_of(5, worn=1.6)), strict=True):
        log.save(path)
    options = ["--robot", "kr5-paper", "--constraints", str(known), "--no-posterior", "--quiet"]
    given = [str(path) for path in logs]
    each, changes = tmp_path / "each", tmp_path / "changes"
    call = ["identify", *given, "--each", *options, "--complete", "off", "--no-report", "--out", str(each)]
    assert main([*call, "--workers", "1"]) == 0
    for path in logs:
        found = load(each / path.stem)
        assert found.model.constraints.labels == LABELS
        assert found.model.cone.stated.contains(found.theta, 1e-6)
        assert found.theta[NAMES.index("Fc2")] == pytest.approx(0.97 * TRUE["Fc2"], rel=0.015)
    assert main(["discrepancy", *given, *options, "--out", str(changes)]) == 0
    assert load(changes).model.constraints.labels == LABELS
    refused = [
        "discrepancy",
        str(each / "monday"),
        given[1],
        "--constraints",
        str(known),
        "--out",
        str(tmp_path / "no"),
    ]
    capsys.readouterr()
    assert main(refused) == 2
    assert "--constraints" in capsys.readouterr().err
