import itertools
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.special import logsumexp
from sign_problems import moments_of

from bayesid.fit.knowledge import Information, Links, Nominal
from bayesid.fit.noise import Noise
from bayesid.fit.solver import ConeLeastSquares
from bayesid.model.coefficients import BaseCoefficients
from bayesid.model.parameters import Cone
from bayesid.posterior.likelihood import make_likelihood
from bayesid.posterior.modes import find_modes, starting_points
from bayesid.posterior.prior import make_prior
from bayesid.posterior.target import Target
from bayesid.signs.search.certified import certified
from bayesid.signs.search.result import SearchResult

LOG_SCALE_SD = 0.5  # of the stated prior


@dataclass(frozen=True)
class Log:
    """Rows of segments, each turned by a sign that is known or not, and all that an inference wants of them."""

    rows: tuple  # of each segment: columns (m, r) and efforts (m,), N m
    joint: np.ndarray
    known: np.ndarray
    cone: Cone
    nominal: Nominal  # of all parameters, so that no default of the prior matters
    sigma: np.ndarray
    time: np.ndarray  # samples that count as one
    projection: np.ndarray
    earlier: Information | None = None  # of an earlier log

    @property
    def moments(self):
        return moments_of(self.rows, self.joint, self.known)

    @property
    def scaled(self):
        return self.moments.scaled(self.sigma * np.sqrt(self.time))

    @property
    def noise(self):
        return Noise(0.6 * self.sigma, 0.8 * self.sigma, np.full(len(self.sigma), 0.1), self.time)

    @property
    def coefficients(self):
        names = tuple(f"b{k}" for k in range(len(self.projection)))
        return BaseCoefficients(names, names, names, np.arange(len(names)), self.projection)

    @property
    def solver(self):
        scaled, earlier = self.scaled, self.earlier or Information.none(len(self.projection))
        hessian, energy = scaled.hessian.total() + earlier.hessian, float(scaled.energy.sum()) + earlier.energy
        return ConeLeastSquares(self.cone, self.coefficients, hessian, energy)

    @property
    def target(self):
        none = np.zeros(len(self.joint), dtype=np.int64)
        likelihood = make_likelihood(self.moments, self.coefficients, self.sigma, self.time, none)
        return Target(make_prior(self.cone, likelihood, Links(), self.nominal), likelihood, self.earlier)

    def search(self):
        return certified(self.scaled, replace(self, earlier=None).solver, budget=20.0)

    def modes(self, search=None):
        return find_modes(self.target, self.scaled, self.solver, search or self.search())

    def segment_logs(self, theta, log_scale):
        """(2, S, M) log densities of each segment's efforts with sign + and -, at M points, by its rows."""
        values = np.empty((2, len(self.rows), len(theta)))
        for k, ((columns, effort), j) in enumerate(zip(self.rows, self.joint, strict=True)):
            predicted = columns @ self.projection @ theta.T
            weight = np.exp(-2.0 * log_scale[:, j]) / self.sigma[j] ** 2
            for row, sign in zip(values, (1.0, -1.0), strict=True):
                square = np.sum((sign * effort[:, None] - predicted) ** 2, axis=0)
                row[k] = -(0.5 * weight * square + len(effort) * log_scale[:, j]) / self.time[j]
        values[1, self.known > 0] = values[0, self.known < 0] = -np.inf
        return values

    def log_prior(self, theta, log_scale):
        """(M,) inside the cone; the earlier log included."""
        square = ((theta - self.nominal.mean) / self.nominal.sd) ** 2
        value = -0.5 * square.sum(axis=1) - 0.5 * np.sum((log_scale / LOG_SCALE_SD) ** 2, axis=1)
        if self.earlier is not None:
            beta, known = theta @ self.projection.T, self.earlier
            value -= 0.5 * np.einsum("mr,rs,ms->m", beta, known.hessian, beta) - beta @ known.gradient
        return value

    def log_density(self, theta, log_scale=None):
        """(M,) of the posterior, not normalised, all signs summed out."""
        log_scale = np.zeros((len(theta), len(self.sigma))) if log_scale is None else log_scale
        return self.log_prior(theta, log_scale) + logsumexp(self.segment_logs(theta, log_scale), axis=0).sum(axis=0)


def make_log(
    theta,
    rows=(8,) * 6,
    joint=None,
    known=None,
    mean=None,
    sd=None,
    cone=None,
    sigma=(1.0,),
    time=(1.0,),
    seed=0,
    projection=None,
    sees=None,
):
    """A log of the model itself: rows normal with sds `sees` (n, r) of each joint, signs drawn, some known."""
    rng = np.random.default_rng(seed)
    theta, sigma, time = (np.array(values, dtype=float) for values in (theta, sigma, time))
    joint = np.zeros(len(rows), dtype=np.int64) if joint is None else np.array(joint)
    known = np.zeros(len(rows), dtype=bool) if known is None else np.array(known, dtype=bool)
    projection = np.eye(len(theta)) if projection is None else np.array(projection)
    sees = np.ones((len(sigma), len(projection))) if sees is None else np.array(sees)
    signs, pieces = rng.choice([-1, 1], len(rows)), []
    for sign, m, j in zip(signs, rows, joint, strict=True):
        columns = rng.standard_normal((m, len(projection))) * sees[j]
        effort = columns @ projection @ theta + sigma[j] * rng.standard_normal(m)
        pieces.append((columns, sign * effort))
    nominal = Nominal(
        np.zeros(len(theta)) if mean is None else np.array(mean), np.ones(len(theta)) if sd is None else np.array(sd)
    )
    cone = Cone.free(len(theta)) if cone is None else cone
    return Log(tuple(pieces), joint, np.where(known, signs, 0), cone, nominal, sigma, time, projection)


