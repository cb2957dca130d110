import pickle
import sys
from dataclasses import fields, replace

import numpy as np
import pytest
from conftest import real_log
from tracked_arm import RATE, T, changed, identified, right_share, run, stream, truth

import bayesid
from bayesid.effects import RigidBody
from bayesid.effects.friction import CoulombFriction
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.identification.identification import Identification
from bayesid.monitor.changes import Window, kind_of
from bayesid.monitor.running_model import RunningModel
from bayesid.monitor.tracker import SignTracker
from bayesid.motion import STANDSTILL


@pytest.mark.parametrize(("lag", "least"), [(0.0, 0.99), (0.05, 0.997)])
def test_signs(lag, least):
    motion, effort = stream()
    tracker, records = run(motion, effort, lag=lag)
    assert tracker.lag == lag
    assert right_share(records, motion, effort) >= least
    assert not tracker.alarms
    assert tracker.counts.updates == len(T)


def test_efforts_residuals_and_predictions_belong_to_the_same_instant():
    motion, effort = stream()
    for lag in (0.0, 0.05):
        _, records = run(motion, effort, lag=lag, rows=slice(0, 400))
        last = records[-1]
        k = np.argmin(np.abs(motion.t - last.t))
        assert abs(motion.t[399] - last.t - lag) < 1e-9
        np.testing.assert_allclose(np.abs(last.effort), np.abs(effort[k]))
        np.testing.assert_allclose(last.residual, last.effort - last.predicted)
        np.testing.assert_allclose(last.q, motion.q[k], atol=1e-4)
        scale = np.abs(effort).max(axis=0)
        predicted = identified().predict(motion, noise=False).mean[k]
        assert (np.abs(last.predicted - predicted) < 0.02 * scale).all()


def test_a_joint_with_a_sign_keeps_it():
    motion, effort = stream()
    tracker = SignTracker(identified(), RATE, signed=[False, True, False])
    records = [tracker.update(t, q, e) for t, q, e in zip(motion.t[:300], motion.q, effort, strict=False)]
    for record, e in zip(records[50:], effort[50:300], strict=True):
        assert record.probability[1] == float(e[1] >= 0.0)
        assert record.effort[1] == e[1]
        assert abs(record.effort[0]) == abs(e[0])


@pytest.mark.parametrize("lag", [0.0, 0.2])
def test_a_record_is_of_the_sample_one_lag_before(lag):
    """Its time never decreases, nor lies before the first sample or in a gap; unknown values are nan."""
    motion, effort = stream()
    motion = replace(motion, t=motion.t + 0.37)
    tracker, first = run(motion, effort, rows=slice(0, 150), lag=lag)
    rest = run(motion, effort, tracker, slice(300, 450))[1]
    for records, begin in ((first, 0), (rest, 300)):
        t, samples = [record.t for record in records], motion.t[begin : begin + 150]
        assert (t[0], t[-1]) == (samples[0], samples[149 - round(lag * RATE)])
        assert set(t) <= set(samples)
        assert (np.diff(t) >= 0.0).all()
        assert np.isnan(records[0].external).all()
        known = np.array([np.isfinite(record.external).all() for record in records])
        limited = np.array([np.isfinite(record.threshold).all() for record in records])
        assert (known == limited).all()
        assert known[60:].all()
    assert tracker.counts.gaps == 1
    assert rest[0].state == ("unknown",) * 3
    assert (first[0].probability == 0.5).all()
    nothing = SignTracker(identified(), RATE, lag).update(0.0, [np.nan] * 3, np.zeros(3))
    assert np.isnan(nothing.t)
    assert not nothing.fresh


def same(one, other):
    """Whether two records are exactly equal."""
    pairs = [(getattr(one, field.name), getattr(other, field.name)) for field in fields(one)]
    return all(np.array_equal(a, b, equal_nan=True) if isinstance(a, np.ndarray) else a == b for a, b in pairs)


def test_a_restart_continues_exactly():
    (motion, effort), lag = stream(2, changed(Fc2=2.5)), 0.05
    tracker, _ = run(motion, effort, rows=slice(0, 700), lag=lag)
    state = tracker.state()
    kept = pickle.dumps(state)
    other = SignTracker(identified(), RATE, lag=lag)
    other.restore(pickle.loads(kept))
    rest = slice(700, 1500)
    first, second = (run(motion, effort, one, rest)[1] for one in (tracker, other))
    assert all(same(a, b) for a, b in zip(first, second, strict=True))
    assert tracker.alarms == other.alarms
    assert tracker.alarms
    assert pickle.dumps(state) == kept, "a state is a copy"


