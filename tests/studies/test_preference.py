"""Which signs the data prefer: against least squares in the orthant by active sets, all assignments enumerated."""

import numpy as np
import pytest
from scipy.optimize import nnls
from sign_problems import synthetic

from bayesid.log.segments import Segments
from bayesid.signs.search.protocol import SignProblem
from bayesid.studies.preference import CLEARLY, preference, true_signs


def posed(**options):
    """A small sign problem, its assignments, and their costs without the Tikhonov term."""
    made = synthetic(**options)
    projected = made.coefficients.projection
    columns = np.vstack([rows @ projected for rows, _ in made.rows])

    def cost(signs):
        efforts = np.concatenate([sign * effort for sign, (_, effort) in zip(signs, made.rows, strict=True)])
        return nnls(columns, efforts)[1] ** 2

    costs = np.array([cost(signs) for signs in made.assignments])
    return SignProblem(made.normal_equations, made.cone, made.coefficients), made.assignments, costs


@pytest.mark.parametrize(("seed", "scale"), [(0, 10.0), (1, 1000.0)])
def test_what_the_best_signs_are_better_by_whatever_was_certified(seed, scale):
    """The energy is up to 1e8 here: `CLEARLY` is above errors of solver, rounding and the remaining rho."""
    problem, assignments, costs = posed(seed=seed, segments=6, joints=2, scale=scale, noise=0.6 / scale, known=1)
    best = int(np.argmin(costs))
    for k in np.random.default_rng(seed).permutation(len(costs))[:5]:
        if k != best:
            found = preference(problem, assignments[k], assignments[best])
            assert found == pytest.approx(costs[k] - costs[best], rel=1e-5, abs=0.2 * CLEARLY)
    second = np.partition(costs, 1)[1]
    assert preference(problem, assignments[best], assignments[best]) <= costs[best] - second + 0.2 * CLEARLY


def test_the_sign_of_a_segment_is_that_of_its_sum():
    effort = np.array([[1.0, -1.0], [-3.0, 5.0], [1.0, -1.0], [4.0, -5.0]])
    ones = np.ones(3, dtype=np.int64)
    segments = Segments(np.array([0, 0, 1]), np.array([0, 2, 0]), np.array([2, 4, 4]), 0 * ones, ones.astype(bool))
    np.testing.assert_array_equal(true_signs(segments, effort), [-1, 1, -1])
