"""A new effect is one class: those of docs/extending.md, registered by a package of their own, or given as such."""

import json
import re
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from command_line import TWO_JOINTS

import bayesid
from bayesid.cli import main
from bayesid.effects.catalogue import forms, make_terms
from bayesid.effects.model import Model
from bayesid.effects.parameters import Coefficient, Cone
from bayesid.regression.selection.hypotheses import hypotheses, maker
from bayesid.robot import load_robot, robot_from_table
from bayesid.simulation.logs import parse_effect, with_effects
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

ROOT = Path(__file__).resolve().parents[2]
ON_PAGE = {"fan_drag": "FanDrag", "position_waves": "PositionWaves"}
KINDS = {**ON_PAGE, "crossover": "Crossover", "late_positions": "LatePositions"}


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
    """The classes as they stand on the page, and in the script beside it."""
    text = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", text, re.M | re.S)
    found = [[block for block in blocks if f'"{name}"\n' in block and "class " in block] for name in ON_PAGE]
    assert [len(one) for one in found] == [1] * len(ON_PAGE)
    return [*(one for (one,) in found), (ROOT / "docs" / "examples" / "own_distortions.py").read_text("utf-8")]


IDENTIFY = ("identify", "log.csv", "--robot", "arm.toml", "--complete", "off", "--no-posterior", "--no-report")
SIMULATE = "simulate --robot arm.toml --duration 6 --noise 0.02 --effect fan_drag:2:0.4 --seed 3 --out log.csv"
TERMS = "rigid_body,viscous_friction,coulomb_friction,torque_offset"


@pytest.fixture
def forgotten():
    """Packages are looked at anew."""

    forms.cache_clear()
    yield forms.cache_clear
    forms.cache_clear()


@pytest.fixture
def registered(tmp_path, monkeypatch, forgotten, sources):
    """The classes come with a package; what takes it from the path again."""
    install(tmp_path, "robot_fan", "\n\n".join(sources), KINDS)
    with monkeypatch.context() as path:
        path.syspath_prepend(tmp_path)
        yield lambda: (path.undo(), forgotten())
    sys.modules.pop("robot_fan", None)


@pytest.mark.usefixtures("any_motion", "registered")
def test_registered_effects_are_simulated_and_sought():
    robot = load_robot("tx40")
    motion = random_trajectory(6, 4.0, rng=1).motion(np.arange(200) / 50.0)
    rigid = Model(robot, make_terms(["rigid_body", "viscous_friction"], robot, motion))
    theta = random_parameters(rigid, rng=np.random.default_rng(1))
    effort = rigid.effort(motion, theta)
    chosen = [parse_effect(text, robot) for text in ("fan_drag:2:0.3", "crossover:3:0.1", "position_waves:4:0.2")]
    both, with_both = with_effects(rigid, theta, motion, chosen, 1)
    change = both.effort(motion, with_both) - effort
    size = np.sqrt(np.mean(change**2, axis=0) / np.mean(effort**2, axis=0))
    np.testing.assert_allclose(size, [0.0, 0.3, 0.1, 0.2, 0.0, 0.0], rtol=0.01, atol=1e-12)

    scene = rigid.scene(motion, theta, effort, np.abs(effort))
    candidates = [one for group in hypotheses(maker(rigid, scene, np.ones(effort.shape, bool)), scene) for one in group]
    for name in KINDS:
        first = 2 if name == "late_positions" else 1  # where joint 1 stands, about the vertical, makes no effort
        assert {one.joints for one in candidates if one.effect == name} == {(j,) for j in range(first, 7)}


