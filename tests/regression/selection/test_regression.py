from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from dense_errors import Dense, covariance
from effect_problems import RATE, Made, observed
from scipy.integrate import simpson
from scipy.special import logsumexp
from scipy.stats import norm

from bayesid.regression.knowledge import InformationMatrix
from bayesid.regression.selection import fitted_effects as judging
from bayesid.regression.selection.columns import Columns
from bayesid.regression.selection.error_model import ErrorModel, fit_error
from bayesid.regression.selection.regression import Regression, explain
from bayesid.regression.selection.scores import best_forms

ERRORS = (ErrorModel(0.3, 0.5, 0.1, RATE), ErrorModel(1.1, 0.7, 0.3, RATE))


def noise(count, rng):
    """Cholesky."""
    return np.stack([np.linalg.cholesky(covariance(e, count)) @ rng.standard_normal(count) for e in ERRORS], axis=1)


def made_data(count=120, seed=0, gaps=True, amount=0.0):
    """Three coefficients, an earlier log about them, and a tenth of the samples unused in stretches."""
    rng = np.random.default_rng(seed)
    t = np.arange(count) / RATE
    waves = np.sin(np.multiply.outer(t, rng.uniform(1.0, 9.0, (2, 3))) + rng.uniform(0.0, 6.0, (2, 3)))
    used = np.ones((count, 2), dtype=bool)
    if gaps:
        used[30:38, 0] = used[70:75, 0] = used[:6, 1] = used[95:103, 1] = False
    root = rng.normal(size=(3, 5))
    hessian = 4.0 * root @ root.T
    centre = np.array([1.0, -2.0, 0.5])
    known = InformationMatrix(hessian, hessian @ centre, float(centre @ hessian @ centre) + 3.0)
    effort = waves @ np.array([1.2, -1.7, 0.4]) + noise(count, rng)
    for effect in made_effects(count):
        effort[:, 1] += amount * effect.rows[1].sum(axis=1) if effect.rows else 0.0
    return replace(observed(waves, effort, used), information=known)


def made_effects(count=120, seed=5):
    """Two amplitudes in both joints; one in the second; a shift in the first; both in both."""
    rng = np.random.default_rng(seed)
    t = np.arange(count) / RATE
    rows = [np.cos(np.multiply.outer(t, rng.uniform(1.0, 8.0, p)) + rng.uniform(0.0, 6.0, p)) for p in (2, 2, 1, 2, 2)]
    shift = [0.6 * np.tanh(np.sin(3.0 * t + phase)) for phase in (0.3, 1.9, 4.0)]
    free = np.zeros(2, dtype=bool)
    return (
        Columns({0: rows[0], 1: rows[1]}, {}, np.array([0.4, 1.1]), free),
        Columns({1: rows[2]}, {}, np.array([0.7]), free[:1]),
        Columns({}, {0: shift[0]}, np.zeros(0), free[:0]),
        Columns({0: rows[3], 1: rows[4]}, {0: shift[1], 1: shift[2]}, np.array([0.8, 0.3]), free),
    )


@pytest.fixture
def kept(monkeypatch):
    """Error models as they are: joints are recognised by which of their samples are used."""

    logs = []

    def as_given(residual, used, rate, limits=None):
        j = next(j for data in logs for j, mask in enumerate(data.used.T) if np.array_equal(mask, used))
        return ERRORS[j], ERRORS[j].log_likelihood(residual, used)

    def fixed(data):
        logs.append(data)
        monkeypatch.setattr(judging, "fit_error", as_given)
        return data

    return fixed


def explained(data, *columns):
    """By effects of some columns, samples weighed by the errors of the truth."""
    return Regression(data, [Made(one, ("made", ())) for one in columns], ERRORS).fitted_effects


@pytest.mark.parametrize("chosen", [(), (1, 3), (2, 0), (3, 2, 1, 0)])
def test_explanation_is_generalised_least_squares(chosen, kept):
    data, effects = kept(made_data()), made_effects()
    picked = [effects[k] for k in chosen]
    found = explained(data, *picked)
    best, spread = Dense(data, ERRORS).least_squares(picked)
    np.testing.assert_allclose(found.beta, best[:3], rtol=1e-7)
    np.testing.assert_allclose(np.concatenate([[], *found.amplitudes]), best[3:], rtol=1e-7)
    np.testing.assert_allclose(np.concatenate([[], *found.sd]), np.sqrt(np.diag(spread))[3:], rtol=1e-7)
    np.testing.assert_allclose(found.root.T @ found.root, spread, rtol=0, atol=1e-8 * spread.max())
    assert [len(one) for one in found.amplitudes] == [len(one.sd) for one in picked]
    left = Dense(data, ERRORS).effort(picked) - Dense(data, ERRORS).rows(picked) @ best
    for j, rows in enumerate(Dense(data, ERRORS).used):
        start = 0 if j == 0 else len(Dense(data, ERRORS).used[0])
        np.testing.assert_allclose(found.residual[rows, j], left[start : start + len(rows)], atol=1e-7)
        assert not found.residual[~data.used[:, j], j].any()


