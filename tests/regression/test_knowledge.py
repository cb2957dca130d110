import numpy as np
import pytest
from conftest import random_motion, small_robot
from oracles import assert_close

from bayesid.effects.catalogue import make_effect, make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.identification.pipeline import identify
from bayesid.posterior.sampler import Sampling
from bayesid.regression.knowledge import CoefficientPrior, ParameterPrior, nominal_parameters, of_base, read_nominal
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory

SIZES = np.array([0.3, 2.0, 0.8])
"""Noise of the three joints, N m."""


def plain_model(names=("rigid_body", "viscous_friction", "torque_offset")):
    robot = small_robot(3, seed=6)
    return Model(robot, make_terms(names, robot, random_motion(3, 50)))


def weighted_rows(model, motion):
    """(N n, P) columns in units of the noise."""
    return (model.columns(motion) / SIZES[:, None]).reshape(-1, len(model.parameters))


def known_from(model, motion, effort):
    """A log's moments of the model's own base coefficients, as knowledge."""
    coefficients = base_coefficients(model)
    rows, effort = weighted_rows(model, motion)[:, coefficients.selected], (effort / SIZES).ravel()
    precision = rows.T @ rows
    return CoefficientPrior(model, coefficients.lift(np.linalg.solve(precision, rows.T @ effort)), precision)


def log_of(model, seed, rng):
    """A motion, and efforts of random parameters with noise."""
    motion = random_motion(3, 60, seed)
    theta = rng.normal(size=len(model.parameters))
    return motion, model.effort(motion, theta) + SIZES * rng.standard_normal((60, 3))


@pytest.fixture
def whole():
    return plain_model().extend(make_effect("joint_spring", {"joints": (2,)})).extend(make_effect("tool_wrench", {}))


def test_information_and_a_second_log_are_both_logs_together(whole, rng):
    """The first log knows nothing of what was added: its columns there are zero. Constants apart, all is the same."""
    part = plain_model()
    motion, effort = log_of(part, 1, rng)
    knowledge = known_from(part, motion, effort)
    coefficients = knowledge.coefficients(whole)
    info = knowledge.information(whole, coefficients)
    first = np.zeros((180, len(whole.parameters)))
    first[:, : len(part.parameters)] = weighted_rows(part, motion)
    second = weighted_rows(whole, log_of(whole, 2, rng)[0])
    after = rng.normal(size=180)
    both = np.vstack([first, second])[:, coefficients.selected]
    assert_close(
        info.hessian + second[:, coefficients.selected].T @ second[:, coefficients.selected], both.T @ both, 1e-9
    )
    efforts = np.concatenate([(effort / SIZES).ravel(), after])
    assert_close(info.gradient + second[:, coefficients.selected].T @ after, both.T @ efforts, 1e-9)
    points = rng.normal(size=(2, len(coefficients)))
    by_hand = [np.sum((first[:, coefficients.selected] @ x - efforts[:180]) ** 2) for x in points]
    assert info.misfit(points[0]) - info.misfit(points[1]) == pytest.approx(by_hand[0] - by_hand[1], rel=1e-9)
    centre = coefficients.project(np.append(knowledge.theta, points[0, : len(whole.parameters) - len(part.parameters)]))
    assert info.misfit(centre) == pytest.approx(0.0, abs=1e-9 * info.energy)
    assert np.array_equal(info.hessian, info.hessian.T)
    assert np.linalg.matrix_rank(both) == len(coefficients)


def test_parameters_in_another_order_are_found_by_their_names(rng):
    """The whole has its friction before its bodies."""
    part, whole = plain_model(("rigid_body", "viscous_friction")), plain_model(("viscous_friction", "rigid_body"))
    motion, effort = log_of(part, 1, rng)
    knowledge = known_from(part, motion, effort)
    info = knowledge.information(whole, knowledge.coefficients(whole))
    rows = weighted_rows(whole, motion)[:, knowledge.coefficients(whole).selected]
    assert_close(info.hessian, rows.T @ rows, 1e-9)
    assert_close(info.gradient, rows.T @ (effort / SIZES).ravel(), 1e-9)


NAMES, SD = ("Fv2", "mc3x", "offset1"), np.array([0.4, 0.05, 3.0])


def test_widened_is_the_covariance_of_a_sum():
    """Coefficients of theta + a step: C + B D B'."""
    knowledge = known_from(plain_model(), *log_of(plain_model(), 1, np.random.default_rng(3)))
    projection = base_coefficients(plain_model()).projection
    labels = [parameter.name for parameter in plain_model().parameters]
    steps = projection[:, [labels.index(name) for name in NAMES]]
    covariance = np.linalg.inv(knowledge.precision) + steps @ np.diag(SD**2) @ steps.T
    wide = knowledge.widened(NAMES, SD)
    assert_close(np.linalg.inv(wide.precision), covariance, 1e-8)
    np.testing.assert_array_equal(wide.theta, knowledge.theta)
    twice = knowledge.widened(NAMES[:1], SD[:1]).widened(NAMES[1:], SD[1:])
    assert_close(twice.precision, wide.precision, 1e-9)


