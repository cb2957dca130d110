"""A new effect is one class: the two of docs/extending.md, registered by a package of their own, or given as such."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import bayesid
from bayesid.cli import main
from bayesid.model.catalogue import forms, make_terms
from bayesid.model.model import Model
from bayesid.model.parameters import Cone
from bayesid.model.registered import registered_effects
from bayesid.model.robot import robot_from_table
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

ROOT = Path(__file__).resolve().parents[2]
NAMES = ("fan_drag", "crossover")
SCRIPT = r"""
import json

import numpy as np
import tomli_w

from bayesid.fit.effects.hypotheses import hypotheses
from bayesid.fit.noise import Noise
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.model.catalogue import make_effect, make_terms, noun
from bayesid.model.coefficients import base_coefficients
from bayesid.model.model import Model
from bayesid.model.robot import load_robot
from bayesid.results.export import mjcf, urdf
from bayesid.results.model_file import load_model, model_table
from bayesid.simulation.logs import parse_effect, with_effects
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

robot = load_robot("tx40")
motion = random_trajectory(6, 4.0, seed=1).motion(np.arange(200) / 50.0)
rigid = Model(robot, make_terms(["rigid_body", "viscous_friction"], robot, motion))
theta = random_parameters(rigid, np.random.default_rng(1))
effort = rigid.effort(motion, theta)
said = {}

# Simulated, each at its level in its joint
chosen = [parse_effect(text, robot) for text in ("fan_drag:2:0.3", "crossover:3:0.1")]
both, with_both = with_effects(rigid, theta, motion, chosen, 1)
change = both.effort(motion, with_both) - effort
size = np.sqrt(np.mean(change**2, axis=0)) / np.sqrt(np.mean(effort**2, axis=0))
said["levels"] = [float(size[1]), float(size[2])]
said["others"] = float(np.abs(np.delete(change, [1, 2], axis=1)).max())

# Candidates for what is missing from a model
scene = rigid.scene(motion, theta, effort, np.abs(effort))
candidates = [one for group in hypotheses(rigid, scene, np.ones(effort.shape, bool)) for one in group]
for name in ("fan_drag", "crossover"):
    said[name] = [sorted({one.joints for one in candidates if one.effect == name}), noun(name)]

# In files
own = [make_effect("fan_drag", {"joints": [2]}), make_effect("crossover", {"joints": [3], "width": [0.5]})]
model = rigid.extend(own[1]).extend(own[0])
theta = np.append(theta, 1.25)
said["remarks"] = [[line.strip() for line in text(model, theta).splitlines()] for text in (urdf, mjcf)]
precision = np.eye(len(base_coefficients(model)))
noise = Noise(*np.full((4, 6), 0.5))
with open("model.toml", "w") as file:
    file.write(tomli_w.dumps(model_table(IdentifiedModel(model, theta, noise, precision))))
