"""Errors seen from Python name the arguments of Python; the command line names its options."""

import pickle

import numpy as np
import pytest
from conftest import small_robot, smooth_motion

import bayesid
from bayesid.cli.arguments import BAYESID
from bayesid.cli.terminal import OPTIONS, in_options
from bayesid.errors import InputError
from bayesid.log.log import Log


@pytest.fixture(scope="module")
def log():
    motion = smooth_motion(2, 4.0, 100.0, seed=1)
    return Log(motion.t, motion.q, np.sin(motion.q) + 0.3 * motion.dq, np.ones(2, dtype=bool))


def refusal(call, *arguments, **options):
    with pytest.raises(InputError) as caught:
        call(*arguments, **options)
    assert "--" not in str(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_an_option_stands_in_place_of_an_argument():
    error = InputError("a budget of -1 s", remedy="give fewer `terms`, or `none`", field="Certified.budget")
    assert str(error) == "`Certified.budget`: a budget of -1 s; give fewer `terms`, or `none`"
    assert in_options(str(error)) == "--search-budget: a budget of -1 s; give fewer --terms, or `none`"
    assert str(InputError("what", "a.toml", "remedy", "columns")) == "`columns` a.toml: what; remedy"


def test_an_error_survives_the_way_from_a_worker():
    error = pickle.loads(pickle.dumps(InputError("what", "where", "remedy", "cutoff")))
    assert (error.field, str(error)) == ("cutoff", "`cutoff` where: what; remedy")


def test_every_argument_has_an_option_there_is():
    assert set(OPTIONS.values()) - {"--no-degrees"} <= BAYESID.names


def test_terms_and_options_are_named_as_arguments(log):
    robot = small_robot(2)
    assert refusal(bayesid.identify, robot, log, ["rigid"]).startswith("`terms`: unknown term 'rigid'")
    assert refusal(bayesid.identify, robot, log, "rigid_body").startswith("`terms`: 'rigid_body' is not a list")
    assert refusal(bayesid.identify, robot, log, complete="no").startswith("`complete`: ")
    assert refusal(bayesid.Certified, budget=-1.0).startswith("`Certified.budget`: ")
    assert refusal(bayesid.Beam, width=0).startswith("`Beam.width`: ")
    assert refusal(bayesid.Sampling, mode=0).startswith("`Sampling.mode`: ")
    assert refusal(bayesid.ParameterPrior, link_mass=-1.0).startswith("`ParameterPrior.link_mass`: ")
    assert refusal(bayesid.ParameterPrior, angle_sd=-1.0).startswith("`ParameterPrior.angle_sd`: ")
    assert refusal(bayesid.identify, robot, log, search="beam").startswith("search: 'beam' is not a search")
    assert refusal(bayesid.identify, robot, log, posterior=60.0).startswith("posterior: 60.0 is not a sampling")
    assert refusal(bayesid.identify, robot, log, prior={"m2": (1.0, 0.1)}).startswith("prior: dict is not a prior")
    fast = bayesid.Preprocessing(cutoff=99.0)
    assert refusal(bayesid.identify, robot, log, preprocessing=fast).startswith("`cutoff`: ")


@pytest.mark.parametrize("stated", [0.7, (0.7,), (0.7, 0.1, 2.0), "0.7", None, ("a", "b")])
def test_a_nominal_value_without_its_sd_is_refused(log, stated):
    said = refusal(bayesid.identify, small_robot(2), log, prior=bayesid.ParameterPrior(nominal={"m2": stated}))
    assert said.startswith(f"`ParameterPrior.nominal`: m2 = {stated!r} is not a mean with its sd")
    assert "{'m2': (0.7, 0.1)}" in said


def test_numbers_in_place_of_lists_are_refused(log, tmp_path):
    log.save(tmp_path / "log.csv")
    assert refusal(bayesid.read_log, tmp_path / "log.csv", gains=14.0).startswith("`gains`: 14.0 is not a list")
    assert refusal(bayesid.read_log, tmp_path / "log.csv", joints=7).startswith("`joints`: 7 is not a list")
    assert "joints=[7]" in refusal(bayesid.plot.drawing.chosen_joints, 7, 7)
