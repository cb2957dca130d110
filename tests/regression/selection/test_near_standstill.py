"""How dry friction turns round near standstill, in closed form."""

import numpy as np
from completion_problems import BASE, MOTION, ROBOT, SIZE, TOP

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.regression.selection.columns import NO_COLUMNS
from bayesid.regression.selection.hypotheses import near_standstill

USED = np.ones(MOTION.dq.shape, dtype=bool)


def test_a_turn_at_once_differs_near_standstill_alone():
    """tanh(4 u' / v) - tanh(u' / v) in each joint's own row, v a hundredth of the highest speed."""
    columns = near_standstill(BASE, MOTION, SIZE, USED)
    for j in range(2):
        speed = MOTION.dq[:, j] / (0.01 * TOP[j])
        expected = np.tanh(4.0 * speed) - np.tanh(speed)
        np.testing.assert_allclose(columns.rows[j][:, j], expected, atol=1e-9)
        np.testing.assert_array_equal(columns.rows[j][:, 1 - j], 0.0)
        np.testing.assert_allclose(columns.sd[j], 0.3 * SIZE[j] / np.abs(expected).max(), rtol=1e-6)
    assert not columns.positive.any()


def test_without_dry_friction_nothing_is_uncertain():
    smooth = make_terms([name for name in STANDARD if name != "coulomb_friction"], ROBOT, MOTION)
    assert near_standstill(Model(ROBOT, smooth), MOTION, SIZE, USED) is NO_COLUMNS
