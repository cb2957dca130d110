import pkgutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
import pytest
from oracles import (
    actuator_efforts,
    assert_close,
    built_in_table,
    dh_chain,
    gear,
    joint_torques,
    parameters_of,
    random_clouds,
    random_table,
    turn,
)

import bayesid.model.distortions
from bayesid.model.catalogue import make_effect
from bayesid.model.distortions import CATALOGUE, Distortion
from bayesid.model.effects import Scene
from bayesid.model.model import Model
from bayesid.model.robot import robot_from_table
from bayesid.motion import Motion

TABLES = {
    "tx40": built_in_table("tx40"),  # coupled wrist, gravity along -z
    "random": random_table("modified", 4, seed=1),  # a joint that slides, gravity along none of the axes
}
BEGIN, RATE, FASTEST, WARMING = 3.0, 100.0, 3.0, 0.7  # s, Hz, rad/s, s
DECAY = 2.0 - np.sqrt(3.0)  # of what a cubic spline's end does, per knot
NOT_THE_FIRST = slice(20, None)  # at the beginning a delayed motion is not known


# ---------------------------------------------------------------------------------------------------------------
# Every distortion, written by hand
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Entry:
    """What a distortion of the catalogue does.

    Attributes:
        read: (N, n) of the healthy efforts (a function of the robot's table and of times), the table, the times, and
            the numbers by name.
        numbers: for joints whose efforts have these RMS values (n,).
    """

    read: Callable
    numbers: Callable


def turned(gravity, first_angle, second_angle):
    """Gravity about the base's axis furthest from it, made perpendicular to it, and about one across both."""
    gravity = np.array(gravity)
    down = gravity / np.linalg.norm(gravity)
    first = np.zeros(3)
    first[np.abs(gravity).argmin()] = 1.0
    first = first - down * (down @ first)
    first = first / np.sqrt(first @ first)
    vector = first_angle * first + second_angle * np.cross(first, down)
    angle = np.linalg.norm(vector)
    return turn(vector / angle, angle) @ gravity if angle else gravity


def off(table, number, error):
    """The table with this number of each row larger by an error."""
    rows = [{**row, number: row[number] + step} for row, step in zip(table["joints"], error, strict=True)]
    return {**table, "joints": rows}


READ = {
    "gain_error": Entry(
        lambda healthy, table, t, gain: healthy(table, t) * gain,
        lambda size: {"gain": np.linspace(0.7, 1.4, len(size))},
    ),
    "delay": Entry(lambda healthy, table, t, lag: healthy(table, t - lag[0]), lambda size: {"lag": (0.0234,)}),
    "base_tilt": Entry(
        lambda healthy, table, t, angle: healthy({**table, "gravity": turned(table["gravity"], *angle)}, t),
        lambda size: {"angle": (0.2, -0.35)},
    ),
    "link_length": Entry(
        lambda healthy, table, t, error: healthy(off(table, "a", error), t),
        lambda size: {"error": np.linspace(0.03, -0.05, len(size))},
    ),
    "link_twist": Entry(
        lambda healthy, table, t, error: healthy(off(table, "alpha", error), t),
        lambda size: {"error": np.linspace(-0.1, 0.15, len(size))},
    ),
    "link_offset": Entry(
        lambda healthy, table, t, error: healthy(off(table, "d", error), t),
        lambda size: {"error": np.linspace(0.05, -0.04, len(size))},
    ),
    "joint_zero": Entry(
        lambda healthy, table, t, error: healthy(off(table, "theta", error), t),
        lambda size: {"error": np.linspace(0.1, -0.15, len(size))},
    ),
    "gear_ratio": Entry(
        lambda healthy, table, t, error: healthy(table, t, 1.0 + np.array(error)),
        lambda size: {"error": np.linspace(0.08, -0.12, len(size))},
    ),
    "clipping": Entry(
        lambda healthy, table, t, limit: healthy(table, t) / np.maximum(1.0, np.abs(healthy(table, t)) / limit),
        lambda size: {"limit": 0.9 * size},
    ),
    "dead_zone": Entry(
        lambda healthy, table, t, width: healthy(table, t) * (np.abs(healthy(table, t)) >= width),
        lambda size: {"width": 0.8 * size},
    ),
    "dead_zone.shrinking": Entry(
        lambda healthy, table, t, width: healthy(table, t) - np.clip(healthy(table, t), -np.array(width), width),
        lambda size: {"width": 0.8 * size},
    ),
}
"""Of each distortion of the catalogue; a new one needs an entry here."""
READINGS = [name for name in CATALOGUE if CATALOGUE[name].of_sensor]  # change what is read; the others change rows
OF_TABLE = {"link_length": "a", "link_twist": "alpha", "link_offset": "d", "joint_zero": "zero"}
OF_ROBOT = ("base_tilt", "gear_ratio", *OF_TABLE)  # what changes the robot or its motion acts in all joints
TUNED = [name for name in CATALOGUE if np.any(np.greater(CATALOGUE[name].typical, 0.0))]
VARIABLES = ("velocity", "position", "acceleration", "load", "time")


