"""Equivalent hypotheses: the expected Bayes factor against draws with dense covariances."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import smooth_motion
from open_results import LIMITS, TERMS, earlier_motion, open_known, open_result
from scipy.stats import multivariate_normal

from bayesid.cli.terminal import in_options
from bayesid.effects.drive import Delay
from bayesid.effects.friction import StribeckFriction
from bayesid.effects.kinematic_errors import BaseTilt
from bayesid.errors import InputError
from bayesid.excitation.competing import indistinguishable, make_competing
from bayesid.excitation.gaussian_posterior import gaussian_posterior, reference_motion
from bayesid.excitation.hypotheses import parse_key

PERIOD = 0.1
DRAWS = 4000


@pytest.fixture(scope="module")
def known():
    """With so much noise that a dozen samples give a few nats."""
    return quiet(open_known(share=0.3), 0.02)


def quiet(known, density):
    return replace(known, density=known.density * density)


@pytest.fixture(scope="module")
def reference(known):
    return reference_motion(known.model.robot, LIMITS)


@pytest.fixture(scope="module")
def motion():
    return smooth_motion(3, 1.2, 1.0 / PERIOD, seed=21)


def keys(*names):
    return [parse_key(name) for name in names]


def numbers(competing, motion, form):
    """Rows (M, R) and noise (M,) of the moving samples, for the coefficients and one form."""
    columns = competing.columns(motion)
    weights = competing.posterior.weights(motion)
    r = len(competing.posterior)
    chosen = np.concatenate([np.arange(r), form.columns])
    seen = weights > 0.0
    return columns[seen][:, chosen], 1.0 / np.sqrt(weights[seen])


def prior(competing, form):
    """Prior mean and covariance of coefficients and amplitudes."""
    mean = np.concatenate([competing.posterior.mean, form.mean])
    covariance = np.zeros((len(mean), len(mean)))
    r = len(competing.posterior)
    covariance[:r, :r] = np.linalg.inv(competing.prior)
    covariance[r:, r:] = np.diag(form.sd**2)
    return mean, covariance


def drawn_factors(motion, competing, true, others):
    """(DRAWS, forms) log Bayes factors of a true distribution of a form against others, in draws of recordings."""
    form, mean, covariance = true
    rows, sd = numbers(competing, motion, form)
    rng = np.random.default_rng(3)
    z = rng.multivariate_normal(mean, covariance, size=DRAWS)
    y = z @ rows.T + sd * rng.standard_normal((DRAWS, len(sd)))
    noise = np.diag(sd**2)
    own = multivariate_normal(rows @ mean, rows @ covariance @ rows.T + noise).logpdf(y)
    factors = []
    for other, centre, spread in others:
        rows, _ = numbers(competing, motion, other)
        factors.append(own - multivariate_normal(rows @ centre, rows @ spread @ rows.T + noise).logpdf(y))
    return np.array(factors).T


def information(competing, motion):
    rows = competing.columns(motion) * np.sqrt(competing.posterior.weights(motion))[:, :, None]
    return np.einsum("njr,njs->rs", rows, rows)


def assert_is_mean(value, factors):
    """Against the best form; within four standard errors."""
    means = factors.mean(axis=0)
    best = int(np.argmin(means))
    error = factors[:, best].std() / np.sqrt(DRAWS)
    assert value == pytest.approx(means[best], abs=4.0 * error)
    assert error < 0.2 * max(abs(value), 0.3)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("stribeck_friction:3", "thermal_drift:3"),
        ("base_tilt", "gravity_spring:2"),
        ("gain_error:1", "asymmetric_coulomb:1"),
        ("link_length:3", "joint_zero:2"),
    ],
)
def test_the_expected_factor_is_that_of_draws_without_an_earlier_recording(known, motion, reference, one, other):
    competing = make_competing(known, keys(one, other), None, reference)
    expected = competing.expected(information(competing, motion))
    assert set(expected) == {(one, other), (other, one)}
    for a, b in competing.pairs:
        form = a.forms[len(a.forms) // 2]
        factors = drawn_factors(
            motion, competing, (form, *prior(competing, form)), [(each, *prior(competing, each)) for each in b.forms]
        )
        assert_is_mean(expected[a.name, b.name], factors)
    most = 4.0 * np.log(10.0)  # what is told clearly counts no more
    assert competing.objective(information(competing, motion)) == pytest.approx(
        -sum(min(value, most) for value in expected.values())
    )


def after(competing, earlier, form, truth):
    """Normal distribution after a noise-free earlier recording, by least squares on rows of prior and recording."""
    mean, covariance = prior(competing, form)
    true_form, values = truth
    rows, sd = numbers(competing, earlier, form)
    true_rows, _ = numbers(competing, earlier, true_form)
    root = np.linalg.cholesky(np.linalg.inv(covariance)).T
    stacked = np.vstack([root, rows / sd[:, None]])
    target = np.concatenate([root @ mean, true_rows @ values / sd])
    estimate = np.linalg.lstsq(stacked, target, rcond=None)[0]
    return estimate, np.linalg.inv(stacked.T @ stacked), float(np.sum((stacked @ estimate - target) ** 2))


def found_result():
    """A result that has found Stribeck friction in joint 3."""
    stribeck = StribeckFriction(joints=(3,), smoothing=(0.02,), speed=(0.4,))
    result = open_result(terms=(*TERMS, stribeck), share=0.3)
    factor = np.ones(len(result.theta))
    factor[result.model.places[-1]] = 1.5, 4.0
    return replace(result, theta=factor * result.theta)


def test_an_effect_that_was_found_is_true_with_its_own_amplitudes(motion):
    """The other effect is fitted to the earlier log as if the first were true."""
    result, earlier = found_result(), earlier_motion()[::5]
    known = quiet(gaussian_posterior(result, 100.0), 0.5)
    competing = make_competing(known, keys("stribeck_friction:3", "thermal_drift:3"), earlier, earlier)
    stribeck, drift = competing.competing
    assert drift.amplitudes is None
    np.testing.assert_array_equal(stribeck.amplitudes, result.theta[result.model.places[-1]])
    assert [term.name for term in competing.posterior.model.terms] == list(TERMS)
    assert len(stribeck.forms) > 1
    assert len(drift.forms) > 1
    before = np.diag(np.linalg.inv(competing.prior))
    assert np.all(
        before >= 0.99 * np.diag(competing.posterior.covariance_now)
    )  # the earlier log has told something of each
    assert np.median(before / np.diag(competing.posterior.covariance_now)) > 2.0
    first = stribeck.forms[0]
    truth = first, np.concatenate([competing.posterior.mean, stribeck.amplitudes])
    expected = competing.expected(information(competing, motion))
    own = truth[1], after(competing, earlier, first, truth)[1]  # about its amplitudes, not drawn to zero by their prior
    others = [(form, *after(competing, earlier, form, truth)[:2]) for form in drift.forms]
    factors = drawn_factors(motion, competing, (first, *own), others)
    assert_is_mean(expected[stribeck.name, drift.name], factors)
    # where drift is true, it has looked to the earlier log as the friction did: in the form that fits best
    fits = [(*after(competing, earlier, form, truth), form) for form in drift.forms]
    mean, covariance, _, form = min(fits, key=lambda fit: fit[2])
    mimic = form, mean
    others = [(form, *after(competing, earlier, form, mimic)[:2]) for form in stribeck.forms]
    factors = drawn_factors(motion, competing, (form, mean, covariance), others)
    assert_is_mean(expected[drift.name, stribeck.name], factors)


@pytest.mark.parametrize(
    ("distortion", "key"), [(BaseTilt(angle=(0.1, -0.05)), "base_tilt"), (Delay(lag=(0.02,)), "delay")]
)
def test_effects_of_the_whole_robot_have_no_joints(distortion, key, reference, motion):
    result = open_result(share=0.3)
    distorted = gaussian_posterior(replace(result, model=result.model.extend(distortion)), 100.0)
    competing = make_competing(distorted, keys(key, "torque_offset:2"), None, reference)
    whole = competing.competing[0]
    assert whole.name == key
    assert whole.amplitudes is not None
    fine = smooth_motion(3, 1.2, 200.0, seed=21)
    columns = competing.columns(fine)
    plain = columns[:, :, : len(competing.posterior)] @ competing.posterior.mean
    change = columns[:, :, whole.forms[0].columns] @ whole.amplitudes
    want = replace(competing.posterior.model, distortions=(distortion,)).effort(fine, competing.posterior.theta) - plain
    scale = np.abs(want).max()
    assert scale > 0.05
    np.testing.assert_allclose(change[10:], want[10:], atol=0.02 * scale)
    assert competing.memory == (key == "delay")


def test_pairs_that_no_motion_distinguishes_are_named(known, reference):
    """A gain error of a joint differs from a load; a drift under another name does not differ from itself."""
    competing = make_competing(known, keys("gain_error:3", "thermal_drift:1"), None, reference)
    gain, drift = competing.competing
    assert indistinguishable(competing, reference) == []
    friction = make_competing(known, keys("coulomb_friction:2", "stribeck_friction:2"), None, reference)
    assert indistinguishable(friction, reference) == []  # the model has the one, not the other's second column
    as_gain = replace(drift, forms=(*drift.forms, replace(gain.forms[0])))  # one form that is alike is enough
    assert indistinguishable(replace(competing, competing=(gain, as_gain)), reference) == [
        ("gain_error:3", "thermal_drift:1")
    ]


def test_names_of_hypotheses(known, reference):
    refused = [lambda text=text: parse_key(text) for text in ("friction:3", "stribeck_friction:x", "", "delay:1.5")]
    for names in ((), ("stribeck_friction:3",), ("thermal_drift:7",), ("base_tilt:2",)):
        pair = keys("stribeck_friction:3", *names)
        refused.append(lambda pair=pair: make_competing(known, pair, None, reference))
    for call in refused:
        with pytest.raises(InputError) as caught:
            call()
        assert in_options(str(caught.value)).startswith("--between")


def test_a_changed_term_has_its_mean_and_covariance_before_the_step():
    """Its prior variance is reduced by the step's, to no less than a hundredth."""
    known, earlier = gaussian_posterior(open_result(share=0.3), 100.0), earlier_motion()[::5]
    (key, other), place = keys("coulomb_friction:3", "thermal_drift:3"), known.coefficients.names.index("Fc3")
    plain, changed = (
        make_competing(known, (key, other), earlier, earlier, {key: step}) for step in ({}, {"Fc3": 0.25})
    )
    assert (plain.competing[0].amplitudes, changed.competing[0].amplitudes) == (None, [0.25])
    moved = np.zeros(len(known))
    moved[place] = 0.25
    np.testing.assert_allclose(plain.posterior.mean - changed.posterior.mean, moved, atol=1e-12)
    covariance, (sd,) = np.linalg.inv(plain.prior), changed.competing[0].forms[0].sd
    covariance[place, place] -= min(sd**2, 0.99 / plain.prior[place, place])
    np.testing.assert_allclose(covariance @ changed.prior, np.eye(len(known)), atol=1e-6)
