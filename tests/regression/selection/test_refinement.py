"""Nonlinear numbers between those of the library, on a friction whose Stribeck speed no list holds."""

import numpy as np
import pytest
from completion_problems import BASE, MOTION, THETA, TOP

from bayesid.effects.catalogue import make_effect
from bayesid.regression.knowledge import Information
from bayesid.regression.selection.explanation import Observations
from bayesid.regression.selection.hypotheses import hypotheses
from bayesid.regression.selection.refinement import refined

SPEED = 0.13
"""Of the highest; the list holds 0.1 and 0.17."""
SIZE = 6.0
"""N m."""


@pytest.fixture(scope="module")
def case():
    """Joint 2 of a log with known signs, and all hypotheses."""
    effect = make_effect("stribeck_friction", {"joints": [2], "smoothing": [0.01 * TOP[1]], "speed": [SPEED * TOP[1]]})
    effort = BASE.extend(effect).effort(MOTION, np.append(THETA, [0.0, SIZE]))
    effort += 0.05 * np.random.default_rng(3).standard_normal(effort.shape)
    columns = BASE.columns(MOTION)
    used = np.ones(effort.shape, dtype=bool)
    scene = BASE.scene(MOTION, THETA, BASE.effort(MOTION, THETA), np.abs(effort))
    nothing = Information(np.eye(columns.shape[2]), THETA, float(THETA @ THETA))
    limits = np.full((2, 2), 0.05)
    data = Observations(columns, effort, used, nothing, np.full(2, 0.05), np.ones(2, dtype=bool), limits, 50.0)
    return data, list(hypotheses(BASE, scene, used))


def form(library, name, **shape):
    forms = [h for group in library for h in group if h.source.name == name and h.joints == (2,)]
    return next(h for h in forms if all(getattr(h.source, key) == pytest.approx(v) for key, v in shape.items()))


@pytest.mark.parametrize("start", [0.1, 0.17])
def test_a_number_between_two_of_the_list_is_found(case, start):
    """The errors that the listed one leaves weigh the first look; those of what it found the second."""
    data, library = case
    first = refined(data, [form(library, "stribeck_friction", speed=(start * TOP[1],))], library)
    assert first[0].source.speed[0] / TOP[1] == pytest.approx(SPEED, rel=0.05)
    (found,) = refined(data, first, library)
    assert found.source.speed[0] / TOP[1] == pytest.approx(SPEED, rel=0.01)
    assert found.key == ("stribeck_friction", (2,))


def test_it_stays_between_its_neighbours(case):
    """From the largest of the list the true one is two steps away."""
    data, library = case
    (found,) = refined(data, [form(library, "stribeck_friction", speed=(0.3 * TOP[1],))], library)
    assert found.source.speed[0] / TOP[1] == pytest.approx(0.17, rel=0.05)
    assert found.source.speed[0] / TOP[1] > 0.17