def test_late_repeated_and_missing_samples_are_counted_and_change_nothing():
    motion, effort = stream()
    clean, expected = run(motion, effort, rows=slice(0, 300))
    tracker, records = SignTracker(identified(), RATE), []
    for k in range(300):
        records.append(tracker.update(motion.t[k], motion.q[k], np.abs(effort[k])))
        if k == 100:
            t, q = motion.t[k], motion.q[k]
            for bad in ((t, q), (motion.t[k - 3], q), (t + 0.001, [np.nan, 0.0, 0.0]), (np.nan, q)):
                assert not tracker.update(*bad, np.abs(effort[k])).fresh
    assert all(same(a, b) for a, b in zip(records, expected, strict=True))
    counts = tracker.counts
    assert (counts.updates, counts.repeated, counts.late, counts.missing, counts.gaps) == (300, 1, 1, 2, 0)


def test_a_missing_effort_has_the_models_sign():
    motion, effort = stream()
    tracker, _ = run(motion, effort, rows=slice(0, 200))
    reading = np.abs(effort[200])
    reading[1] = np.nan
    record = tracker.update(motion.t[200], motion.q[200], reading)
    assert tracker.counts.unread == 1
    assert np.isnan(record.effort[1])
    assert not np.isnan(record.effort[[0, 2]]).any()
    assert (record.probability[1] > 0.5) == (record.predicted[1] > 0.0)
    assert np.isfinite(record.external).all()
    assert len(tracker.window()) == 200, "a missing effort is not an effort of zero"


def test_a_clock_reset():
    """It is detected at the fifth sample, which is the first that counts; then the tracker restarts."""
    motion, effort = stream()
    tracker, _ = run(motion, effort, rows=slice(0, 1000))
    later = replace(motion, t=motion.t - 400.0)
    _, records = run(later, effort, tracker, slice(1000, 2500))
    counts = tracker.counts
    assert (counts.set_back, counts.late, counts.updates, counts.gaps) == (1, 4, 2500 - 4, 0)
    assert not any(record.fresh for record in records[:4])
    assert all(record.fresh for record in records[4:])
    assert records[4].state == ("unknown",) * 3
    assert right_share(records[4:], later, effort) > 0.99
    assert not tracker.alarms
    window = tracker.window()
    assert window.t[0] == later.t[1004]
    assert len(window) == 1496


def test_neither_objects_nor_the_state_grow_with_updates():
    motion, effort = stream()
    tracker, period = SignTracker(identified(), RATE, lag=0.05), 1200  # samples of the motion
    for k in range(2000):
        if k == 500:
            blocks, size = sys.getallocatedblocks(), len(pickle.dumps(tracker.state()))
        tracker.update(k / RATE, motion.q[k % period], np.abs(effort[k % period]))
    assert not tracker.alarms
    assert sys.getallocatedblocks() - blocks < 500  # one per update would be 1,500 blocks
    assert len(pickle.dumps(tracker.state())) < 1.5 * size


def test_thresholds_are_valid_from_the_start():
    """With encoder noise: 3600 false contacts per hour are 1 % of the observer's independent values."""
    motion, effort = stream()
    tracker, rng, beyond = SignTracker(identified(), RATE, false_alarms=3600.0), np.random.default_rng(5), []
    for start in rng.integers(0, len(T) - 40, 120):
        tracker.restore(None)
        for k in range(start, start + 40):
            q = motion.q[k] + 1e-4 * rng.standard_normal(3)
            now = tracker.update(motion.t[k], q, np.abs(effort[k]))
            if k < start + 12:
                assert np.isinf(now.threshold).all()
                assert not now.contact
            elif k >= start + 13:
                beyond.append(np.abs(now.external) > now.threshold)
    shares = np.array(beyond).reshape(120, 27, 3).mean(axis=(0, 2))
    assert shares[:9].mean() <= 0.01, shares
    assert shares[9:].mean() <= 0.01, shares


def pushed(joint, size, start, length=0.2):
    """A stream with a push on a joint (from 1) by a share of its largest effort: M ddq = tau + push."""
    motion, effort = stream()
    during = (motion.t >= start) & (motion.t < start + length)
    torque = size * np.abs(effort).max(axis=0)[joint - 1]
    effort = effort.copy()
    effort[during, joint - 1] -= torque
    return motion, effort, torque, during


