"""The study of model selection: its cases have the stated truth, noise and effects."""

from dataclasses import replace

import numpy as np
import pytest

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.log.signals import prepare
from bayesid.studies import complete
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
def test_one_effect_is_hidden_in_one_joint_at_its_size(name):
    scenario = of_class(name, robot="kr5")
    with_it, without = (make_case(replace(scenario, effects=effects), 5) for effects in (scenario.effects, ()))
    ((effect, (joint,)),) = with_it.hidden
    assert effect in scenario.effects
    assert without.hidden == ()
    change = np.sqrt(np.mean((with_it.log.effort - without.log.effort) ** 2, axis=0))
    share = change / np.sqrt(np.mean(without.log.effort**2, axis=0))
    assert 0.9 * SHARES[0] < share[joint - 1] < 1.1 * SHARES[1]
    assert np.all(np.delete(share, joint - 1) == 0.0)


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


@pytest.mark.long
def test_one_log_in_both_modes():
    row = complete.trial(of_class("short", robot="kr5"), 0)
    for mode in MODES:
        assert row[f"right_{mode}"] > 0.95
        assert row[f"coefficients_{mode}"] >= row["compared"] > 50
        assert row[f"inside_{mode}"] > 0.8 * row[f"coefficients_{mode}"]
        assert 0.0 < row[f"error_{mode}"] < 0.5
        assert row["timings"][mode] > 0.0
