from dataclasses import replace
from functools import cache, cached_property

import numpy as np
import pytest
from completion_problems import BASE, MOTION, ROBOT, SIZE, TOP
from conftest import small_robot, smooth_motion
from oracles import assert_close

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import DISTORTIONS, TERMS, main_forms, make_effect, make_terms
from bayesid.effects.distortion import RobotDistortion
from bayesid.effects.effect import Scene
from bayesid.effects.model import Model
from bayesid.regression.selection.columns import NO_COLUMNS
from bayesid.regression.selection.hypotheses import hypotheses, maker, near_standstill
from bayesid.simulation.parameters import random_parameters

NAMES = """
asymmetric_coulomb base_tilt cable_drag clipping coulomb_friction dead_zone delay gain_error gravity_spring hysteresis
joint_spring load_dependent_friction payload rotor_inertia stribeck_friction thermal_drift tool_wrench torque_offset
torque_ripple viscous_friction
"""
EFFECTS = sorted(name for name, kind in main_forms().items() if not kind.frees)
JOINTS = 3


class Case:
    """An arm, its motion, and a log of |effort| that is no multiple of what the model says."""

    def __init__(self, names=STANDARD, extra=()):
        robot = small_robot(JOINTS, seed=2)
        self.motion = smooth_motion(JOINTS, 9.0, 50.0, seed=4)
        own = tuple(make_effect(name, shape) for name, shape in extra)
        self.model = Model(robot, (*make_terms(names, robot, self.motion), *own))
        self.theta = random_parameters(self.model, rng=np.random.default_rng(3))
        self.effort = self.model.effort(self.motion, self.theta)
        self.used = np.ones_like(self.effort, dtype=bool)
        self.used[:40] = self.used[200:230, 1] = False
        self.measured = np.abs(self.effort) * np.array([0.8, 0.9, 0.7])

    @property
    def scene(self):
        robot = self.model.robot

        def effort_with(other, moving):
            return replace(self.model, robot=other).effort(moving, self.theta)

        return Scene(
            robot,
            self.motion,
            robot.actuators(self.motion),
            self.effort,
            self.measured,
            self.theta[: 10 * JOINTS],
            effort_with,
        )

    @cached_property
    def groups(self):
        return list(hypotheses(maker(self.model, self.scene, self.used), self.scene, refinements=True))

    def all(self):
        return [one for group in self.groups for one in group]

    def of(self, name):
        return [one for one in self.all() if one.source.name == name]


@cache
def case(*names, extra=()):
    return Case(names or STANDARD, extra)


UNTRIED = {"rigid_body", "learned_effect", "payload.carried", "overcompensated_friction"}
"""What others are missing from, what has no name, what logs say themselves, and what has no columns."""


def test_the_catalogue_is_complete():
    assert set(NAMES.split()) <= set(EFFECTS)
    assert {one.effect for one in case().all()} == set(EFFECTS)
    assert {one.source.name for one in case().all()} == {*TERMS, *DISTORTIONS} - UNTRIED


def test_every_effect_is_tried_wherever_it_may_be():
    """In each joint by itself, or on the whole robot; the delay both.

    The first row of a modified table mounts the base: its d leaves no trace, the others are `base_tilt`.
    """
    alone = {(j,) for j in range(1, JOINTS + 1)}
    expected = {"payload": {()}, "tool_wrench": {()}, "base_tilt": {()}, "delay": {(), *alone}}
    expected |= {of_link: alone - {(1,)} for of_link in ("link_length", "link_twist", "link_offset")}
    for name in EFFECTS:
        found = {one.joints for one in case().all() if one.effect == name}
        by_joint = name in NAMES.split() or main_forms()[name].acts_on != "robot"
        assert found == expected.get(name, alone if by_joint else {()}), name


def test_rows_are_the_terms_columns():
    model, motion = case().model, case().motion
    checked = set()
    for one in case().all():
        if one.effect in DISTORTIONS or one.source.name in checked:
            continue
        checked.add(one.source.name)
        columns = one.source.columns(model.robot, motion)
        assert not one.columns.shift
        assert set(one.columns.rows) == {j for j in range(JOINTS) if columns[:, j].any()}
        assert one.columns.joints == set(one.columns.rows)
        assert {j + 1 for j in one.columns.rows} == set(one.joints) or not one.joints
        for j, rows in one.columns.rows.items():
            np.testing.assert_array_equal(rows, columns[:, j])
            assert rows.shape[1] == len(one.columns.sd) == len(one.columns.positive)
    assert checked == set(TERMS) - UNTRIED


def test_distortions_have_shifts_and_slopes_where_they_act():
    """Shift and slopes together are the change of the efforts, to first order in a small step."""
    smooth = case("rigid_body", "viscous_friction")
    model, motion, theta = smooth.model, smooth.motion, smooth.theta
    for one in smooth.all():
        if one.effect not in DISTORTIONS:
            continue
        moves_robot = isinstance(one.source, RobotDistortion)
        named = set(range(JOINTS)) if moves_robot or not one.joints else {j - 1 for j in one.joints}
        assert one.columns.joints <= named
        p = len(one.columns.sd)
        assert bool(one.columns.rows) == bool(p)
        assert not any(one.columns.positive)
        step = 1e-5 * np.array([1.0, -2.0, 0.0, 0.0])[:p]
        changed = model.extend(one.source.moved(step)).effort(motion, theta) - smooth.effort
        expected = np.zeros_like(changed)
        for j, shift in one.columns.shift.items():
            expected[:, j] += shift
        for j, rows in one.columns.rows.items():
            expected[:, j] += rows @ step
        assert_close(changed[20:], expected[20:], 1e-3)
        assert changed[20:].any()
        if p:
            typical = np.atleast_2d(one.source.typical)[:, :p]
            assert any(np.allclose(one.columns.sd, sd) for sd in typical)


