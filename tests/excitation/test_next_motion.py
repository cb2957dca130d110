from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from open_results import LIMITS, TERMS, earlier_motion, open_result

from bayesid.cli.terminal import in_options
from bayesid.effects.bodies import CarriedPayload
from bayesid.errors import InputError
from bayesid.excitation.next_motion import design_next, slowed
from bayesid.excitation.settings import MotionSettings
from bayesid.excitation.tuning import TUNING
from bayesid.identification.pipeline import identify
from bayesid.log.log import join_logs
from bayesid.simulation.logs import simulate

SENSOR = np.array([0.8, 0.3, 0.1])
EFFORT = (60.0, 8.5, 1.6)
QUICK = 100  # changes that are tried
EFFECTS = ("dead_zone", "hysteresis", "thermal_drift", "payload", "link_length", "gain_error", "base_tilt")
"""Effects of different kinds."""
RUN = MotionSettings(duration=5.0, rate=50.0, limits=replace(LIMITS, jerk=(150.0, 90.0, 120.0), effort=EFFORT))


class Table:
    """The second joint must stay below a height."""

    source, margin, not_checked = "a table", 0.05, ("hand and table (held)",)

    def __init__(self, height):
        self.height = height

    def stays_clear(self, path, t, speed):
        return bool((self.distance(path(np.linspace(t[0], t[-1], 301))) > self.margin).all())

    def distance(self, q):
        return self.height - q[:, 1]

    def nearest(self, q):
        return float(self.height - q[1]), ("arm", "table")


def log_of(truth, motion, seed):
    return simulate(truth.model, truth.theta, motion, rng=np.random.default_rng(seed), signed=True, sensor=SENSOR)


@pytest.fixture(scope="module")
def truth():
    return open_result()


@pytest.fixture(scope="module")
def log(truth):
    return log_of(truth, earlier_motion(), 7)


@pytest.fixture(scope="module")
def result(truth, log):
    return identify(truth.model.robot, log, TERMS, complete="off", posterior=False)


@pytest.fixture(scope="module")
def design(result):
    return design_next(result, settings=replace(RUN, changes=QUICK))


@pytest.mark.parametrize("effect", EFFECTS)
def test_a_motion_is_found_for_every_effect(effect):
    """Within its limits, and better than standing still."""
    strong = replace(RUN, limits=replace(LIMITS, effort=(200.0, 40.0, 9.0)))
    level = 0.03 if effect == "dead_zone" else 0.01  # it grows in steps, from sample to sample
    design = design_next(open_result(effects={effect: level}), settings=replace(strong, changes=12))
    assert np.all(design.largest_effort <= design.feasibility.effort)
    assert np.all(design.predicted.sd <= design.predicted.sd_now * (1.0 + 1e-9))
    assert design.predicted.gain > 0.1


def test_limits_hold_at_every_millisecond_with_the_true_parameters(truth, design):
    t = np.linspace(0.0, 5.0, 5001)
    motion, limits = design.trajectory.motion(t), design.settings.limits
    assert np.all((motion.q >= np.array(limits.lower) - 1e-9) & (motion.q <= np.array(limits.upper) + 1e-9))
    jerk = design.trajectory.basis.values(t, 3) @ design.trajectory.control
    rates = (motion.dq, limits.velocity), (motion.ddq, limits.acceleration), (jerk, limits.jerk)
    for values, limit in rates:
        assert np.all(np.abs(values) <= np.array(limit) * (1.0 + 1e-9))
    true = np.abs(truth.model.effort(motion, truth.theta)).max(axis=0)
    assert np.all(true <= EFFORT)
    assert np.all(true <= design.largest_effort)
    assert np.all(design.largest_effort <= EFFORT)


def test_the_motion_starts_and_ends_at_rest_where_the_log_began(result, design):
    motion = design.motion
    assert len(motion) == 251
    assert motion.t[-1] == 5.0
    np.testing.assert_allclose(motion.q[[0, -1]], np.tile(result.signals.motion.q[0], (2, 1)), atol=1e-12)
    np.testing.assert_allclose(motion.dq[[0, -1]], 0.0, atol=1e-12)
    assert np.abs(motion.dq).max(axis=0).min() > 0.3
    assert design.predicted.gain > design.of_random.gain > 0.0


def test_the_next_motion_states_what_stays_undetermined(design):
    assert f"{design.predicted.open} after its recording" in repr(design)
    assert any("jerks" in sentence for sentence in design.checked)


def test_a_stated_start_and_a_default_start(result):
    run = replace(RUN, duration=3.0, start=(0.1, 0.4, -0.5))
    own = design_next(result, settings=replace(run, changes=10))
    np.testing.assert_allclose(own.motion.q[[0, -1]], [run.start, run.start], atol=1e-12)
    loaded = design_next(result.identified, settings=replace(RUN, duration=3.0, changes=10))
    middle = 0.5 * (np.array(LIMITS.lower) + np.array(LIMITS.upper))
    np.testing.assert_allclose(loaded.motion.q[0], middle, atol=1e-12)


