from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from conftest import smooth_motion
from oracles import assert_close, parameters_of, random_clouds, random_motion, random_table
from term_efforts import EFFORTS, by_hand

from bayesid.effects import STANDARD, ActuatorTerm
from bayesid.effects.catalogue import DISTORTIONS, TERMS, make_effect, make_terms
from bayesid.effects.model import Model
from bayesid.effects.tuning import TUNING
from bayesid.errors import InputError
from bayesid.motion import Motion
from bayesid.robot import load_robot, robot_from_table

TABLES = {  # each with a joint that slides and gravity along none of the axes
    "coupled": random_table("standard", 3, seed=2, coupled=True),
    "modified": random_table("modified", 4, seed=1),
}
NEED_A_SHAPE = [name for name, entry in EFFORTS.items() if entry.shape is not None]
WITH_COLUMNS = [name for name, kind in TERMS.items() if not kind.frees]
"""Terms that do more than to lift bounds of others."""
OF_JOINTS = [name for name, kind in TERMS.items() if issubclass(kind, ActuatorTerm)]


def made(name, robot, motion):
    """The term that the entry speaks of."""
    entry = EFFORTS[name]
    return make_effect(name, entry.shape(robot.n_joints)) if entry.shape else make_terms([name], robot, motion)[0]


def motion_of(robot):
    """Some of the speeds are near zero, where dry friction is smoothed; the clock begins at 3 s; there are payloads."""
    motion = random_motion(robot.n_joints, 12)
    dq = motion.dq * np.where(np.arange(12) % 3, 1.0, 0.005)[:, None]
    return Motion(motion.t + 3.0, motion.q, dq, motion.ddq, payload=np.resize(["", "tool1", "tool2", "tool1"], 12))


@pytest.fixture
def table():
    return TABLES["coupled"]


@pytest.fixture
def robot(table):
    return robot_from_table(table, "test")


@pytest.fixture
def motion(robot):
    return motion_of(robot)


@pytest.fixture
def terms(robot, motion):
    return [made(name, robot, motion) for name in WITH_COLUMNS]


@pytest.fixture
def scene(robot):
    """Ten seconds of a rigid robot with dry friction."""
    motion = smooth_motion(robot.n_joints, 10.0, 6.0)
    model = Model(robot, make_terms(["rigid_body", "coulomb_friction"], robot, motion))
    theta = np.concatenate([sensible(term, robot) for term in model.terms])
    effort = model.effort(motion, theta)
    return model.scene(motion, theta, effort, np.abs(effort))


