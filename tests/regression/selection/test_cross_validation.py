"""Products against dense normal densities, quadrature and explicit refits; held-back errors in closed form."""

from dataclasses import replace

import dense_errors
import numpy as np
import pytest
from dense_errors import bridging, whitening
from effect_problems import RATE, made, observed, waves
from scipy.integrate import quad
from scipy.linalg import null_space
from scipy.stats import multivariate_normal, norm

from bayesid.regression.knowledge import InformationMatrix
from bayesid.regression.selection.columns import Columns, blocks_of
from bayesid.regression.selection.cross_validation import CrossValidation, confirms, harmed
from bayesid.regression.selection.error_model import ErrorModel, fit_error
from bayesid.regression.selection.regression import Regression
from bayesid.regression.tuning import TUNING

ERRORS = (ErrorModel(0.3, 0.5, 0.1, RATE), ErrorModel(1.1, 0.7, 0.3, RATE))
SMALL = 160  # samples, of which every one of the 16 blocks has ten
LONG = 10.0
"""Hz, at which they are a log of 16 seconds."""
SLOWER = [replace(error, rate=LONG, correlation=error.correlation * RATE / LONG) for error in ERRORS]
"""The same from sample to sample."""


def made_case(seed=3, positive=(False, False)):
    """Two joints with gaps, three coefficients, four candidates of one or two columns in one joint or both."""
    rng = np.random.default_rng(seed)
    columns = waves(rng, SMALL, 3, joints=2)
    used = np.ones((SMALL, 2), dtype=bool)
    used[30:38, 0] = used[70:75, 0] = used[:6, 1] = used[95:103, 1] = False
    both, first, second, third = (waves(rng, SMALL, k) for k in (2, 1, 2, 1))
    candidates = [
        made("both", {0: both, 1: 0.5 * both[:, ::-1]}, [0.8, 2.1]),
        made("single", {1: first}, [1.4], positive[0]),
        made("double", {0: second}, [0.3, 1.7], [positive[1], False]),
        made("across", {0: third, 1: -2.0 * third}, [0.7]),
    ]
    effort = columns @ np.array([1.2, -1.7, 0.4]) + rng.normal(size=(SMALL, 2)) * [0.6, 1.3]
    effort[:, 0] += both @ [1.5, -2.9] + second @ [0.9, 2.6]
    effort[:, 1] += 0.5 * both[:, ::-1] @ [1.5, -2.9] - 2.7 * first[:, 0]
    return Regression(observed(columns, effort, used), candidates, list(ERRORS))


def white(products, of_joint, errors=ERRORS):
    """Rows of all joints below each other, whitened."""
    used = products.data.used
    parts = [whitening(e, SMALL) @ bridging(used[:, j]) @ of_joint(j) for j, e in enumerate(errors)]
    return np.concatenate([(part.T * used[:, j]).T for j, part in enumerate(parts)])


def rows_of(products, candidate):
    blank = np.zeros((SMALL, len(candidate.columns.sd)))
    return white(products, lambda j: candidate.columns.rows.get(j, blank))


class Dense:
    """Density of the efforts' part outside the coefficients' span, with some effects' amplitudes integrated out."""

    def __init__(self, products, chosen=()):
        self.left = null_space(white(products, lambda j: products.data.columns[:, j]).T)
        self.effort = self.left.T @ white(products, lambda j: products.data.effort[:, j])
        self.covariance = np.eye(len(self.effort))
        for candidate in chosen:
            rows = self.left.T @ rows_of(products, candidate) * candidate.columns.sd
            self.covariance += rows @ rows.T

    def log_density(self):
        return multivariate_normal(np.zeros(len(self.effort)), self.covariance).logpdf(self.effort)


