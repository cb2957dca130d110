from dataclasses import replace

import numpy as np
import pytest
from posterior_logs import FEW, Enumerated, cells, errors, infer_from, make_log, near_symmetric, nonnegative, unproven
from scipy.special import expit

from bayesid.errors import InputError
from bayesid.posterior.modes import MarginalLikelihood, Mode, SampledMode, pool
from bayesid.posterior.sampler import Diagnostics, Draws, Sampling, nominal_sweep
from bayesid.progress import Progress
from bayesid.signs.search.beam import beam
from bayesid.signs.search.protocol import Assignment, SearchResult


def listing(log, assignments, decided):
    """A search result that lists these assignments (B, S) and decides the same segments (S,) in each."""
    prepared, gradient = log.solver.prepared(), log.scaled.gradient
    branches = tuple(Assignment(signs, prepared.solve(signs @ gradient).theta, 0.0, 0.0) for signs in assignments)
    figures = 0.0, "given", None, True, 0.0, 0, 0, 0.0, 0.0, branches, 1.0, 1e-3, decided
    return SearchResult(assignments[0], branches[0].theta, *figures, np.tile(decided, (len(branches), 1)))


def sign_odds(log, posterior):
    """(D, E, W, S) P(sign = +) at each draw, from the rows."""
    pull = np.array([y.T @ e for y, e in log.rows]) / (log.sigma**2 * log.time)[log.joint, None]
    return expit(2.0 * posterior.draws.beta @ pull.T * np.exp(-2.0 * posterior.draws.log_scale[..., log.joint]))


def mass_at_draws(log, posterior, signs, where):
    odds = sign_odds(log, posterior)[..., where]
    return np.where(signs[where] > 0, odds, 1.0 - odds).prod(axis=-1)


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
    fixed = np.zeros(len(log.known), dtype=bool)
    fixed[np.flatnonzero(unknown)[0]] = True
    chosen = [k for k in order if exact.signs[k][fixed] == exact.signs[order[0]][fixed]]
    chosen = [order[0], *[k for k in chosen if np.sum(exact.signs[k] != exact.signs[order[0]]) == 1][:2]]
    listed = exact.signs[chosen]
    decided = fixed | np.any(listed != listed[0], axis=0)
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


def test_leaves_of_a_beam_have_the_masses_of_a_certified_list():
    """Leaves with equal signs in the segments that a branch decides have the branch's mass together."""
    log = replace(doubtful(9), sigma=np.array([0.5]))
    certified = log.search()
    by_beam = replace(certified, **vars(beam(log.scaled, log.solver, width=None)))
    ours, theirs = infer_from(log, by_beam), infer_from(log, certified)
    assert len(by_beam.branches) >= len(certified.branches) > 2
    for branch, decided, mass in zip(certified.branches, certified.decided, theirs.branch_mass, strict=True):
        alike = [np.array_equal(leaf.signs[decided], branch.signs[decided]) for leaf in by_beam.branches]
        error = errors(theirs, mass_at_draws(log, theirs, branch.signs, decided & (log.known == 0)))
        assert abs(ours.branch_mass[alike].sum() - mass) < 4.5 * np.sqrt(2.0) * error + 2e-3  # leaves of less mass
    assert ours.posterior_conflict is None, "a beam excludes nothing"
    assert ours.elsewhere == pytest.approx(1.0 - ours.branch_mass.sum(), abs=1e-12)


def test_without_a_list_assignments_have_no_mass():
    log = doubtful()
    posterior = infer_from(log, unproven(log.search()), replace(FEW, budget=0.0))
    assert posterior.branch_mass.shape == (0,)
    assert posterior.elsewhere is None


