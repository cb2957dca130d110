import itertools
from dataclasses import replace

import numpy as np
import pytest
from posterior_logs import make_log, near_symmetric, unproven

from bayesid.effects.parameters import Cone
from bayesid.posterior.modes import starting_points
from bayesid.regression.knowledge import InformationMatrix, NominalParameters


@pytest.mark.parametrize("proven", [True, False])
def test_both_sides_of_a_near_symmetry(proven):
    log = alone(1.5)
    search = log.search()
    assert search.branches
    modes = log.modes(search if proven else unproven(search))
    assert len(modes) == 2
    assert modes[0].theta[0] * modes[1].theta[0] < 0.0
    assert np.array_equal(modes[0].signs, -modes[1].signs)
    for mode in modes:  # without a cone, the centre is the normal distribution's mean under these signs
        precision = sum(y.T @ y for y, _ in log.rows) + np.diag(1.0 / log.nominal.sd**2)
        slope = sum(s * y.T @ e for s, (y, e) in zip(mode.signs, log.rows, strict=True))
        mean = np.linalg.solve(precision, slope + log.nominal.mean / log.nominal.sd**2)
        assert np.allclose(mode.theta, mean, rtol=1e-4)
        nearby = mode.theta + 1e-3 * np.array([[0.0], [1.0], [-1.0]])
        assert np.ptp(log.log_density(nearby)) < 1e-2


def alone(size, lean=0.0, seed=1):
    """One free parameter and unknown signs alone."""
    return make_log((size,), rows=(6, 5, 7, 6), mean=(lean,), sd=(2.0,), seed=seed)


@pytest.mark.parametrize(("lean", "first"), [(1.0, 1.0), (-3.0, -1.0)])
def test_densities_are_the_rows_own_and_the_densest_is_first(lean, first):
    log = near_symmetric(lean)
    modes = log.modes()
    assert [np.sign(mode.theta[0]) for mode in modes] == [first, -first]
    values = np.array([mode.log_density for mode in modes])
    exact = log.log_density(np.array([mode.theta for mode in modes]))
    assert np.isclose(values[0] - values[1], exact[0] - exact[1], atol=1e-6)
    assert values[0] - values[1] > 1.0


@pytest.mark.parametrize("depth", [8.0, 12.0])
def test_modes_ten_nats_below_the_best_are_dropped(depth):
    log = alone(1.5)
    size = abs(log.modes()[0].theta[0])
    lean = depth * 4.0 / (2.0 * size)  # the prior's log ratio between the two sides, 2 size lean / sd^2
    log = replace(log, nominal=NominalParameters(np.array([lean]), log.nominal.sd))
    points = np.linspace(-4.0, 4.0, 4001)[:, None]
    values = log.log_density(points)
    assert abs(values[points[:, 0] > 0].max() - values[points[:, 0] < 0].max() - depth) < 1.0
    assert len(log.modes()) == (2 if depth < 10.0 else 1)


@pytest.mark.parametrize(("side", "weight"), [(1.0, 100.0), (-1.0, 1e6)])
def test_a_side_that_an_earlier_log_rules_out_is_no_starting_point(side, weight):
    log = make_log((1.5,), rows=(6, 5, 7, 6), sd=(2.0,), sigma=(0.1,), seed=1)
    """The other side costs too much; of the larger weight it is given up by the signs it predicts."""
    for search in (log.search(), unproven(log.search())):
        assert len(log.modes(search)) == 2
        earlier = InformationMatrix(np.array([[weight]]), np.array([side * 1.4 * weight]), weight * 1.4**2)
        known = replace(log, earlier=earlier)
        ((_, start),) = starting_points(known.scaled, known.earlier, known.solver, search)
        assert start[0] * side > 0.0
        modes = known.modes(search)
        assert len(modes) == 1
        predicted = np.array([np.sign(side * y[:, 0] @ e) for y, e in log.rows])
        assert np.array_equal(modes[0].signs, predicted)
        precision = sum(float(y[:, 0] @ y[:, 0]) for y, _ in log.rows) / 0.01 + weight + 0.25
        slope = sum(abs(float(y[:, 0] @ e)) for y, e in log.rows) / 0.01 + 1.4 * weight
        assert modes[0].theta[0] == pytest.approx(side * slope / precision, rel=1e-6)


