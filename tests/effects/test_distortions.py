from dataclasses import replace

import numpy as np
import pytest
from distorted_arms import BEGIN, FASTEST, RATE, READ, TABLES, cubics, shared_arm, sines
from oracles import assert_close

from bayesid.effects.catalogue import DISTORTIONS, make_effect
from bayesid.effects.distortion import SensorDistortion
from bayesid.effects.tuning import TUNING

DECAY = 2.0 - np.sqrt(3.0)  # of what a cubic spline's end does, per knot
NOT_THE_FIRST = slice(20, None)  # at the beginning a delayed motion is not known
READINGS = [name for name, kind in DISTORTIONS.items() if issubclass(kind, SensorDistortion)]  # the others change rows
OF_TABLE = {"link_length": "a", "link_twist": "alpha", "link_offset": "d", "joint_zero": "zero"}
OF_ROBOT = ("base_tilt", "gear_ratio", *OF_TABLE)  # what changes the robot or its motion acts in all joints
TUNED = [name for name in DISTORTIONS if np.any(np.greater(DISTORTIONS[name].typical, 0.0))]


@pytest.fixture(params=TABLES)
def arm(request):
    return shared_arm(request.param, sines)


@pytest.fixture
def sliding():
    """The arm with a joint that slides, for what is the same with every robot."""
    return shared_arm("random", sines)


def each(arm, names=DISTORTIONS):
    return [arm.distortion(name) for name in names]


def test_each_distortion_has_an_entry_here():
    assert set(READ) == set(DISTORTIONS)
    assert set(READINGS) == {"clipping", "dead_zone", "dead_zone.shrinking"}


@pytest.mark.parametrize("name", DISTORTIONS)
@pytest.mark.parametrize("table", TABLES)
def test_efforts_are_read_as_by_hand(name, table):
    """A delay included: splines follow cubics, also before the beginning."""
    arm = shared_arm(table, cubics)
    distortion = arm.distortion(name)
    distorted = arm.model.extend(distortion)
    assert arm.model.distortions == ()
    assert distorted.distortions == (distortion,)
    expected = arm.read(distortion)
    assert_close(distorted.effort(arm.motion, arm.theta), expected, 1e-10)
    assert np.abs(expected - arm.effort).max() > 0.01 * np.abs(arm.effort).max()


@pytest.mark.parametrize("table", TABLES)
def test_delay_is_an_earlier_motion_up_to_the_splines_error(table):
    """The error of a cubic spline is 5/384 h^4 of the fourth derivative."""
    errors = []
    for rate in (RATE / 4, RATE / 2):
        arm = shared_arm(table, sines, rate)
        delay = arm.distortion("delay")
        found = arm.model.extend(delay).effort(arm.motion, arm.theta)
        late = arm.t > BEGIN + 0.4
        errors.append(np.abs(found - arm.read(delay))[late].max() / np.abs(arm.effort).max())
        assert errors[-1] < 10 * 5 / 384 * (FASTEST / rate) ** 4
    assert errors[0] > 10 * errors[1]


def test_other_joints_are_left_alone(sliding):
    arm = sliding
    n, healthy = arm.robot.n_joints, arm.model.effort(arm.motion, arm.theta)
    for distortion in each(arm, [name for name in DISTORTIONS if name not in OF_ROBOT]):
        all_of_it = arm.model.extend(distortion).effort(arm.motion, arm.theta)
        ((key, values),) = distortion.shape.items()
        for joints in ((2,), (3, 1)):
            own = np.array(joints) - 1
            shape = {key: [values[i] for i in own] if len(values) == n else values, "joints": joints}
            part = make_effect(distortion.name, shape)
            part.check(n)
            expected = healthy.copy()
            expected[:, own] = all_of_it[:, own]
            found = arm.model.extend(part).effort(arm.motion, arm.theta)
            np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)
            shift, slopes = part.change(arm.scene)
            others = np.delete(np.arange(n), own)
            assert shift[:, own].any(axis=0).all()
            assert not shift[:, others].any()
            assert not slopes[:, others].any()


def test_what_is_restored_is_what_was_there(sliding):
    size = np.abs(sliding.effort)
    for distortion in each(sliding):
        magnitude = np.abs(distortion.measured(sliding.effort))
        restored, valid = distortion.restored(magnitude)
        np.testing.assert_allclose(restored[valid], size[valid], rtol=1e-14, atol=0)
        if distortion.name not in READINGS:
            np.testing.assert_array_equal(magnitude, size)
            assert valid.all()
            continue
        assert all(0.2 < share < 0.95 for share in valid.mean(axis=0))
        clips = distortion.name == "clipping"
        sure = size < 0.9 * np.array(distortion.limit) if clips else size > 1.4 * np.array(distortion.width)
        assert valid[sure].all()


