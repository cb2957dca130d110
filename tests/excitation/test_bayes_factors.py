"""Expected Bayes factors against the formula of the manual with dense inverses."""

from itertools import pairwise

import numpy as np

from bayesid.excitation.bayes_factors import Belief, expected_factors

R, EXTRA = 5, (2, 1, 3, 2)
"""Coefficients, and further columns of four cases."""


def positive(rng, n, rows=40):
    scale = 10.0 ** rng.uniform(-2.0, 2.0, n)
    x = rng.standard_normal((rows, n)) * scale
    return x.T @ x


def cases(rng):
    """Beliefs with a common block of the coefficients."""
    total = R + sum(EXTRA)
    every = positive(rng, total) + np.diag(rng.uniform(0.1, 5.0, total))
    ends = R + np.cumsum([0, *EXTRA])
    made = []
    for start, end in pairwise(ends.tolist()):
        columns = np.concatenate([np.arange(R), np.arange(start, end)])
        own = every[np.ix_(columns, columns)]
        made.append(Belief(columns, rng.standard_normal(len(columns)) / np.sqrt(np.diag(own)), own))
    return made


def plain(case, true, information):
    """The formula of the manual."""
    own = information[np.ix_(case.columns, case.columns)]
    across = information[np.ix_(case.columns, true.columns)]
    after = case.precision + own
    pull = case.precision @ case.mean + across @ true.mean
    spread = across @ np.linalg.inv(true.precision) @ across.T + own
    left = np.linalg.inv(after)
    dets = np.linalg.slogdet(case.precision)[1] - np.linalg.slogdet(after)[1]
    return 0.5 * (dets - case.mean @ case.precision @ case.mean + pull @ left @ pull + np.trace(left @ spread))


def test_the_formula_with_dense_matrices():
    rng = np.random.default_rng(0)
    a, b, c, d = cases(rng)
    information = 3.0 * positive(rng, R + sum(EXTRA))
    pairs = [(a, [b]), (b, [a, d]), (c, [d, a, b]), (a, [c])]
    factors = expected_factors(pairs, information)
    direct = [
        plain(true, true, information) - max(plain(o, true, information) for o in others) for true, others in pairs
    ]
    size = max(abs(plain(a, a, information)), 1.0)
    np.testing.assert_allclose(factors, direct, rtol=1e-8, atol=1e-8 * size)
    assert np.ptp(direct) > 1.0  # a sign or an order that is wrong would show


def test_without_information_the_expected_factors_are_zero():
    """Different prior means and deviations are not evidence."""
    a, b, *_ = cases(np.random.default_rng(1))
    np.testing.assert_allclose(expected_factors([(a, [b])], np.zeros((13, 13))), 0.0, atol=1e-9)