def unproven(search):
    """The same without any list of assignments."""
    return replace(search, branches=(), settled=None, certified=False, missed=np.inf)


def near_symmetric(lean=1.0, seed=3):
    """The unknown signs of joint 0 may all be turned with its free parameter; what decides is `lean` of the prior."""
    return make_log(
        (1.5, 0.4),
        rows=(8, 9, 10, 8, 12),
        joint=(0, 0, 0, 1, 1),
        known=(0, 0, 0, 1, 1),
        sd=(2.0, 1.0),
        mean=(lean, 0.2),
        cone=Cone.free(1) + Cone.orthant(1),
        sigma=(1.0, 0.5),
        time=(1.0, 1.5),
        sees=((1.0, 0.3), (0.0, 1.0)),
        seed=seed,
    )


# ---------------------------------------------------------------------------------------------------------------
# How many
# ---------------------------------------------------------------------------------------------------------------
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


def test_one_clear_best_is_one_mode():
    log = make_log((1.5, 0.4), rows=(8, 9, 10, 8), known=(0, 0, 0, 1), sd=(2.0, 1.0), mean=(0.0, 0.0), sigma=(0.3,))
    modes = log.modes()
    assert len(modes) == 1
    assert np.allclose(modes[0].theta, (1.5, 0.4), atol=5 * 0.3 / np.sqrt(35))


@pytest.mark.parametrize("depth", [8.0, 12.0])
def test_ten_nats_below_the_best_do_not_matter(depth):
    log = alone(1.5)
    size = abs(log.modes()[0].theta[0])
    lean = depth * 4.0 / (2.0 * size)  # the prior's log ratio between the two sides, 2 size lean / sd^2
    log = replace(log, nominal=Nominal(np.array([lean]), log.nominal.sd))
    points = np.linspace(-4.0, 4.0, 4001)[:, None]
    values = log.log_density(points)
    assert abs(values[points[:, 0] > 0].max() - values[points[:, 0] < 0].max() - depth) < 1.0
    assert len(log.modes()) == (2 if depth < 10.0 else 1)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("depth", [8.0, 12.0])
def test_an_earlier_log_settles_a_symmetry_as_far_as_it_goes(depth, side):
    log = alone(1.5)
    lean = side * depth / (2.0 * abs(log.modes()[0].theta[0]))  # what decides between the sides, by 2 g theta
    log = replace(log, earlier=Information(np.array([[0.3]]), np.array([lean]), 0.0))
    points = np.linspace(-4.0, 4.0, 4001)[:, None]
    values = log.log_density(points)
    assert abs(values[side * points[:, 0] > 0].max() - values[side * points[:, 0] < 0].max() - depth) < 1.0
    modes = log.modes()
    assert len(modes) == (2 if depth < 10.0 else 1)
    assert modes[0].theta[0] * side > 0.0
    exact = log.log_density(np.array([mode.theta for mode in modes]))
    assert np.allclose(np.diff([mode.log_density for mode in modes]), np.diff(exact), atol=1e-8)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    "weight", [100.0, 1e6]
)  # the other side costs too much; it is given up by the signs it predicts
def test_a_side_that_an_earlier_log_rules_out_is_no_starting_point(side, weight):
    log = make_log((1.5,), rows=(6, 5, 7, 6), sd=(2.0,), sigma=(0.1,), seed=1)
    for search in (log.search(), unproven(log.search())):
        assert len(log.modes(search)) == 2
        earlier = Information(np.array([[weight]]), np.array([side * 1.4 * weight]), weight * 1.4**2)
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


def test_a_list_holds_what_turning_single_joints_does_not():
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


# ---------------------------------------------------------------------------------------------------------------
# Where
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(3))
def test_centres_lie_strictly_inside(seed):
    log = make_log(
        (1.5, 0.0, 0.0),
        rows=(40, 30, 50),
        known=(0, 0, 1),
        cone=Cone.free(1) + Cone.orthant(2),
        sd=(2.0, 1.0, 1.0),
        mean=(0.0, -0.5, 0.0),
        seed=seed,
        sigma=(0.1,),
    )
    modes = log.modes()
    assert min(branch.theta[1:].min() for branch in log.search().branches) < 1e-5  # the optimum sits on the edge
    for mode in modes:
        assert np.all(mode.theta[1:] > 0.0)
        assert np.all(np.isfinite(mode.theta))
        assert np.isfinite(mode.log_density)


@pytest.mark.parametrize("proven", [True, False])
def test_known_signs_are_never_turned(proven):
    log = alone(1.5)
    columns, effort = log.rows[0]
    weak = [(np.array([[0.05]]), np.array([sign * 0.4])) for sign in (1.0, -1.0)]
    log = replace(
        log, rows=(*log.rows, *weak), joint=np.zeros(6, dtype=np.int64), known=np.array([0, 0, 0, 0, 1, 1])
    )  # on either side, one of the known signs is not what the parameters predict
    search = log.search()
    modes = log.modes(search if proven else unproven(search))
    assert len(modes) == 2
    assert np.array_equal(modes[0].signs[:4], -modes[1].signs[:4])
    assert all(np.array_equal(mode.signs[4:], [1, 1]) for mode in modes)


def test_all_signs_known():
    log = make_log((1.5, 0.4), known=(1,) * 6)
    signs = log.known
    theta = log.solver.prepared().solve(signs @ log.scaled.gradient).theta
    search = SearchResult(signs, theta, 0.0, "given", None, False, None, 0, 0, 0.0, 0.0)
    modes = log.modes(search)
    assert len(modes) == 1
    assert np.array_equal(modes[0].signs, signs)