def sines(n, t):
    """Two sines a joint, up to the highest frequency."""
    rng = np.random.default_rng(5)
    size, phase = rng.uniform(0.2, 0.6, (2, n)), rng.uniform(0, 6, (2, n))
    speed = np.stack([np.full(n, FASTEST), rng.uniform(0.3, 0.6, n) * FASTEST])
    waves = size * np.exp(1j * (speed * t[:, None, None] + phase))
    return Motion(t, *(((1j * speed) ** k * waves).sum(axis=1).imag for k in range(3)))


def cubics(n, t):
    """Cubics of time, which splines follow exactly, beyond their ends as well."""
    a, b, c, d = np.random.default_rng(6).uniform(-0.7, 0.7, (4, n))
    x = t[:, None] - BEGIN - 0.9
    return Motion(t, ((a * x + b) * x + c) * x + d, (3 * a * x + 2 * b) * x + c, 6 * a * x + 2 * b)


class Arm:
    """Point masses, viscous friction, and a zero that drifts; by hand and as a model."""

    def __init__(self, name, motion_at, rate=RATE):
        self.table = TABLES[name]
        n = len(self.table["joints"])
        self.robot = robot_from_table(self.table, "test")
        self.clouds, rng = random_clouds(n, seed=3), np.random.default_rng(4)
        self.viscous, self.drift = rng.uniform(0.5, 3.0, n), rng.uniform(-2.0, 2.0, n)
        drift = make_effect("thermal_drift.offset", {"time": [WARMING] * n})
        self.model = Model(self.robot, (make_effect("rigid_body", {}), make_effect("viscous_friction", {}), drift))
        drifts = np.stack([np.zeros(n), self.drift], axis=1).ravel()
        self.theta = np.concatenate([parameters_of(self.clouds), self.viscous, drifts])
        self.motion_at = lambda t: motion_at(n, t)
        self.t = BEGIN + np.arange(int(1.8 * rate) + 1) / rate
        self.motion = self.motion_at(self.t)

    def healthy(self, table, t, further=None):
        motion, gravity = self.motion_at(t), np.array(table["gravity"])
        if further is not None:  # motors turn by such factors, joints as they are coupled
            of_motors = np.array(table.get("transmission", np.eye(len(further))))
            to_joints = np.linalg.solve(of_motors, np.diag(further) @ of_motors).T
            motion = Motion(t, *(getattr(motion, key) @ to_joints for key in ("q", "dq", "ddq")))
        bodies = actuator_efforts(
            joint_torques(dh_chain(table), self.clouds, gravity, motion), table.get("transmission")
        )
        warmth = 1.0 - np.exp((BEGIN - t) / WARMING)
        return bodies + self.viscous * gear(table, motion.dq) + self.drift * warmth[:, None]

    @cached_property
    def effort(self):
        effort = self.healthy(self.table, self.t)
        effort.setflags(write=False)
        return effort

    def distortion(self, name):
        return make_effect(name, READ[name].numbers(np.sqrt(np.mean(self.effort**2, axis=0))))

    def read(self, distortion):
        numbers = {key: values for key, values in distortion.shape.items() if key != "joints"}
        return READ[distortion.name].read(self.healthy, self.table, self.t, **numbers)

    @cached_property
    def scene(self):
        motion, effort = self.motion, self.model.effort(self.motion, self.theta)
        return Scene(
            robot=self.robot,
            motion=motion,
            actuators=self.robot.actuators(motion),
            effort=effort,
            measured=np.abs(effort),
            links=parameters_of(self.clouds),
            effort_with=lambda other, moving: replace(self.model, robot=other).effort(moving, self.theta),
        )


@cache
def shared_arm(name, motion_at, rate=RATE):
    return Arm(name, motion_at, rate)


@pytest.fixture(params=TABLES)
def arm(request):
    return shared_arm(request.param, sines)