def test_a_registered_term_is_named_on_the_command_line_and_read_back(registered, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("arm.toml").write_text(TWO_JOINTS)
    assert main(SIMULATE.split()) == 0
    assert main([*IDENTIFY, "--terms", f"{TERMS},fan_drag", "--out", "result"]) == 0
    assert main(["validate", "result", "log.csv", "--out", "validated"]) == 0
    assert main([*IDENTIFY, "--terms", "rigid_body,fan_drug", "--out", "no"]) == 2
    assert "did you mean fan_drag?" in capsys.readouterr().err
    registered()
    assert main(["validate", "result", "log.csv", "--out", "v"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "unknown term 'fan_drag'" in line
    assert "install the package that registers it" in line


CLASS = "from bayesid.effects import Term\nclass Any(Term):\n    "
SYMBOL = """
from bayesid.effects import ActuatorTerm, Coefficient
class Any(ActuatorTerm):
    name = 'any'
    coefficients = (Coefficient('{}', 'N m'),)
"""


def test_a_package_that_registers_nonsense_is_named(tmp_path, monkeypatch, capsys, forgotten):
    for k, (source, expected) in enumerate(
        (
            ("raise OSError('no licence')", "cannot be loaded (OSError: no licence)"),
            ("Any = 3", "wrong1:Any is not an effect class with a name"),
            (CLASS + "pass", "is not an effect class with a name"),
            (CLASS + "name = 'payload'", "its effect 'payload' has the name of one of bayesid.effects.bodies"),
            (SYMBOL.format("Fe"), "its symbol Fe is that of viscous_friction.saturating"),
            (SYMBOL.format("Fany2"), "its symbol Fany2 ends in a digit; name it Fany2_"),
        )
    ):
        place = tmp_path / str(k)
        place.mkdir()
        install(place, f"wrong{k}", source, {"any": "Any"})
        forgotten()
        with monkeypatch.context() as path:
            path.syspath_prepend(place)
            assert main(["simulate", "--robot", "kr5", "--effect", "payload:6:0.1", "--out", str(place / "x.csv")]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert expected in line
        assert f"wrong{k}" in line
        assert not (place / "x.csv").exists()


@pytest.fixture(scope="module")
def kinds(sources):
    """Two of the classes, registered by nobody."""
    space = {"__name__": "a_script"}
    for source in sources:
        exec(source, space)
    return space["FanDrag"], space["Crossover"]


@pytest.fixture(scope="module")
def arm():
    return robot_from_table(tomllib.loads(TWO_JOINTS), "arm")


@pytest.fixture(scope="module")
def log(arm, kinds):
    """A fan of 4 N m s^2/rad^2 in joint 2."""
    motion = random_trajectory(2, 8.0, rng=4).motion(np.arange(801) / 100.0)
    model = Model(arm, make_terms(["rigid_body", "viscous_friction", kinds[0](joints=(2,))], arm, motion))
    rng = np.random.default_rng(4)
    theta = np.append(random_parameters(model, rng=rng)[:-1], 4.0)
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
    bayesid.save(result, tmp_path / "result", report=False)
    again = bayesid.load(tmp_path / "result", effects=kinds)
    assert again.model.terms == result.identified.model.terms
    np.testing.assert_array_equal(again.theta, result.identified.theta)
    with pytest.raises(bayesid.InputError, match=r"unknown term 'fan_drag'; .*effects=\["):
        bayesid.load(tmp_path / "result")


def columns_of(shape, value=1.0):
    return lambda self, robot, motion: np.full((len(motion), *shape), value)


def test_what_is_no_term_or_does_not_suit_is_refused(arm, log, kinds):
    def broken(**change):
        return type("Broken", (kinds[0],), change)()

    for wrong, expected in (
        (broken(unit_efforts=lambda self, actuators: actuators.dq[:, 0]), "does not suit the robot"),
        (broken(unit_efforts=lambda self, actuators: np.nan * actuators.dq), "columns are not finite"),
        (broken(columns=columns_of((2, 3))), r"columns are \(8, 2, 3\), expected \(8, 2, 2\)"),
        (broken(cone=lambda self, robot: Cone.free(5)), "cone has 5 parameters, expected 2"),
        (broken(coefficients=(Coefficient("m", "N m"),)), "two terms have a parameter m1"),
        (kinds[0], r"give a term: FanDrag\(\)"),
        (3, "neither the name of a term nor a term"),
        (kinds[1](joints=(2,), width=(0.1,)), "neither the name of a term nor a term"),
        (kinds[0](joints=(3,)), "are not joints of the robot"),
    ):
        with pytest.raises(bayesid.InputError, match=expected):
            bayesid.identify(arm, log, terms=["rigid_body", wrong])
