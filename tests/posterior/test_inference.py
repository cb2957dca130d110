from dataclasses import replace

import numpy as np
import pytest
from posterior_problems import information_of, one_each, whole_space
from scipy.special import expit
from scipy.stats import norm, truncnorm
from test_modes import LOG_SCALE_SD, make_log, near_symmetric, unproven

from bayesid.errors import InputError
from bayesid.fit.knowledge import Information, Links, Nominal
from bayesid.model.parameters import Cone
from bayesid.posterior import inference, marginal_likelihood, moves, sampled_modes, sampler
from bayesid.posterior.diagnostics import Diagnostics
from bayesid.posterior.inference import Posterior, infer, widened
from bayesid.posterior.likelihood import Likelihood, make_likelihood
from bayesid.posterior.marginal_likelihood import MarginalLikelihood
from bayesid.posterior.modes import Mode
from bayesid.posterior.prior import Prior
from bayesid.posterior.problem import PosteriorProblem
from bayesid.posterior.region import Region
from bayesid.posterior.sampled_modes import SampledMode, pool
from bayesid.posterior.sampler import Draws, Sampling, sample
from bayesid.posterior.target import Target
from bayesid.progress import SILENT, Progress
from bayesid.signs.search.beam import beam
from bayesid.signs.search.result import Branch, SearchResult

FEW = Sampling(walkers=16)
AVERAGED = 1024  # draws, at least, from which probabilities are averaged


def problem_of(log):
    return PosteriorProblem(
        one_each(log.moments), log.coefficients, log.cone, log.noise, Links(), log.nominal, log.earlier
    )


def infer_from(log, search=None, options=FEW, progress=SILENT):
    search = search or log.search()
    return infer(problem_of(log), search, options, progress)


def listing(log, assignments, decided):
    """A search's answer that lists these assignments (B, S) and decides the same segments (S,) in each."""
    prepared, gradient = log.solver.prepared(), log.scaled.gradient
    branches = tuple(Branch(signs, prepared.solve(signs @ gradient).theta, 0.0, 0.0) for signs in assignments)
    return SearchResult(
        assignments[0],
        branches[0].theta,
        0.0,
        "given",
        None,
        True,
        0.0,
        0,
        0,
        0.0,
        0.0,
        branches,
        1.0,
        1e-3,
        decided,
        np.tile(decided, (len(branches), 1)),
    )


