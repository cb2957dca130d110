"""Proposals for joints with a poor fit and unknown signs."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from completion_problems import BASE, RIPPLE, identified, log_with, true_signs

from bayesid.effects.catalogue import make_effect
from bayesid.log.segments import Segmentation, find_segments
from bayesid.log.signals import prepare
from bayesid.regression.selection.detected import SignedLog
from bayesid.signs.proposals import AlternatingFit, PoorJoint, propose
from bayesid.signs.search.certified import Certified
from bayesid.signs.sign_solution import find_signs


@pytest.fixture(scope="module")
def searched():
    """Segments and log, under the standard terms, two fifths of the second joint's signs wrong."""
    signals = prepare(log_with("torque_ripple"))
    segments = find_segments(signals, BASE.robot.actuators(signals.motion), Segmentation())
    sign_solution = find_signs(BASE, signals, segments, Certified(budget=2.0))
    return sign_solution.signs.segments, SignedLog.of(
        sign_solution.log_data, sign_solution.fit, sign_solution.probability
    )


@pytest.fixture(scope="module")
def log(searched):
    return searched[1]


@pytest.fixture(scope="module")
def segments(searched):
    return searched[0]


def test_what_is_missing_is_proposed_first_though_signs_are_wrong(log, segments):
    signs, strong = true_signs("torque_ripple")
    found = np.where(log.fit.predicted >= 0.0, 1.0, -1.0)
    assert np.mean((found == signs)[strong[:, 1], 1]) < 0.7
    best = propose(PoorJoint.of(log, segments, 1), log.library(1))[0]
    assert [(one.effect, one.joints) for one in best.effects] == [("torque_ripple", (2,))]
    assert best.effects[0].harmonic[0] == pytest.approx(RIPPLE, rel=0.02)
    right = abs(np.mean((best.signs[:, 1] * signs[:, 1])[strong[:, 1]]))
    assert right > 0.95, "its own signs are right, or all of them wrong"
    assert propose(PoorJoint.of(log, segments, 0), log.library(0)) == [], "that joint lacks nothing"


def test_efforts_the_wrong_way_round_lead_to_the_same_proposals(log, segments):
    """Signs that are all wrong show as much as signs that are all right."""
    turned = replace(log, fit=replace(log.fit, predicted=-log.fit.predicted))
    found, expected = (propose(PoorJoint.of(one, segments, 1), log.library(1)) for one in (turned, log))
    assert [proposal.effects for proposal in found] == [proposal.effects for proposal in expected]


@pytest.mark.parametrize(
    ("name", "shape"), [("delay", {"lag": [0.04]}), ("clipping", {"limit": [1.0]}), ("dead_zone", {"width": [0.2]})]
)
def test_a_distortion_acts_on_columns_and_readings_as_in_a_model(log, segments, name, shape):
    poor, effect = PoorJoint.of(log, segments, 1), make_effect(name, {"joints": [2], **shape})
    like = next(group[0] for group in log.library(1) if group[0].joints == (2,))
    rows = poor.rows_under(replace(like, source=effect))
    model, log_data, used = BASE.extend(effect), log.log_data, log.data.used[:, 1]
    magnitude, readable = model.invert_sensor(log_data.signals.magnitude[log.rows])
    visible = readable[used, 1]
    columns = model.columns(log_data.signals.motion[log.rows])[:, 1, log_data.coefficients.selected]
    np.testing.assert_array_equal(rows.columns, columns[used])
    np.testing.assert_array_equal(rows.visible, visible)
    np.testing.assert_array_equal(rows.magnitude[visible], magnitude[used, 1][visible])
    plain = poor.rows()
    changed = (rows.columns != plain.columns).any() or (rows.magnitude != plain.magnitude).any() or not visible.all()
    assert changed


def test_hidden_efforts_are_compared_with_the_reading(searched):
    """A dead zone as wide as most efforts hides what the model gets wrong; but nothing reads as zero."""
    segments, log = searched
    wide = make_effect("dead_zone", {"joints": [2], "width": [float(np.median(log.modelled.magnitude[:, 1]))]})
    like = next(group[0] for group in log.library(1) if group[0].joints == (2,))
    poor = PoorJoint.of(log, segments, 1)
    assert not poor.rows_under(replace(like, source=wide)).visible.all()
    assert propose(poor, [[replace(like, source=wide)]]) == []


def test_flips_of_whole_segments_reach_the_optimum():
    """Brute force over the signs of 10 segments: a local search from many starts ends at the least cost."""
    rng = np.random.default_rng(5)
    truth, segment = rng.normal(size=3), np.repeat(np.arange(10), 6)
    columns = rng.normal(size=(60, 3)) + np.repeat(rng.normal(size=(10, 3)), 6, axis=0)
    effort = columns @ truth + 0.3 * rng.normal(size=60)
    magnitude = np.abs(effort)
    alternating_fit = AlternatingFit(columns, magnitude, np.eye(3), np.array([0.2, -0.1, 0.0]))

    def cost(signs):
        whole, target = np.eye(3) + columns.T @ columns, np.array([0.2, -0.1, 0.0]) + columns.T @ (signs * magnitude)
        return -target @ np.linalg.solve(whole, target)

    every = [np.array(signs)[segment] for signs in itertools.product([-1.0, 1.0], repeat=10)]
    found = alternating_fit.flipped(np.ones(60), segment, segment >= 0)
    assert cost(found) == pytest.approx(min(map(cost, every)), rel=1e-9)
    held = alternating_fit.flipped(np.ones(60), np.where(segment < 2, -1, segment), segment >= 2)
    least = min(cost(signs) for signs in every if np.all(signs[segment < 2] == 1.0))
    assert cost(held) == pytest.approx(least, rel=1e-9)
    assert np.all(held[segment < 2] == 1.0)


def test_signs_are_found_under_what_was_proposed():
    """It enters the model, as held-back blocks confirm it."""
    signs, strong = true_signs("torque_ripple")
    off, only, auto = (identified("torque_ripple", complete=how) for how in ("off", "only-uncertainty", "auto"))
    np.testing.assert_array_equal(only.sample_signs, off.sample_signs)
    assert np.mean((off.sample_signs == signs)[strong]) < 0.9
    assert np.mean((auto.sample_signs == signs)[strong]) > 0.995
    assert auto.search.certified
    assert {(e.effect, e.joints) for e in auto.model_selection.effects} == {("torque_ripple", (2,))}
    assert auto.model_error_probability.max() == 0.0
    assert auto.model_selection.after[1] < 0.1 * auto.model_selection.before[1]