@pytest.fixture(params=CATALOGUE)
def distortion(request, arm):
    return arm.distortion(request.param)


# ---------------------------------------------------------------------------------------------------------------
# What is read
# ---------------------------------------------------------------------------------------------------------------
def test_every_distortion_has_an_entry():
    assert set(READ) == set(CATALOGUE)
    assert {"clipping", "dead_zone", "dead_zone.shrinking"} <= set(READINGS)
    assert not {"gain_error", "delay", "base_tilt"} & set(READINGS)


def test_catalogue_holds_every_file_of_the_folder():
    files = {one.name for one in pkgutil.iter_modules(bayesid.model.distortions.__path__)} - {"base", "displacement"}
    assert {name.split(".")[0] for name in CATALOGUE} == files


@pytest.mark.parametrize("name", CATALOGUE)
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


def test_delay_that_is_none_or_of_a_single_instant_changes_nothing(arm):
    for lag, motion in ((0.0, arm.motion), (0.01, arm.motion[:1])):
        columns = arm.model.extend(make_effect("delay", {"lag": (lag,)})).columns(motion)
        np.testing.assert_array_equal(columns, arm.model.columns(motion))


@pytest.mark.parametrize("name", [name for name in CATALOGUE if name not in OF_ROBOT])
def test_other_joints_are_left_alone(arm, name):
    distortion, n = arm.distortion(name), arm.robot.n_joints
    for joints in ((2,), (3, 1)):
        own = np.array(joints) - 1
        ((key, values),) = distortion.shape.items()
        part = make_effect(name, {key: [values[i] for i in own] if len(values) == n else values, "joints": joints})
        part.check(n)
        found, all_of_it = (arm.model.extend(one).effort(arm.motion, arm.theta) for one in (part, distortion))
        expected = arm.model.effort(arm.motion, arm.theta)
        expected[:, own] = all_of_it[:, own]
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)
        shift, slopes = part.change(arm.scene)
        others = np.delete(np.arange(n), own)
        assert shift[:, own].any(axis=0).all()
        assert not shift[:, others].any()
        assert not slopes[:, others].any()


@pytest.mark.parametrize(
    ("gravity", "angle", "expected"),
    [
        ((0, 0, -9.81), (0.3, 0.0), (0, 9.81 * np.sin(0.3), -9.81 * np.cos(0.3))),  # about x
        ((0, 0, -9.81), (0.0, 0.3), (-9.81 * np.sin(0.3), 0, -9.81 * np.cos(0.3))),  # about y
        ((0, 0, 9.81), (0.3, 0.0), (0, -9.81 * np.sin(0.3), 9.81 * np.cos(0.3))),  # hanging: about x
        ((0, 0, 9.81), (0.0, 0.3), (-9.81 * np.sin(0.3), 0, 9.81 * np.cos(0.3))),  # and -y
        ((9.81, 0, 0), (0.3, 0.0), (9.81 * np.cos(0.3), 0, -9.81 * np.sin(0.3))),  # on a wall: about y
        ((9.81, 0, 0), (0.0, 0.3), (9.81 * np.cos(0.3), -9.81 * np.sin(0.3), 0)),  # and -z
        ((0, 0, 0), (0.3, 0.1), (0, 0, 0)),
    ],
)
def test_base_tilts_about_axes_across_gravity(gravity, angle, expected):
    robot = robot_from_table({**TABLES["tx40"], "gravity": list(gravity)}, "test")
    seen = []
    make_effect("base_tilt", {"angle": angle}).columns(lambda r, m: seen.append(r.gravity), robot, None)
    np.testing.assert_allclose(seen[0], expected, rtol=0, atol=1e-14)


def test_base_tilts_by_the_length_of_both_angles():
    """From a gravity along none of the axes, too; the two turn it into directions across each other."""
    robot = robot_from_table(TABLES["random"], "test")
    seen = []
    for angle in ((0.3, 0.0), (0.0, 0.3), (0.3, 0.4)):
        make_effect("base_tilt", {"angle": angle}).columns(lambda r, m: seen.append(r.gravity), robot, None)
    length = np.linalg.norm(robot.gravity)
    cosines = [robot.gravity @ gravity / length**2 for gravity in seen]
    np.testing.assert_allclose(cosines, np.cos([0.3, 0.3, 0.5]), rtol=1e-14)
    first, second = (gravity - np.cos(0.3) * robot.gravity for gravity in seen[:2])
    assert abs(first @ second) < 1e-13 * length**2


