"""Public functions that take a result or a robot: the form that is meant, and options of the other one."""

from pathlib import Path

import numpy as np
import pytest
from conftest import small_robot

import bayesid
from bayesid.errors import InputError

ROBOT = small_robot(2, seed=3)
ROW = {"a": 0.35, "alpha": 0.0, "d": 0.1, "theta": 0.0}
TABLE = {"name": "scara", "convention": "standard", "joints": [ROW, ROW | {"a": 0.3}]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A result folder."""
    log = bayesid.simulate(ROBOT, duration=6.0, rate=50.0, rng=2)
    result = bayesid.identify(ROBOT, log, ["rigid_body"], complete="off", posterior=False)
    return bayesid.save(result, tmp_path_factory.mktemp("results") / "result", report=False)


def test_a_folder_in_place_of_a_result_is_refused_with_the_call_that_loads_it(folder):
    with pytest.raises(InputError, match=r"is a folder; give the result in it: bayesid\.load\('"):
        bayesid.find_discrepancy(folder, "log.csv")
    assert bayesid.load(folder).folder == str(folder)
    assert {check.name for check in bayesid.load(folder).checks()} >= {"Sampling", "Validation"}


def test_options_of_the_other_form_are_refused(folder):
    stored, log = bayesid.load(folder), bayesid.simulate(ROBOT, duration=6.0, rate=50.0, rng=5)
    for call, said in (
        (lambda: bayesid.find_discrepancy(stored, log, terms=["rigid_body"]), "`terms`: cannot be given with a result"),
        (lambda: bayesid.find_discrepancy(ROBOT, log), "`log`: one log and a robot"),
        (lambda: bayesid.design_excitation(stored, ["rigid_body"]), "`terms`: cannot be given with a result"),
        (lambda: bayesid.design_excitation(ROBOT, about=["Fc2"]), "`about`: needs a result"),
        (lambda: bayesid.save(log, folder), "`result`: Log is not a result"),
        (lambda: bayesid.load_robot(TABLE, tip="flange"), "robot scara: is a table of one chain"),
    ):
        with pytest.raises(InputError) as caught:
            call()
        assert str(caught.value).startswith(said)


def test_a_robot_is_simulated_with_and_without_its_signs():
    """The same efforts, and what an effect adds to them is in one joint alone."""
    options = {"duration": 4.0, "rate": 50.0, "noise": 0.0, "rng": 3}
    hidden, truth = bayesid.simulate(ROBOT, **options), bayesid.simulate(ROBOT, **options, signed=True)
    np.testing.assert_array_equal(hidden.effort, np.abs(truth.effort))
    assert (hidden.effort != truth.effort).any()
    rubbed = bayesid.simulate(ROBOT, **options, effects=["viscous_friction:2:0.2"], signed=True)
    added = np.sqrt(np.mean((rubbed.effort - truth.effort) ** 2, axis=0) / np.mean(truth.effort**2, axis=0))
    np.testing.assert_allclose(added, [0.0, 0.2], atol=1e-9)


def test_limits_of_a_motion_from_a_mapping_are_those_of_the_file(tmp_path):
    limits = {"lower": [-1.0, -0.5], "upper": 0.8, "velocity": 2.0, "acceleration": 9.0}
    path = Path(tmp_path, "limits.toml")
    path.write_text("lower = [-1.0, -0.5]\nupper = 0.8\nvelocity = 2.0\nacceleration = 9.0\n")
    settings = (bayesid.MotionSettings(duration=3.0, limits=one, changes=3, harmonics=2) for one in (limits, path))
    given, read = (bayesid.design_excitation(ROBOT, ["rigid_body"], settings=one) for one in settings)
    assert given.limits == read.limits
    assert given.motion.q[:, 1].min() >= -0.5
    np.testing.assert_array_equal(given.motion.q, read.motion.q)