def test_a_collision_model_keeps_the_robot_off_the_table(result, design):
    height = 0.5 * (design.motion.q[0, 1] + design.motion.q[:, 1].max())
    assert height > design.motion.q[0, 1] + 0.1
    run = replace(RUN, clearance=Table(height))
    kept = design_next(result, settings=replace(run, changes=QUICK))
    assert kept.trajectory.motion(np.linspace(0.0, 5.0, 5001)).q[:, 1].max() < height - 0.049
    assert not any("collisions" in sentence for sentence in kept.unchecked)


def test_predicted_deviations_agree_with_an_identification_of_both_logs(truth, log, result, design):
    """Standard deviations depend on the estimated noise, known to 5 %, and on its correlation time."""
    both = join_logs([log, log_of(truth, design.motion, 8)])
    found = identify(truth.model.robot, both, TERMS, complete="off", posterior=False)
    assert found.coefficients.names == design.predicted.names
    ratio = design.predicted.sd / found.sd
    assert np.all((ratio > 0.8) & (ratio < 1.25))
    assert np.median(ratio) == pytest.approx(1.0, abs=0.12)
    assert np.median(design.predicted.sd_now / found.sd) > 2.0  # so it is no wonder of a small change
    np.testing.assert_allclose(design.predicted.sd_now, result.sd, rtol=1e-6)
    assert design.predicted.open_now == len(found.sd) - result.n_known
    assert abs(design.predicted.open - (len(found.sd) - found.n_known)) <= 3  # those whose sd is near a tenth
    np.testing.assert_array_equal(design.predicted.sd_lacking, design.predicted.sd)  # nothing is said to be lacking


def test_a_motion_for_one_coefficient_determines_it_better(result, design):
    """For the two criteria: the friction of joint 2 alone."""
    place = design.predicted.names.index("Fc2")
    for criterion in ("D", "A"):
        about = design_next(result, ["Fc2"], settings=replace(RUN, changes=QUICK), criterion=criterion)
        assert about.goal.names == ("Fc2",)
        assert about.predicted.sd[place] < design.predicted.sd[place]


def test_a_designed_motion_distinguishes_better_than_a_random_one(result):
    pair = ("stribeck_friction:3", "thermal_drift:3")
    telling = design_next(result.identified, between=pair, settings=replace(RUN, duration=3.0, changes=QUICK))
    assert set(telling.predicted.log10_bayes_factors) == {pair, pair[::-1]}
    assert telling.goal is None
    assert telling.predicted.gain == 0.0
    assert all(f"{true} against {other}" in repr(telling) for true, other in (pair, pair[::-1]))
    told, by_random = (
        sum(
            min(value, 2.0 * TUNING.decisive) for value in one.log10_bayes_factors.values()
        )  # what is clear counts no more
        for one in (telling.predicted, telling.of_random)
    )
    assert told > 1.5 * by_random


def test_a_payload_is_determined_only_if_the_motion_carries_it():
    carrying = open_result(terms=(*TERMS, CarriedPayload(label=("tool",))))
    run = replace(RUN, effort_limits=(150.0, 80.0, 30.0))
    empty = design_next(carrying, ["Fc2"], settings=replace(run, changes=QUICK))
    loaded = design_next(carrying, ["payload"], settings=replace(run, payload="tool", changes=QUICK))
    places = [loaded.predicted.names.index(name) for name in loaded.goal.names]
    assert len(places) == 10
    before, without, after = loaded.predicted.sd_now[places], empty.predicted.sd[places], loaded.predicted.sd[places]
    np.testing.assert_allclose(without, before, rtol=1e-6)
    assert np.sum(after < 0.5 * before) >= 5
    assert set(loaded.motion.payload) == {"tool"}
    assert np.any(loaded.of_random.sd[places] < 0.9 * before)  # the random one carries it too
    mean, _ = loaded.effort_band
    np.testing.assert_allclose(mean, carrying.model.effort(loaded.motion, carrying.theta), atol=1e-8)
    near = design_next(carrying, ["payload"], settings=replace(run, payload="tool", clearance=Table(1.7), changes=2))
    assert any(sentence.startswith("distances of tool:") for sentence in near.unchecked)


def test_what_was_not_checked_is_listed(result):
    for limits, clearance, words in (
        ({}, None, ("efforts: no limits are known", "jerks", "collisions")),
        ({"effort": (60.0, np.inf, 1.6), "jerk": 150.0}, None, ("efforts of joints 2:", "collisions")),
        ({"effort": 70.0, "jerk": 150.0}, Table(1.7), ("distances of hand and table (held)",)),
    ):
        run = replace(RUN, duration=2.0, limits=replace(LIMITS, **limits), clearance=clearance)
        unchecked = design_next(result, settings=replace(run, changes=2)).unchecked
        assert len(unchecked) == len(words)
        assert all(word in sentence for sentence, word in zip(unchecked, words, strict=True))