@pytest.mark.parametrize("chosen", [(), (1, 0, 3)])
def test_gains_are_those_of_dense_densities(chosen):
    products = made_case()
    before = [products.effects[k] for k in chosen]
    tried = [c for k, c in enumerate(products.effects) if k not in chosen]
    without = Dense(products, before).log_density()
    expected = [Dense(products, [*before, one]).log_density() - without for one in tried]
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(products.gains(before, tried), expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("chosen", [(), (3, 2)])
def test_gains_with_an_earlier_log_and_uncertain_columns_are_those_of_dense_densities(chosen):
    """The coefficients' prior is correlated and biased; one uncertain column resembles a candidate's."""
    plain = made_case()
    root = np.array([[2.0, 0.3, -0.4], [0.0, 3.0, 0.9], [0.0, 0.0, 0.7]])
    hessian = root.T @ root
    centre = np.array([0.9, -1.9, 0.8])
    known = InformationMatrix(hessian, hessian @ centre, float(centre @ hessian @ centre))
    rng = np.random.default_rng(8)
    alike = plain.effects[0].columns.rows[1][:, :1] + 0.3 * waves(rng, SMALL, 1)
    uncertain = Columns(
        {1: np.hstack([alike, waves(rng, SMALL, 1)])}, {}, np.array([0.4, 1.9]), np.zeros(2, dtype=bool)
    )
    products = Regression(replace(plain.data, information=known), plain.effects, list(ERRORS), uncertain)
    before = [products.effects[k] for k in chosen]
    tried = [c for k, c in enumerate(products.effects) if k not in chosen]
    dense, base = dense_errors.Dense(products.data, ERRORS), [uncertain, *(c.columns for c in before)]
    without = dense.log_density(base)
    expected = [dense.log_density([*base, one.columns]) - without for one in tried]
    np.testing.assert_allclose(products.gains(before, tried), expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("which", "sign"), [(1, 1.0), (2, -1.0)])
def test_one_sided_gains_are_integrals_over_one_side(which, sign):
    """Twice the prior on the allowed side of zero; the amplitude is negative, or reversed to positive."""
    products = made_case(positive=(which == 1, which == 2))
    before, candidate = [products.effects[3]], products.effects[which]
    one = candidate.columns
    for rows in one.rows.values():
        rows[:, 0] *= sign  # the products are made anew
    products = Regression(products.data, products.effects, list(ERRORS))
    others = Dense(products, before)
    rows = others.left.T @ rows_of(products, candidate)
    if len(one.sd) == 2:
        others.covariance += one.sd[1] ** 2 * np.outer(rows[:, 1], rows[:, 1])
    none = Dense(products, before).log_density()
    inverse = np.linalg.inv(others.covariance)  # the integrand is a normal density times a constant
    spread = 1.0 / np.sqrt(rows[:, 0] @ inverse @ rows[:, 0] + one.sd[0] ** -2.0)
    at_zero = others.log_density() - none
    slope, curvature = rows[:, 0] @ inverse @ others.effort, rows[:, 0] @ inverse @ rows[:, 0]

    def integrand(amplitude):
        prior = 2.0 * norm.pdf(amplitude, scale=one.sd[0])
        return np.exp(at_zero + amplitude * slope - 0.5 * amplitude**2 * curvature) * prior

    best = spread**2 * slope
    expected, _ = quad(integrand, 0.0, max(best, 0.0) + 12.0 * spread, points=[max(best, spread)], epsabs=0.0)
    (found,) = products.gains(before, [products.effects[which]])
    assert found == pytest.approx(np.log(expected), abs=1e-5)


def test_best_is_ridge_regression_and_the_residual_follows():
    products = made_case()
    chosen = [products.effects[2], products.effects[0]]
    augmented, effort = stacked(products, chosen)
    expected = np.linalg.lstsq(augmented, effort, rcond=None)[0]
    found = products.best(chosen)
    np.testing.assert_allclose(found[products.indices(chosen)], expected, rtol=1e-7, atol=1e-9)
    assert np.count_nonzero(found) == len(expected)
    np.testing.assert_allclose(products.residual(chosen), unexplained(products, chosen, expected), atol=1e-7)


def stacked(products, chosen, kept=None):
    """Whitened rows of some samples and of the priors, and efforts."""
    kept = np.tile(np.ones(SMALL, dtype=bool) if kept is None else kept, 2)
    rows = [white(products, lambda j: products.data.columns[:, j]), *(rows_of(products, c) for c in chosen)]
    columns, effort = np.hstack(rows)[kept], white(products, lambda j: products.data.effort[:, j])[kept]
    sd = np.concatenate([c.columns.sd for c in chosen]) if chosen else np.zeros(0)
    prior = np.hstack([np.zeros((len(sd), 3)), np.diag(1.0 / sd)]) if chosen else np.zeros((0, 3))
    return np.vstack([columns, prior]), np.concatenate([effort, np.zeros(len(sd))])


def unexplained(products, chosen, best):
    data, left = products.data, products.data.effort - products.data.columns @ best[:3]
    start = 3
    for candidate in chosen:
        end = start + len(candidate.columns.sd)
        for j, rows in candidate.columns.rows.items():
            left[:, j] -= rows @ best[start:end]
        start = end
    return left * data.used


@pytest.mark.parametrize("which", [(), (0, 3, 1)])
def test_held_back_blocks_are_predicted_by_fits_without_them(which):
    first = made_case()
    products = Regression(replace(first.data, rate=LONG), first.effects, SLOWER)
    chosen = [products.effects[k] for k in which]
    fold = (np.arange(SMALL) // (SMALL // 16)) % 4
    left = np.empty((SMALL, 2))
    for k in range(4):
        best = np.linalg.lstsq(*stacked(products, chosen, fold != k), rcond=None)[0]
        left[fold == k] = unexplained(products, chosen, best)[fold == k]
    found = products.cross_validation(chosen)
    np.testing.assert_allclose(found.squares, (left**2).reshape(16, 10, 2).sum(axis=1), rtol=1e-6)
    np.testing.assert_array_equal(found.counts, products.data.used.reshape(16, 10, 2).sum(axis=1))
    within = np.sqrt((products.residual(chosen) ** 2).sum(axis=0) / products.data.used.sum(axis=0))
    assert np.abs(found.rms / within - 1.0).max() > 0.01


@pytest.mark.parametrize("base", [[], [1, 4]])
def test_sets_are_predicted_together_as_one_by_one(base):
    """With and without a change."""
    first, rng = made_case(), np.random.default_rng(8)
    changing = [
        replace(first.effects[1], columns=replace(first.effects[1].columns, shift={0: rng.normal(size=SMALL)})),
        made("change", {}, [], shift={1: rng.normal(size=SMALL)}),
    ]
    products = Regression(replace(first.data, rate=LONG), [*first.effects, *changing], SLOWER)
    chosen = [products.effects[k] for k in base]
    more = [candidate for candidate in products.effects if candidate not in chosen]
    sets = [*([*chosen, candidate] for candidate in more), more]
    found = products.held_back_each(sets)
    for errors, one in zip(found, sets, strict=True):
        np.testing.assert_allclose(errors.squares, products.cross_validation(one).squares, rtol=1e-9)
        np.testing.assert_array_equal(errors.counts, products.cross_validation(one).counts)


def test_uncertain_columns_predict_held_back_blocks_only_if_they_may():
    """Columns equal to the effect explain it in evidence and predictions; if left out, they predict nothing."""
    plain = made_case()
    twin = plain.effects[0].columns
    uncertain = Columns(twin.rows, {}, 50.0 * twin.sd, np.zeros(len(twin.sd), dtype=bool))
    with_them, without = (
        Regression(plain.data, plain.effects, list(ERRORS), uncertain, predicting=which) for which in (True, False)
    )
    first = plain.effects[0]
    for products in (with_them, without):
        assert products.gains((), products.effects[:1])[0] < 0.0 < plain.gains((), [first])[0]
    np.testing.assert_allclose(without.cross_validation(()).squares, plain.cross_validation(()).squares)
    form = replace(first, columns=uncertain)
    free = plain.with_forms({id(first): form})
    np.testing.assert_allclose(with_them.cross_validation(()).squares, free.cross_validation([form]).squares)


def shifted(hypothesis, seed, joints):
    """Another form of it: other rows, and a change that has no amplitude."""
    rng = np.random.default_rng(seed)
    rows = {j: rows + 0.3 * waves(rng, SMALL, rows.shape[1]) for j, rows in hypothesis.columns.rows.items()}
    shift = {j: waves(rng, SMALL, 1)[:, 0] for j in joints}
    return replace(hypothesis, columns=replace(hypothesis.columns, rows=rows, shift=shift))


def without(data, *forms):
    effort = data.effort.copy()
    for form in forms:
        for j, shift in form.columns.shift.items():
            effort[:, j] -= shift * data.used[:, j]
    return replace(data, effort=effort)


def plain(form):
    """Its columns alone."""
    return replace(form, columns=replace(form.columns, shift={}))


@pytest.mark.parametrize("others", [(0,), (3, 1)])
def test_a_change_without_amplitude_is_whole_or_not_there(others):
    """On top of some candidates, one of which may have a change itself, against efforts without these changes."""
    first = made_case()
    forms = [shifted(h, 5 + k, (k % 2,)) if k in (0, 2) else h for k, h in enumerate(first.effects)]
    products, bare = Regression(first.data, forms, list(ERRORS)), [plain(form) for form in forms]
    taken = [forms[k] for k in others]
    before = Regression(without(first.data, *taken), bare, list(ERRORS))
    after = Regression(without(first.data, *taken, forms[2]), bare, list(ERRORS))
    gain = products.gains([products.effects[k] for k in others], [products.effects[2]])[0]
    with_it, without_it = [*others, 2], list(others)
    dense = [Dense(p, [p.effects[k] for k in which]) for p, which in ((after, with_it), (before, without_it))]
    assert gain == pytest.approx(dense[0].log_density() - dense[1].log_density(), abs=1e-5)
    chosen, expected = ([p.effects[k] for k in with_it] for p in (products, after))
    np.testing.assert_allclose(products.residual(chosen), after.residual(expected), atol=1e-7)
    np.testing.assert_allclose(
        products.cross_validation(chosen).squares, after.cross_validation(expected).squares, rtol=1e-6
    )


def test_joints_are_whitened_anew_by_what_is_left_there():
    products = made_case()
    chosen = [products.effects[0], products.effects[2]]
    left = products.residual(chosen)
    weighed = products.weighed_by(chosen)
    fitted = [fit_error(left[:, j], products.data.used[:, j], RATE)[0] for j in (0, 1)]
    assert weighed.errors == fitted
    assert fitted[1].sigma != pytest.approx(ERRORS[1].sigma, rel=0.01)
    anew = Regression(products.data, products.effects, fitted)
    np.testing.assert_allclose(weighed.hessian, anew.hessian, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(weighed.gradient, anew.gradient, rtol=1e-10, atol=1e-9)


COUNT = 25
"""Samples a block."""


def errors(*mean_squares, counts=COUNT):
    """Of each joint, one number for all blocks or one a block, (N m)^2."""
    blocks = np.stack([np.broadcast_to(values, TUNING.blocks) for values in mean_squares], axis=1)
    counts = np.broadcast_to(counts, blocks.shape)
    return CrossValidation(blocks * counts, counts)


def spread(mean, sd):
    """(TUNING.blocks,) of exactly this mean and standard deviation, in no order."""
    return mean + sd * np.resize([1.0, -1.0, -1.0, 1.0], TUNING.blocks)


def test_rms_weighs_samples_not_blocks():
    found = CrossValidation(np.array([[8.0, 0.0], [1.0, 18.0]]), np.array([[2, 0], [7, 2]]))
    np.testing.assert_allclose(found.rms, [1.0, 3.0])
    nothing = CrossValidation(np.zeros((2, 1)), np.zeros((2, 1), dtype=int))
    np.testing.assert_array_equal(nothing.rms, [0.0])


def test_rise_and_its_standard_error_are_those_of_the_mean_of_blocks():
    """Sixteen independent changes: the sd of their mean is theirs over four."""
    rise, error = errors(spread(5.0, 0.8), 2.0).rise(errors(4.0, 3.0))
    np.testing.assert_allclose(rise, [1.0, -1.0])
    np.testing.assert_allclose(error, [0.8 / 4.0, 0.0], atol=1e-15)


def test_above_a_level_is_sure_by_the_scatter_of_the_blocks():
    """A mean square of 10 over a level of 3 N m: 1 against 1.5 sd / 4."""
    for sd, sure in ((2.6, True), (2.7, False)):
        np.testing.assert_array_equal(errors(spread(10.0, sd), 0.24).surely_above(np.array([3.0, 0.5])), [sure, False])


@pytest.mark.parametrize(
    ("rise", "sd", "grown"), [(0.11, 0.0, True), (0.09, 0.0, False), (0.3, 0.7, True), (0.3, 0.9, False)]
)
def test_growth_is_as_large_and_as_sure_as_the_help_of_an_effect(rise, sd, grown):
    """A tenth of the mean square, and one and a half standard errors: 0.3 against 1.5 sd / 4."""
    before = errors(1.0, 3.0)
    np.testing.assert_array_equal(errors(spread(1.0 + rise, sd), 3.0).surely_grown(before), [grown, False])
    assert not before.surely_grown(errors(1.0 + rise, 3.0)).any()


def test_harm_is_visible_from_four_per_cent_of_the_square_and_sure_from_one_standard_error_on():
    """The same rise in all blocks, without scatter; and a rise of one with a standard error of scatter / 4."""
    before = errors(7.0, 0.3)
    for rise, visible in ((-0.5, False), (0.039, False), (0.041, True)):
        np.testing.assert_array_equal(harmed(errors(7.0 * (1.0 + rise), 0.3), before), [visible, False])
        np.testing.assert_array_equal(harmed(errors(7.0, 0.3 * (1.0 + rise)), before), [False, visible])
    for share in (0.9, 1.1):
        np.testing.assert_array_equal(harmed(errors(spread(11.0, 4.0 / share)), errors(10.0)), [share > 1.0])


def test_an_effect_must_lower_the_mean_square_by_a_tenth():
    before = errors(2.0, 9.0)
    for share, confirmed in ((0.095, False), (0.105, True)):
        after = errors(2.0, 9.0 * (1.0 - share))
        assert [confirms(after, before, [j]) for j in (1, 0)] == [confirmed, False]


@pytest.mark.parametrize(
    ("first", "second", "confirmed"), [(0.06, 0.06, True), (0.06, 0.03, False), (0.2, -0.01, True)]
)
def test_shares_of_joints_add_up(first, second, confirmed):
    """However different the joints' efforts are."""
    after = errors(1e-4 * (1.0 - first), 1e4 * (1.0 - second), 1.0)
    assert confirms(after, errors(1e-4, 1e4, 1.0), {0, 1}) is confirmed


def test_a_drop_must_exceed_its_standard_error():
    """A fall of a third, by some standard errors."""
    for deviations, confirmed in ((1.3, False), (1.7, True)):
        scatter = 1.0 / deviations * np.sqrt(TUNING.blocks)
        assert confirms(errors(spread(2.0, scatter)), errors(3.0), [0]) is confirmed


def test_a_drop_in_one_joint_is_weighed_against_a_rise_in_another():
    """A large drop in two blocks, none in others or a double square in half of them; then a rise in another joint."""
    acts = np.isin(np.arange(TUNING.blocks), (5, 6)).astype(float)
    before = errors(1.0 + 9.0 * acts)
    for elsewhere in (0.0, 1.0):
        after = errors(1.0 + 3.0 * acts + elsewhere * np.resize([1.0, 0.0], TUNING.blocks) * (1.0 - acts))
        assert confirms(after, before, [0]) is (elsewhere == 0.0)
        assert confirms(before, after, [0]) is False
    for rise, confirmed in ((0.75, True), (0.85, False)):  # a fall by four fifths in the first joint
        assert confirms(errors(0.4, 5.0 * (1.0 + rise)), errors(2.0, 5.0), [0]) is confirmed


def test_joints_without_samples_do_not_count():
    before = CrossValidation(np.zeros((TUNING.blocks, 1)), np.zeros((TUNING.blocks, 1), dtype=int))
    assert not confirms(before, before, [0])
    np.testing.assert_array_equal(harmed(before, before), [False])


def test_blocks_last_a_second_unless_there_are_too_few():
    assert [blocks_of(duration) for duration in (0.5, 3.9, 5.5, 15.9, 16.0, 500.0)] == [4, 4, 5, 15, 16, 16]
