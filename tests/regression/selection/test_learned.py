"""Learned effects: which function is found."""

from dataclasses import replace

import numpy as np
from conftest import small_robot, smooth_motion
from effect_problems import observed

from bayesid.effects import RigidBody
from bayesid.effects.axes import Family, Quantity
from bayesid.effects.model import Model
from bayesid.regression.selection.hypotheses import maker
from bayesid.regression.selection.learned import Finder
from bayesid.regression.selection.regression import explain


def test_a_law_is_found_among_smooth_functions_and_series_that_fit_as_well():
    """A sine of three times an angle: two columns."""
    robot, motion = small_robot(2, seed=2), smooth_motion(2, 8.0, 50.0, seed=4)
    effort = np.random.default_rng(3).normal(size=motion.q.shape)
    effort[:, 1] += 5.0 * np.sin(3.0 * motion.q[:, 0] + 0.4)
    data = replace(observed(np.stack([motion.dq, motion.ddq], axis=2), effort), limits=np.ones((2, 2)))
    model, used = Model(robot, (RigidBody(),)), np.ones(effort.shape, dtype=bool)
    scene = model.scene(motion, np.zeros(20), effort, np.abs(effort))
    best = Finder(scene, used, 2, maker(model, scene, used)).ranked(explain(data, []))[0]
    ((variable, family, order, count),) = [(a.variable, a.family, a.order, a.count) for a in best.form.axes]
    assert (variable, family, order, count) == ((Quantity.POSITION, 1), Family.PERIODIC, 3.0, 2)
    assert best.gain > 20.0