def test_slower_motions_take_longer_and_less_effort(design):
    slow, whole = slowed(design.trajectory, 0.3, 120.0), design.trajectory
    assert slow.t[-1] == pytest.approx(5.0 / 0.3)
    np.testing.assert_allclose(slow.q, whole.motion(0.3 * slow.t).q, atol=1e-12)
    np.testing.assert_allclose(np.gradient(slow.q, slow.t, axis=0)[1:-1], slow.dq[1:-1], atol=2e-3)
    np.testing.assert_allclose(np.gradient(slow.dq, slow.t, axis=0)[1:-1], slow.ddq[1:-1], atol=1e-2)


def test_allowed_speeds_are_those_within_effort_limits(truth, design):
    """Efforts are checked at each speed, as friction depends on it."""
    for share in (0.1, 0.3, 1.0):
        duration = 5.0 / share
        motion = slowed(design.trajectory, share, 2000.0 / duration)
        columns = design.known.columns(motion)
        mean, sd = (
            columns @ design.known.mean,
            np.sqrt(np.einsum("njr,rs,njs->nj", columns, design.known.covariance_now, columns)),
        )
        holds = np.all(np.abs(mean) + TUNING.effort_sds * sd <= EFFORT)
        assert (share in design.allowed_speeds) == holds


def assert_refused(call, where, *words):
    with pytest.raises(InputError) as caught:
        call()
    said = in_options(str(caught.value))
    assert said.startswith(where)
    assert "\n" not in said
    assert all(word in said for word in words)


def test_invalid_settings_are_refused(result):
    for run, options, where, words in (
        ({"start": (0.1, 0.2)}, {}, "--start", ("2 numbers", "3 joints")),
        ({"start": (0.1, 0.2, float("nan"))}, {}, "--start", ()),
        ({"start": (-1.5, 0.2, 0.1)}, {}, "--start", ("joint 1 starts at -1.5", "-1.4 to 0.9")),
        ({"limits": replace(LIMITS, velocity=(1.0, 2.0))}, {}, "--limits", ("2 numbers",)),
        ({"limits": replace(LIMITS, effort=(1.0, 2.0))}, {}, "--limits", ("'effort'",)),
        ({"limits": replace(LIMITS, effort=(60.0, 0.4, 60.0))}, {}, "--limits", ("joint 2 may need", "0.4 N m")),
        ({"clearance": Table(0.1), "start": (0.0, 0.4, 0.0)}, {}, "--start", ("-0.300 m", "0.05 m")),
        ({}, {"about": ["Fc2"], "between": ["torque_offset:1", "joint_spring:1"]}, "--between", ()),
        ({}, {"between": ["torque_offset:1"]}, "--between", ()),
        ({}, {"about": ["Fc8"]}, "--about", ("Fc8",)),
        ({}, {"criterion": "E"}, "--criterion", ("'E'", "D or A")),
        ({"changes": 0}, {}, "--changes", ()),
    ):
        run = {"changes": 1, **run}
        assert_refused(
            lambda run=run, more=options: design_next(result, settings=replace(RUN, **run), **more), where, *words
        )
    with pytest.raises(InputError, match=r"'result' is not a result.*bayesid.load"):
        design_next("result")


def test_model_error_of_the_draws_stays_after_a_recording(result):
    theta = result.theta + 1e-3 * np.random.default_rng(4).standard_normal((2, 300, len(result.theta)))
    wide = theta[0] + 0.1 * (theta[1] - result.theta) / 1e-3
    draws, uncertain = (SimpleNamespace(theta=one) for one in (theta[0], wide))
    prior = SimpleNamespace(sd=np.ones(len(result.theta)))
    posterior = SimpleNamespace(
        **{"log_gain": None, "shift": wide - theta[0], "draws": draws, "uncertain": uncertain},
        target=SimpleNamespace(prior=prior),
        decided_by_constraints=lambda rows: np.zeros(len(rows), dtype=bool),
        covariance=result.covariance,
        interval=lambda share: result.interval_95,
    )
    run = MotionSettings(duration=2.0, rate=50.0, limits=LIMITS)
    told = design_next(replace(result, posterior=posterior), settings=replace(run, changes=1)).predicted
    wider, narrow = (result.coefficients.project(one.theta).var(axis=0, ddof=1) for one in (uncertain, draws))
    np.testing.assert_allclose(told.sd_lacking**2 - told.sd**2, wider - narrow, rtol=1e-6)
    posterior.shift = None
    told = design_next(replace(result, posterior=posterior), settings=replace(run, changes=1)).predicted
    np.testing.assert_array_equal(told.sd_lacking, told.sd)
