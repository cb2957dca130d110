"""The examples of public docstrings run.

Examples use the names that docs/python.md makes: a small robot, a simulated log of it, the model and its parameters, a
result and what is made of it. All are made once; each docstring gets a copy of the names, and the files of a user.
"""

from __future__ import annotations

import doctest
import inspect
from collections.abc import Iterator
from contextlib import chdir, suppress
from functools import cached_property
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from test_docs import FEW, GAINS, SHOWN, assert_alike, write_files, write_logs

import bayesid
from bayesid.log.segments import find_segments
from bayesid.regression.normal_equations import normal_equations
from bayesid.signs.search.protocol import SignProblem

TERMS = ["rigid_body", "viscous_friction", "coulomb_friction"]


def make_namespace(folder: Path) -> dict[str, object]:
    """The names of docs/python.md, and the files beside them in the folder, which is the working directory."""
    write_files(folder, SHOWN)
    write_logs(folder, "python.md")
    (folder / "limits.toml").write_text(
        "lower = [-2, -1, -2]\nupper = [2, 1, 2]\nvelocity = 2.0\nacceleration = 10.0\n"
    )
    (folder / "nominal.csv").write_text("name,mean,sd\nm3,1.2,0.1\n")
    box = "[[-0.8, -0.6, -0.6], [0.8, 0.6, 0.6]]"
    (folder / "known.toml").write_text(f"total_mass = [3, 60]\n[link.2]\ncom_box = {box}\n[bounds]\nm3 = [0, 9]\n")
    robot, log, other_log = bayesid.load_robot("robot.toml"), *map(bayesid.read_log, ("log.csv", "another_log.csv"))
    motion = bayesid.random_trajectory(robot.n_joints, duration=4.0, rng=1).motion(np.arange(201) / 50.0)
    header = ",".join(["t", *(f"q{j}" for j in (1, 2, 3))])
    np.savetxt("motion.csv", np.column_stack([motion.t, motion.q]), delimiter=",", header=header, comments="")
    model = bayesid.Model.of(robot, TERMS, motion)
    result = bayesid.identify(robot, log, TERMS, posterior=FEW)
    bayesid.save(result, "result", report=False)
    settings = bayesid.MotionSettings(duration=4.0, rate=50.0, harmonics=2, changes=20)
    return {
        "bayesid": bayesid,
        "np": np,
        "robot": robot,
        "log": log,
        "other_log": other_log,
        "motion": motion,
        "terms": TERMS,
        "model": model,
        "theta": bayesid.random_parameters(model, rng=np.random.default_rng(0)),
        "result": result,
        "check": result.validate(other_log),
        "predicted": result.predict(motion),
        "findings": result.report_data(),
        "reading": bayesid.identify_payload(
            result, bayesid.read_log("loaded.csv", gains=GAINS.tolist()), known_mass=2.0
        ),
        "gains": bayesid.identify(
            robot, bayesid.read_log("currents.csv", gains="12~20%,16~20%,10~20%"), complete="off", posterior=False
        ).gains,
        "found": bayesid.find_discrepancy(result, other_log, posterior=False),
        "design": bayesid.design_excitation(robot, TERMS, settings=settings),
        "problem": sign_problem(result),
    }


def sign_problem(result: bayesid.Identification) -> SignProblem:
    """What a search is given: segments of the log, efforts in units of their noise."""
    signals, model = result.signals, result.model
    segments = find_segments(signals, model.robot.actuators(signals.motion))
    segments = segments[segments.fitted]
    coefficients = result.coefficients
    of_log = normal_equations(model, coefficients, signals.motion, signals.raw_effort, segments)
    return SignProblem(of_log.scaled(result.noise.sigma), model.cone, coefficients)


def public() -> Iterator[tuple[str, str]]:
    """Names and docstrings of all that is promised, methods and properties among them."""
    owners = (("bayesid", bayesid), ("bayesid.types", bayesid.types), ("bayesid.plot", bayesid.plot))
    named = ((f"{place}.{name}", getattr(owner, name)) for place, owner in owners for name in owner.__all__)
    for name, value in named:
        yield name, inspect.getdoc(value) or ""
        if inspect.isclass(value):
            yield from methods(name, value)


def methods(name: str, kind: type) -> Iterator[tuple[str, str]]:
    """Those of a class that are its own or inherited from this package; what a field holds has no docstring."""
    for member in dir(kind):
        value = inspect.getattr_static(kind, member)
        if isinstance(value, staticmethod | classmethod):
            value = value.__func__
        told = inspect.isfunction(value) or isinstance(value, property | cached_property)
        if told and not member.startswith("_") and member not in getattr(kind, "__dataclass_fields__", {}):
            yield f"{name}.{member}", inspect.getdoc(value) or ""


class Alike(doctest.OutputChecker):
    """Numbers to about the digits shown, as on the pages."""

    def check_output(self, want: str, got: str, optionflags: int) -> bool:
        if super().check_output(want, got, optionflags):
            return True
        with suppress(AssertionError):
            assert_alike(got, want)
            return bool(want.strip())
        return False


@pytest.fixture(scope="module")
def namespace(tmp_path_factory):
    folder = tmp_path_factory.mktemp("user")
    with chdir(folder), mpl.rc_context({"svg.hashsalt": "bayesid"}):
        yield make_namespace(folder)


@pytest.mark.long
def test_examples_run(namespace):
    runner, told = doctest.DocTestRunner(Alike(), verbose=False, optionflags=doctest.NORMALIZE_WHITESPACE), []
    for name, text in public():
        runner.run(doctest.DocTestParser().get_doctest(text, dict(namespace), name, None, 0), out=told.append)
    assert "".join(told) == ""