again = load_model(".")
said["read back"] = again.model.effects == model.effects and bool(np.array_equal(again.theta, theta))
print(json.dumps(said))
"""


def install(folder, module, source, entries):
    """A package of one module, as an installer leaves it, with entry points of the group that registers effects."""
    (folder / f"{module}.py").write_text(source, encoding="utf-8")
    about = folder / f"{module}-1.0.dist-info"
    about.mkdir()
    about.joinpath("METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    lines = [f"{name} = {module}:{value}" for name, value in entries.items()]
    about.joinpath("entry_points.txt").write_text("\n".join(["[bayesid.effects]", *lines, ""]))


@pytest.fixture(scope="module")
def sources():
    """The two classes as they stand on the page."""
    text = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", text, re.M | re.S)
    found = [[block for block in blocks if f'"{name}"\n' in block and "class " in block] for name in NAMES]
    assert [len(one) for one in found] == [1, 1]
    return [one for (one,) in found]


@pytest.fixture(scope="module")
def package(tmp_path_factory, sources):
    """A folder on the path with a package that registers both."""
    folder = tmp_path_factory.mktemp("installed")
    install(folder, "robot_fan", "\n\n".join(sources), {"fan_drag": "FanDrag", "crossover": "Crossover"})
    return folder


def run(folder, *arguments):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])}
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)


@pytest.fixture(scope="module")
def said(package):
    """What the catalogue with two more effects has to say."""
    done = run(package, "-c", SCRIPT)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_registered_effects_are_simulated_sought_exported_and_read_back(said):
    assert said["levels"] == pytest.approx([0.3, 0.1], rel=0.01)
    assert said["others"] < 1e-12
    joints = [[j] for j in range(1, 7)]
    assert said["fan_drag"] == [joints, "a fan's drag"]
    assert said["crossover"][0] == joints
    for lines in said["remarks"]:
        assert "fan_drag: c2 = 1.25 N m s^2/rad^2" in lines
        assert "crossover: width3 = 0.5 N m" in lines
    assert said["read back"]


# ---------------------------------------------------------------------------------------------------------------
# On the command line
# ---------------------------------------------------------------------------------------------------------------
IDENTIFY = ("identify", "log.csv", "--robot", "arm.toml", "--complete", "off", "--no-posterior", "--no-report")
COMMANDS = """
import json, sys
from bayesid.cli import main
sys.exit(next((code for command in json.loads(sys.argv[1]) if (code := main(command))), 0))
"""
ARM = """convention = "standard"
name = "arm"
joints = [
  {a = 0.0, alpha = 1.5707963267948966, d = 0.4, theta = 0.0},
  {a = 0.35, alpha = 0.0, d = 0.0, theta = 0.0},
]
"""


def test_a_registered_term_is_named_on_the_command_line_and_read_back(package, capsys):
    """The last of the commands, which run in one process, misspells it: its code is the process's."""
    (package / "arm.toml").write_text(ARM)
    terms = "rigid_body,viscous_friction,coulomb_friction,torque_offset,fan_drag"
    simulate = "simulate --robot arm.toml --duration 6 --noise 0.02 --effect fan_drag:2:0.4 --seed 3 --out log.csv"
    commands = [
        simulate.split(),
        [*IDENTIFY, "--terms", terms, "--out", "result"],
        ["validate", "result", "log.csv", "--out", "validated"],
        [*IDENTIFY, "--terms", "rigid_body,fan_drug", "--out", "no"],
    ]
    done = run(package, "-c", COMMANDS, json.dumps(commands))
    assert (package / "validated").is_dir(), done.stderr
    assert done.returncode == 2
    assert "did you mean fan_drag?" in done.stderr

    elsewhere = main(["validate", str(package / "result"), str(package / "log.csv"), "--out", str(package / "v")])
    assert elsewhere == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "unknown term 'fan_drag'" in line
    assert "install the package that registers it" in line


@pytest.fixture
def forgotten():
    """Packages are looked at anew."""

    def forget():
        registered_effects.cache_clear()
        forms.cache_clear()

    forget()
    yield
    forget()


