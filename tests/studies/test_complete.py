"""The study of completed models: its cases are true to what they say, its report and figure bear short runs."""

from dataclasses import replace

import numpy as np
import pytest
from reported import reported

from bayesid.log.signals import prepare
from bayesid.model.catalogue import make_terms
from bayesid.model.coefficients import base_coefficients
from bayesid.model.model import Model
from bayesid.model.terms import STANDARD
from bayesid.studies import complete
from bayesid.studies.complete_report import coverage, found, mean_ratio, torque_ratio
from bayesid.studies.hidden import SHARES, make_case
from bayesid.studies.readings import NOISES

MODES = ("off", "auto")
KINDS = {
    name: scenario for scenario, _ in complete.plan(200, 0) if (name := scenario.name) and scenario.part == "classes"
}


def of_class(name, **options):
    return replace(KINDS[name], **options)


def explained(case):
    """The standard model on the log's motion, its efforts by the true parameters, and the log's, ends left out."""
    signals = prepare(case.log)
    model = Model(case.robot, make_terms(STANDARD, case.robot, signals.motion))
    theta = np.array([case.parameters[parameter.name] for parameter in model.parameters])
    inside = slice(50, -50)
    return model, model.effort(signals.motion, theta)[inside], signals.raw_effort[inside]


def test_the_true_parameters_explain_the_log_up_to_its_noise():
    _, predicted, effort = explained(make_case(of_class("right", robot="random"), 1))
    left = np.sqrt(np.mean((effort - predicted) ** 2, axis=0) / np.mean(effort**2, axis=0))
    assert np.all(left < 0.06), left  # noise of 3 % and dry friction near standstill


@pytest.mark.parametrize("name", ["load_dependent", "warming"])
def test_one_effect_is_hidden_in_one_joint_and_is_as_large_as_said(name):
    scenario = of_class(name, robot="kr5")
    with_it, without = (make_case(replace(scenario, effects=effects), 5) for effects in (scenario.effects, ()))
    ((effect, (joint,)),) = with_it.hidden
    assert effect in scenario.effects
    assert without.hidden == ()
    change = np.sqrt(np.mean((with_it.log.effort - without.log.effort) ** 2, axis=0))
    share = change / np.sqrt(np.mean(without.log.effort**2, axis=0))
    assert 0.9 * SHARES[0] < share[joint - 1] < 1.1 * SHARES[1]
    assert np.all(np.delete(share, joint - 1) == 0.0)


def test_kinetic_friction_of_a_stribeck_joint_is_that_at_high_speed():
    case = make_case(of_class("stribeck", robot="kr5"), 1)
    ((_, (joint,)),) = case.hidden
    _, predicted, effort = explained(case)
    speed, residual = (values[:, joint - 1] for values in (prepare(case.log).motion.dq[50:-50], effort - predicted))
    fast = np.abs(speed) > 0.7 * np.abs(speed).max()
    left = np.mean(np.sign(speed[fast]) * residual[fast]) / np.sqrt(np.mean(effort[:, joint - 1] ** 2))
    assert abs(left) < 0.05  # kinetic friction left out would be some tenths


def test_what_changes_during_the_log_has_no_true_value():
    case = make_case(of_class("warming", robot="kr5"), 2)
    model, _, _ = explained(case)
    coefficients = base_coefficients(model)
    unknown = {name for name, value in case.parameters.items() if np.isnan(value)}
    truth = case.truth(model, coefficients)
    assert unknown
    assert {name for name, value in zip(coefficients.names, truth, strict=True) if np.isnan(value)} == unknown


def test_truth_of_effects_that_are_not_there_is_zero():
    case = make_case(of_class("right", robot="kr5"), 2)
    model, _, _ = explained(case)
    motion = prepare(case.log).motion
    more = Model(case.robot, make_terms((*STANDARD, "joint_spring"), case.robot, motion))
    standard, wider = base_coefficients(model), base_coefficients(more)
    truth = dict(zip(wider.names, case.truth(more, wider), strict=True))
    assert len(wider) > len(standard)
    assert np.allclose([truth[name] for name in standard.names], case.truth(model, standard))