@pytest.mark.parametrize(("size", "lean", "deep"), [(0.7, 0.1, False), (0.8, 0.1, True), (0.8, 10.0, False)])
def test_without_a_valley_two_centres_are_one_mode(size, lean, deep):
    log = alone(size, lean)
    points = np.linspace(-3.0, 3.0, 6001)[:, None]
    values = log.log_density(points)
    top = [values[points[:, 0] * side > 0].max() for side in (1.0, -1.0)]
    valley = min(top) - values[np.abs(points[:, 0]) < 0.5 * size].min()
    assert (3.3 < valley < 4.5) if deep else (1.5 < valley < 2.8)  # below the lower one; the threshold is 3
    assert lean < 1.0 or max(top) - min(top) + valley > 3.5
    search = log.search()
    assert len({branch.signs.tobytes() for branch in search.branches}) >= 2  # both are looked at
    assert len(log.modes(search)) == (2 if deep else 1)


def three_joints():
    """Three joints, each with a parameter and two sides each: eight modes."""
    return make_log(
        (2.0, 1.5, 1.8),
        rows=(6, 5, 7, 6, 5, 8),
        joint=(0, 1, 2, 0, 1, 2),
        sigma=(1.0,) * 3,
        time=(1.0,) * 3,
        sd=(2.0,) * 3,
        mean=(0.1, 0.3, 0.7),
        sees=np.eye(3),
        seed=2,
    )


def test_listed_assignments_give_modes_beyond_single_flips():
    log = three_joints()
    search = log.search()
    sides = np.array(list(itertools.product((1.0, -1.0), repeat=3)))
    best = np.abs(log.modes(search)[0].theta)
    density = log.log_density(sides * best)
    modes = log.modes(search)
    assert len(modes) == 6
    kept = np.array([np.sign(mode.theta) for mode in modes])
    assert np.array_equal(kept, sides[np.argsort(-density)[:6]])  # the densest of eight, in this order
    alone = log.modes(unproven(search))
    assert len(alone) == 4  # the best one, and each joint turned
    assert sorted(int(np.sum(np.sign(mode.theta) != np.sign(search.theta))) for mode in alone) == [0, 1, 1, 1]


def test_centres_lie_strictly_inside():
    log = make_log(
        (1.5, 0.0, 0.0),
        rows=(40, 30, 50),
        known=(0, 0, 1),
        cone=Cone.free(1) + Cone.orthant(2),
        sd=(2.0, 1.0, 1.0),
        mean=(0.0, -0.5, 0.0),
        sigma=(0.1,),
    )
    modes = log.modes()
    assert min(branch.theta[1:].min() for branch in log.search().branches) < 1e-5  # the optimum sits on the edge
    for mode in modes:
        assert np.all(mode.theta[1:] > 0.0)
        assert np.all(np.isfinite(mode.theta))
        assert np.isfinite(mode.log_density)


def test_known_signs_are_never_flipped():
    log = alone(1.5)
    columns, effort = log.rows[0]
    weak = [(np.array([[0.05]]), np.array([sign * 0.4])) for sign in (1.0, -1.0)]
    log = replace(
        log, rows=(*log.rows, *weak), joint=np.zeros(6, dtype=np.int64), known=np.array([0, 0, 0, 0, 1, 1])
    )  # on either side, one of the known signs is not what the parameters predict
    search = log.search()
    for modes in (log.modes(search), log.modes(unproven(search))):
        assert len(modes) == 2
        assert np.array_equal(modes[0].signs[:4], -modes[1].signs[:4])
        assert all(np.array_equal(mode.signs[4:], [1, 1]) for mode in modes)