def test_readings_are_restored_from_the_last_distortion_to_the_first(sliding):
    arm = sliding
    size = np.sqrt(np.mean(arm.effort**2, axis=0))
    shrinking = make_effect("dead_zone.shrinking", {"width": 0.3 * size})
    clipping = make_effect("clipping", {"limit": 0.9 * size})
    effort = arm.effort
    for first, last, highest in ((shrinking, clipping, 0.9 * size), (clipping, shrinking, 0.6 * size)):
        model = arm.model.extend(first).extend(last)
        read = model.read(effort)
        np.testing.assert_array_equal(read, last.measured(first.measured(effort)))
        np.testing.assert_allclose(np.abs(read).max(axis=0), highest, rtol=1e-14)
        restored, valid = model.invert_sensor(np.abs(read))
        np.testing.assert_allclose(restored[valid], np.abs(effort)[valid], rtol=1e-14, atol=0)
        middle = (np.abs(effort) > 0.5 * size) & (np.abs(effort) < 0.8 * size)
        assert middle.any(axis=0).all()
        assert valid[middle].all()
        assert not valid[(np.abs(effort) < 0.3 * size) | (np.abs(effort) > 1.25 * size)].any()


def test_distortions_of_rows_come_before_those_of_readings(arm):
    gain, tilt = arm.distortion("gain_error"), arm.distortion("base_tilt")
    clipping, delay = arm.distortion("clipping"), arm.distortion("delay")
    model = arm.model.extend(gain).extend(tilt).extend(clipping)
    expected = np.clip(arm.read(tilt) * gain.gain, -np.array(clipping.limit), clipping.limit)
    assert_close(model.effort(arm.motion, arm.theta), expected, 1e-11)
    twice = arm.model.extend(delay).extend(gain).extend(delay)
    once = arm.model.extend(make_effect("delay", {"lag": (2 * delay.lag[0],)})).extend(gain)
    found, expected = (one.effort(arm.motion, arm.theta)[NOT_THE_FIRST] for one in (twice, once))
    assert_close(found, expected, 20 * 5 / 384 * (FASTEST / RATE) ** 4)


def test_chunks_have_the_columns_of_the_whole(monkeypatch, sliding):
    """A spline feels its end less by `DECAY` with every knot from there; the error at the end is of fourth order."""
    motion, theta = sliding.motion, sliding.theta
    for distortion in each(sliding):
        model = sliding.model.extend(distortion)
        whole = model.columns(motion)
        with monkeypatch.context() as chunks:
            chunks.setattr("bayesid.effects.model.TUNING", replace(TUNING, chunk=37, look_back=16))
            error = DECAY**16 * 10 * (FASTEST / RATE) ** 4 if distortion.memory else 0.0
            assert error < 1e-13
            assert_close(np.concatenate([columns for _, columns in model.chunks(motion)]), whole, error + 1e-13)
            assert_close(model.effort(motion, theta), model.read(whole @ theta), 1e-12)
            chunks.setattr("bayesid.effects.model.TUNING", replace(TUNING, chunk=37, look_back=0, look_ahead=0))
            model.forget()
            pieces = np.concatenate([columns for _, columns in model.chunks(motion)])
            assert (np.abs(pieces - whole).max() > 1e-9 * np.abs(whole).max()) == distortion.memory


@pytest.mark.parametrize("name", DISTORTIONS)
def test_change_is_the_difference_that_the_model_makes(arm, name):
    distortion = arm.distortion(name)
    shift, slopes = distortion.change(arm.scene)
    healthy, distorted = (one.effort(arm.motion, arm.theta) for one in (arm.model, arm.model.extend(distortion)))
    error = 1e-12
    if distortion.name == "delay":  # a spline of the effort, with up to three times the motion's frequency
        error += 10 * 5 / 384 * (3 * FASTEST / RATE) ** 4
    error *= np.abs(healthy).max()
    np.testing.assert_allclose(shift[NOT_THE_FIRST], (distorted - healthy)[NOT_THE_FIRST], rtol=0, atol=error)
    assert slopes.shape[:2] == healthy.shape
    numbers = sum(map(len, distortion.shape.values())) if distortion.name in TUNED else 0
    assert slopes.shape[2] == {"base_tilt": 4}.get(distortion.name, numbers)


