"""Relevance: against densities worked out on a grid, and directions that the model stands for itself."""

from functools import cached_property

import numpy as np
import pytest
from scipy.linalg import null_space, solve_triangular
from scipy.optimize import approx_fprime
from scipy.stats import t

from bayesid.regression.knowledge import inverse_of
from bayesid.regression.selection.unseen import Group, learn_scales

COUNT, FREE = 120, 3
ABSENT = 0.5
"""The belief that an effect is absent, half an observation of nothing."""


class Case:
    """Whitened columns of a model and of some groups, and efforts."""

    def __init__(self, sds, amplitudes, seed=0, least=None, there=None):
        rng = np.random.default_rng(seed)
        self.sds = [np.asarray(sd, dtype=float) for sd in sds]
        self.model = rng.normal(size=(COUNT, FREE)) * [1.0, 30.0, 0.02]
        self.rows = [rng.normal(size=(COUNT, len(sd))) + 0.4 * self.model[:, :1] for sd in self.sds]
        self.effort = self.model @ [2.0, -0.1, 80.0] + rng.normal(size=COUNT)
        for rows, values in zip(self.rows, amplitudes, strict=True):
            self.effort += rows @ np.asarray(values, dtype=float)
        self.least = least or [0.0] * len(sds)
        self.there = there or [False] * len(sds)

    def learned(self):
        columns, groups, start = np.hstack([self.model, *self.rows]), [], FREE
        for sd, there, least in zip(self.sds, self.there, self.least, strict=True):
            groups.append(Group(slice(start, start + len(sd)), sd, there, least))
            start += len(sd)
        return learn_scales(columns.T @ columns, columns.T @ self.effort, groups, FREE)

    @cached_property
    def left(self):
        """What the model's columns cannot make."""
        return null_space(self.model.T)

    def log_density(self, scales):
        """Of what of the efforts the model's columns cannot make: a normal one, by its covariance's triangular root."""
        sd = np.concatenate([sd * scale for sd, scale in zip(self.sds, scales, strict=True)])
        rows, effort = self.left.T @ np.hstack(self.rows) * sd, self.left.T @ self.effort
        root = np.linalg.cholesky(np.eye(len(rows)) + rows @ rows.T)
        white = solve_triangular(root, effort, lower=True)
        return -0.5 * (white @ white) - np.log(np.diag(root)).sum() - 0.5 * len(rows) * np.log(2.0 * np.pi)

    def posterior(self, scales):
        """Mean and covariance of all amplitudes, given their scales."""
        left = self.left
        rows = left.T @ np.hstack(self.rows)
        sd = np.concatenate([sd * scale for sd, scale in zip(self.sds, scales, strict=True)])
        covariance = np.linalg.inv(rows.T @ rows + np.diag(sd**-2.0))
        return covariance @ rows.T @ left.T @ self.effort, covariance


@pytest.mark.parametrize(("sd", "amplitudes"), [([0.5], [1.3]), ([0.5, 2.0, 0.1], [0.9, -1.0, 0.2])])
def test_scale_of_a_group_maximises_the_penalised_evidence(sd, amplitudes):
    """On a grid of two per cent; the penalty makes zero a maximum too, which is left aside."""
    case = Case([sd], [amplitudes])
    grid = np.exp(np.arange(np.log(0.2), np.log(10.0), 0.02))
    densities = np.array([case.log_density([s]) for s in grid])
    penalised = densities - ABSENT * np.log(grid)
    peaks = [k for k in range(1, len(grid) - 1) if penalised[k] > max(penalised[k - 1], penalised[k + 1])]
    assert len(peaks) == 1
    found = case.learned()
    assert found.scales[0] == pytest.approx(grid[peaks[0]], rel=0.021)
    assert found.scales[0] < 0.95 * grid[np.argmax(densities)]


def test_scales_of_several_groups_are_a_common_maximum():
    case = Case([[0.5, 0.3], [1.0], [2.0, 0.7]], [[1.0, -0.4], [2.2], [0.9, 0.5]], seed=4)
    found = case.learned()

    def penalised(logarithms):
        return case.log_density(np.exp(logarithms)) - ABSENT * logarithms.sum()

    slope = approx_fprime(np.log(found.scales), penalised, 1e-6)
    assert np.abs(slope).max() < 0.05  # curvatures are about the number of amplitudes
    doubled = approx_fprime(np.log(2.0 * found.scales), penalised, 1e-6)
    assert np.all(doubled < -0.3)