# ---------------------------------------------------------------------------------------------------------------
# What readings show
# ---------------------------------------------------------------------------------------------------------------
def test_what_is_restored_is_what_was_there(arm, distortion):
    size = np.abs(arm.effort)
    magnitude = np.abs(distortion.measured(arm.effort))
    restored, valid = distortion.restored(magnitude)
    np.testing.assert_allclose(restored[valid], size[valid], rtol=1e-14, atol=0)
    if distortion.name not in READINGS:
        np.testing.assert_array_equal(magnitude, size)
        assert valid.all()
        return
    assert all(0.2 < share < 0.95 for share in valid.mean(axis=0))
    if distortion.name == "clipping":
        assert valid[size < 0.9 * np.array(distortion.limit)].all()
    else:
        assert valid[size > 1.4 * np.array(distortion.width)].all()


def test_readings_are_restored_from_the_last_distortion_to_the_first(arm):
    size = np.sqrt(np.mean(arm.effort**2, axis=0))
    shrinking = make_effect("dead_zone.shrinking", {"width": 0.3 * size})
    clipping = make_effect("clipping", {"limit": 0.9 * size})
    effort = arm.effort
    for first, last, highest in ((shrinking, clipping, 0.9 * size), (clipping, shrinking, 0.6 * size)):
        model = arm.model.extend(first).extend(last)
        read = model.read(effort)
        np.testing.assert_array_equal(read, last.measured(first.measured(effort)))
        np.testing.assert_allclose(np.abs(read).max(axis=0), highest, rtol=1e-14)
        restored, valid = model.unread(np.abs(read))
        np.testing.assert_allclose(restored[valid], np.abs(effort)[valid], rtol=1e-14, atol=0)
        middle = (np.abs(effort) > 0.5 * size) & (np.abs(effort) < 0.8 * size)
        assert middle.any(axis=0).all()
        assert valid[middle].all()
        assert not valid[(np.abs(effort) < 0.3 * size) | (np.abs(effort) > 1.25 * size)].any()


def test_model_without_distortions_reads_what_is_there(arm):
    np.testing.assert_array_equal(arm.model.read(arm.effort), arm.effort)
    magnitude, valid = arm.model.unread(np.abs(arm.effort))
    np.testing.assert_array_equal(magnitude, np.abs(arm.effort))
    assert valid.all()


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


def test_several_parameters_have_the_efforts_of_each(arm, distortion):
    model = arm.model.extend(distortion)
    several = np.stack([arm.theta, 0.5 * arm.theta, -arm.theta[::-1]], axis=1)
    efforts = model.effort(arm.motion, several)
    assert efforts.shape == (*arm.effort.shape, 3)
    for k, theta in enumerate(several.T):
        assert_close(efforts[..., k], model.effort(arm.motion, theta), 1e-13)


def test_chunks_have_the_columns_of_the_whole(monkeypatch, arm, distortion):
    """A spline feels its end less by `DECAY` with every knot from there; the error at the end is of fourth order."""
    model = arm.model.extend(distortion)
    whole = model.columns(arm.motion)
    monkeypatch.setattr("bayesid.model.model.CHUNK", 37)
    monkeypatch.setattr("bayesid.model.model.LOOK_BACK", 16)

    def pieces():
        model.forget()
        return np.concatenate([columns for _, columns in model.chunks(arm.motion)])

    error = DECAY**16 * 10 * (FASTEST / RATE) ** 4 if distortion.memory else 0.0
    assert error < 1e-13
    assert_close(pieces(), whole, error + 1e-13)
    assert_close(model.effort(arm.motion, arm.theta), model.read(whole @ arm.theta), 1e-12)
    monkeypatch.setattr("bayesid.model.model.LOOK_BACK", 0)
    monkeypatch.setattr("bayesid.model.model.LOOK_AHEAD", 0)
    unlike = np.abs(pieces() - whole).max() > 1e-9 * np.abs(whole).max()
    assert unlike == distortion.memory


# ---------------------------------------------------------------------------------------------------------------
# Change of a scene
# ---------------------------------------------------------------------------------------------------------------
def test_change_is_the_difference_that_the_model_makes(arm, distortion):
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