def test_errors_are_told_a_joint_with_their_units(sliding):
    for name, unit in (("link_length", "m"), ("link_twist", "rad"), ("gear_ratio", "1")):
        distortion = sliding.distortion(name)
        assert [*distortion.numbers(sliding.robot).values()] == [(error, unit) for error in distortion.error]


@pytest.mark.parametrize("name", TUNED)
def test_slopes_are_those_of_the_efforts_by_hand(arm, name):
    distortion, step = arm.distortion(name), 1e-4
    some = slice(NOT_THE_FIRST.start, None, 9)
    _, slopes = distortion.change(arm.scene)
    size = np.abs(arm.effort).max()
    slopes = slopes[:, :, :2] if name == "base_tilt" else slopes  # the others are link 1's weight
    for slope, direction in zip(np.moveaxis(slopes, 2, 0), np.eye(slopes.shape[2]), strict=True):
        up, down = (arm.read(distortion.moved(side * step * direction), arm.t[some]) for side in (1, -1))
        expected = (up - down) / (2 * step)
        error = {
            "gain_error": 1e-11 * size,  # rounding
            "base_tilt": step * size,  # half a step of bayesid's own differences, of gravity's second derivative
            "delay": 10 * (3 * FASTEST / RATE) ** 3 / 24 * 3 * FASTEST * size,  # h^3/24 of the fourth derivative
        }.get(name, step * size)
        assert error < 0.02 * np.abs(expected).max() or (name in OF_TABLE and np.abs(expected).max() < error)
        np.testing.assert_allclose(slope[some], expected, rtol=0, atol=error)


def business_of_others(arm, name):
    """In the modified convention the first a and alpha mount the base; of a joint that slides d is the zero."""
    sliding = {(j,) for j, row in enumerate(arm.table["joints"], start=1) if row.get("type") == "prismatic"}
    first = {(1,)} if arm.table["convention"] == "modified" else set()
    return {"link_length": first, "link_twist": first, "joint_zero": sliding}.get(name, set())


def test_variants_are_distortions_of_this_robot(arm):
    scene = replace(arm.scene, measured=np.abs(arm.distortion("clipping").measured(arm.scene.effort)))
    joints = {(j,) for j in range(1, arm.robot.n_joints + 1)}
    columns = arm.model.columns(arm.motion)
    for name, kind in DISTORTIONS.items():
        variants = list(kind.variants(scene))
        expected = {"delay": {(), *joints}, "base_tilt": {()}}.get(name, joints) - business_of_others(arm, name)
        assert {one.joints for one in variants} == expected
        assert len(set(variants)) == len(variants)
        if name in ("gain_error", "base_tilt", "delay"):
            assert len(variants) == len(expected) * (5 if name == "delay" else 1)
        for one in variants:
            one.check(arm.robot.n_joints)
            assert make_effect(name, one.shape) == one
            assert {type(value) for values in one.shape.values() for value in values} <= {int, float}
        for one in variants[:: max(1, len(variants) // 8)]:
            shift, slopes = one.change(scene)
            assert np.isfinite(shift).all()
            assert np.isfinite(slopes).all()
            assert (slopes.shape[2] > 0) == (name in TUNED)
            if name in TUNED and getattr(one, "lag", (0.0,)) == (0.0,):  # what is tuned begins neutral
                np.testing.assert_allclose(shift, 0.0, rtol=0, atol=1e-13 * np.abs(arm.effort).max())
                np.testing.assert_array_equal(arm.model.extend(one).columns(arm.motion), columns)
                np.testing.assert_array_equal(one.measured(arm.effort), arm.effort)


def test_tilt_may_show_the_weight_of_link_1(arm):
    """Where gravity lies along the first axis: a torque in joint 1 that turns with it, of any size and phase."""
    _, slopes = arm.distortion("base_tilt").change(arm.scene)
    first = arm.robot.joints[0]
    across = np.linalg.norm(np.cross(first.placement[:3, :3] @ first.axis, arm.robot.gravity))
    q1 = arm.motion.q[:, 0]
    waves = np.stack([np.sin(q1), np.cos(q1)], axis=1) if across < 0.1 else np.zeros((len(q1), 2))
    np.testing.assert_allclose(slopes[:, 0, 2:], waves, rtol=1e-14)
    np.testing.assert_array_equal(slopes[:, 1:, 2:], 0.0)