class Enumerated:
    """Every assignment of the unknown signs, and the integral of its posterior over a product grid of axes."""

    def __init__(self, log, *axes):
        size = log.cone.size
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
        self.theta, log_scale = points[:, :size], points[:, size:]
        unknown = np.flatnonzero(log.known == 0)
        choices = np.stack(np.meshgrid(*[[1, -1]] * len(unknown), indexing="ij"), axis=-1).reshape(-1, len(unknown))
        self.signs = np.tile(log.known, (len(choices), 1))
        self.signs[:, unknown] = choices
        of_segments, prior = log.segment_logs(self.theta, log_scale), log.log_prior(self.theta, log_scale)
        index = np.arange(len(log.known))
        logs = np.array([prior + of_segments[(1 - signs) // 2, index].sum(axis=0) for signs in self.signs])
        density = np.exp(logs - logs.max())
        self.weight = density.sum(axis=0) / density.sum()  # of the points
        self.mass = density.sum(axis=1) / density.sum()  # of the assignments
        edge = self.weight.reshape([len(axis) for axis in axes])
        ends = [np.take(edge, -1, axis=k).sum() for k in range(len(axes))]
        ends += [np.take(edge, 0, axis=k).sum() for k in range(len(axes)) if axes[k][0] < 0.0]
        assert max(ends) < 1e-4, "the grid is too small"

    @property
    def plus(self):
        return self.mass @ (self.signs > 0)

    def mass_of(self, signs, where):
        """Of all assignments with these signs in some of the segments."""
        return float(self.mass[np.all(self.signs[:, where] == signs[where], axis=1)].sum())

    def moments_where(self, where):
        """Mass, means and sds of the parameters over a part of the grid."""
        weight, theta = self.weight[where], self.theta[where]
        mean = weight @ theta / weight.sum()
        return weight.sum(), mean, np.sqrt(weight @ (theta - mean) ** 2 / weight.sum())


def errors(posterior, values):
    """Standard errors of averages over part of the draws of values (D, E, W, ...): walkers are independent."""
    sweeps = len(values)
    walkers = values.reshape(sweeps, -1, *values.shape[3:]).mean(axis=0)
    share = max(1.0, sweeps * len(walkers) / AVERAGED)
    return walkers.std(axis=0, ddof=1) / np.sqrt(len(walkers)) * np.sqrt(share)


def sign_odds(log, posterior):
    """(D, E, W, S) P(sign = +) at each draw, from the rows."""
    pull = np.array([y.T @ e for y, e in log.rows]) / (log.sigma**2 * log.time)[log.joint, None]
    return expit(2.0 * posterior.draws.beta @ pull.T * np.exp(-2.0 * posterior.draws.log_scale[..., log.joint]))


def mass_at_draws(log, posterior, signs, where):
    odds = sign_odds(log, posterior)[..., where]
    return np.where(signs[where] > 0, odds, 1.0 - odds).prod(axis=-1)


def cells(low, high, count):
    """Midpoints of equal cells."""
    return low + (high - low) * (np.arange(count) + 0.5) / count


# ---------------------------------------------------------------------------------------------------------------
# Signs and assignments, one mode
# ---------------------------------------------------------------------------------------------------------------
def doubtful(seed=5):
    """One joint, two free parameters, one sign known and five in doubt; the noise is larger than its reference."""
    log = make_log(
        (0.5, -0.8),
        rows=(3, 4, 5, 3, 6, 4),
        known=(0, 0, 1, 0, 0, 0),
        mean=(0.3, -0.6),
        sd=(0.4, 0.5),
        sigma=(1.2,),
        time=(1.5,),
        seed=seed,
    )
    return replace(log, sigma=np.array([0.7]))


def nonnegative():
    """Two joints and one parameter that is nonnegative and presses against zero; all signs of joint 1 in doubt."""
    return make_log(
        (0.2,),
        rows=(4, 5, 3, 6, 5),
        joint=(0, 1, 1, 1, 0),
        known=(1, 0, 0, 0, 0),
        cone=Cone.orthant(1),
        mean=(-0.3,),
        sd=(0.7,),
        sigma=(0.5, 0.8),
        time=(2.0, 1.2),
        seed=6,
    )


CASES = {
    "doubtful": (doubtful, (cells(-1.8, 2.4, 70), cells(-2.8, 1.6, 70), cells(-0.9, 2.2, 40))),
    "nonnegative": (nonnegative, (cells(0.0, 2.5, 200), cells(-1.3, 1.6, 40), cells(-1.3, 1.6, 40))),
}


@pytest.mark.parametrize("case", CASES)
def test_masses_of_signs_and_assignments_match_enumeration(case):
    make, axes = CASES[case]
    log, exact = make(), Enumerated(make(), *axes)
    unknown = log.known == 0
    order = np.argsort(-exact.mass)
    settled = np.zeros(len(log.known), dtype=bool)
    settled[np.flatnonzero(unknown)[0]] = True
    chosen = [k for k in order if exact.signs[k][settled] == exact.signs[order[0]][settled]]
    chosen = [order[0], *[k for k in chosen if np.sum(exact.signs[k] != exact.signs[order[0]]) == 1][:2]]
    listed = exact.signs[chosen]
    decided = settled | np.any(listed != listed[0], axis=0)
    assert 1 < decided.sum() < unknown.sum()  # the list leaves some segments open
    posterior = infer_from(log, listing(log, listed, decided | ~unknown))
    assert posterior.converged
    assert len(posterior.modes) == 1

    plus, error = posterior.plus[unknown], errors(posterior, sign_odds(log, posterior))[unknown]
    assert np.all(np.abs(plus - exact.plus[unknown]) < 4.5 * error)
    assert np.all(error < 0.03)
    assert np.ptp(exact.plus[unknown]) > 0.2

    for signs, mass in zip(listed, posterior.branch_mass, strict=True):
        error = errors(posterior, mass_at_draws(log, posterior, signs, decided))
        assert abs(mass - exact.mass_of(signs, decided)) < 4.5 * error
        assert error < 0.02
    rest = 1.0 - sum(exact.mass_of(signs, decided) for signs in listed)
    of_list = sum(mass_at_draws(log, posterior, signs, decided) for signs in listed)
    assert abs(posterior.elsewhere - rest) < 4.5 * errors(posterior, of_list)
    assert rest > 0.1
    assert posterior.elsewhere + posterior.branch_mass.sum() == pytest.approx(1.0, abs=1e-12)


def test_coefficients_match_enumeration():
    log = nonnegative()
    exact = Enumerated(log, cells(0.0, 2.0, 800), *CASES["nonnegative"][1][1:])
    posterior = infer_from(log, options=replace(FEW, seed=1))  # of 0, draws let half the mass begin at zero by a hair
    _, mean, sd = exact.moments_where(slice(None))
    theta = posterior.draws.theta
    error = errors(posterior, theta)
    assert np.all(np.abs(posterior.theta - mean) < 4.5 * error)
    assert np.all(np.abs(posterior.parameter_sd**2 - sd**2) < 4.5 * errors(posterior, (theta - mean) ** 2))
    for mass in (0.5, 0.95):
        low, high = posterior.interval(mass)
        assert (low[0] == 0.0) == (mass > 0.9)
        inside = (theta[..., 0] > low[0]) & (theta[..., 0] < high[0])
        held = exact.weight[(exact.theta[:, 0] > low[0]) & (exact.theta[:, 0] < high[0])].sum()
        assert abs(held - mass) < 4.5 * errors(posterior, inside.astype(float)) + 0.02  # two cells


def test_masses_of_a_certified_list():
    log = replace(doubtful(9), sigma=np.array([0.5]))
    exact = Enumerated(log, *CASES["doubtful"][1][:2], cells(-0.6, 2.4, 40))
    search = log.search()
    posterior = infer_from(log, search)
    assert len(posterior.branch_mass) == len(search.branches)
    signs = np.array([branch.signs for branch in search.branches])
    decided = search.decided & (log.known == 0)
    assert decided.sum(axis=1).min() >= 2
    assert len(signs) > 2
    for row, its, mass in zip(signs, decided, posterior.branch_mass, strict=True):
        expected = exact.mass_of(row, its)
        error = errors(posterior, mass_at_draws(log, posterior, row, its))
        assert abs(mass - expected) < 4.5 * error + 1e-4
    assert np.sum(posterior.branch_mass > 0.03) >= 2
    assert posterior.elsewhere == pytest.approx(1.0 - posterior.branch_mass.sum(), abs=1e-12)


def test_leaves_of_a_beam_have_the_masses_of_a_certified_list():
    """Where the beam kept them: together those that are alike in what the proof decides have the mass of its branch."""
    log = replace(doubtful(9), sigma=np.array([0.5]))
    certified = log.search()
    by_beam = replace(certified, **vars(beam(log.scaled, log.solver, width=None)))
    ours, theirs = infer_from(log, by_beam), infer_from(log, certified)
    assert len(by_beam.branches) >= len(certified.branches) > 2
    for branch, decided, mass in zip(certified.branches, certified.decided, theirs.branch_mass, strict=True):
        alike = [np.array_equal(leaf.signs[decided], branch.signs[decided]) for leaf in by_beam.branches]
        error = errors(theirs, mass_at_draws(log, theirs, branch.signs, decided & (log.known == 0)))
        assert abs(ours.branch_mass[alike].sum() - mass) < 4.5 * np.sqrt(2.0) * error + 2e-3  # leaves of less mass
    assert ours.excluded is None, "a beam excludes nothing"
    assert ours.elsewhere == pytest.approx(1.0 - ours.branch_mass.sum(), abs=1e-12)


def test_without_a_list_nothing_is_said_about_assignments():
    log = doubtful()
    posterior = infer_from(log, unproven(log.search()), replace(FEW, budget=0.0))
    assert posterior.branch_mass.shape == (0,)
    assert posterior.elsewhere is None


# ---------------------------------------------------------------------------------------------------------------
# Two modes
# ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("lean", [0.6, -2.5])
def test_two_modes_are_weighed_as_quadrature_weighs_them(lean):
    log = near_symmetric(lean)
    axes = (cells(-3.2, 3.2, 100), cells(0.0, 1.6, 40), cells(-0.9, 1.2, 16), cells(-1.2, 1.9, 16))
    exact = Enumerated(log, *axes)
    plus = exact.theta[:, 0] > 0.0
    share, mean_plus, sd_plus = exact.moments_where(plus)
    _, mean_minus, sd_minus = exact.moments_where(~plus)
    assert 0.05 < min(share, 1 - share) < 0.45
    posterior = infer_from(log)
    assert posterior.converged
    first, second = posterior.modes
    assert first.weight >= second.weight
    assert first.weight + second.weight == pytest.approx(1.0)
    for sampled in posterior.modes:  # no walker has crossed
        assert np.all(sampled.draws.theta[..., 0] * sampled.mode.theta[0] > 0.0)
        inside = sampled.draws.theta.mean(axis=(0, 1, 2))
        mean, sd = (mean_plus, sd_plus) if sampled.mode.theta[0] > 0.0 else (mean_minus, sd_minus)
        assert np.all(np.abs(inside - mean) < 4.5 * errors(posterior, sampled.draws.theta))
        square = (sampled.draws.theta - mean) ** 2
        assert np.all(np.abs(square.mean(axis=(0, 1, 2)) - sd**2) < 4.5 * errors(posterior, square) + 2e-4)  # the grid
        assert np.all(sampled.draws.theta[..., 1] > 0.0)

    of_plus = next(sampled.weight for sampled in posterior.modes if sampled.mode.theta[0] > 0.0)
    log_odds = np.log(of_plus / (1.0 - of_plus))
    doubt = np.hypot(first.marginal_likelihood.standard_error, second.marginal_likelihood.standard_error)
    assert abs(log_odds - np.log(share / (1.0 - share))) < 4.5 * doubt
    assert doubt < 0.15

    pooled = posterior.draws.theta
    assert np.mean(pooled[..., 0] > 0.0) == pytest.approx(of_plus, abs=2.0 / pooled[..., 0].size)
    _, mean, sd = exact.moments_where(slice(None))
    apart, both = mean_plus - mean_minus, share * (1.0 - share)
    shares, sds = np.array([share, 1.0 - share])[:, None], np.array([sd_plus, sd_minus])
    worst = min(sampled.draws.diagnostics.min_ess / sampled.draws.log_density.size for sampled in posterior.modes)
    effective = worst * shares * pooled[..., 0].size
    within = np.sqrt(np.sum((shares * sds) ** 2 / effective, axis=0))
    pooled_mean = posterior.draws.theta.mean(axis=(0, 1, 2))
    assert np.all(np.abs(pooled_mean - mean) < 4.5 * np.hypot(doubt * both * np.abs(apart), within))
    np.testing.assert_array_equal(posterior.theta, first.draws.theta.mean(axis=(0, 1, 2)))  # no point between
    of_weight = doubt * both * ((1.0 - 2.0 * share) * apart**2 + sd_plus**2 - sd_minus**2)
    of_means = 2.0 * both * apart * np.sqrt(np.sum(sds**2 / effective, axis=0))
    of_sds = np.sqrt(np.sum((shares * sds**2) ** 2 * 2.0 / effective, axis=0))
    doubts = np.sqrt(of_weight**2 + of_means**2 + of_sds**2)
    about_mean = np.mean((posterior.draws.theta - pooled_mean) ** 2, axis=(0, 1, 2))
    assert np.all(np.abs(about_mean - sd**2) < 4.5 * doubts + 2e-4)
    about_theta = posterior.draws.theta - posterior.theta
    np.testing.assert_allclose(posterior.parameter_sd**2, np.mean(about_theta**2, axis=(0, 1, 2)), rtol=1e-9)
    about_beta = (posterior.draws.beta - first.draws.beta.mean(axis=(0, 1, 2))).reshape(-1, 2)
    np.testing.assert_allclose(posterior.covariance, about_beta.T @ about_beta / len(about_beta), rtol=2e-3)
    assert posterior.turned_joints(0) == ()
    assert posterior.turned_joints(1) == (1,)
    assert posterior.turned_joints(0, -first.mode.signs) == (1,)
    of_draws = posterior.mode_of_draws
    np.testing.assert_array_equal(np.sign(pooled[..., 0]) == np.sign(first.mode.theta[0]), of_draws == 0)
    assert np.mean(of_draws) == pytest.approx(second.weight, abs=2.0 / of_draws.size)

    odds = sign_odds(log, posterior)[..., :3]
    assert np.all(np.abs(posterior.plus[:3] - odds.mean(axis=(0, 1, 2))) < 4.5 * odds.std(axis=(0, 1, 2)) / 32.0)
    assert np.all(np.abs(posterior.plus[:3] - exact.plus[:3]) < 4.5 * (doubt * both + odds.std(axis=(0, 1, 2)) / 32.0))
    assert np.ptp(exact.plus[:3]) > 0.3
    assert posterior.branch_mass.sum() + posterior.elsewhere == pytest.approx(1.0, abs=1e-12)
    assert posterior.max_rhat == max(sampled.draws.diagnostics.max_rhat for sampled in posterior.modes)
    assert posterior.min_ess == min(sampled.draws.diagnostics.min_ess for sampled in posterior.modes)


def test_another_mode_can_be_asked_for():
    log = near_symmetric(0.6)
    first, second, third = (infer_from(log, options=replace(FEW, budget=0.0, mode=k)) for k in (1, 2, 3))
    assert first.chosen == third.chosen == 0
    assert second.chosen == 1
    np.testing.assert_array_equal(second.theta, first.modes[1].draws.theta.mean(axis=(0, 1, 2)))
    assert second.theta[0] * first.theta[0] < 0.0
    with pytest.raises(InputError, match="no mode 0"):
        Sampling(mode=0)


def given(weight, side, sweeps, walkers=8, converged=True):
    """A mode whose draws are numbered: theta is side, sweep, walker."""
    sweep, ensemble, walker = np.meshgrid(*(np.arange(k) for k in (sweeps, 4, walkers)), indexing="ij")
    theta = np.stack([np.full(sweep.shape, side), sweep, ensemble * walkers + walker], axis=-1).astype(float)
    good = Diagnostics(np.full(1, 1.0 + 0.001 * side), np.full(1, 500.0 + side), np.full(1, 600.0))
    draws = Draws(theta, -theta[..., 1:2], 2.0 * theta, theta[..., 1], good, good, converged, 2.0)
    mass = MarginalLikelihood(0.0, 0.1, 0.0, 1, 0.1)
    return SampledMode(Mode(theta[0, 0, 0], np.ones(1, dtype=int), 0.0), draws, mass, weight)


@pytest.mark.parametrize(
    ("weights", "sweeps"),
    [
        ((0.9, 0.1), (24, 36)),
        ((0.985, 0.015), (24, 24)),
        ((0.5, 0.3, 0.2), (81, 24, 36)),
        ((0.994, 0.0055, 5e-4), (9, 9, 9)),
    ],
)
def test_pooled_draws_hold_each_mode_in_proportion(weights, sweeps):
    modes = tuple(given(weight, k, d) for k, (weight, d) in enumerate(zip(weights, sweeps, strict=True)))
    pooled = pool(modes)
    side = pooled.theta[..., 0]
    for k, weight in enumerate(weights):
        wanted = weight if weight > 1e-3 else 0.0
        assert np.mean(side == k) == pytest.approx(wanted / sum(w for w in weights if w > 1e-3), abs=2.0 / side.size)
        each = np.sum(side == k, axis=0)
        assert np.ptp(each) <= 1  # of every walker alike
        assert np.ptp(each.sum(axis=1)) <= 4
        if each.min() >= 2:  # early sweeps and late ones
            taken = np.where(side == k, pooled.theta[..., 1], np.nan)
            assert np.all(np.abs(np.nanmean(taken, axis=0) - 0.5 * (sweeps[k] - 1)) <= 0.5 * sweeps[k] / each + 0.5)
            counts = np.unique(pooled.theta[side == k], axis=0, return_counts=True)[1]
            assert counts.max() <= 2
    assert np.all(pooled.theta[..., 2] == np.arange(32).reshape(4, 8))  # a walker stays in its place
    assert np.array_equal(pooled.beta, 2.0 * pooled.theta)
    assert np.array_equal(pooled.log_scale[..., 0], -pooled.theta[..., 1])
    assert np.array_equal(pooled.log_density, pooled.theta[..., 1])
    assert pooled.theta.shape[0] >= 0.9 * min(d / w for d, w in zip(sweeps, weights, strict=True) if w > 1e-3)


def test_pooled_diagnostics_are_the_worst():
    pooled = pool((given(0.7, 0, 24), given(0.3, 1, 24, converged=False)))
    assert not pooled.converged
    assert pooled.diagnostics.max_rhat == pytest.approx(1.001)
    assert pooled.diagnostics.min_ess == 500.0
    assert pooled.seconds == 4.0
    assert pool((given(1.0, 0, 24),)).converged


# ---------------------------------------------------------------------------------------------------------------
# Information of an earlier log
# ---------------------------------------------------------------------------------------------------------------
SHORT = Sampling(walkers=4, budget=0.0)


def test_an_earlier_log_counts_as_if_its_segments_were_there():
    common = {
        "joint": (0, 1, 1, 0, 1),
        "sigma": (0.6, 1.1),
        "time": (1.5, 2.5),
        "mean": (0.1, 0.4, -0.2),
        "sd": (0.8, 1.2, 1.0),
        "cone": Cone.free(1) + Cone.orthant(2),
        "projection": [[1.0, 0.0, 0.5], [0.0, 1.0, -2.0]],
    }
    log = make_log((0.7, 0.5, 0.2), rows=(5, 7, 4, 6, 5), known=(0, 1, 0, 1, 0), seed=11, **common)
    earlier = make_log((0.7, 0.5, 0.2), rows=(9, 3, 8, 5, 6), known=(1,) * 5, seed=12, **common)
    noise = infer_from(log, options=SHORT).noise
    scaled = earlier.moments.scaled(noise.sigma * np.sqrt(noise.autocorrelation))
    known = Information(scaled.hessian.total(), earlier.known @ scaled.gradient, float(scaled.energy.sum()))
    target = infer_from(replace(log, earlier=known), options=SHORT).target
    joined = make_likelihood(
        log.moments.join(earlier.moments), log.coefficients, noise.sigma, noise.autocorrelation, np.zeros(10, dtype=int)
    )
    theta = np.random.default_rng(2).standard_normal((50, 3))
    theta[:, 1:] = np.abs(theta[:, 1:])
    points = np.hstack([theta, np.zeros((50, 2))])
    differences, exact = (np.diff(density.log_density(points)) for density in (target, Target(target.prior, joined)))
    assert np.allclose(differences, exact, rtol=1e-9, atol=1e-9)
    without = np.diff(replace(target, information=None).log_density(points))
    assert np.abs(differences - without).max() > 10.0


def test_the_draws_are_the_closed_form_of_both_logs():
    """Two free parameters and all signs known: normal given the noise scale, which a sum over a grid integrates out."""
    log = make_log(
        (1.0, -0.6), rows=(4, 5), known=(1, 1), mean=(0.3, 0.1), sd=(0.9, 1.4), sigma=(0.8,), seed=21, time=(1.4,)
    )
    log = replace(log, sigma=np.array([0.5]))  # the noise is larger than its reference
    rng = np.random.default_rng(3)
    rows = rng.standard_normal((5, 2)) + np.array([1.2, -0.4])
    log = replace(log, earlier=information_of(rows, rows @ np.array([0.2, 0.5]) + rng.standard_normal(5)))
    posterior = infer_from(log)
    assert posterior.converged

    columns, effort = (np.concatenate(parts) for parts in zip(*log.rows, strict=True))
    effort = np.repeat(log.known, [len(e) for _, e in log.rows]) * effort
    unit = posterior.noise.sigma[0] ** 2 * 1.4
    assert unit == pytest.approx(0.5**2 * 1.4, rel=1e-4)
    fence, mean = np.diag(1.0 / log.nominal.sd**2), log.nominal.mean
    grid, logs, centres, squares = np.linspace(-1.5, 2.5, 2001), [], [], []
    for u in grid:
        weight = np.exp(-2.0 * u) / unit
        precision = weight * columns.T @ columns + log.earlier.hessian + fence
        pull = weight * columns.T @ effort + log.earlier.gradient + fence @ mean
        covariance = np.linalg.inv(precision)
        centre = covariance @ pull
        logs.append(
            0.5 * pull @ centre
            + 0.5 * np.linalg.slogdet(covariance)[1]
            - 0.5 * weight * effort @ effort
            - len(effort) / 1.4 * u
            - 0.5 * (u / LOG_SCALE_SD) ** 2
        )
        centres.append(centre)
        squares.append(covariance + np.outer(centre, centre))
    share = np.exp(np.array(logs) - max(logs))
    share /= share.sum()
    mean, square = share @ np.array(centres), np.tensordot(share, np.array(squares), 1)

    draws = posterior.draws.theta
    assert np.all(np.abs(posterior.theta - mean) < 4.5 * errors(posterior, draws))
    products = (draws - mean)[..., :, None] * (draws - mean)[..., None, :]
    wanted = square - np.outer(mean, mean)
    assert np.all(np.abs(products.mean(axis=(0, 1, 2)) - wanted) < 4.5 * errors(posterior, products))
    scale = posterior.draws.log_scale[..., 0]
    assert abs(scale.mean() - share @ grid) < 4.5 * errors(posterior, scale)
    without = infer_from(replace(log, earlier=None))
    assert np.all(np.abs(without.theta - mean) > 20.0 * errors(without, without.draws.theta))


def test_an_earlier_log_weighs_two_modes_as_quadrature_weighs_them():
    log = near_symmetric(0.4)
    rows = np.array([[0.7, 0.2], [-0.3, 0.9]])
    log = replace(log, earlier=information_of(rows, np.array([-0.8, 1.0])))
    axes = (cells(-3.2, 3.2, 100), cells(0.0, 1.6, 40), cells(-0.9, 1.2, 16), cells(-1.2, 1.9, 16))
    exact, alone = Enumerated(log, *axes), Enumerated(replace(log, earlier=None), *axes)
    share, other = (case.weight[case.theta[:, 0] > 0.0].sum() for case in (exact, alone))
    assert 0.05 < share < 0.4
    assert other > 0.5  # the earlier log has turned the odds
    posterior = infer_from(log)
    assert posterior.converged
    assert len(posterior.modes) == 2
    of_plus = next(sampled.weight for sampled in posterior.modes if sampled.mode.theta[0] > 0.0)
    doubt = np.hypot(*(sampled.marginal_likelihood.standard_error for sampled in posterior.modes))
    assert abs(np.log(of_plus / (1.0 - of_plus)) - np.log(share / (1.0 - share))) < 4.5 * doubt
    assert doubt < 0.15
    assert np.allclose(posterior.plus, exact.plus, atol=0.03 + 4.5 * doubt * share * (1.0 - share))


@pytest.mark.parametrize(("ratio", "decided"), [(8.0, False), (10.5, True)])
def test_what_only_an_earlier_log_shows_is_decided_by_data(ratio, decided):
    log = make_log(
        (0.9, 0.5, -0.8),
        rows=(30, 40, 20),
        known=(1, 0, 0),
        sigma=(0.3,),
        sees=((1.0, 0.0, 0.4),),
        mean=(0.5, 0.2, 0.0),
        sd=(1.0, 0.4, 1.5),
    )
    without = infer_from(log, options=SHORT)
    assert np.array_equal(without.decided_by_data, [True, False, True])
    precision = ratio / 0.4**2
    known = Information(np.diag([0.0, precision, 0.0]), np.array([0.0, 3.0 * precision, 0.0]), 9.0 * precision)
    posterior = infer_from(replace(log, earlier=known), options=replace(SHORT, walkers=64))
    assert np.array_equal(posterior.decided_by_data, [True, decided, True])
    assert posterior.theta[1] == pytest.approx((3.0 * ratio + 0.2) / (ratio + 1.0), abs=0.05)
    assert posterior.parameter_sd[1] == pytest.approx(0.4 / np.sqrt(ratio + 1.0), rel=0.15)


def test_modes_and_sizes_rest_on_the_information_of_an_earlier_log():
    log = make_log((1.0, 0.8, 30.0), rows=(8, 9), known=(1, 1), sigma=(0.4,), sees=((1.0, 0.5, 0.0),), seed=2)
    free = Nominal(np.array([0.0, 0.0, np.nan]), np.array([1.0, 2.0, np.nan]))  # nothing is stated of the third
    rows = np.array([[0.5, 3.0, 0.4], [0.0, -1.0, 2.0], [1.0, 0.0, 5.0]])
    earlier = information_of(rows, rows @ np.array([1.0, 0.8, 30.0]) + np.array([0.3, -0.2, 0.1]))
    log = replace(log, nominal=free, earlier=earlier)
    problem = problem_of(log).with_least_noise()
    moments, solver = problem.scaled_moments, problem.solver
    posterior = infer_from(log, replace(log, earlier=None).search(), SHORT)
    both = replace(log, sigma=posterior.noise.sigma).solver  # for the moments and what is known, added
    gradient = log.known @ moments.gradient + log.earlier.gradient
    hessian = moments.hessian.total() + log.earlier.hessian
    solution = solver.prepared().solve_precisely(gradient)
    assert np.allclose(solution.theta, np.linalg.solve(hessian, gradient), rtol=1e-4)
    assert solver.regularisation(solution.theta) == pytest.approx(both.regularisation(solution.theta), rel=1e-5)
    curvature = np.sum(rows[:, 2] ** 2)
    assert posterior.target.prior.sd[2] == pytest.approx(np.sqrt(log.earlier.energy / curvature))
    assert posterior.decided_by_data[2]


@pytest.mark.parametrize("make", [nonnegative, near_symmetric])
def test_information_of_nothing_changes_no_bit(make):
    log = make()
    options = Sampling(walkers=8, most_sweeps=30)
    runs = [
        infer_from(replace(log, earlier=known), options=options)
        for known in (None, Information.none(len(log.projection)))
    ]
    for name in ("theta", "log_scale", "beta", "log_density"):
        assert np.array_equal(*(getattr(run.draws, name) for run in runs))
    assert [sampled.weight for sampled in runs[0].modes] == [sampled.weight for sampled in runs[1].modes]
    assert np.array_equal(runs[0].branch_mass, runs[1].branch_mass)


# ---------------------------------------------------------------------------------------------------------------
# Seed and budget
# ---------------------------------------------------------------------------------------------------------------
def test_the_seed_decides_the_draws():
    log = near_symmetric(0.6)
    search = log.search()
    runs = [infer_from(log, search, Sampling(walkers=8, seed=seed)) for seed in (1, 1, 2)]
    for name in ("theta", "log_scale", "beta", "log_density"):
        first, same, other = (getattr(run.draws, name) for run in runs)
        assert np.array_equal(first, same)
        assert first.shape != other.shape or not np.array_equal(first, other)
    assert [sampled.weight for sampled in runs[0].modes] == [sampled.weight for sampled in runs[1].modes]
    assert runs[0].modes[0].weight != runs[2].modes[0].weight
    assert np.array_equal(runs[0].plus, runs[1].plus)


@pytest.mark.parametrize("lean", [0.6, 12.0])
def test_no_time_at_all_is_said_and_gives_finite_results(lean):
    calls = []
    posterior = infer_from(
        near_symmetric(lean), options=Sampling(walkers=4, budget=0.0), progress=Progress(lambda *all: calls.append(all))
    )
    assert len(posterior.modes) == (2 if lean < 5.0 else 1)
    assert not posterior.converged
    assert not posterior.draws.converged
    assert all(sampled.draws.sweeps == 8 for sampled in posterior.modes)  # what is kept however little time there is
    assert sum(stage.startswith("posterior") and done == 8 for stage, done, _ in calls) == len(posterior.modes)
    values = [
        posterior.theta,
        posterior.covariance,
        posterior.parameter_sd,
        posterior.plus,
        posterior.branch_mass,
        *posterior.interval(0.95),
        *posterior.spread(),
        posterior.draws.log_density,
    ]
    assert all(np.all(np.isfinite(value)) for value in values)
    assert sum(sampled.weight for sampled in posterior.modes) == pytest.approx(1.0)
    assert 0.0 <= posterior.elsewhere <= 1.0


def test_modes_share_the_budget(monkeypatch):
    budgets = []

    def short(target, theta, sampling, steps, leave):
        budgets.append(sampling.budget)
        return sample(target, theta, replace(sampling, budget=0.0), steps, leave)

    monkeypatch.setattr(sampled_modes, "sample", short)
    posterior = infer_from(near_symmetric(0.6), options=Sampling(walkers=4, budget=1e4))
    assert len(posterior.modes) == 2
    assert budgets[0] == pytest.approx(5e3, rel=0.01)
    assert budgets[1] == pytest.approx(1e4, rel=0.01)  # what remains after the first


class Work:
    """A clock that goes on by work alone: a sweep of half of the walkers is half a second."""

    def __init__(self, monkeypatch, diagnosis, mass):
        self.now = 0.0
        for module in (inference, sampled_modes, sampler, marginal_likelihood):
            monkeypatch.setattr(module, "time", self)
        monkeypatch.setenv("OMP_NUM_THREADS", "1")  # copies of the process have clocks of their own
        self.costs(monkeypatch, moves.NoiseScales, "update", lambda move, coordinates, random: 0.5)
        self.costs(monkeypatch, sampler, "diagnose", lambda draws: diagnosis * (len(draws) + 6.0) * draws.shape[-1] / 3)
        self.costs(monkeypatch, sampled_modes, "integrate", lambda *given: mass)

    def perf_counter(self):
        return self.now

    def costs(self, monkeypatch, owner, name, price):
        plain = getattr(owner, name)

        def working(*given):
            result, began = plain(*given), self.now
            self.now += price(*given)
            return replace(result, seconds=self.now - began) if isinstance(result, MarginalLikelihood) else result

        monkeypatch.setattr(owner, name, working)


NEVER = replace(FEW, walkers=4, max_rhat=0.9)  # converged


@pytest.mark.parametrize("lean", [0.6, 12.0])
@pytest.mark.parametrize(("diagnosis", "mass"), [(0.1, 20.0), (0.4, 70.0), (0.8, 40.0)])
@pytest.mark.parametrize("budget", [300.0, 1000.0])
def test_the_time_asked_for_is_the_time_used(monkeypatch, lean, diagnosis, mass, budget):
    log = near_symmetric(lean)
    search, work = log.search(), Work(monkeypatch, diagnosis, mass)
    posterior = infer_from(log, search, replace(NEVER, budget=budget))
    assert len(posterior.modes) == (2 if lean < 5.0 else 1)
    assert not posterior.converged
    assert posterior.seconds == work.now
    assert posterior.seconds == pytest.approx(budget, rel=0.2)
    sweeps = [sampled.draws.sweeps for sampled in posterior.modes]
    assert max(sweeps) < 4.0 * min(sweeps)


def test_what_has_converged_does_not_depend_on_the_time(monkeypatch):
    log = near_symmetric(0.6)
    search, options = log.search(), Sampling(walkers=8, seed=1)
    usual = infer_from(log, search, options)
    assert usual.converged
    Work(monkeypatch, 0.2, 50.0)
    other = infer_from(log, search, replace(options, budget=1e5))
    for name in ("theta", "log_scale", "log_density"):
        assert np.array_equal(getattr(usual.draws, name), getattr(other.draws, name))
    assert [sampled.weight for sampled in usual.modes] == [sampled.weight for sampled in other.modes]


# ---------------------------------------------------------------------------------------------------------------
# What is read off the draws
# ---------------------------------------------------------------------------------------------------------------
def test_what_the_data_decide():
    # the first and the third parameter show in their sum alone; the fourth not at all
    log = make_log(
        (1.0, -0.7, 0.8, 0.5),
        rows=(30, 40, 30),
        known=(1, 0, 0),
        sd=(1.0, 0.5, 2.0, 0.1),
        mean=(0.5, 0.0, 0.5, 0.5),
        sigma=(0.3,),
        projection=[[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0]],
    )
    posterior = infer_from(log, options=Sampling(walkers=4, budget=0.0))
    assert np.array_equal(posterior.decided_by_data, [False, True, False, False])


@pytest.mark.parametrize(("ratio", "decided"), [(8.0, False), (10.5, True)])
def test_nine_tenths_of_the_precision_decide(ratio, decided):
    log = make_log((1.0,), rows=(30, 40), known=(1, 1), sigma=(2.0,), time=(3.0,), mean=(1.0,))
    information = sum(np.sum(y**2) for y, _ in log.rows) / (4.0 * 3.0)
    posterior = infer_from(log, options=Sampling(walkers=4, budget=0.0))
    scale = np.exp(-2.0 * posterior.draws.log_scale.mean())
    log = replace(log, nominal=replace(log.nominal, sd=np.sqrt([ratio / (information * scale)])))
    posterior = infer_from(log, options=Sampling(walkers=4, budget=0.0))
    ratio_of_precisions = information * np.exp(-2.0 * posterior.draws.log_scale.mean()) * log.nominal.sd[0] ** 2
    assert (ratio_of_precisions > 9.0) == decided
    assert bool(posterior.decided_by_data[0]) == decided


def numbered(sweeps, ensembles=4, walkers=16):
    """A posterior whose draws are numbers, two parameters and one coefficient."""
    sweep, place = np.meshgrid(np.arange(sweeps), np.arange(ensembles * walkers), indexing="ij")
    theta = np.stack([sweep, place], axis=-1).astype(float).reshape(sweeps, ensembles, walkers, 2)
    projection = np.array([[1.0, 10.0], [0.5, -1.0]])
    zero = np.zeros((1, 2, 2)), np.zeros(1), np.ones(1), np.zeros((1, 2)), np.zeros(1, dtype=int)
    likelihood = Likelihood(projection, *zero, np.zeros(1, dtype=int), np.ones(1))
    prior = Prior(whole_space(2), np.zeros(2), np.ones(2), np.full(1, LOG_SCALE_SD), np.zeros(2))
    log_scale = theta @ np.array([[0.0], [1e-3]]) + 1.0
    none = Diagnostics(np.ones(1), np.ones(1), np.ones(1))
    draws = Draws(theta, log_scale, theta @ projection.T, theta[..., 0], none, none, True, 1.0)
    mode = SampledMode(Mode(np.zeros(2), np.ones(1, dtype=int), 0.0), draws, None, 1.0)
    return Posterior(Target(prior, likelihood), None, None, (mode,), draws, np.ones(1), np.empty(0), None, 1.0, FEW)


@pytest.mark.parametrize("sweeps", [8, 23, 24, 46, 51, 85, 255, 300, 510])
@pytest.mark.parametrize("count", [24, 256])
def test_spread_draws_come_from_all_sweeps_and_walkers_alike(sweeps, count):
    posterior = numbered(sweeps)
    theta, log_scale = posterior.spread(count)
    assert theta.shape == (count, 2)
    assert log_scale.shape == (count, 1)
    assert np.allclose(log_scale[:, 0], 1.0 + 1e-3 * theta[:, 1])
    assert len(np.unique(theta, axis=0)) == count
    for values, size, parts in ((theta[:, 0], sweeps, 8), (theta[:, 1], 64, 4), (theta[:, 1], 64, 8)):
        counted = np.bincount((values * parts / size).astype(int), minlength=parts)
        assert np.all(np.abs(counted - count / parts) <= 0.35 * count / parts)
    early = theta[:, 0] < 0.5 * sweeps
    assert abs(np.mean(theta[early, 1]) - np.mean(theta[~early, 1])) < 10.0


def test_spread_of_more_than_there_are_is_all_of_them():
    posterior = numbered(3, ensembles=2, walkers=5)
    theta, log_scale = posterior.spread(1000)
    assert len(theta) == 30
    assert {tuple(row) for row in theta} == {tuple(row) for row in posterior.draws.theta.reshape(-1, 2)}
    assert len(posterior.spread(7)[0]) == 7
    assert len(numbered(8).spread()[0]) == 256


def test_figures_of_the_draws():
    posterior = numbered(11)
    sweep, place = (values.ravel() for values in np.meshgrid(np.arange(11.0), np.arange(64.0)))
    assert np.allclose(posterior.theta, [5.0, 31.5])
    assert np.allclose(posterior.parameter_sd, [sweep.std(), place.std()])
    a, b = np.var(sweep), np.var(place)  # independent by their make
    covariance = np.array([[a + 100.0 * b, 0.5 * a - 10.0 * b], [0.5 * a - 10.0 * b, 0.25 * a + b]])
    assert np.allclose(posterior.covariance, covariance * 704 / 703)
    beta = np.stack([sweep + 10.0 * place, 0.5 * sweep - place])
    low, high = posterior.interval(0.8)
    for ends, share in ((low, 0.1), (high, 0.9)):
        assert np.allclose([np.mean(values < end) for values, end in zip(beta, ends, strict=True)], share, atol=0.02)


def test_one_coefficient_has_a_covariance_matrix():
    posterior = infer_from(nonnegative(), options=Sampling(walkers=4, budget=0.0))
    assert posterior.covariance.shape == (1, 1)
    assert posterior.covariance[0, 0] == pytest.approx(np.var(posterior.draws.beta, ddof=1))
    low, high = posterior.interval(0.9)
    assert low.shape == high.shape == (1,)
    assert np.mean((posterior.draws.beta > low) & (posterior.draws.beta < high)) == pytest.approx(0.9, abs=0.02)


@pytest.mark.parametrize(("mean", "from_zero"), [(-1.0, True), (0.3, True), (8.0, False)])
def test_a_coefficient_that_cannot_be_negative_has_the_shortest_interval(mean, from_zero):
    """Normal draws cut at zero; far from it the shortest interval is the central one, of the free one it always is."""
    posterior = normal_draws(np.eye(2), cone=Cone.orthant(1) + Cone.free(1))
    drawn = truncnorm.rvs(-mean, np.inf, loc=mean, size=(400, 4, 16), random_state=1)
    beta = np.stack([drawn, drawn], axis=-1)
    posterior = replace(posterior, draws=replace(posterior.draws, theta=beta, beta=beta))
    low, high = posterior.interval(0.95)
    assert (low[0] == 0.0) == from_zero
    np.testing.assert_allclose([low[1], high[1]], np.quantile(drawn, [0.025, 0.975]))
    share = norm.sf(0.0, mean)
    expected = mean + norm.isf(0.05 * share) if from_zero else mean + norm.isf(0.025)
    assert high[0] == pytest.approx(expected, abs=0.06)


def test_what_a_model_may_lack_widens_by_the_closed_form():
    """A normal posterior: theta moves by Cov(theta, beta) H e; nothing else moves."""
    plain = normal_draws(np.array([[2.0, 0.6], [0.6, 0.5]]))
    information = np.linalg.inv(plain.covariance_of_log)
    lacking = np.array([[3.0, -1.1], [-1.1, 0.7]])
    wide = widened(plain, information, lacking)
    error = 4.5 * np.sqrt(2.0 / plain.draws.log_density.size) * np.array([[5.0, 3.0], [3.0, 1.5]])
    assert np.all(np.abs(wide.covariance - plain.covariance - lacking) < error)
    np.testing.assert_array_equal(wide.theta, plain.theta)
    np.testing.assert_array_equal(wide.covariance_of_log, plain.covariance_of_log)
    assert np.all(wide.parameter_sd > 1.2 * plain.parameter_sd)
    np.testing.assert_array_equal(widened(plain, information, lacking).shift, wide.shift)


def test_what_a_model_may_lack_is_no_less_in_a_corner_of_the_cone():
    """The mean lies on a wall that half of the draws would have to cross: the spread is that of the closed form."""
    plain = normal_draws(np.array([[2.0, 0.6], [0.6, 0.5]]))
    wall = Region(np.array([[1.0, 1.0]]), np.array([2.0]), np.empty((10, 0, 2)), np.empty((10, 0)))
    target = replace(plain.target, prior=replace(plain.target.prior, region=wall, inside=np.array([5.0, 5.0])))
    lacking = np.array([[3.0, -1.1], [-1.1, 0.7]])
    wide = widened(replace(plain, target=target), np.linalg.inv(plain.covariance_of_log), lacking)
    error = 4.5 * np.sqrt(2.0 / plain.draws.log_density.size) * np.array([[5.0, 3.0], [3.0, 1.5]])
    assert np.all(np.abs(wide.covariance - plain.covariance - lacking) < error)
    assert np.all(np.abs(wide.shift.mean(axis=(0, 1, 2))) < 4.5 * np.sqrt(np.diag(lacking) / wide.shift[..., 0].size))


def test_what_a_model_may_lack_leaves_no_friction_below_zero():
    """The second parameter cannot be negative; the first is as free as ever."""
    log = near_symmetric(0.6)
    posterior = infer_from(log, options=Sampling(walkers=8, budget=0.0))
    information = np.diag([50.0, 50.0])
    wide = widened(posterior, information, np.diag([0.09, 4.0]))
    assert np.all(wide.uncertain.theta[..., 1] >= 0.0)
    assert np.any(wide.uncertain.theta[..., 1] == 0.0)
    assert np.all(posterior.uncertain.theta == posterior.draws.theta)
    of_mode = wide.mode_of_draws == 0
    assert np.all(np.sign(wide.draws.theta[of_mode][:, 0]) == np.sign(wide.theta[0]))
    assert wide.shift[..., 1].std() > 0.0


def test_what_efforts_show_in_sums_alone_gives_way_on_both_sides():
    """One coefficient a + 2 m, of a mass near zero: kept there, it would let the sum move to one side only."""
    plain = normal_draws(np.array([[2.0, -0.9], [-0.9, 0.5]]), cone=Cone.free(1) + Cone.orthant(1))
    sums = np.array([[1.0, 2.0]])
    likelihood = replace(plain.target.likelihood, projection=sums, hessian=np.zeros((1, 1, 1)))
    theta = np.abs(plain.draws.theta - [0.0, -3.0])
    draws = replace(plain.draws, theta=theta, beta=theta @ sums.T)
    target, modes = replace(plain.target, likelihood=likelihood), (replace(plain.modes[0], draws=draws),)
    plain = replace(plain, target=target, draws=draws, modes=modes)
    wide = widened(plain, np.linalg.inv(plain.covariance_of_log), np.array([[9.0]]))
    shift = (wide.uncertain.beta - plain.draws.beta).ravel()
    assert np.any(wide.uncertain.theta[..., 1] < 0.0)
    assert abs(shift.mean()) < 4.5 * 3.0 / np.sqrt(shift.size)
    assert shift.std() == pytest.approx(3.0, rel=4.5 / np.sqrt(2.0 * shift.size))


def normal_draws(covariance, cone=None):
    """A posterior of two free parameters whose draws are normal, and are the coefficients."""
    posterior = numbered(40)
    theta = np.random.default_rng(5).multivariate_normal([1.0, -3.0], covariance, size=(400, 4, 16))
    projection = np.eye(2)
    zeros = np.zeros((1, 2, 2)), np.zeros(1), np.ones(1), np.zeros((1, 2)), np.zeros(1, dtype=int)
    likelihood = Likelihood(projection, *zeros, np.zeros(1, dtype=int), np.ones(1))
    draws = replace(posterior.draws, theta=theta, beta=theta, log_density=theta[..., 0], log_scale=theta[..., :1])
    mode = replace(posterior.modes[0], draws=draws)
    target = replace(posterior.target, likelihood=likelihood)
    if cone is not None:
        target = replace(target, prior=replace(target.prior, region=Region.of(cone), inside=np.ones(2)))
    return replace(posterior, target=target, draws=draws, modes=(mode,))


def test_the_mean_of_two_modes_on_an_edge_is_inside():
    log = near_symmetric(0.6)
    log = replace(log, nominal=replace(log.nominal, mean=np.array([0.6, -3.0]), sd=np.array([2.0, 0.3])))
    posterior = infer_from(log, options=Sampling(walkers=4, budget=0.0))
    region = posterior.target.prior.region
    assert region.contains(posterior.theta[:, None])[0]
    assert np.all(region.contains(posterior.spread()[0].T))
    assert posterior.theta[1] < 3.0 * posterior.parameter_sd[1]  # near the edge
