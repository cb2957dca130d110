"""Doubt of signs because of the model: of which joints, and how much."""

import itertools

import numpy as np
from sign_problems import synthetic

from bayesid.signs.averaging import doubt_of, rises_by_joint


def test_a_joint_is_doubted_for_its_own_error_and_for_the_worst_one_unless_its_other_side_needs_more():
    for error, other_side, proven, expected in (
        ([0.1, 0.29], [0.0, 0.0], True, [0.0, 0.0]),
        ([0.02, 0.09], [0.0, 0.0], False, [0.0, 0.0]),
        ([0.2, 0.24], [9.0, 9.0], False, [0.1, 0.14]),
        ([0.65, 0.1], [0.1, 0.1], True, [0.35, 0.39 - 0.3]),
        ([0.65, 0.1], [0.1, 0.39], True, [0.35, 0.39 - 0.3]),
        ([0.65, 0.1], [0.1, 0.45], True, [0.35, 0.33 - 0.3]),
        ([0.65, 0.1], [0.1, 0.79], True, [0.35, 0.0]),
        ([0.1, 3.0], [0.2, 9.0], True, [0.7, 0.7]),
        ([0.1, 3.0], [3.5, 9.0], True, [0.0, 0.7]),
    ):
        found = doubt_of(np.array(error), np.array(other_side), proven=proven)
        np.testing.assert_allclose(found, 0.5 * np.array(expected) / 0.7, atol=1e-12)


def test_what_a_joint_turned_round_costs_is_what_is_left_of_the_rows_of_each():
    """Row by row, by ordinary least squares: three joints that share their coefficients, in every set of them."""
    problem = synthetic(5, 14, joints=3, cone="free", size=5, noise=0.2, longest=9)
    joint, known = problem.moments.joint, problem.moments.known
    signs = problem.assignments[int(np.argmin(problem.costs))]
    columns = np.concatenate([y for y, _ in problem.rows])
    of_row = np.repeat(np.arange(len(joint)), [len(e) for _, e in problem.rows])

    def residuals(assignment):
        effort = np.concatenate([s * e for s, (_, e) in zip(assignment, problem.rows, strict=True)])
        left = effort - columns @ np.linalg.lstsq(columns, effort, rcond=None)[0]
        return np.bincount(joint[of_row], weights=left**2, minlength=3)

    sets = []
    for turned, rise in rises_by_joint(problem.moments, problem.solver(), signs, 3):
        sets.append(tuple(turned))
        expected = residuals(np.where(np.isin(joint, turned) & (known == 0), -signs, signs)) - residuals(signs)
        np.testing.assert_allclose(rise, expected, atol=2e-3 * problem.energy)
    assert sorted(sets) == sorted(s for k in (1, 2, 3) for s in itertools.combinations(range(3), k))
