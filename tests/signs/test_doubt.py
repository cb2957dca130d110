"""Doubt of signs because of the model: of which joints, and how much."""

import numpy as np
from sign_problems import synthetic

from bayesid.signs.doubt import doubt_of, shares_by_joint


def test_a_joint_is_doubted_for_its_own_error_and_for_those_whose_rows_decide_its_signs():
    alone, shared = np.eye(2), np.array([[0.9, 0.1], [0.4, 0.6]])
    for error, decided_by, proven, expected in (
        ([0.1, 0.29], alone, True, [0.0, 0.0]),
        ([0.02, 0.09], alone, False, [0.0, 0.0]),
        ([0.2, 0.24], alone, False, [0.1, 0.14]),
        ([0.65, 0.1], alone, True, [0.35, 0.0]),
        ([0.65, 0.1], shared, True, [0.35, 0.4 * 0.65 + 0.06 - 0.3]),
        ([0.1, 3.0], shared, True, [0.09 + 0.3 - 0.3, 0.7]),
    ):
        found = doubt_of(np.array(error), decided_by, proven=proven)
        np.testing.assert_allclose(found, 0.5 * np.array(expected) / 0.7, atol=1e-12)


def test_what_decides_a_joint_is_where_turning_it_leaves_a_larger_residual():
    """Row by row, by ordinary least squares: two joints share a coefficient, a third one shares none."""
    problem = synthetic(5, 12, joints=2, cone="free", size=5, noise=0.2, longest=9)
    joint, known = problem.moments.joint, problem.moments.known
    signs = problem.assignments[int(np.argmin(problem.costs))]
    columns = np.concatenate([y for y, _ in problem.rows])
    of_row = np.repeat(np.arange(len(joint)), [len(e) for _, e in problem.rows])

    def residuals(assignment):
        effort = np.concatenate([s * e for s, (_, e) in zip(assignment, problem.rows, strict=True)])
        left = effort - columns @ np.linalg.lstsq(columns, effort, rcond=None)[0]
        return np.bincount(joint[of_row], weights=left**2, minlength=2)

    found = shares_by_joint(problem.moments, problem.solver(), signs, 2)
    for j in (0, 1):
        rise = residuals(np.where((joint == j) & (known == 0), -signs, signs)) - residuals(signs)
        expected = np.maximum(rise, 0.0) / np.maximum(rise, 0.0).sum()
        np.testing.assert_allclose(found[j], expected, atol=2e-3)
    assert 0.02 < found[0, 1] < 0.98, "or the case shows nothing"
