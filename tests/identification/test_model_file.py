"""model.toml: models come back the same, and broken files are refused in one line."""

import tomllib
from dataclasses import fields, replace

import numpy as np
import pinocchio as pin
import pytest
import tomli_w
from conftest import small_robot, smooth_motion
from exported_robots import in_pinocchio
from identified_arm import by_least_squares, sampled
from oracles import urdf_text
from saved_results import identified, save, simulated

from bayesid.effects import ActuatorTerm, RigidBody
from bayesid.effects.catalogue import DISTORTIONS, TERMS, make_effect
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.identification.model_file import load, model_table
from bayesid.identification.pipeline import identify, identify_again
from bayesid.regression.noise import Noise
from bayesid.robot import load_robot, robot_from_urdf
from bayesid.simulation.logs import simulate
from bayesid.simulation.trajectories import random_trajectory


@pytest.mark.parametrize("robot", ["dh", "tx40", "urdf"])
def test_a_model_comes_back_the_same(robot, tmp_path):
    """And the URDF beside it has the torques of the rigid bodies."""
    result = identified()
    if robot != "dh":
        other = load_robot("tx40") if robot == "tx40" else robot_from_urdf(urdf_text(), "test")
        result = identify(other, simulated(other, signed=True), posterior=False, complete="off")
    folder = save(result, tmp_path / "r")
    loaded, arm = load(folder), result.model.robot
    assert loaded.model.robot.same_kinematics(arm)
    assert loaded.draws is None
    np.testing.assert_array_equal(loaded.model.robot.coupling, arm.coupling)
    assert loaded.model.robot.name == arm.name
    assert loaded.model.terms == result.model.terms
    assert loaded.model.parameters == result.model.parameters
    np.testing.assert_allclose(loaded.theta, result.fit.theta, rtol=1e-12, atol=0.0)
    for key, values in vars(result.fit.noise).items():
        np.testing.assert_allclose(getattr(loaded.noise, key), values, rtol=1e-12)
    predicted = loaded.model.effort(result.signals.motion[:50], loaded.theta)
    np.testing.assert_allclose(predicted, result.fit.predicted[:50], rtol=1e-9, atol=1e-9)
    motion = result.signals.motion[::20]
    found = in_pinocchio(pin.buildModelFromUrdf(str(folder / "robot.urdf")), arm.gravity, motion)
    expected = replace(arm, transmission=None).inverse_dynamics(motion, result.fit.theta[: 10 * arm.n_joints])
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("made", [by_least_squares, sampled])
def test_a_loaded_model_has_the_coefficients_of_its_identification(made, tmp_path):
    """Means, deviations and intervals of coefficients.csv; without that file they follow from the model."""
    result = made()
    folder = save(result, tmp_path / "r")
    loaded, expected = load(folder), result.coefficients_table()
    assert loaded.coefficients.names == result.coefficients.names
    keys = "name", "expression", "unit", "decided_by"
    assert [[getattr(one, key) for key in keys] for one in loaded.coefficients_table()] == [
        [getattr(one, key) for key in keys] for one in expected
    ]
    numbers = [[[one.mean, one.sd, one.rsd, one.lower, one.upper] for one in of] for of in (loaded.listed, expected)]
    np.testing.assert_allclose(*numbers, rtol=1e-8)
    assert loaded.coefficient("Fc2").mean == pytest.approx(result.coefficient("Fc2").mean, rel=1e-8)
    with (folder / "coefficients.csv").open("a") as file:
        file.write("stray,words\n")
    with pytest.raises(InputError, match=r"coefficients\.csv"):
        load(folder)
    (folder / "coefficients.csv").unlink()
    alone = load(folder).coefficients_table()
    np.testing.assert_allclose([one.mean for one in alone], result.beta, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose([one.sd for one in alone], result.sd, rtol=0.05)


NUMBERS = {
    "smoothing": 0.03,
    "speed": 0.1,
    "harmonic": 23.7,
    "width": 0.07,
    "time": 1.9,
    "start": -0.3,
    "side": -1.0,
    "gain": 1.1,
    "lag": 0.013,
    "angle": 0.07,
    "limit": 31.7,
}


def made(name, joints, n=3):
    """An effect of a catalogue, on some of the joints."""
    kind = {**TERMS, **DISTORTIONS}[name]
    needed = {one.name for one in fields(kind)} - {"joints", "links"}
    count = {key: kind.number_fields()[key].count or len(joints) for key in needed}
    shape = {key: [NUMBERS.get(key, 0.37) * (1.0 + i / 7.0) for i in range(count[key])] for key in needed}
    shape |= {key: ["tool1"] for key in needed & {"label"}}
    shape |= {"links": np.linspace(-1.0, 2.0, 10 * n).tolist()} if name == "load_dependent_friction" else {}
    if (issubclass(kind, ActuatorTerm) or name in DISTORTIONS) and name != "base_tilt":
        shape["joints"] = joints
    return make_effect(name, shape)


def of_everything(rng, terms=(), distortions=()):
    """A stored model with numbers that no decimals can write."""
    model = Model(small_robot(3), (RigidBody(), *terms), distortions)
    size = len(base_coefficients(model))
    root = rng.standard_normal((size, size - 2)) * np.geomspace(1e-3, 1e3, size)[:, None]
    noise = Noise(*rng.uniform(0.1, 1.0, (len(fields(Noise)), 3)))
    return IdentifiedModel(model, rng.standard_normal(len(model.parameters)), noise, root @ root.T)


def there_and_back(stored, folder):
    (folder / "model.toml").write_text(tomli_w.dumps(model_table(stored)))
    return load(folder)


def assert_same(found, stored):
    assert found.model.terms == stored.model.terms
    assert found.model.distortions == stored.model.distortions
    assert found.model.parameters == stored.model.parameters
    for one, other in ((found, stored), (found.noise, stored.noise)):
        for name in ("theta", "precision") if one is found else vars(one):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    motion = smooth_motion(3, 1.0, 50.0)
    effort = stored.model.effort(motion, stored.theta)
    np.testing.assert_allclose(found.model.effort(motion, found.theta), effort, rtol=1e-12, atol=1e-12)


NOT_MADE_HERE = ("rigid_body", "learned_effect")  # the latter is tested in tests/discrepancy/test_learned_functions.py


def test_a_model_of_every_effect_comes_back(tmp_path, rng):
    """Terms of one name in different joints, all distortions one after the other."""
    names = [name for name in TERMS if name not in NOT_MADE_HERE]
    terms = dict.fromkeys(made(name, joints) for joints in ((2,), (3, 1)) for name in names)
    stored = of_everything(rng, terms, tuple(made(name, (1, 3)) for name in reversed(DISTORTIONS)))
    names = [parameter.name for parameter in stored.model.parameters]
    assert len(set(names)) == len(names)
    found = there_and_back(stored, tmp_path)
    assert_same(found, stored)
    assert found.knowledge.model == found.model
    np.testing.assert_array_equal(found.knowledge.precision, stored.precision)


def test_a_robot_that_took_up_a_payload_comes_back(tmp_path):
    """What the two logs tell of the last link and the payload each is more than one log without the other can tell."""
    result = identified()
    terms = (made("payload", ()), make_effect("hysteresis", {"width": [0.1], "joints": [2]}))
    model = Model(result.model.robot, (*result.model.terms, *terms), (made("delay", (1,)),))
    theta = np.concatenate([result.theta, [0.01, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0, 0.0, 0.0, 0.3, 0.2]])
    motion = random_trajectory(3, 6.0, rng=8).motion(result.log.t - result.log.t[0])
    log = simulate(model, theta, motion, rng=np.random.default_rng(1), noise=0.03, signed=True)
    again = identify_again(model, log, result.knowledge, theta)
    own = base_coefficients(model)
    assert len(again.coefficients) == len(own) + 10
    loaded = load(save(again, tmp_path / "r"))
    assert loaded.model.terms == model.terms
    assert loaded.model.distortions == model.distortions
    np.testing.assert_allclose(loaded.theta, again.theta, rtol=1e-12, atol=0.0)
    size = np.sqrt(np.diag(again.fit.information))
    covariance = np.linalg.inv(again.fit.information / np.outer(size, size)) / np.outer(size, size)
    turn = own.projection @ np.linalg.pinv(again.coefficients.projection)
    np.testing.assert_allclose(turn @ covariance @ turn.T @ loaded.precision, np.eye(len(own)), atol=1e-5)


def put(*path):
    *keys, value = path

    def change(content):
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value

    return change


BROKEN = [  # what else may be wrong is in tests/fuzz
    *((lambda content, key=key: content.pop(key), None) for key in ("robot", "terms", "values", "noise")),
    (lambda content: content["values"].pop("m1"), None),
    (lambda content: content["robot"]["joints"][0].pop("axis"), None),
    (put("terms", 0, {"name": "magic"}), "unknown term 'magic'"),
    (put("values", "m1", float("nan")), None),
    (put("noise", "white", [-1.0] * 3), None),
    (put("noise", "other", [1.0] * 3), None),
    (put("robot", "joints", 0, "parent", 9), None),
    (put("robot", "convention", "own"), None),
    (put("terms", 1, "name", "gain_error"), "unknown term 'gain_error'"),
    (put("terms", 3, "shape", "links", [0.0] * 29), "links has 29 numbers"),
    (put("terms", 2, "shape", "joints", [3, 3]), "are not joints"),
    (put("terms", 2, "shape", "joints", [3, 2]), "comes twice"),
    (put("distortions", 0, "name", "hysteresis"), "unknown distortion 'hysteresis'"),
    (put("distortions", 0, "shape", {"gain": [1.1], "joints": [3, 1]}), "gain has 1 numbers"),
    (put("distortions", 0, "shape", "lag", [0.1]), "lag"),
    (put("distortions", 0, "shape", "gain", [1.0, 10**400]), "too large"),
    (put("distortions", 0, {"name": "base_tilt", "shape": {"angle": [0.1, 0.2], "joints": [1]}}), "all joints"),
    (put("distortions", 1, "shape", "joints", [4]), "are not joints"),
    (put("knowledge", {}), "'coefficients'"),
    (put("knowledge", "coefficients", 0, "m9"), "other coefficients"),
    (lambda content: content["knowledge"]["precision"].pop(), "shape"),
    (put("knowledge", "precision", 0, 0, float("nan")), "not finite"),
]


def test_a_broken_model_file_is_refused_in_one_line_that_names_it(tmp_path, rng):
    """Of a model with two terms of one name and two distortions."""
    terms = [made("hysteresis", (2,)), made("hysteresis", (3, 1)), made("load_dependent_friction", (2,))]
    there_and_back(of_everything(rng, terms, (made("gain_error", (3, 1)), made("clipping", (2,)))), tmp_path)
    path = tmp_path / "model.toml"
    before = path.read_text()
    for change, says in BROKEN:
        content = tomllib.loads(before)
        change(content)
        path.write_text(tomli_w.dumps(content))
        with pytest.raises(InputError, match=says) as refusal:
            load(tmp_path)
        assert str(path) in refusal.value.where
        assert "\n" not in str(refusal.value)