def test_two_modes_are_weighed_as_quadrature_weighs_them():
    log = near_symmetric(-2.5)
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
    model_error_probability = np.hypot(
        first.marginal_likelihood.standard_error, second.marginal_likelihood.standard_error
    )
    assert abs(log_odds - np.log(share / (1.0 - share))) < 4.5 * model_error_probability
    assert model_error_probability < 0.15

    pooled = posterior.draws.theta
    assert np.mean(pooled[..., 0] > 0.0) == pytest.approx(of_plus, abs=2.0 / pooled[..., 0].size)
    _, mean, _ = exact.moments_where(slice(None))
    apart, both = mean_plus - mean_minus, share * (1.0 - share)
    shares, sds = np.array([share, 1.0 - share])[:, None], np.array([sd_plus, sd_minus])
    worst = min(sampled.draws.diagnostics.min_ess / sampled.draws.log_density.size for sampled in posterior.modes)
    effective = worst * shares * pooled[..., 0].size
    within = np.sqrt(np.sum((shares * sds) ** 2 / effective, axis=0))
    pooled_mean = posterior.draws.theta.mean(axis=(0, 1, 2))
    assert np.all(np.abs(pooled_mean - mean) < 4.5 * np.hypot(model_error_probability * both * np.abs(apart), within))
    np.testing.assert_array_equal(posterior.theta, first.draws.theta.mean(axis=(0, 1, 2)))  # no point between
    about_theta = posterior.draws.theta - posterior.theta
    np.testing.assert_allclose(posterior.parameter_sd**2, np.mean(about_theta**2, axis=(0, 1, 2)), rtol=1e-9)
    about_beta = (posterior.draws.beta - first.draws.beta.mean(axis=(0, 1, 2))).reshape(-1, 2)
    np.testing.assert_allclose(posterior.covariance, about_beta.T @ about_beta / len(about_beta), rtol=2e-3)
    assert posterior.flipped_joints(0) == ()
    assert posterior.flipped_joints(1) == (1,)
    assert posterior.flipped_joints(0, -first.mode.signs) == (1,)
    of_draws = posterior.mode_of_draws
    np.testing.assert_array_equal(np.sign(pooled[..., 0]) == np.sign(first.mode.theta[0]), of_draws == 0)
    assert np.mean(of_draws) == pytest.approx(second.weight, abs=2.0 / of_draws.size)

    odds = sign_odds(log, posterior)[..., :3]
    assert np.all(np.abs(posterior.plus[:3] - odds.mean(axis=(0, 1, 2))) < 4.5 * odds.std(axis=(0, 1, 2)) / 32.0)
    assert np.all(
        np.abs(posterior.plus[:3] - exact.plus[:3])
        < 4.5 * (model_error_probability * both + odds.std(axis=(0, 1, 2)) / 32.0)
    )
    assert np.ptp(exact.plus[:3]) > 0.3
    assert posterior.branch_mass.sum() + posterior.elsewhere == pytest.approx(1.0, abs=1e-12)
    assert posterior.max_rhat == max(sampled.draws.diagnostics.max_rhat for sampled in posterior.modes)
    assert posterior.min_ess == min(sampled.draws.diagnostics.min_ess for sampled in posterior.modes)


def test_another_mode_can_be_chosen():
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
    mass = MarginalLikelihood(0.0, 0.1)
    return SampledMode(Mode(theta[0, 0, 0], np.ones(1, dtype=int), 0.0), draws, mass, weight)