@pytest.mark.parametrize("joint", [1, 3])
def test_external_torque_is_that_of_the_push(joint):
    motion, _ = stream()
    quiet = np.flatnonzero(np.abs(motion.dq[:, joint - 1]) > 0.3 * motion.top_speed[joint - 1])
    strong = np.abs(stream()[1][:, joint - 1]) > 0.4 * np.abs(stream()[1][:, joint - 1]).max()
    start = motion.t[next(k for k in quiet if k > 200 and strong[k - 5 : k + 60].all())]
    sign = np.sign(stream()[1][int(start * RATE), joint - 1])
    motion, effort, torque, during = pushed(joint, -0.3 * sign, start, 0.4)  # away from zero: the sign stays
    _, records = run(motion, effort)
    after_transient = np.flatnonzero(during)[20:]
    external = np.array([records[k].external for k in after_transient])
    limit = np.array([records[k].threshold for k in after_transient])
    expected = np.zeros(3)
    expected[joint - 1] = torque
    assert (np.abs(external - expected) < limit).all()


def test_pushes_are_found_in_time_and_distinguished_from_changes():
    motion, _ = stream()
    times = np.arange(2.0, 28.0, 1.3)
    joints = 1 + np.arange(len(times)) % 3
    sizes = np.random.default_rng(3).uniform(0.15, 0.4, len(times)) * np.where(np.arange(len(times)) % 2, 1, -1)
    effort = stream()[1].copy()
    for start, joint, size in zip(times, joints, sizes, strict=True):
        effort += pushed(joint, size, start)[1] - stream()[1]
    tracker, _ = run(motion, effort)
    assert {alarm.kind for alarm in tracker.alarms} == {"contact"}
    found = [next((a for a in tracker.alarms if start <= a.time <= start + 0.25), None) for start in times]
    hits = [(a, start, joint) for a, start, joint in zip(found, times, joints, strict=True) if a is not None]
    assert len(hits) >= 0.9 * len(times)  # |tau - push| = |tau| if the push is twice the torque: it is invisible
    assert all(alarm.joint == joint for alarm, _, joint in hits)
    assert np.median([alarm.time - start for alarm, start, _ in hits]) <= 0.06
    assert len(tracker.alarms) == len(hits)


def with_payload():
    """A body of 1.5 kg at the flange, in the parameters of the last link (with its first moment)."""
    model, theta = truth()
    theta = theta.copy()
    added = {"m3": 1.5, "mcx3": 0.1, "mcy3": -0.05, "mcz3": 0.15, "Jxx3": 0.05, "Jyy3": 0.05, "Jzz3": 0.05}
    for k, parameter in enumerate(model.parameters):
        theta[k] += added.get(parameter.name, 0.0)
    return tuple(theta.tolist())


def with_gain(factor):
    motion, effort = stream()
    return motion, effort * np.array([1.0, factor, 1.0])


@pytest.mark.parametrize(
    ("streamed", "kind", "joint", "least", "most"),
    [
        (stream(2, with_payload()), "payload", None, 1.2, 1.8),
        (stream(2, changed(Fc3=2.5, Fv3=2.0)), "friction", 3, 0.0, np.inf),
        (with_gain(0.6), "gain", 2, -0.5, -0.3),
    ],
    ids=["payload", "friction", "gain"],
)
def test_changes_are_named(streamed, kind, joint, least, most):
    tracker, records = run(*streamed)
    changes = [alarm for alarm in tracker.alarms if alarm.kind != "contact"]
    assert {alarm.kind for alarm in changes} == {kind}
    assert joint in (None, changes[0].joint)
    assert changes[0].raised - changes[0].time < 3.0
    assert least < changes[0].amount < most
    assert "unknown" in records[-1].state


def test_the_window_of_a_change_is_a_log_for_a_discrepancy():
    tracker, _ = run(*stream(2, with_payload()), rows=slice(0, 1900))
    change = next(alarm for alarm in tracker.alarms if alarm.kind != "contact")
    window = tracker.window(since=change.time)
    assert window.n_joints == 3
    assert (window.t[0], window.t[-1]) == (change.time, T[1899])
    assert not window.signed.any()
    found = bayesid.find_discrepancy(identified(), window)
    assert "payload" in {name for effect in found.added for name in (effect.effect, *effect.equivalent)}


