"""A new effect is one file: the two of docs/extending.md, in a copy of the package that nothing else was changed in."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = r"""
import json
from types import SimpleNamespace

import numpy as np
import tomli_w

from bayesid.fit.effects.hypotheses import hypotheses
from bayesid.fit.noise import Noise
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.model.catalogue import effect_names, make_effect, noun
from bayesid.model.coefficients import base_coefficients
from bayesid.model.model import Model
from bayesid.model.robot import load_robot
from bayesid.model.terms import make_terms
from bayesid.report.discrepancy_verdicts import discrepancy_checks
from bayesid.results.export import mjcf, urdf
from bayesid.results.model_file import load_model, model_table
from bayesid.simulation.logs import parse_effect, simulate_log
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

robot = load_robot("tx40")
said = {"names": effect_names()}

# Simulated, each at its level in its joint
chosen = [parse_effect(text, robot) for text in ("fan_drag:2:0.3", "crossover:3:0.1")]
plain, with_both = (simulate_log(robot, 3.0, 50.0, 0.0, effects, 1)[1] for effects in ((), chosen))
change = with_both.effort - plain.effort
size = np.sqrt(np.mean(change**2, axis=0)) / np.sqrt(np.mean(plain.effort**2, axis=0))
said["levels"] = [float(size[1]), float(size[2])]
said["others"] = float(np.abs(np.delete(change, [1, 2], axis=1)).max())

# A term of a model, and a candidate for what is missing from one
motion = random_trajectory(6, 4.0, seed=1).motion(np.arange(200) / 50.0)
rigid = Model(robot, make_terms(["rigid_body", "viscous_friction"], robot, motion))
theta = random_parameters(rigid, np.random.default_rng(1))
effort = rigid.effort(motion, theta)
scene = rigid.scene(motion, theta, effort, np.abs(effort))
candidates = [one for group in hypotheses(rigid, scene, np.ones(effort.shape, bool)) for one in group]
sizes = np.full(6, 0.5)
for name, number in (("fan_drag", ("c2", 6.0, 0.1, "N m s^2/rad^2")), ("crossover", ("width2", 0.4, np.nan, "N m"))):
    forms = [one for one in candidates if one.effect == name]
    in_joint_2 = next(one for one in forms if one.joints == (2,))
    effect = SimpleNamespace(
        hypothesis=in_joint_2, effect=name, joints=(2,), parameters={number[0]: number[1:]}, readable={},
        probability=0.99, equivalent=(),
    )
    result = SimpleNamespace(
        added=[effect], before=sizes, after=sizes, holdout="later.csv", where=[],
        floor=SimpleNamespace(rms=sizes, lasting=sizes > 1.0),
        unexplained=[], not_testable=[], identification=SimpleNamespace(model=rigid),
    )
    said[name] = {
        "joints": sorted({one.joints for one in forms}), "noun": noun(name),
        "paragraph": discrepancy_checks(result)[0].message,
    }

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
said["read back"] = again.model.terms == model.terms and again.model.distortions == model.distortions
said["values"] = bool(np.array_equal(again.theta, theta))
print(json.dumps(said))
"""


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """What a copy of the package with two more files has to say."""
    folder = tmp_path_factory.mktemp("copy")
    shutil.copytree(ROOT / "bayesid", folder / "bayesid", ignore=shutil.ignore_patterns("__pycache__"))
    text = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", text, re.M | re.S)
    for place in ("terms/fan_drag", "distortions/crossover"):
        name = place.split("/")[1]
        (source,) = [block for block in blocks if f'"{name}"\n' in block and "class " in block]
        file = folder / "bayesid" / "model" / f"{place}.py"
        file.write_text(f'"""As on the page."""\n\nfrom __future__ import annotations\n\n{source}', encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    command = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_new_effects_are_simulated_at_their_levels(said):
    assert {"fan_drag", "crossover", "viscous_friction"} <= set(said["names"])
    assert said["levels"] == pytest.approx([0.3, 0.1], rel=0.01)
    assert said["others"] < 1e-12


def test_new_effects_are_candidates_in_every_joint_and_are_spoken_of(said):
    each = [[j] for j in range(1, 7)]
    assert said["fan_drag"]["joints"] == said["crossover"]["joints"] == each
    assert said["fan_drag"]["noun"] == "a fan's drag"
    drag = "Joint 2 needs the drag of a fan, 6.00 +- 0.10 N m s^2/rad^2 times the squared speed"
    assert said["fan_drag"]["paragraph"] == drag
    loss = "Joint 2's efforts read too small, those of 0.400 N m by half"
    assert said["crossover"]["paragraph"] == loss


def test_new_effects_stand_at_the_head_of_exports(said):
    for lines in said["remarks"]:
        assert "fan_drag: c2 = 1.25 N m s^2/rad^2" in lines
        assert "crossover: width3 = 0.5 N m" in lines


def test_models_with_new_effects_come_back(said):
    assert said["read back"]
    assert said["values"]
