"""Bounds of flips, against the cost of all 2^k sets of flips; the bound without the cone."""

import numpy as np
import pytest
from sign_problems import synthetic

from bayesid.signs.search.bounds import UnconstrainedBound
from bayesid.signs.search.problem import SearchProblem
from bayesid.signs.tuning import Tuning


class Flipped:
    """The flips of the branch of a rank, by cost, and what all of them cost by brute force."""

    def __init__(self, problem, rank=0, fixed=(), tolerance=None):
        self.problem, self.fixed = problem, np.array(fixed, dtype=np.int64)
        self.view = SearchProblem(problem.normal_equations, problem.solver(tolerance or 1e-6), np.inf)
        self.signs = problem.assignments[np.argsort(problem.costs)[rank]]
        if tolerance is None:
            self.branch = self.view.price(self.signs)
        else:
            self.branch = self.view.complete(self.signs, np.zeros(problem.cone.size))
        unknown = np.flatnonzero(problem.normal_equations.known == 0)
        self.free = np.setdiff1d(unknown, self.fixed)
        self.flips = self.view.flips(self.branch, self.free)
        self.turned = problem.assignments != self.signs
        self.changes = problem.costs - self.branch.lower_bound
        self.rounding = problem.precision

    def limited(self, **limits):
        """The same flips, with less work done on them."""
        view = SearchProblem(self.problem.normal_equations, self.problem.solver(), np.inf, tuning=Tuning(**limits))
        return view.flips(self.branch, self.free)

    def least(self, *chosen):
        """The least change over those sets of flips, of free segments only, for which all the masks hold."""
        only_free = ~np.any(self.turned[:, self.fixed], axis=1)
        rows = np.all([only_free, *chosen], axis=0)
        return self.changes[rows].min(initial=np.inf)


