"""Payloads: bodies from draws, what a log says of one, and whether nothing else has changed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import real_log, smooth_motion
from payload_cases import CENTRE, MASS, PAYLOAD, TERMS, TRUTH, PayloadCase, ten_parameters
from scipy.stats import binom

import bayesid
from bayesid.identification.payload import (
    AXES,
    Estimate,
    InertialParameters,
    evenly_sized,
    identify_payload,
    with_common_factor,
)
from bayesid.identification.unchanged import UnchangedCheck
from bayesid.report.payload import payload_checks
from bayesid.robot.inertia import pseudo_inertia

ALL = range(24)
"""Seeds of the cases whose rates are counted."""


@cache
def case(seed):
    return PayloadCase(seed)


@cache
def reading(seed, loaded=True, friction=None):
    return identify_payload(case(seed).result, case(seed).later(PAYLOAD if loaded else None, friction), common_sd=0.0)


def numbers(body):
    return [body.mass, *body.centre, *body.inertia]


def test_sizes_of_a_flat_posterior_become_flat():
    """Draws flat in the cone of second moments, by rejection: their diagonals become uniform, correlations stay so."""
    rng = np.random.default_rng(2)
    diagonal = rng.uniform(0.01, 0.04, (400_000, 3))
    across = rng.uniform(-0.04, 0.04, (400_000, 3))
    second = np.zeros((400_000, 3, 3))
    second[:, range(3), range(3)] = diagonal
    for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        second[:, i, j] = second[:, j, i] = across[:, k]
    second = second[np.linalg.eigvalsh(second)[:, 0] > 0.0]
    inertia = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
    draws = np.array([ten_parameters(1.0, CENTRE, one) for one in inertia[:20_000]])
    kept = pseudo_inertia(evenly_sized(draws))
    normal_equations = (kept[:, :3, :3] - np.einsum("i,j->ij", CENTRE, CENTRE))[:, range(3), range(3)]
    assert len(np.unique(kept[:, 0, 0])) > 5_000
    np.testing.assert_allclose(
        np.quantile(normal_equations, [0.25, 0.5, 0.75], axis=0).T, [[0.0175, 0.025, 0.0325]] * 3, atol=6e-4
    )


def test_a_common_factor_moves_mass_and_inertia_alike_and_no_centre():
    rng = np.random.default_rng(3)
    draws = PAYLOAD * (1.0 + 0.01 * rng.standard_normal((4000, 1)))
    plain, wide = InertialParameters.of_draws(draws), InertialParameters.of_draws(draws, common_sd=0.05)
    for before, after in zip((plain.mass, *plain.inertia), (wide.mass, *wide.inertia), strict=True):
        assert after.value == before.value
        assert after.sd / abs(after.value) == pytest.approx(np.hypot(0.01, 0.05), rel=0.05)
    assert [one.sd for one in wide.centre] == pytest.approx([0.0] * 3, abs=1e-12)
    assert with_common_factor(draws, 0.0) is draws


def test_intervals_are_central_and_hold_nineteen_of_twenty_draws():
    """Of a skew distribution: exponential, its quantiles -ln(1 - p)."""
    draws = -np.log1p(-(np.arange(10_000) + 0.5) / 10_000)
    assert Estimate.of_draws(draws).interval == pytest.approx((-np.log(0.975), -np.log(0.025)), rel=3e-3)


def test_a_payload_is_read():
    read = reading(0)
    errors = np.array([(one.value - true) / one.sd for one, true in zip(numbers(read.body), TRUTH, strict=True)])
    assert read.body.shown
    assert read.check.passed
    assert read.posterior.converged
    np.testing.assert_array_less(np.abs(errors), 3.0)
    assert read.body.mass.sd < 0.1
    assert max(one.sd for one in read.body.centre) < 0.01
    assert read.frame == "link 3"
    assert "2.0" in repr(read)
    assert AXES == ("xx", "yy", "zz", "xy", "xz", "yz")


def test_bounds_of_the_prior_name_the_payload():
    """The bodies of the model are the three links and the payload."""
    names = [window.name for window in reading(0).posterior.target.prior.windows]
    assert names[:4] == [f"radius of gyration of {name}" for name in ("link 1", "link 2", "link 3", "the payload")]


def test_without_a_payload_there_is_none():
    read = reading(0, loaded=False)
    assert payload_checks(read)[1].remedy
    assert not read.body.shown
    assert read.check.passed
    assert read.body.centre is read.body.inertia is None
    assert read.body.mass.interval[0] == 0.0
    assert read.body.mass.interval[1] < 0.2


def test_changed_friction_is_marked():
    read = reading(0, friction=(2, 1.4))
    assert not read.check.passed
    assert read.check.joints == (2,)
    assert "CHANGED: joint 2" in repr(read)
    (unchanged,) = (one for one in payload_checks(read, "before") if one.name == "Other changes")
    assert (unchanged.state, "joint 2" in unchanged.message) == ("bad", True)
    assert "`bayesid discrepancy before " in unchanged.remedy
    moved = np.array([1.0, 50.0, 2.0])  # what no mass depends on
    own = replace(read, check=replace(read.check, residual=np.ones(3), chi_square=1.0, moved=moved))
    (unchanged,) = (one for one in payload_checks(own, "before") if one.name == "Other changes")
    assert (unchanged.state, "joint 2 alone 50 " in unchanged.message) == ("look", True)


def test_gains_that_are_off_by_a_tenth():
    """Both logs in efforts that are a tenth too large: the factor is what takes them back."""
    arm = PayloadCase(1)
    first = arm.log(arm.before, gain=1.1)
    result = bayesid.identify(arm.robot, first, TERMS, complete="off", posterior=False)
    log = replace(arm.log(arm.after, PAYLOAD, gain=1.1), read_with={"gains": [1.1, 2.2, 3.3]})
    read = identify_payload(result, log, known_mass=(MASS, 0.01), common_sd=0.1)
    assert read.body.mass.value == pytest.approx(1.1 * MASS, rel=0.05)
    assert read.body.mass.sd / read.body.mass.value == pytest.approx(0.1, rel=0.1)
    assert abs(read.gain_factor.value - 1.0 / 1.1) < 3.0 * read.gain_factor.sd
    assert read.gain_factor.sd < 0.03
    given, corrected = read.gains
    np.testing.assert_allclose(corrected, read.gain_factor.value * given)
    exact = identify_payload(result, log)
    assert exact.gain_factor is None
    assert exact.body.mass.interval[0] > MASS, "gains that are stated are taken as exact"
    nobody_knows = identify_payload(result, replace(log, read_with={}))
    assert (exact.common_sd, nobody_knows.common_sd) == (0.0, 0.1)
    assert nobody_knows.body.mass.value == exact.body.mass.value
    low, high = nobody_knows.body.mass.interval
    assert low < MASS < 1.2 * MASS < high
    assert nobody_knows.mass_sd_by_log == exact.mass_sd_by_log == pytest.approx(exact.body.mass.sd)
    assert [payload_checks(one)[0].state for one in (nobody_knows, exact, read)] == ["look", "good", "look"]


@pytest.mark.parametrize(
    ("sd", "by_log", "source", "known", "gains", "mass", "says"),
    [
        (0.2, 0.05, "gains", None, "good", "good", ""),
        (2.74, 0.05, "gains", None, "bad", "bad", "--known-mass"),
        (2.74, 0.05, "gains", (2.0, 0.1), "good", "good", ""),  # the known mass replaces the common factor
        (0.24, 0.05, "assumed", None, "look", "look", "--common-sd"),
        (0.5, 0.45, "stated", None, "good", "look", "against gravity"),
    ],
)
def test_the_relative_sd_of_the_mass_enters_the_verdict(sd, by_log, source, known, gains, mass, says):
    """Good up to 10 %, bad above 100 %, of a mass of 2 kg; every check that is not good says what to do."""
    read = reading(0)
    body = replace(read.body, mass=Estimate(2.0, sd, (1.9, 2.1)))
    share = np.sqrt(max(sd**2 - by_log**2, 0.0)) / 2.0
    factor = None if known is None else Estimate(1.0, 0.02, (0.96, 1.04))
    wide = replace(read, body=body, common_sd=share, common_sd_from=source, mass_sd_by_log=by_log)
    checks = payload_checks(replace(wide, known_mass=known, gain_factor=factor))
    assert [checks[0].state, checks[1].state] == [gains, mass]
    assert checks[0].name == ("Torque scale" if source == "assumed" or known else "Gains")
    assert all(check.remedy for check in checks if check.state != "good")
    assert says in checks[1].remedy
    assert mass == "good" or f"relative sd {50.0 * sd:.0f}" in checks[1].message


def test_limits_keep_the_false_alarms_and_name_what_has_changed():
    """Chi-squares of a normal distribution, the joints' own part of the whole."""

    def check(residual=(1.0, 1.0), moved=(0.0, 0.0), chi_square=5.0):
        return UnchangedCheck(np.array(residual), np.array(moved), np.array([2, 2]), chi_square, 10)

    most = UnchangedCheck.MOST_RESIDUAL
    assert check(residual=(most, most)).passed
    assert check(residual=(1.0, 1.01 * most)).joints == (2,)
    assert check(moved=(30.0, 0.0)).joints == (1,)
    links = check(chi_square=40.0)
    assert (links.joints, links.passed) == ((), False)
    rng, one = np.random.default_rng(6), check()
    whole = rng.chisquare(10, 200_000) > one.limit
    joints = (rng.chisquare(2, (200_000, 2)) > one.moved_limits).any(axis=1)
    assert np.mean(whole | joints) == pytest.approx(UnchangedCheck.FALSE_ALARM, rel=0.1)