def test_widened_needs_no_inverse_of_what_is_known():
    """A log that has shown nothing of two coefficients, as the limit of one that has shown very little."""
    model = plain_model()
    coefficients, rng = base_coefficients(model), np.random.default_rng(5)
    root = rng.normal(size=(len(coefficients), len(coefficients) - 2))
    knowledge = CoefficientPrior(model, np.zeros(len(model.parameters)), root @ root.T)
    labels = [parameter.name for parameter in model.parameters]
    steps = coefficients.projection[:, [labels.index(name) for name in NAMES]]
    nearly = np.linalg.inv(root @ root.T + 1e-7 * np.eye(len(coefficients))) + steps @ np.diag(SD**2) @ steps.T
    assert_close(knowledge.widened(NAMES, SD).precision, np.linalg.inv(nearly), 1e-5)


def test_what_a_model_cannot_show_by_itself_is_integrated_out():
    """Its own coefficients are sums of those that an earlier log tells apart: their covariance, dense."""
    part, rng = plain_model(), np.random.default_rng(2)
    whole = part.extend(make_effect("payload", {}))
    both, own = base_coefficients(whole, earlier=part), base_coefficients(whole)
    root = rng.normal(size=(len(both),) * 2)
    precision = root @ root.T + np.eye(len(both))
    sums = np.linalg.lstsq(both.projection.T, own.projection.T, rcond=None)[0].T
    assert_close(sums @ both.projection, own.projection, 1e-9)
    found = of_base(whole, both, precision)
    assert found.shape == (len(own),) * 2
    assert len(own) < len(both)
    assert_close(np.linalg.inv(found), sums @ np.linalg.solve(precision, sums.T), 1e-7)
    assert of_base(part, base_coefficients(part), precision) is precision


TERMS = ("rigid_body", "viscous_friction")
T = np.arange(301) / 50.0
MOTION = random_trajectory(2, 6.0, rng=3).motion(T)


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
        ("name,mean,sd\nm2,,0.1\n", "line 2", "not numbers"),
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
    nominal = nominal_parameters(ParameterPrior(nominal=stated), model.parameters)
    names = [parameter.name for parameter in model.parameters]
    known = {names[k]: (nominal.mean[k], nominal.sd[k]) for k in np.flatnonzero(np.isfinite(nominal.mean))}
    assert known == stated
    np.testing.assert_array_equal(np.isfinite(nominal.sd), np.isfinite(nominal.mean))
    assert nominal.mean.shape == nominal.sd.shape == (len(names),)


def test_values_that_cannot_be_used_are_refused(model):
    wrong = ((1.0, 0.0), (1.0, -0.1), (np.nan, 0.1), (1.0, np.nan), (np.inf, 0.1), (1.0, np.inf))
    for name, value in (("m3", (1.0, 0.1)), ("", (1.0, 0.1)), *(("m2", value) for value in wrong)):
        with pytest.raises(InputError) as refusal:
            nominal_parameters(ParameterPrior(nominal={"m1": (2.0, 0.1), name: value}), model.parameters)
        assert name in refusal.value.what
        assert "\n" not in str(refusal.value)


@pytest.fixture(scope="module")
def log(model):
    theta = random_parameters(model, rng=np.random.default_rng(2))
    return simulate(model, theta, MOTION, rng=np.random.default_rng(3), noise=0.03, signed=True)


def test_a_known_parameter_that_the_data_leave_open_is_what_it_is_said_to_be(model, log):
    """The first link's mass leaves no trace in this arm; a value a few prior sd away from the typical link's 3 kg."""
    names = [parameter.name for parameter in model.parameters]
    first = names.index("m1")
    assert np.abs(model.columns(MOTION)[:, :, first]).max() == 0.0
    prior, sampling = ParameterPrior(nominal={"m1": (31.5, 0.4)}), Sampling(walkers=16)
    stated = identify(model.robot, log, TERMS, complete="off", posterior=sampling, prior=prior)
    draws, count = stated.posterior.draws.theta[..., first], 400.0
    assert draws.mean() == pytest.approx(31.5, abs=5.0 * 0.4 / np.sqrt(count))
    assert draws.std() == pytest.approx(0.4, rel=5.0 / np.sqrt(2.0 * count))
    assert stated.posterior.target.prior.sd[first] == 0.4
    with pytest.raises(InputError, match="m9"):
        identify(model.robot, log, TERMS, prior=ParameterPrior(nominal={"m9": (1.0, 0.1)}))