def test_noise_has_the_size_and_the_colour_it_is_given_and_eight_bits_have_so_many_values():
    rng, sd = np.random.default_rng(0), np.array([0.5, 2.0])
    for kind in NOISES.keys() - {"8 bit"}:
        noise = NOISES[kind](np.zeros((200_000, 2)), sd, rng)
        assert np.allclose(noise.std(axis=0), sd, rtol=0.1)
        neighbours = np.mean(noise[1:] * noise[:-1], axis=0) / sd**2
        assert np.allclose(neighbours, {"AR(1) 0.9": 0.9, "AR(1) 0.97": 0.97}.get(kind, 0.0), atol=0.1)
    efforts = np.linspace(-3.0, 3.0, 5001)[:, None]
    read = NOISES["8 bit"](efforts, np.ones(1), rng)
    assert len(np.unique(read)) == 257
    assert np.abs(read - efforts).max() <= 3.0 / 256 + 1e-12


def test_a_short_run_has_some_of_every_part():
    order = complete.plan(complete.STUDY.trials, 0)
    parts = list(dict.fromkeys(scenario.part for scenario, _ in order))
    assert {scenario.part for scenario, _ in order[:8]} == set(parts)
    assert parts[:3] == ["classes", "noise", "blind"]
    assert all(order.count(item) == 1 for item in order)


def made_up(trials):
    """Rows as the trials might give them."""
    rng, rows = np.random.default_rng(0), []
    for scenario, seed in complete.plan(trials, 0):
        row = {"seed": seed, **vars(scenario), "timings": {"off": 3.0, "auto": 5.0}}
        row["hidden"] = [f"{effect} 2" for effect in getattr(scenario, "effects", ())]
        for mode in MODES:
            numbers = {"coefficients": 50, "inside": 45, "error": 0.01 + 0.01 * rng.random(), "sd": 0.01}
            row |= {f"{key}_{mode}": value for key, value in numbers.items()}
            row |= {f"right_{mode}": 0.99, f"joints_{mode}": [0.99] * 6, f"certified_{mode}": True}
            row |= {f"entered_{mode}": [], f"torque_error_{mode}": (1.0 + rng.random(6)).tolist()}
        row["entered_auto"] = [*row["hidden"], "delay all"]
        rows.append(row)
    return rows


@pytest.mark.parametrize("trials", [1, 400])
def test_report_and_figure_of_however_few_trials(trials):
    text = reported(complete.STUDY, made_up(trials))
    assert text.startswith(f"{trials} logs")
    assert ("nothing hidden" in text) == (trials > 1)


def test_ratios_are_of_auto_to_off():
    rows = [{"sd_off": 2.0, "sd_auto": 1.0}, {"sd_off": 1.0, "sd_auto": 2.0}, {"sd_off": 4.0, "sd_auto": 0.5}]
    assert mean_ratio(rows, "sd") == pytest.approx(0.5)
    assert torque_ratio({"torque_error_off": [2.0, 1.0], "torque_error_auto": [1.0, 3.0]}).tolist() == [0.5, 3.0]
    counts = [{"inside_off": 9, "coefficients_off": 10}, {"inside_off": 30, "coefficients_off": 30}]
    assert coverage(counts, "off") == 39 / 40


def test_an_effect_is_found_in_its_joint_and_in_any_form():
    for entered in ("thermal_drift 2", "thermal_drift.viscous 2"):
        assert found("thermal_drift 2", ["torque_ripple 1", entered])
    for entered in ("thermal_drift 3", "delay 2"):
        assert not found("thermal_drift 2", ["torque_ripple 1", entered])


@pytest.mark.long
def test_one_log_in_both_modes():
    row = complete.trial(of_class("short", robot="kr5"), 0)
    for mode in MODES:
        assert row[f"right_{mode}"] > 0.95
        assert row[f"coefficients_{mode}"] >= row["compared"] > 50
        assert row[f"inside_{mode}"] > 0.8 * row[f"coefficients_{mode}"]
        assert 0.0 < row[f"error_{mode}"] < 0.5
        assert row["timings"][mode] > 0.0
