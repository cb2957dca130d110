import numpy as np
import pytest
from conftest import small_robot

from bayesid.effects.catalogue import make_terms
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.identification.pipeline import identify
from bayesid.posterior.sampler import Sampling
from bayesid.regression.knowledge import Beliefs, read_nominal
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

TERMS = ("rigid_body", "viscous_friction")
T = np.arange(301) / 50.0
MOTION = random_trajectory(2, 6.0, seed=3).motion(T)


@pytest.fixture(scope="module")
def model():
    robot = small_robot(2, 1)
    return Model(robot, make_terms(TERMS, robot, MOTION))


def written(tmp_path, text):
    path = tmp_path / "known.csv"
    path.write_text(text)
    return path


def test_names_means_and_deviations(tmp_path):
    path = written(tmp_path, "name,mean,sd\nm2,1.25,0.1\nmc2x,-3e-2,5e-3\n")
    assert read_nominal(path) == read_nominal(str(path)) == {"m2": (1.25, 0.1), "mc2x": (-0.03, 0.005)}
    of_identify = "name,unit,joint,mean,sd,decided_by\nm1,kg,1,3.5,,prior\nFv2,N m s,2,0.7,0.02,data\n"
    assert read_nominal(written(tmp_path, of_identify)) == {"Fv2": (0.7, 0.02)}


def test_a_file_that_holds_something_else_or_cannot_be_read_is_refused(tmp_path):
    def refused(path):
        with pytest.raises(InputError) as refusal:
            read_nominal(path)
        assert str(path) in refusal.value.where
        assert "\n" not in str(refusal.value)
        return refusal.value

    for text, line, what in (
        ("", "", "columns"),
        ("m2,1.0,0.1\n", "", "columns"),
        ("name,mean,sd\nm1,1.0,0.1\nm2,heavy,0.1\n", "line 3", "'heavy'"),
        ("name,mean,sd\nm2,,0.1\n", "line 2", "no numbers"),
        ("name,mean,sd\nm2,1.0,0.1\nm1,2.0,0.1\nm2,1.0,0.1\n", "line 4", "m2"),
    ):
        refusal = refused(written(tmp_path, text))
        assert line in refusal.where
        assert what in refusal.what
    (tmp_path / "picture.csv").write_bytes(b"\xff\xd8\x00" * 100)
    for name in ("nowhere.csv", "picture.csv", "."):
        assert "cannot be read" in refused(tmp_path / name).what


def test_known_parameters_stand_in_the_models_order(model):
    stated = {"Fv2": (0.5, 0.1), "m1": (2.0, 0.3), "mc1y": (-0.4, 0.2)}
    nominal = Beliefs(nominal=stated).of(model.parameters)
    names = [parameter.name for parameter in model.parameters]
    known = {names[k]: (nominal.mean[k], nominal.sd[k]) for k in np.flatnonzero(np.isfinite(nominal.mean))}
    assert known == stated
    np.testing.assert_array_equal(np.isfinite(nominal.sd), np.isfinite(nominal.mean))
    assert nominal.mean.shape == nominal.sd.shape == (len(names),)


def test_values_that_cannot_be_used_are_refused(model):
    wrong = ((1.0, 0.0), (1.0, -0.1), (np.nan, 0.1), (1.0, np.nan), (np.inf, 0.1), (1.0, np.inf))
    for name, value in (("m3", (1.0, 0.1)), ("", (1.0, 0.1)), *(("m2", value) for value in wrong)):
        with pytest.raises(InputError) as refusal:
            Beliefs(nominal={"m1": (2.0, 0.1), name: value}).of(model.parameters)
        assert name in refusal.value.what
        assert "\n" not in str(refusal.value)


@pytest.fixture(scope="module")
def log(model):
    theta = random_parameters(model, np.random.default_rng(2))
    return simulate(model, theta, MOTION, rng=np.random.default_rng(3), noise=0.03, signed=True)


def test_a_known_parameter_that_the_data_leave_open_is_what_it_is_said_to_be(model, log):
    """The first link's mass leaves no trace in this arm; a value a few prior sd away from the typical link's 3 kg."""
    names = [parameter.name for parameter in model.parameters]
    first = names.index("m1")
    assert np.abs(model.columns(MOTION)[:, :, first]).max() == 0.0
    beliefs, sampling = Beliefs(nominal={"m1": (31.5, 0.4)}), Sampling(walkers=16)
    stated = identify(model.robot, log, TERMS, complete="off", posterior=sampling, beliefs=beliefs)
    draws, count = stated.posterior.draws.theta[..., first], 400.0
    assert draws.mean() == pytest.approx(31.5, abs=5.0 * 0.4 / np.sqrt(count))
    assert draws.std() == pytest.approx(0.4, rel=5.0 / np.sqrt(2.0 * count))
    assert stated.posterior.target.prior.sd[first] == 0.4
    with pytest.raises(InputError, match="m9"):
        identify(model.robot, log, TERMS, beliefs=Beliefs(nominal={"m9": (1.0, 0.1)}))