def test_invalid_options_and_samples_are_refused():
    bad = {"rate": [0.0, np.nan], "lag": [-1.0, 3.0], "signed": [[True]], "payload": ["tool1"], "false_alarms": [0.0]}
    for name, values in bad.items():
        for value in values:
            with pytest.raises(InputError):
                SignTracker(identified(), **{"rate": RATE, name: value})
    tracker = SignTracker(identified(), RATE)
    tracker.update(0.0, [0.0, 0.1, 0.2], [1.0, 2.0, 3.0])
    for call in (
        lambda: tracker.update(0.01, [0.0, 0.1, 0.2], [1.0, 2.0, 3.0], dq=[0.0, 0.0, 0.0]),
        lambda: tracker.update(0.01, [0.0, 0.1], [1.0, 2.0, 3.0]),
        SignTracker(identified(), RATE).window,
        lambda: SignTracker(identified(), 2 * RATE).restore(tracker.state()),
    ):
        with pytest.raises(InputError):
            call()


@pytest.fixture(scope="module")
def ur10e() -> Identification:
    log = bayesid.read_log(real_log("ur10e/a_50s.csv"), unsigned="all")
    return bayesid.identify("ur10e", log, posterior=False)


@pytest.mark.real
@pytest.mark.parametrize(("lag", "least", "name"), [(0.0, 0.99, "b_20s"), (0.05, 0.997, "c_unloaded")])
def test_real_streams(ur10e, name, lag, least):
    log = bayesid.read_log(real_log(f"ur10e/{name}.csv"))
    tracker = SignTracker(ur10e, RATE, lag)
    records = [
        tracker.update(t, q, np.abs(e), dq) for t, q, e, dq in zip(log.t, log.q, log.effort, log.dq, strict=True)
    ]
    k = np.searchsorted(log.t, [record.t - 1e-4 for record in records])
    probability = np.array([record.probability for record in records])
    used = (np.abs(log.effort) >= 0.05 * np.abs(log.effort).max(axis=0))[k]
    used &= (np.abs(log.dq) > 0.01 * np.abs(log.dq).max(axis=0))[k]
    used &= np.array([record.t >= log.t[0] for record in records])[:, None]
    right = (probability > 0.5) == (log.effort[k] > 0.0)
    assert right[used].mean() >= least
    sure = used & (np.maximum(probability, 1.0 - probability) >= 0.99)
    assert 1.0 - right[sure].mean() <= 0.003
    assert not tracker.alarms


@pytest.mark.real
def test_a_real_payload(ur10e):
    """Streamed to the model of the unloaded arm: classified within 2 s of motion."""
    loaded = bayesid.read_log(real_log("ur10e/c_loaded.csv"), unsigned="all")
    tracker = SignTracker(ur10e, RATE)
    for t, q, e, dq in zip(loaded.t, loaded.q, loaded.effort, loaded.dq, strict=True):
        tracker.update(t, q, e, dq)
    (alarm,) = tracker.alarms
    assert alarm.kind == "payload"
    assert alarm.raised - alarm.time <= 2.0
    assert abs(alarm.amount - 3.0) < 0.3  # 2.8 kg by currents that read 7 % too much


def test_a_misfit_that_no_kind_explains_is_unknown(rng):
    effort, off = 5.0 * rng.standard_normal((300, 2)), np.array([0.0, 3.0])
    speed, ones = rng.standard_normal((300, 2)), np.ones((300, 2))
    reading, body = effort + off * rng.standard_normal((300, 2)), rng.standard_normal((300, 2, 4))
    window = Window(reading, effort, ones, body, np.sign(speed), speed, np.array([True, True]), np.ones(2))
    kind = kind_of(window, off > 0.0)
    assert (kind.name, kind.joints, kind.amount) == ("unknown", (2,), None)
    assert kind.explained < 0.1


def test_a_joint_without_dry_friction_stands_still_below_a_share_of_its_highest_speed():
    friction = CoulombFriction(joints=(2,), smoothing=(0.3,))
    bare = Model(truth()[0].robot, (RigidBody(), friction))
    running = RunningModel(replace(identified().identified, model=bare))
    np.testing.assert_allclose(running.resting_speeds(np.array([1.0, 2.0, 4.0])), [STANDSTILL, 0.3, 4.0 * STANDSTILL])