def test_what_the_log_cannot_show_vanishes():
    """Columns of a thousandth of the error, and large ones of effects that are not there."""
    case = Case([[0.5], [1.0, 1.0], [0.8]], [[1.3], [0.0, 0.0], [0.0]], seed=7)
    case.rows[2] *= 1e-3
    found = case.learned()
    assert found.scales[0] > 1.0
    assert found.scales[2] == 0.0
    size = sum(turn.shape[1] for turn in found.turns)
    assert found.moments.shape == (size, size)
    np.testing.assert_array_equal(found.moments[-1], 0.0)
    absent = [Case([[1.0] * 4], [[0.0] * 4], seed=seed).learned().scales[0] for seed in range(20)]
    assert np.median(absent) < 0.1
    assert np.max(absent) < 0.3  # sqrt(4 / 120) is what four amplitudes of noise alone would be


@pytest.mark.parametrize("amplitude", [0.2, 6.0])
def test_what_was_stated_never_shrinks_but_may_grow(amplitude):
    amplitudes, there = [[amplitude, 2.0 * amplitude], [0.9]], [True, False]
    case = Case([[1.0, 2.0], [0.5]], amplitudes, seed=2, least=[1.0, 0.0], there=there)
    found = case.learned()
    if amplitude == 6.0:
        assert 3.0 < found.scales[0] < 9.0
    else:
        assert found.scales[0] == 1.0
    np.testing.assert_array_equal(found.turns[0], np.diag([1.0, 2.0]))
    mean, covariance = case.posterior(found.scales)
    turn = np.diag([1.0, 2.0, *found.turns[1].ravel()])
    moments = turn @ found.moments @ turn.T
    np.testing.assert_allclose(moments, covariance + np.outer(mean, mean), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("amplitude", [0.3, 5.0])
def test_what_is_there_in_any_case_has_the_mean_square_that_belief_and_log_leave(amplitude):
    """By densities of all rows, on an even grid, beside another group that is searched for."""
    case = Case([[1.0, 0.5, 2.0], [0.5]], [amplitude * np.array([0.9, -0.6, 1.7]), [1.3]], seed=6, there=[True, False])
    found = case.learned()
    grid = np.linspace(0.005, 20.0, 2000)
    densities = np.array([case.log_density([s, found.scales[1]]) for s in grid])
    densities += t(4, scale=np.sqrt(0.5)).logpdf(grid)
    weight = np.exp(densities - densities.max())
    assert found.scales[0] == pytest.approx(np.sqrt(weight @ grid**2 / weight.sum()), rel=0.02)
    assert (found.scales[0] < 1.0) == (amplitude < 1.0)


def with_collinear(part, sd=(0.5, 2.0), seed=3, *, there=False):
    """A group whose columns' sum is in the model's span, but for a part of it; and the difference's size."""
    case = Case([sd], [[0.9, -1.1]], seed=seed, there=[there])
    inside = case.model @ [0.7, 0.03, -9.0]
    beside = null_space(np.column_stack([case.model, case.rows[0]]).T)[:, 0]
    target = inside + part * np.linalg.norm(inside) * beside
    case.rows[0][:, 1] = target - case.rows[0][:, 0]
    return case


@pytest.mark.parametrize("part", [0.0, 0.02])
def test_what_the_models_columns_stand_for_is_left_to_them(part):
    """Only the amplitudes that are no multiple of (1, 1) count, in units of what was believed of them."""
    case = with_collinear(part)
    found = case.learned()
    (turn,) = found.turns
    assert turn.shape == (2, 1)
    sd = np.array([0.5, 2.0])
    alone, both = turn[:, 0] / sd, np.array([1.0, 1.0]) / sd
    assert np.linalg.norm(alone) == pytest.approx(1.0)
    if part == 0.0:
        assert alone @ both == pytest.approx(0.0, abs=1e-6)
    else:
        assert abs(alone @ both) < 0.05 * np.linalg.norm(both)


@pytest.mark.parametrize(("part", "there"), [(0.5, False), (0.0, True)])
def test_directions_of_their_own_and_of_what_is_there_in_any_case_are_kept(part, there):
    (turn,) = with_collinear(part, there=there).learned().turns
    assert turn.shape == (2, 2)
    np.testing.assert_allclose(turn @ turn.T, np.diag([0.25, 4.0]), atol=1e-9)


def test_inverse_in_mixed_units_and_with_a_column_of_nothing():
    """A model's column that is zero on all rows that are looked at; what the others say is the same without it."""
    units = np.array([1e-5, 3.0, 0.0, 1e6, 40.0])
    rows = np.random.default_rng(1).normal(size=(30, 5))
    found, kept = inverse_of((rows * units).T @ (rows * units)), [0, 1, 3, 4]
    assert np.isfinite(found).all()
    scaled = (found * np.outer(units, units))[np.ix_(kept, kept)]
    np.testing.assert_allclose(scaled, np.linalg.inv(rows[:, kept].T @ rows[:, kept]), rtol=1e-6)