CLASS = "from bayesid.model.terms import Term\nclass Any(Term):\n    "


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("raise OSError('no licence')", "cannot be loaded (OSError: no licence)"),
        ("Any = 3", "wrong_1:Any is no effect's class with a name"),
        (CLASS + "pass", "is no effect's class with a name"),
        (CLASS + "name = 'payload'", "registers an effect of this name too"),
    ],
    ids=range(4),
)
def test_a_package_that_registers_nonsense_is_named(
    tmp_path, monkeypatch, capsys, forgotten, request, source, expected
):
    module = f"wrong_{request.node.callspec.id}"  # one that no other case has imported
    install(tmp_path, module, source, {"any": "Any"})
    monkeypatch.syspath_prepend(tmp_path)
    assert main(["simulate", "--robot", "kr5", "--effect", "payload:6:0.1", "--out", str(tmp_path / "x.csv")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert expected in line
    assert module in line
    assert not (tmp_path / "x.csv").exists()


# ---------------------------------------------------------------------------------------------------------------
# Given as they are
# ---------------------------------------------------------------------------------------------------------------
JOINTS = [{"a": 0.0, "alpha": np.pi / 2, "d": 0.4, "theta": 0.0}, {"a": 0.35, "alpha": 0.0, "d": 0.0, "theta": 0.0}]


@pytest.fixture(scope="module")
def kinds(sources):
    """The two classes, registered by nobody."""
    space = {"__name__": "a_script"}
    for source in sources:
        exec(source, space)
    return space["FanDrag"], space["Crossover"]


@pytest.fixture(scope="module")
def arm():
    return robot_from_table({"name": "arm", "convention": "standard", "joints": JOINTS}, "arm")


@pytest.fixture(scope="module")
def log(arm, kinds):
    """A fan of 4 N m s^2/rad^2 in joint 2."""
    motion = random_trajectory(2, 8.0, seed=4).motion(np.arange(801) / 100.0)
    model = Model(arm, make_terms(["rigid_body", "viscous_friction", kinds[0](joints=(2,))], arm, motion))
    rng = np.random.default_rng(4)
    theta = np.append(random_parameters(model, rng)[:-1], 4.0)
    return bayesid.simulate(model, theta, motion, rng=rng, noise=0.02)


@pytest.fixture(scope="module")
def result(arm, log, kinds):
    terms = ["rigid_body", "viscous_friction", kinds[0](joints=(2,))]
    return bayesid.identify(arm, log, terms=terms, complete="off", posterior=False)


def test_a_term_of_ones_own_is_identified(result, kinds):
    number = result.coefficient("c2")
    assert abs(number.mean - 4.0) < 4.0 * number.sd
    assert 0.0 < number.sd < 0.2  # 2 % of noise, 800 samples, a drag of tens of N m
    assert result.identified.model.terms[-1] == kinds[0](joints=(2,))
    assert "FanDrag(joints=(2,))" in result.provenance.call
    json.dumps(dict(result.provenance.options))


def test_its_model_is_read_back_with_its_class_and_refused_without(tmp_path, result, kinds):
    bayesid.save_identification(result, tmp_path / "result", report=False)
    again = bayesid.load_model(tmp_path / "result", effects=kinds)
    assert again.model.terms == result.identified.model.terms
    np.testing.assert_array_equal(again.theta, result.identified.theta)
    with pytest.raises(bayesid.InputError, match=r"unknown term 'fan_drag'; .*effects=\[its class\]"):
        bayesid.load_model(tmp_path / "result")


def columns_of(shape, value=1.0):
    return lambda self, robot, motion: np.full((len(motion), *shape), value)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"unit_efforts": lambda self, actuators: actuators.dq[:, 0]}, "does not suit the robot"),
        ({"unit_efforts": lambda self, actuators: np.full(actuators.dq.shape, np.nan)}, "columns are not finite"),
        ({"columns": columns_of((2, 3))}, r"columns are \(8, 2, 3\), expected \(8, 2, 2\)"),
        ({"cone": lambda self, robot: Cone.free(5)}, "cone is of 5 parameters, it has 2"),
        ({"symbols": ("m",)}, "two terms have a parameter m1"),
    ],
)
def test_a_term_that_does_not_suit_is_refused_by_name(arm, log, kinds, change, expected):
    broken = type("Broken", (kinds[0],), change)()
    with pytest.raises(bayesid.InputError, match=expected):
        bayesid.identify(arm, log, terms=["rigid_body", broken])


def test_what_is_no_term_is_refused(arm, log, kinds):
    for wrong, expected in (
        (kinds[0], r"give a term: FanDrag\(\)"),
        (3, "neither the name of a term nor a term"),
        (kinds[1](joints=(2,), width=(0.1,)), "neither the name of a term nor a term"),
        (kinds[0](joints=(3,)), "are not joints of the robot"),
    ):
        with pytest.raises(bayesid.InputError, match=expected):
            bayesid.identify(arm, log, terms=["rigid_body", wrong])