def test_evidences_differ_by_the_density_of_the_efforts(kept):
    """e ~ N(Y b0, C + Y L^-1 Y' + Z D Z'), dense; constants are common to all explanations."""
    data, effects = kept(made_data(amount=0.5)), made_effects()
    nothing = explained(data).log_evidence
    base = Dense(data, ERRORS).log_density()
    gains = []
    for picked in [(effects[0],), (effects[1],), (effects[2],), (effects[3],), effects[:2], effects[1:]]:
        gains.append(explained(data, *picked).log_evidence - nothing)
        assert gains[-1] == pytest.approx(Dense(data, ERRORS).log_density(picked) - base, abs=1e-6)
    assert np.ptp(gains) > 3.0


@pytest.mark.parametrize(
    ("positive", "amount", "tolerance"),
    [((False, False), 0.3, 1e-4), ((True, False), 0.3, 1e-4), ((True, False), -0.3, 1e-4), ((True, True), 0.3, 0.1)],
)
def test_evidence_of_two_amplitudes_is_the_integral(positive, amount, tolerance, kept):
    """Of two half-normals the probability to be positive is taken for each by itself, which is exact for one."""
    data, effect = kept(made_data(amount=amount)), replace(made_effects()[0], positive=np.array(positive))
    axes = [sd * np.linspace(0.0 if side else -5.0, 5.0, 161) for sd, side in zip(effect.sd, positive, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    density = Dense(data, ERRORS).log_likelihood_of(effect, grid) + norm(0.0, effect.sd).logpdf(grid).sum(axis=1)
    cells = np.exp(density - density.max()).reshape(161, 161)
    expected = np.log(simpson(simpson(cells, x=axes[1]), x=axes[0])) + density.max() + sum(positive) * np.log(2.0)
    nothing = Dense(data, ERRORS).log_likelihood_of(effect, np.zeros((1, 2)))
    gain = explained(data, effect).log_evidence - explained(data).log_evidence
    assert gain == pytest.approx(expected - nothing, abs=tolerance)


def test_the_residual_gets_its_own_likeliest_error_model():
    """As noise within the limits, or as anything, at the price of log N, whichever is likelier."""
    data = replace(made_data(300, gaps=False), limits=np.array([[0.2, 0.1], [9.0, 9.0]]))
    found = explained(data)
    for j, limits in enumerate(data.limits):
        error, value = fit_error(found.residual[:, j], data.used[:, j], RATE)
        assert found.errors[j] == error
        assert found.free_evidence[j] == pytest.approx(value - np.log(300))
        within = fit_error(found.residual[:, j], data.used[:, j], RATE, tuple(limits))[1]
        assert found.noise_evidence[j] == pytest.approx(value if j else within)
    assert found.noise_evidence[0] < found.free_evidence[0]
    assert found.noise_evidence[1] == pytest.approx(found.free_evidence[1] + np.log(300))
    assert found.log_evidence_as_noise == pytest.approx(
        found.log_evidence - (found.free_evidence[0] - found.noise_evidence[0])
    )


def test_refitted_errors_are_those_of_the_truth():
    """Begun with a wrong error model; within the sampling error of 1500 samples."""
    data = made_data(1500, gaps=False)
    fit = explain(data, (), SimpleNamespace(errors=(ErrorModel(3.0, 0.1, 0.5, RATE),) * 2))
    for found, truth in zip(fit.errors, ERRORS, strict=True):
        assert found.white == pytest.approx(truth.white, rel=0.15)
        assert found.coloured == pytest.approx(truth.coloured, rel=0.35)
    again = explain(data, (), fit)
    assert again.log_evidence == pytest.approx(fit.log_evidence, abs=0.3)


def family(effect, size, seed=9):
    """Effects of the same joints and number of amplitudes, all different."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(size):
        sizes = rng.uniform(0.5, 2.0, len(effect.sd))
        rows = {j: one * sizes + 0.1 * rng.normal(size=one.shape) for j, one in effect.rows.items()}
        shift = {j: one * rng.uniform(0.3, 2.0) for j, one in effect.shift.items()}
        made.append(replace(effect, rows=rows, shift=shift, sd=effect.sd * rng.uniform(0.3, 3.0, len(effect.sd))))
    return made


@pytest.mark.parametrize(("kind", "already"), [(0, (1, 2)), (1, ()), (2, (0,)), (3, (1, 2))])
def test_screen_gains_what_an_explanation_would(kind, already, kept):
    """With the errors kept; also where amplitudes have a sign, as long as none added before has."""
    data, effects = kept(made_data(amount=0.4)), made_effects()
    before = [effects[k] for k in already]
    now = explained(data, *before)
    regression = Regression(data, now.effects, ERRORS)
    for positive in (False, True):
        group = [replace(one, positive=np.full(len(one.sd), positive)) for one in family(effects[kind], 4)]
        gains, _ = regression.screened(group)
        expected = [explained(data, *before, one).log_evidence - now.log_evidence for one in group]
        np.testing.assert_allclose(gains, expected, atol=1e-6)
        assert np.ptp(gains) > 0.01


def test_visible_is_the_mean_gain_of_effects_of_their_usual_size(kept):
    """Over 400 draws of amplitudes, coefficients and noise (of the filter's own covariance)."""
    effect, rng = made_effects()[0], np.random.default_rng(3)
    data = made_data()
    dense = Dense(data, ERRORS)
    root, rows = np.linalg.cholesky(dense.covariance()), dense.rows((effect,))
    known = data.information
    centre, spread = np.linalg.solve(known.hessian, known.gradient), np.linalg.cholesky(np.linalg.inv(known.hessian))
    kept(data)
    visible = Regression(data, (), ERRORS).screened([effect])[1][0]
    gains = []
    for _ in range(400):
        beta = centre + spread @ rng.standard_normal(3)
        amplitude = effect.sd * rng.standard_normal(2)
        drawn = rows @ np.concatenate([beta, amplitude]) + root @ rng.standard_normal(len(root))
        effort = np.zeros_like(data.effort)
        effort.T[data.used.T] = drawn
        gains.append(Regression(replace(data, effort=effort), (), ERRORS).screened([effect])[0][0])
    assert np.mean(gains) == pytest.approx(visible, abs=4.5 * np.std(gains) / 20.0)
    assert visible > 3.0


def test_errors_of_joints_that_an_effect_leaves_alone_are_kept():
    data, effect = made_data(300, gaps=False, amount=0.5), made_effects(300)[1]
    before, one = explained(data), Made(effect, ("made", ()))
    after = Regression(replace(data, reference=before), [one], before.errors).fitted_effects
    assert after.errors[0] is before.errors[0]
    assert after.errors[1] == fit_error(after.residual[:, 1], data.used[:, 1], RATE)[0]
    moved = [before.errors[0].log_likelihood(one.residual[:, 0], data.used[:, 0]) for one in (before, after)]
    assert after.noise_evidence[0] - before.noise_evidence[0] == pytest.approx(moved[1] - moved[0], abs=1e-9)
    assert after.free_evidence[0] - before.free_evidence[0] == pytest.approx(moved[1] - moved[0], abs=1e-9)
    own = Regression(data, [one], before.errors).fitted_effects
    assert own.errors[0] != before.errors[0]
    assert abs(own.log_evidence - after.log_evidence) < 0.5


def test_of_the_groups_of_an_effect_the_best_stands_for_it():
    """Averaged over its forms, and over all names that share the effect; the best effect first."""

    def group(name, key, *gains):
        source = SimpleNamespace(name=name)
        return [SimpleNamespace(key=(key, (1,)), source=source, columns=gain) for gain in gains]

    regression = SimpleNamespace(screened=lambda gains: (np.array(gains), np.zeros(len(gains))))
    groups = [group("a", "a", 4.0, 2.0), group("b", "b", 2.0), group("b.x", "b", 9.0, 1.0), []]
    for order in ((0, 1, 2, 3), (2, 3, 1, 0)):
        best = best_forms(regression, [groups[k] for k in order])
        assert [one.hypothesis.columns for one in best] == [9.0, 4.0]
        assert [one.gain for one in best] == pytest.approx(
            [logsumexp([9.0, 1.0]) - np.log(4.0), logsumexp([4.0, 2.0]) - np.log(2.0)]
        )
        assert [one.gain - one.spread for one in best] == pytest.approx([9.0, 4.0])