@pytest.mark.parametrize(
    ("weights", "sweeps"),
    [((0.985, 0.015), (24, 24)), ((0.5, 0.3, 0.2), (81, 24, 36)), ((0.994, 0.0055, 5e-4), (9, 9, 9))],
)
def test_pooled_draws_hold_each_mode_in_proportion(weights, sweeps):
    modes = tuple(given(weight, k, d) for k, (weight, d) in enumerate(zip(weights, sweeps, strict=True)))
    pooled = pool(modes)
    side, wanted = pooled.theta[..., 0], np.where(np.array(weights) > 1e-3, weights, 0.0)
    for k, share in enumerate(wanted / wanted.sum()):
        assert np.mean(side == k) == pytest.approx(share, abs=2.0 / side.size)
        each = np.sum(side == k, axis=0)
        assert np.ptp(each) <= 1  # of every walker alike
        if each.min() >= 2:  # early sweeps and late ones
            taken = np.where(side == k, pooled.theta[..., 1], np.nan)
            assert np.all(np.abs(np.nanmean(taken, axis=0) - 0.5 * (sweeps[k] - 1)) <= 0.5 * sweeps[k] / each + 0.5)
    assert np.all(pooled.theta[..., 2] == np.arange(32).reshape(4, 8))  # a walker stays in its place
    assert np.array_equal(pooled.beta, 2.0 * pooled.theta)
    assert np.array_equal(pooled.log_scale[..., 0], -pooled.theta[..., 1])
    assert np.array_equal(pooled.log_density, pooled.theta[..., 1])
    assert len(pooled.theta) >= 0.9 * min(d / w for d, w in zip(sweeps, weights, strict=True) if w > 1e-3)
    assert pooled.diagnostics.max_rhat == pytest.approx(1.0 + 0.001 * (len(weights) - 1))


def test_the_seed_decides_the_draws():
    log = near_symmetric(0.6)
    search = log.search()
    runs = [infer_from(log, search, Sampling(walkers=8, rng=seed)) for seed in (1, 1, 2)]
    for name in ("theta", "log_scale", "beta", "log_density"):
        first, same, other = (getattr(run.draws, name) for run in runs)
        assert np.array_equal(first, same)
        assert first.shape != other.shape or not np.array_equal(first, other)
    assert [sampled.weight for sampled in runs[0].modes] == [sampled.weight for sampled in runs[1].modes]
    assert runs[0].modes[0].weight != runs[2].modes[0].weight
    assert np.array_equal(runs[0].plus, runs[1].plus)


def test_a_zero_budget_is_reported_and_gives_finite_results():
    calls, options = [], Sampling(walkers=4, budget=0.0)
    found = infer_from(near_symmetric(0.6), options=options, progress=Progress(lambda *all: calls.append(all)))
    assert len(found.modes) == 2
    assert not found.converged
    assert not found.draws.converged
    assert all(sampled.draws.sweeps == 8 for sampled in found.modes)  # what is kept however little time there is
    sampled = [stage for stage, done, _ in calls if stage.partition(" of ")[0] == "sampling" and done == 8]
    assert len(sampled) == len(found.modes)
    values = [found.theta, found.covariance, found.plus, found.branch_mass, *found.interval(0.95), *found.spread()]
    assert all(np.all(np.isfinite(value)) for value in [*values, found.draws.log_density])
    assert sum(sampled.weight for sampled in found.modes) == pytest.approx(1.0)
    assert 0.0 <= found.elsewhere <= 1.0


NEVER = replace(FEW, walkers=4, max_rhat=0.9)  # converged


@pytest.mark.parametrize(("lean", "walkers", "sweeps"), [(0.6, 4, 400), (12.0, 4, 400), (0.6, 2048, 150)])
def test_the_work_stays_within_the_budget(lean, walkers, sweeps):
    """Shared by the modes, what weighs them included: at least 30 sweeps of all walkers for each."""
    log, sampling = near_symmetric(lean), replace(NEVER, walkers=walkers)
    search = log.search()
    target = infer_from(log, search, replace(NEVER, budget=0.0)).target
    sweep = nominal_sweep(target, sampling.ensembles * walkers)
    posterior = infer_from(log, search, replace(sampling, budget=sweeps * sweep))
    several = lean < 5.0
    assert len(posterior.modes) == (2 if several else 1)
    assert not posterior.converged
    assert not posterior.timed_out
    most = sweeps - 2 * 30 * several
    assert 0.75 * most < sum(sampled.draws.spent for sampled in posterior.modes) / sweep <= most
    made = [sampled.draws.sweeps for sampled in posterior.modes]
    assert max(made) <= 1.1 * min(made)