def flipped_cases():
    """Every cone; the best branch, a good one and a poor one; parameters that few rows leave open; weak segments."""
    for cone in ("free", "orthant", "half", "body"):
        for seed in range(8):
            segments = 6 if cone == "body" else 7
            problem = synthetic(
                seed,
                segments,
                cone=cone,
                size=2 + seed % 6,
                noise=(0.1, 0.5, 1.0)[seed % 3],
                longest=(2, 6)[seed % 2],
                spread=(1.0, 10.0)[seed // 4],
                known=seed % 3,
                scale=3.0,
            )
            for rank in (0, 1, len(problem.assignments) // 2):
                yield Flipped(problem, rank, fixed=np.flatnonzero(problem.normal_equations.known == 0)[: seed % 3])


@pytest.fixture(scope="module")
def cases():
    return list(flipped_cases())


def assert_bounds_hold(case, flips):
    assert flips.best[0] <= min(case.least(), 0.0) + case.rounding
    assert flips.any <= case.least(np.any(case.turned, axis=1)) + case.rounding
    alone = np.sum(case.turned, axis=1) == 1
    for k, change, by_itself in zip(case.free, flips.changes(), flips.alone, strict=True):
        assert change <= case.least(case.turned[:, k]) + case.rounding
        assert by_itself <= case.least(alone & case.turned[:, k]) + case.rounding


def test_no_set_of_flips_costs_less_than_its_bound(cases):
    for case in cases:
        assert_bounds_hold(case, case.flips)
        assert set(case.flips.best[1]) <= set(case.free)
        (nothing_forced,) = case.flips.forced(np.zeros((1, case.problem.normal_equations.gradient.shape[1])))
        assert nothing_forced <= case.flips.best[0] + case.rounding, "the slopes are no sharper than the enumeration"


@pytest.mark.parametrize("limits", [{"enumerated": 0}, {"many_flips": 1}, {"rows_at_once": 2}])
def test_less_work_bounds_flips_less_sharply_and_never_wrongly(cases, limits):
    looser = 0
    for case in cases:
        flips = case.limited(**limits)
        assert_bounds_hold(case, flips)
        assert flips.best[0] <= case.flips.best[0] + case.rounding
        assert np.all(flips.changes() <= case.flips.changes() + case.rounding)
        looser += flips.best[0] < case.flips.best[0] or bool(np.any(flips.changes() < case.flips.changes()))
    assert "rows_at_once" in limits or looser > 10, "or as much work was done"


def test_the_bound_of_forced_flips_holds_for_all_free_segments(cases):
    rng = np.random.default_rng(0)
    for case in cases:
        m, unknown = case.problem.normal_equations, np.flatnonzero(case.problem.normal_equations.known == 0)
        free = rng.choice(unknown, len(unknown) // 2, replace=False)
        forced = np.setdiff1d(unknown, free)
        flips = case.view.flips(case.branch, free)
        sets = rng.integers(0, 2, (10, len(forced))).astype(bool)
        steps = np.array([case.signs[forced[one]] @ m.gradient[forced[one]] for one in sets])
        for one, bound in zip(sets, flips.forced(steps), strict=True):
            exactly = np.all(case.turned[:, forced] == one, axis=1)
            assert bound <= case.changes[exactly].min() + case.rounding


def test_the_bounds_are_no_worse_than_the_quadratic_itself_for_few_segments(cases):
    """`best` is the least of 4 (sum a - sum K) over all sets, here written out set by set."""
    for case in cases:
        m, beta = case.problem.normal_equations, case.problem.coefficients.project(case.branch.theta)
        pull = case.problem.solver().tikhonov()[0]
        turned = case.signs[case.free, None] * m.gradient[case.free]
        inner = turned @ np.linalg.solve(m.hessian.total() + pull, turned.T)
        model_error_probability = np.sqrt(max(case.branch.cost - case.branch.lower_bound, 0.0) * np.diag(inner))
        gains = turned @ beta - model_error_probability
        sets = (np.arange(2 ** len(case.free))[:, None] >> np.arange(len(case.free))) & 1
        least = 4.0 * np.min(sets @ gains - np.einsum("tk,kl,tl->t", sets, inner, sets))
        assert case.flips.best[0] == pytest.approx(least, abs=case.rounding)


def test_the_bound_holds_for_inaccurate_parameters():
    """A coarse tolerance leaves beta off the best point; the gap that it leaves takes care of that."""
    for cone in ("orthant", "half", "body"):
        for seed in range(6):
            problem = synthetic(seed, 6, cone=cone, size=5, noise=0.5, longest=3, scale=10.0)
            precise, coarse = Flipped(problem, 1), Flipped(problem, 1, tolerance=1e-2)
            assert coarse.branch.cost - coarse.branch.lower_bound > precise.branch.cost - precise.branch.lower_bound
            assert coarse.flips.best[0] <= coarse.least() + coarse.rounding
            for k, bound in zip(coarse.free, coarse.flips.changes(), strict=True):
                assert bound <= coarse.least(coarse.turned[:, k]) + coarse.rounding


def test_the_bound_is_what_least_squares_leaves_unexplained():
    """Of rows that show all coefficients, and of too few rows beside a pull, which needs no ridge."""
    for samples, pull, options in ((12, 0.0, {}), (2, 1e-3, {"ridge": 0.0})):
        rng = np.random.default_rng(samples)
        y, efforts = rng.normal(size=(samples, 4)), rng.normal(size=(5, samples))
        explained = UnconstrainedBound(y.T @ y + pull**2 * np.eye(4), **options)(efforts @ y)
        stacked = np.vstack([y, pull * np.eye(4)])
        for effort, minimum in zip(efforts, explained, strict=True):
            target = np.append(effort, np.zeros(4))
            left = np.sum((stacked @ np.linalg.lstsq(stacked, target, rcond=None)[0] - target) ** 2)
            assert effort @ effort + minimum == pytest.approx(left, rel=1e-6, abs=1e-9)


def test_columns_that_no_row_shows_explain_nothing():
    """Fewer rows than coefficients, one column zero, two alike: the ridge makes H invertible."""
    rng = np.random.default_rng(3)
    y, effort = rng.normal(size=(3, 6)) * np.array([1.0, 0.0, 1e-3, 2.0, 2.0, 5.0]), rng.normal(size=3)
    y[:, 4] = y[:, 3]
    left = effort @ effort + UnconstrainedBound(y.T @ y)((effort @ y)[None])[0]
    exactly = np.sum((y @ np.linalg.lstsq(y, effort, rcond=None)[0] - effort) ** 2)
    assert exactly - 1e-9 * effort @ effort <= left <= exactly + 1e-2 * effort @ effort