@pytest.mark.parametrize("name", TUNED)
def test_slopes_are_those_of_the_efforts_by_hand(arm, name):
    distortion, step = arm.distortion(name), 1e-4
    _, slopes = distortion.change(arm.scene)
    size = np.abs(arm.effort).max()
    slopes = slopes[:, :, :2] if name == "base_tilt" else slopes  # the others are link 1's weight
    for slope, direction in zip(np.moveaxis(slopes, 2, 0), np.eye(slopes.shape[2]), strict=True):
        up, down = (arm.read(distortion.moved(side * step * direction)) for side in (1, -1))
        expected = (up - down) / (2 * step)
        error = {
            "gain_error": 1e-11 * size,  # rounding
            "base_tilt": step * size,  # half a step of bayesid's own differences, of gravity's second derivative
            "delay": 10 * (3 * FASTEST / RATE) ** 3 / 24 * 3 * FASTEST * size,  # h^3/24 of the fourth derivative
        }.get(name, step * size)
        assert error < 0.02 * np.abs(expected).max() or (name in OF_TABLE and np.abs(expected).max() < error)
        np.testing.assert_allclose(slope[NOT_THE_FIRST], expected[NOT_THE_FIRST], rtol=0, atol=error)


def test_moved_adds_to_the_numbers(arm, distortion):
    before = distortion.numbers(arm.robot)
    values = np.array([value for value, _ in before.values()])
    if distortion.name in TUNED:
        step = np.linspace(0.01, 0.05, len(values))
        moved = distortion.moved(step)
        moved.check(arm.robot.n_joints)
        assert type(moved) is type(distortion)
        after = moved.numbers(arm.robot)
        assert after.keys() == before.keys()
        np.testing.assert_allclose([v for v, _ in after.values()], values + step, rtol=1e-15)
        assert {type(value) for values in moved.shape.values() for value in values} == {float}  # as in TOML
    else:
        assert distortion.moved(np.empty(0)) == distortion


# ---------------------------------------------------------------------------------------------------------------
# Forms, numbers and names
# ---------------------------------------------------------------------------------------------------------------
def business_of_others(arm, name):
    """In the modified convention the first a and alpha mount the base; of a joint that slides d is the zero."""
    sliding = {(j,) for j, row in enumerate(arm.table["joints"], start=1) if row.get("type") == "prismatic"}
    first = {(1,)} if arm.table["convention"] == "modified" else set()
    return {"link_length": first, "link_twist": first, "joint_zero": sliding}.get(name, set())


@pytest.mark.parametrize("name", CATALOGUE)
def test_variants_are_distortions_of_this_robot(arm, name):
    scene = arm.scene
    scene = replace(scene, measured=np.abs(arm.distortion("clipping").measured(scene.effort)))
    variants = list(CATALOGUE[name].variants(scene))
    each = {(j,) for j in range(1, arm.robot.n_joints + 1)}
    expected = {"delay": {(), *each}, "base_tilt": {()}}.get(name, each) - business_of_others(arm, name)
    assert {one.joints for one in variants} == expected
    assert len(set(variants)) == len(variants)
    for one in variants:
        one.check(arm.robot.n_joints)
        assert type(one) is CATALOGUE[name]
        assert make_effect(name, one.shape) == one
        assert {type(value) for values in one.shape.values() for value in values} <= {int, float}
        shift, slopes = one.change(scene)
        assert np.isfinite(shift).all()
        assert np.isfinite(slopes).all()
        assert (slopes.shape[2] > 0) == (name in TUNED)
    if name in ("gain_error", "base_tilt", "delay"):
        assert len(variants) == len(expected) * (5 if name == "delay" else 1)


def test_tilt_may_show_the_weight_of_link_1(arm):
    """Where gravity lies along the first axis: a torque in joint 1 that turns with it, of any size and phase."""
    _, slopes = arm.distortion("base_tilt").change(arm.scene)
    first = arm.robot.joints[0]
    across = np.linalg.norm(np.cross(first.placement[:3, :3] @ first.axis, arm.robot.gravity))
    q1 = arm.motion.q[:, 0]
    waves = np.stack([np.sin(q1), np.cos(q1)], axis=1) if across < 0.1 else np.zeros((len(q1), 2))
    np.testing.assert_allclose(slopes[:, 0, 2:], waves, rtol=1e-14)
    np.testing.assert_array_equal(slopes[:, 1:, 2:], 0.0)