def test_effects_that_change_no_used_sample_are_left_out():
    """A dead zone that only unused samples reach; and nothing is clipped that the model does not exceed."""
    one = case()
    calm = replace(one.scene, measured=one.measured + 2.0 * np.abs(one.effort).max())
    found = {h.effect for group in hypotheses(maker(one.model, calm, one.used), calm) for h in group}
    assert found == set(EFFECTS) - {"clipping"}
    small = np.abs(one.effort) < 0.3 * np.abs(one.effort).max(axis=0)
    found = [h for group in hypotheses(maker(one.model, one.scene, one.used & ~small), one.scene) for h in group]
    widths = np.array([h.source.width[0] for h in found if h.source.name == "dead_zone" and h.joints == (2,)])
    assert len(widths)
    assert widths.min() >= 0.3 * np.abs(one.effort[:, 1]).max()


def test_an_amplitude_of_one_sd_is_three_tenths_of_the_joints_effort():
    """At its largest, in used samples, beside the RMS of the measured efforts there."""
    one = case()
    size = np.array([np.sqrt(np.mean(one.measured[one.used[:, j], j] ** 2)) for j in range(JOINTS)])
    for found in one.all():
        if found.effect in ("payload", *DISTORTIONS):
            continue
        largest = [np.abs(rows[one.used[:, j]]).max(axis=0) / size[j] for j, rows in found.columns.rows.items()]
        np.testing.assert_allclose(found.columns.sd * np.max(largest, axis=0), 0.3, rtol=1e-9)


def test_what_cannot_be_negative_is_marked():
    for one in case("rigid_body").all():
        if one.effect in DISTORTIONS:
            continue
        marked = np.zeros(len(one.columns.sd), dtype=bool)
        marked[one.source.cone(case().model.robot).nonnegative] = True
        np.testing.assert_array_equal(one.columns.positive, marked)
        assert one.changes == ()


HELD = {"viscous_friction": "Fv", "coulomb_friction": "Fc", "torque_offset": "offset", "rotor_inertia": "Ia"}


@pytest.mark.parametrize("name", ["coulomb_friction", "torque_offset"])
def test_existing_effects_may_change_with_either_sign(name):
    found = case().of(name)
    assert [one.changes for one in found] == [(f"{HELD[name]}{j}",) for j in (1, 2, 3)]
    assert [one.joints for one in found] == [(1,), (2,), (3,)]
    assert not any(one.columns.positive.any() for one in found)
    places = [parameter.name for parameter in case().model.parameters]
    columns = case().model.columns(case().motion)
    for j, one in enumerate(found):
        np.testing.assert_allclose(one.columns.rows[j][:, 0], columns[:, j, places.index(one.changes[0])], rtol=1e-12)
    others = [name for name in STANDARD if name not in HELD or name != found[0].source.name]
    without = case(*others).of(name)
    assert [one.changes for one in without] == [()] * 3
    assert all(one.columns.positive.all() for one in without) == (name != "torque_offset")


def test_a_change_has_the_shape_of_the_models_own_term():
    """In joints 3 and 1, in this order; in joint 2 the model holds none, and many shapes are tried."""
    shape = {"joints": (3, 1), "smoothing": (0.03, 0.05), "speed": (0.21, 0.37)}
    names = ("rigid_body", "viscous_friction")
    found = Case(names, (("stribeck_friction", shape),)).of("stribeck_friction")
    of_joint = {j: [one for one in found if one.joints == (j,)] for j in (1, 2, 3)}
    for j, smoothing, speed in ((1, 0.05, 0.37), (3, 0.03, 0.21)):
        for one in of_joint[j]:
            assert one.changes == (f"Fk{j}", f"Fs{j}")
            assert one.source.shape == {"joints": [j], "smoothing": [smoothing], "speed": [speed]}
            assert not one.columns.positive.any()
    assert len({one.source.speed for one in of_joint[2]}) > 3
    assert all(one.changes == () and one.columns.positive.all() for one in of_joint[2])


USED = np.ones(MOTION.dq.shape, dtype=bool)


def test_a_sharp_reversal_differs_near_standstill_only():
    """tanh(4 u' / v) - tanh(u' / v) in each joint's own row, v a hundredth of the highest speed."""
    columns = near_standstill(BASE, MOTION, SIZE, USED)
    for j in range(2):
        speed = MOTION.dq[:, j] / (0.01 * TOP[j])
        expected = np.tanh(4.0 * speed) - np.tanh(speed)
        np.testing.assert_allclose(columns.rows[j][:, j], expected, atol=1e-9)
        np.testing.assert_array_equal(columns.rows[j][:, 1 - j], 0.0)
        np.testing.assert_allclose(columns.sd[j], 0.3 * SIZE[j] / np.abs(expected).max(), rtol=1e-6)
    assert not columns.positive.any()


def test_without_dry_friction_nothing_is_uncertain():
    smooth = make_terms([name for name in STANDARD if name != "coulomb_friction"], ROBOT, MOTION)
    assert near_standstill(Model(ROBOT, smooth), MOTION, SIZE, USED) is NO_COLUMNS