def test_what_cannot_be_used_is_refused():
    arm = case(0)
    result, log = arm.result, arm.later(PAYLOAD)
    loaded = reading(0).identification
    still = replace(log, q=np.zeros_like(log.q))
    short = bayesid.Log(log.t[:90], log.q[:90], log.effort[:90], log.signed)
    two = bayesid.Log(log.t, log.q[:, :2], log.effort[:, :2], log.signed[:2])
    blank = replace(result.identified, precision=np.zeros_like(result.identified.precision))
    noise = replace(log, effort=np.abs(np.random.default_rng(7).standard_normal(log.effort.shape)) * log.effort.mean())
    for earlier, given, says in (
        (result, arm.first, "identified from"),
        (loaded, arm.later(PAYLOAD), "already has a payload"),
        (blank, log, "uncertainty"),
        (result, two, "2 joints"),
        (result, still, "no joint moves"),
        (result, short, "samples in motion"),
        (result, noise, "no joint's efforts better"),
    ):
        with pytest.raises(bayesid.InputError, match=says):
            identify_payload(earlier, given)
    for sd in (-0.1, np.nan):
        with pytest.raises(bayesid.InputError, match="standard deviation"):
            identify_payload(result, log, common_sd=sd)
    for mass in (0.0, -1.0, np.nan, np.inf, (1.0, -0.1), (1.0, 0.5), (1.0, 2.0, 3.0), "heavy"):
        with pytest.raises(bayesid.InputError, match="mass"):
            identify_payload(result, log, known_mass=mass)