def sensible(term, robot, seed=0):
    """A physical point of the term's cone."""
    size = len(term.parameters(robot))
    if len(term.cone(robot).bodies):
        return parameters_of(random_clouds(size // 10, seed))
    return np.random.default_rng(seed).uniform(0.1, 2.0, size)


def of_joints(term, joints, n):
    """The term in some of its n joints only."""
    shape = {
        key: tuple(values[j - 1] for j in joints) if len(values) == n else values for key, values in term.shape.items()
    }
    return make_effect(term.name, {**shape, "joints": joints})


def test_each_term_has_an_entry_here():
    assert set(STANDARD) <= set(TERMS) == set(EFFORTS)
    assert {"clipping", "delay", "joint_zero"} <= set(DISTORTIONS)


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
@pytest.mark.parametrize("name", WITH_COLUMNS)
def test_columns_are_the_efforts_of_each_parameter(name, table):
    robot = robot_from_table(table, "test")
    motion = motion_of(robot)
    term = made(name, robot, motion)
    columns = term.columns(robot, motion)
    assert columns.shape == (len(motion), robot.n_joints, len(term.parameters(robot)))
    base, steps = sensible(term, robot), np.eye(columns.shape[2])
    effort = partial(by_hand, name, table, motion)
    differences = [effort(base + e) - effort(base) for e in steps]
    assert_close(np.moveaxis(columns, 2, 0), np.array(differences), 1e-11)
    assert_close(columns @ base, effort(base), 1e-12)


def test_chunks_have_the_columns_of_the_whole(monkeypatch, terms, robot, motion):
    """And of terms without a memory, so has any part of the motion by itself."""
    monkeypatch.setattr("bayesid.effects.model.TUNING", replace(TUNING, chunk=5))
    parts = (slice(0, 5), slice(5, 10), np.array([7, 2, 2]), np.arange(12) % 2 == 0)
    for term in terms:
        whole = term.columns(robot, motion)
        pieces = [columns for _, columns in Model(robot, (term,)).chunks(motion)]
        assert [len(columns) for columns in pieces] == [5, 5, 2]
        assert_close(np.concatenate(pieces), whole, 1e-14)
        same = [np.allclose(term.columns(robot, motion[rows]), whole[rows], rtol=1e-14, atol=0) for rows in parts]
        assert all(same) is not term.memory


def test_term_in_some_joints_has_the_columns_of_these(robot, motion):
    for name in OF_JOINTS:
        term = made(name, robot, motion)
        columns, parameters = term.columns(robot, motion), term.parameters(robot)
        for joints in ((2,), (3, 1)):
            part = of_joints(term, joints, robot.n_joints)
            part.check(robot.n_joints)
            chosen = [k for j in joints for k, parameter in enumerate(parameters) if parameter.joint == j]
            assert part.joints == joints
            assert part.parameters(robot) == tuple(parameters[k] for k in chosen)
            np.testing.assert_array_equal(part.columns(robot, motion), columns[:, :, chosen])
            chosen_too = [k for k, index in enumerate(chosen) if index in term.cone(robot).nonnegative]
            np.testing.assert_array_equal(part.cone(robot).nonnegative, chosen_too)


def test_cone_keeps_from_negative_what_cannot_be(terms, robot):
    for term in terms:
        cone, theta = term.cone(robot), sensible(term, robot)
        names = [parameter.name for parameter in term.parameters(robot)]
        kept = {f"{symbol}{j + 1}" for symbol in EFFORTS[term.name].nonnegative for j in range(robot.n_joints)}
        bodies = {"rigid_body": robot.n_joints, "payload": 1, "payload.carried": 1}.get(term.name, 0)
        assert {names[k] for k in cone.nonnegative} == kept
        assert cone.bodies.shape == (bodies, 10)
        assert cone.size == len(theta) == len(names)
        assert cone.contains(theta)
        for index in [*cone.nonnegative, *cone.bodies[:, 9]]:
            bad = theta.copy()
            bad[index] *= -1
            assert not cone.contains(bad)
        if not bodies:
            assert cone.contains(np.where([name in kept for name in names], 1.0, -1.0))


def test_shape_that_no_motion_tells_is_asked_for(robot, motion):
    for name in NEED_A_SHAPE:
        with pytest.raises(InputError, match=r"bayesid discrepancy|carrying") as caught:
            make_terms(["rigid_body", name], robot, motion)
        assert caught.value.field == "terms"
        assert caught.value.what.startswith(f"{name} ")


def test_variants_are_terms_of_this_robot(robot, scene):
    for name, kind in TERMS.items():
        variants = list(kind.variants(scene))
        assert len(set(variants)) == len(variants)
        joints = {(j + 1,) for j in range(robot.n_joints)} if name in OF_JOINTS or kind.frees else {()}
        assert {one.joints for one in variants} == (joints if kind.can_be_missing else set())
        for one in variants:
            one.check(robot.n_joints)
            assert make_effect(name, one.shape) == one
            assert {type(value) for values in one.shape.values() for value in values} <= {int, float}  # as in TOML
        for one in variants[:: max(1, len(variants) // 10)]:
            columns = one.columns(robot, scene.motion)
            assert columns.shape[2] == len(one.parameters(robot)) == one.cone(robot).size
            assert np.isfinite(columns).all()
            assert columns.any() == (name in WITH_COLUMNS)


def test_variants_go_through_what_the_log_can_tell(robot, scene):
    """Positions that were reached, ways that were covered, speeds that were passed, waves that were sampled."""
    u, speeds, last = scene.actuators.q, np.abs(scene.actuators.dq), scene.motion.t[-1]

    later = replace(scene, motion=replace(scene.motion, t=scene.motion.t + 1e3, origin=scene.motion.origin + 1e3))

    def values(name, key, j, seen=scene):
        return np.array([getattr(one, key)[0] for one in TERMS[name].variants(seen) if one.joints == (j + 1,)])

    for j in range(robot.n_joints):
        for name in ("cable_drag", "cable_drag.friction", "cable_drag.stiffening"):
            starts = values(name, "start", j)
            assert u[:, j].min() < starts.min() < np.median(u[:, j]) < starts.max() < u[:, j].max()
            assert len(set(starts)) >= 9
        assert set(values("cable_drag", "side", j)) == {-1.0, 1.0}
        for name in ("hysteresis", "hysteresis.layers", "hysteresis.smooth", "hysteresis.elastic"):
            widths = values(name, "width", j)
            assert 0 < widths.min() <= 0.02
            assert widths.max() < np.ptp(u[:, j]) / 2
        slow = values("stribeck_friction", "speed", j)
        assert 0 < slow.min() < slow.max() < speeds[:, j].max() / 2
        knees = values("viscous_friction.saturating", "knee", j)
        assert 0.05 * speeds[:, j].max() < knees.min() < 0.2 * speeds[:, j].max()
        assert 0.5 * speeds[:, j].max() < knees.max() < speeds[:, j].max()
        for name in ("thermal_drift", "thermal_drift.viscous", "thermal_drift.both", "thermal_drift.offset"):
            times = values(name, "time", j)
            assert 0 < times.min() < last < times.max() < 2 * last
            np.testing.assert_allclose(values(name, "time", j, later), times, rtol=1e-9)
        waves = values("torque_ripple", "harmonic", j)
        usual = np.percentile(speeds[:, j], 80)
        assert waves.max() * usual < np.pi * 6.0 <= 2 * (waves.max() + np.diff(waves)[0]) * usual
        assert np.diff(waves).max() * np.ptp(u[:, j]) < np.pi or len(waves) >= 400
        for name in ("coulomb_friction", "load_dependent_friction", "stribeck_friction", "cable_drag.friction"):
            np.testing.assert_allclose(values(name, "smoothing", j), 0.01 * speeds[:, j].max(), rtol=1e-14)


def test_presliding_forgets_what_lies_two_widths_back(monkeypatch, robot):
    """A difference of two states never grows: stretched fully once, it is gone; gradually, it falls with the way."""
    motion = smooth_motion(robot.n_joints, 4.0, 50.0)
    monkeypatch.setattr("bayesid.effects.model.TUNING", replace(TUNING, chunk=40, look_back=60))
    u = robot.actuators(motion).q
    ways = [np.abs(np.diff(u[s - 60 : s + 1], axis=0)).sum(axis=0) for s in (80, 120, 160)]
    ranges = [np.ptp(u[s - 60 : s + 1], axis=0) for s in (80, 120, 160)]
    width = 0.1 * np.min(ranges, axis=0)
    for name, error in (("hysteresis", 0.0), ("hysteresis.smooth", 2 * np.exp(-np.min(ways, axis=0) / width).max())):
        term = make_effect(name, {"width": width})
        whole = term.columns(robot, motion)
        pieces = np.concatenate([columns for _, columns in Model(robot, (term,)).chunks(motion)])
        assert error < 1e-3
        np.testing.assert_allclose(pieces, whole, rtol=0, atol=error + 1e-13)


def test_model_stacks_its_terms(terms, table, robot, motion):
    model = Model(robot, tuple(terms[:2]))
    for term in terms[2:]:
        model = model.extend(term)
    names = [parameter.name for parameter in model.parameters]
    assert len(set(names)) == len(names)
    theta = np.concatenate([sensible(term, robot, seed) for seed, term in enumerate(terms)])
    assert model.cone.size == len(theta) == len(names)
    assert model.cone.contains(theta)
    efforts = [by_hand(term.name, table, motion, sensible(term, robot, seed)) for seed, term in enumerate(terms)]
    assert_close(model.effort(motion, theta), sum(efforts), 1e-12)
    theta[names.index("Fc2")] = -0.1
    assert not model.cone.contains(theta)
    assert Model(robot, ()).cone.size == 0


@pytest.mark.filterwarnings("error")
def test_actuator_that_never_moves_has_no_dry_friction():
    robot, dq = load_robot("kr5"), np.ones((5, 6)) * [0.1, 0.2, 0.0, 0.4, 0.5, 0.6]
    still = Motion(np.arange(5.0), np.ones((5, 6)), dq, np.zeros((5, 6)))
    columns = make_terms(["coulomb_friction"], robot, still)[0].columns(robot, still)
    np.testing.assert_array_equal(columns[:, 2], 0.0)
    assert np.isfinite(columns).all()


def test_bad_names_are_refused_in_one_line(robot, motion):
    for names, said in (
        (["rigid_body", "stiction"], "unknown term 'stiction'"),
        ([""], "unknown term ''"),
        (["rigid_body", "torque_offset", "rigid_body"], "term 'rigid_body' comes twice"),
    ):
        with pytest.raises(InputError, match=said) as caught:
            make_terms(iter(names), robot, motion)
        assert "\n" not in str(caught.value)


def test_a_lifted_bound_is_that_of_its_own_actuators(robot, motion):
    """The cone of all other parameters stays as it is."""
    plain = Model(robot, make_terms(["viscous_friction", "coulomb_friction"], robot, motion))
    lifted = plain.extend(make_effect("overcompensated_friction", {"joints": [2]}))
    assert lifted.parameters == plain.parameters
    free = set(plain.cone.nonnegative.tolist()) - set(lifted.cone.nonnegative.tolist())
    assert [plain.parameters[k].name for k in free] == ["Fv2"]
