"""What all effects share: changes joint by joint, whether samples resolve a form, what only an earlier log tells."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from conftest import small_robot, smooth_motion
from term_efforts import EFFORTS, LEARNED

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import forms, make_effect, make_terms
from bayesid.effects.model import Model, SparseColumns
from bayesid.effects.tuning import TUNING
from bayesid.simulation.parameters import random_parameters

JOINTS = 3


def scene_of(motion, robot=None):
    robot = robot or small_robot(JOINTS)
    model = Model(robot, make_terms(STANDARD, robot, motion))
    theta = random_parameters(model, rng=np.random.default_rng(1))
    effort = model.effort(motion, theta)
    return model.scene(motion, theta, effort, np.abs(effort))


@pytest.fixture(scope="module")
def scene():
    return scene_of(smooth_motion(JOINTS, 3.0, 50.0, seed=2))


def test_changes_by_joint_are_those_of_all_joints(scene):
    """In the joints named there, and zero in all others."""
    for kind in (kind for kind in forms().values() if kind.can_be_missing):
        found = list(kind.variants(scene))
        assert found
        for form in (found[0], found[len(found) // 2], found[-1]):
            shift, columns = form.change(scene)
            shifts, rows = form.change_by_joint(scene)
            for j in range(JOINTS):
                np.testing.assert_allclose(shifts.get(j, np.zeros(len(shift))), shift[:, j], rtol=1e-12, atol=1e-14)
                blank = np.zeros(columns[:, j].shape)
                np.testing.assert_allclose(rows.get(j, blank), columns[:, j], rtol=1e-12, atol=1e-14)
            assert set(shifts) <= set(rows) or not rows
            assert all(np.any(shift) for shift in shifts.values())


def test_an_effect_takes_only_numbers_of_its_robot(scene):
    for kind in (kind for kind in forms().values() if kind.can_be_missing):
        form = next(iter(kind.variants(scene)))
        form.check(JOINTS)
        assert make_effect(form.name, form.shape) == form
        for key in set(form.shape) - {"joints"} if kind.name != "learned_effect" else ():
            with pytest.raises(ValueError, match=f"{key} has "):
                make_effect(form.name, {**form.shape, key: [*form.shape[key], 0.1]}).check(JOINTS)
        for joints in ((JOINTS + 1,), (0,), (2, 2)) if form.joints else ():
            shape = {key: values * len(joints) if len(values) == 1 else values for key, values in form.shape.items()}
            with pytest.raises(ValueError, match="not joints of the robot"):
                make_effect(form.name, {**shape, "joints": joints}).check(JOINTS)
    learned = {**LEARNED, "links": [0.1] * 10 * JOINTS}
    for key in ("links", "number"):
        with pytest.raises(ValueError, match=f"{key} has "):
            make_effect("learned_effect", {**learned, key: [*learned[key], 1.0]}).check(JOINTS)
    with pytest.raises(ValueError, match="all joints"):
        make_effect("base_tilt", {"angle": (0.1, 0.2), "joints": (2,)}).check(JOINTS)


def test_a_learned_effect_takes_only_functions_that_there_are():
    shape = EFFORTS["learned_effect"].shape(JOINTS)
    make_effect("learned_effect", shape).check(JOINTS)
    (first, weights), *others = shape["functions"]
    for place, value in ((1, JOINTS + 1.0), (4, first[0][3]), (5, -1.0)):  # joint, high, order
        changed = [*first[0][:place], value, *first[0][place + 1 :]]
        functions = [[[changed, *first[1:]], weights], *others]
        with pytest.raises(ValueError, match="cannot be used"):
            make_effect("learned_effect", {**shape, "functions": functions}).check(JOINTS)
    with pytest.raises(ValueError, match="expected 3 rows"):
        make_effect("learned_effect", {**shape, "functions": [[first, [*weights, [0.1, 0.1]]], *others]}).check(JOINTS)


def test_only_gains_payloads_and_tables_need_an_earlier_log():
    """They make the same efforts as other parameters of the robot itself, or nearly."""
    needing = {kind.name for kind in forms().values() if kind.needs_earlier}
    assert {name.split(".")[0] for name in needing} == {
        *("gain_error", "payload", "gear_ratio", "joint_zero", "link_length", "link_offset", "link_twist")
    }


def at_rate(rate):
    """One second of the fastest joint passing zero; the same motion whatever the rate."""
    return smooth_motion(1, 4.0, rate, seed=2)


@pytest.mark.parametrize("name", ["hysteresis", "hysteresis.layers", "hysteresis.smooth", "hysteresis.elastic"])
def test_presliding_is_resolved_where_samples_lie_in_its_way(name):
    """A way of a given length: by a log that is fast enough, in proportion to its rate, and by no slower one."""
    robot = small_robot(1)
    shortest = {}
    for rate in (25.0, 100.0, 400.0):
        scene = scene_of(at_rate(rate), robot)
        widths = np.exp(np.arange(np.log(1e-4), np.log(3.0), 0.02))
        resolved = [make_effect(name, {"joints": [1], "width": [width]}).resolved(scene) for width in widths]
        assert resolved == sorted(resolved)  # none below a width, all above
        assert not resolved[0]
        assert resolved[-1]
        shortest[rate] = widths[np.argmax(resolved)]
    assert shortest[25.0] / shortest[100.0] == pytest.approx(4.0, rel=0.05)
    assert shortest[100.0] / shortest[400.0] == pytest.approx(4.0, rel=0.05)
    usual = np.median(np.abs(at_rate(100.0).dq))
    assert 1.0 < shortest[100.0] * 100.0 / usual < 20.0  # a few samples


@pytest.mark.parametrize("fitting", [2.5, 10.0])
def test_a_model_remembers_columns_of_the_same_motion_only(monkeypatch, fitting):
    """In chunks, where memory holds all four of them; what a caller does to his own changes nothing."""
    robot = small_robot(JOINTS)
    motions = [smooth_motion(JOINTS, 1.0, 50.0, seed=seed) for seed in (3, 4)]
    model = Model(robot, make_terms(STANDARD, robot, motions[0]))
    whole = [model.columns(motion) for motion in motions]
    cached_bytes = int(fitting * SparseColumns.of(whole[0][:13]).nbytes)
    monkeypatch.setattr("bayesid.effects.model.TUNING", replace(TUNING, chunk=13, cached_bytes=cached_bytes))
    for which in (0, 0, 1, 0):
        next(model.sparse_chunks(motions[which]))  # somebody who asks for a part leaves it to the others
        chunks = list(model.chunks(motions[which]))
        assert [rows for rows, _ in chunks] == [slice(0, 13), slice(13, 26), slice(26, 39), slice(39, 50)]
        np.testing.assert_allclose(np.concatenate([columns for _, columns in chunks]), whole[which], rtol=1e-13)
        for _, columns in chunks:
            columns[:] = np.nan
    again = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(next(iter(again.chunks(motions[0])))[1], next(iter(model.chunks(motions[0])))[1])