@pytest.mark.parametrize("name", TUNED)
def test_what_is_tuned_begins_neutral(arm, name):
    columns = arm.model.columns(arm.motion)
    for one in CATALOGUE[name].variants(arm.scene):
        if getattr(one, "lag", (0.0,)) != (0.0,):
            continue
        shift, _ = one.change(arm.scene)
        np.testing.assert_allclose(shift, 0.0, rtol=0, atol=1e-13 * np.abs(arm.effort).max())
        np.testing.assert_array_equal(arm.model.extend(one).columns(arm.motion), columns)
        np.testing.assert_array_equal(one.measured(arm.effort), arm.effort)


@pytest.mark.parametrize(("name", "share"), [("clipping", 0.9), ("dead_zone", 0.25), ("dead_zone.shrinking", 0.25)])
def test_limits_and_widths_that_are_tried_go_beyond_the_true_ones(arm, name, share):
    true = share * np.sqrt(np.mean(arm.effort**2, axis=0))
    (key,) = arm.distortion(name).shape
    measured = np.abs(make_effect(name, {key: true}).measured(arm.effort))
    variants = list(CATALOGUE[name].variants(replace(arm.scene, measured=measured)))
    for j in range(arm.robot.n_joints):
        tried = [getattr(one, key)[0] for one in variants if one.joints == (j + 1,)]
        assert len(tried) > 10
        assert min(tried) < true[j] < max(tried) * (1 + 1e-12)


def test_nothing_is_clipped_that_the_model_does_not_exceed(arm):
    scene = replace(arm.scene, measured=1.01 * np.abs(arm.scene.effort).max(axis=0) * np.ones_like(arm.effort))
    assert not list(CATALOGUE["clipping"].variants(scene))


def test_numbers_have_names_and_units(arm, distortion):
    """A joint that slides has N, not N m."""
    ((key, values),) = distortion.shape.items()
    numbers, robot = distortion.numbers(arm.robot), arm.robot
    symbol = {"angle": "tilt", "error": OF_TABLE.get(distortion.name, "ratio")}.get(key, key)
    unit = {"gain": "1", "lag": "s", "angle": "rad"}.get(key, distortion.shape_units.get(key))
    unit = {"a": "m", "d": "m", "alpha": "rad", "zero": "rad", "ratio": "1"}.get(symbol, unit)
    units = [unit.replace("N m", "N") if joint.prismatic else unit for joint in robot.joints]
    assert [value for value, _ in numbers.values()] == values
    assert all(name.startswith(symbol) for name in numbers)
    if distortion.counts:
        assert {said for _, said in numbers.values()} == {unit}
    else:
        assert numbers == {f"{symbol}{j}": pair for j, pair in enumerate(zip(values, units, strict=True), start=1)}
    if distortion.by_joint:
        part = make_effect(distortion.name, {"joints": (2,), key: values[:1]})
        assert part.numbers(robot) == {f"{symbol}2": (values[0], unit if distortion.counts else units[1])}


def test_distortion_describes_itself(distortion):
    assert isinstance(distortion, Distortion)
    assert CATALOGUE[distortion.name] is type(distortion)
    assert distortion.name.split(".")[0] in CATALOGUE
    assert distortion.physics[0].isupper()
    assert distortion.physics.endswith(".")
    assert distortion.variable in VARIABLES
    assert np.all(np.greater_equal(distortion.typical, 0.0))
    for text in (distortion.physics, distortion.reference, distortion.shown_by):
        assert text.strip() == text != ""
        assert "\n" not in text


def test_distortion_comes_back_from_its_name_and_shape(arm, distortion):
    for one in (distortion, replace(distortion, joints=(2, 1))):
        shape = {key: [float(repr(float(value))) for value in values] for key, values in one.shape.items()}
        again = make_effect(one.name, shape)
        assert again == one
        assert again.joints == one.joints


def test_check_takes_only_numbers_of_this_robot(arm, distortion):
    n = arm.robot.n_joints
    distortion.check(n)
    for key, values in distortion.shape.items():
        for wrong in (values[:-1], [*values, values[0]]):
            with pytest.raises(ValueError, match=f"{key} has {len(wrong)} numbers"):
                make_effect(distortion.name, {key: wrong}).check(n)
        for joints in ((n + 1,), (0,), (2, 2)):
            shape = {key: values[: len(joints)] if len(values) == n else values, "joints": joints}
            with pytest.raises(ValueError, match="not joints of the robot"):
                make_effect(distortion.name, shape).check(n)
        if distortion.name == "base_tilt":
            with pytest.raises(ValueError, match="all joints"):
                make_effect("base_tilt", {key: values, "joints": (2,)}).check(n)