def test_a_mass_that_no_motion_shows_is_refused():
    """One joint about the vertical: gravity never shows a mass."""
    joint = {"a": 0.3, "alpha": 0.0, "d": 0.1, "theta": 0.0}
    robot = bayesid.load_robot({"name": "turntable", "convention": "standard", "joints": [joint]})
    motions, rng = [smooth_motion(1, 8.0, 50.0, seed=k) for k in (1, 2)], np.random.default_rng(0)
    model = bayesid.Model.of(robot, TERMS, motions[0])
    theta = bayesid.random_parameters(model, rng=rng)
    first, second = (bayesid.simulate(model, theta, motion, rng=rng, noise=0.03) for motion in motions)
    result = bayesid.identify(robot, first, TERMS, complete="off", posterior=False)
    with pytest.raises(bayesid.InputError, match="does not show the mass"):
        identify_payload(result, second)


@pytest.mark.long
def test_intervals_cover():
    """Of 24 cases and ten numbers each: no number is covered less often than one in 10,000 such studies would."""
    inside = np.array(
        [
            [
                one.interval[0] <= true <= one.interval[1]
                for one, true in zip(numbers(reading(k).body), TRUTH, strict=True)
            ]
            for k in ALL
        ]
    )
    least = binom.ppf(1e-4 / 10, len(ALL), 0.95)
    assert (inside.sum(axis=0) >= least).all(), inside.sum(axis=0)
    assert inside.mean() >= 0.9


@pytest.mark.long
@pytest.mark.parametrize("loaded", [True, False])
def test_false_alarms_and_changes_that_are_seen(loaded):
    passed = [reading(k, loaded).check.passed for k in ALL]
    shown = [reading(k, loaded).body.shown for k in ALL]
    changed = [reading(k, loaded, friction=(k % 3 + 1, 1.4)).check for k in ALL]
    assert sum(passed) >= binom.ppf(1e-3, len(ALL), 1.0 - UnchangedCheck.FALSE_ALARM)
    assert sum(shown) == (len(ALL) if loaded else 0)
    assert [one.passed for one in changed] == [False] * len(ALL)
    assert all(k % 3 + 1 in one.joints for k, one in zip(ALL, changed, strict=True))


@pytest.mark.long
@pytest.mark.real
def test_a_real_payload():
    """2.805 kg on a UR10e, the gains of these logs some 10 % high; and nothing where there is nothing."""
    robot = real_log("ur10e/robot.toml")
    first = bayesid.read_log(real_log("ur10e/c_unloaded.csv"), unsigned="all")
    result = bayesid.identify(robot, first)
    read = identify_payload(result, bayesid.read_log(real_log("ur10e/c_loaded.csv"), unsigned="all"), known_mass=2.805)
    none = identify_payload(result, bayesid.read_log(real_log("ur10e/a_50s.csv"), unsigned="all"))
    assert read.body.mass.value == pytest.approx(3.07, abs=0.1)
    assert read.gain_factor.value == pytest.approx(0.91, abs=0.03)
    assert read.check.passed
    assert not none.body.shown
    assert none.check.passed
