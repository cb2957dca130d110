"""Results entry by entry: what records hold, how they are looked up, and the tables of pandas."""

from dataclasses import asdict

import numpy as np
import pytest
from conftest import small_robot, smooth_motion

from bayesid.errors import InputError
from bayesid.fit.knowledge import Beliefs
from bayesid.identification.pipeline import identify
from bayesid.log.log import join_logs
from bayesid.model.catalogue import make_terms
from bayesid.model.model import Model
from bayesid.posterior.sampler import Sampling
from bayesid.simulation.logs import simulate
from bayesid.simulation.parameters import random_parameters

TERMS = ("rigid_body", "viscous_friction", "coulomb_friction")


def logs():
    robot = small_robot(2)
    motions = [smooth_motion(2, 6.0, 100.0, seed=seed) for seed in (0, 5)]
    model = Model(robot, make_terms(TERMS, robot, motions[0]))
    theta = random_parameters(model, np.random.default_rng(4))
    return robot, [simulate(model, theta, motion, rng=np.random.default_rng(1), noise=0.05) for motion in motions]


@pytest.fixture(scope="module")
def fit():
    """Least squares, of two logs as one; the mass of link 2 is stated."""
    robot, both = logs()
    beliefs = Beliefs(nominal={"Fv2": (0.7, 0.1)})
    return identify(robot, join_logs(both), TERMS, complete="off", posterior=False, beliefs=beliefs)


@pytest.fixture(scope="module")
def sampled():
    robot, both = logs()
    return identify(robot, both[0], TERMS, complete="off", posterior=Sampling(budget=0.0))


@pytest.mark.parametrize("which", ["fit", "sampled"])
def test_coefficients_are_those_of_the_arrays(which, request):
    result = request.getfixturevalue(which)
    records = result.coefficients_table()
    assert [one.name for one in records] == list(result.coefficients.names)
    assert [one.expression for one in records] == list(result.coefficients.expressions)
    assert [one.unit for one in records] == list(result.coefficients.units)
    np.testing.assert_array_equal([one.mean for one in records], result.beta)
    np.testing.assert_array_equal([one.sd for one in records], result.sd)
    if result.posterior is None:
        expected = result.beta - 1.959964 * result.sd, result.beta + 1.959964 * result.sd
        assert all(np.isnan(one.prior_sd) for one in records)
    else:
        expected = result.posterior.interval(0.95)
        assert all(one.prior_sd > 0.0 for one in records)
    np.testing.assert_allclose([(one.lower, one.upper) for one in records], np.transpose(expected), rtol=1e-6)
    assert {type(value) for value in asdict(records[0]).values()} == {str, float}


def test_nominal_values_stand_beside_what_was_found(fit):
    assert fit.coefficient("Fv2").nominal == 0.7
    assert np.isnan(fit.coefficient("Fc2").nominal)


def test_parameters_are_those_of_the_model(sampled):
    records = sampled.parameters_table()
    sd, by_data = sampled.parameter_sd
    assert [(one.name, one.unit, one.joint) for one in records] == [
        (one.name, one.unit, one.joint) for one in sampled.model.parameters
    ]
    np.testing.assert_array_equal([one.mean for one in records], sampled.theta)
    np.testing.assert_array_equal([one.sd for one in records], sd)
    assert [one.decided_by == "data" for one in records] == by_data.tolist()
    assert sampled.parameter("m2") == records[[one.name for one in records].index("m2")]


def test_segments_count_joints_from_one_and_keep_their_logs_clock(fit):
    records, (segments, signs, confidence) = fit.segments_table(), fit.recorded_segments
    assert len(records) == len(segments)
    assert {one.joint for one in records} == {1, 2}
    first, last = records[0], records[-1]
    assert (first.start, first.joint, first.sign) == (0.0, segments.joint[0] + 1, signs[0])
    assert first.n_samples == segments.end[0] - segments.start[0]
    assert first.end == pytest.approx((first.n_samples - 1) / 100.0)
    assert last.end <= 6.0
    assert len({one.log for one in records}) == 1  # both were simulated alike
    np.testing.assert_array_equal([one.confidence for one in records], confidence)
    assert sum(one.n_samples for one in records) <= 2 * len(fit.log)


def test_a_coefficient_is_found_by_its_name(fit):
    one, k = fit.coefficient("Fc2"), fit.coefficients.names.index("Fc2")
    assert (one.mean, one.sd, one.unit, one.expression) == (fit.beta[k], fit.sd[k], "N m", "Fc2")
    assert one.lower < one.mean < one.upper


@pytest.mark.parametrize(
    ("of", "name", "says"),
    [
        ("coefficient", "Fc3", r"coefficient\(name\): there is no coefficient 'Fc3'; did you mean Fc"),
        ("coefficient", "m1", r"there is no coefficient 'm1'; efforts show it in sums alone; take parameter\('m1'\)"),
        ("coefficient", "qqq", r"there is no coefficient 'qqq'; choose from J"),
        ("parameter", "mass2", r"there is no parameter 'mass2'; did you mean m"),
        ("parameter", 2, "there is no parameter 2; did you mean m2"),
    ],
)
def test_an_unknown_name_is_told_near_ones(fit, of, name, says):
    with pytest.raises(InputError, match=says) as caught:
        getattr(fit, of)(name)
    assert "\n" not in str(caught.value)


def test_tables_become_frames(fit):
    coefficients, parameters, segments = (
        table().to_dataframe() for table in (fit.coefficients_table, fit.parameters_table, fit.segments_table)
    )
    assert list(coefficients.columns[:7]) == ["name", "expression", "unit", "mean", "sd", "lower", "upper"]
    np.testing.assert_array_equal(coefficients["mean"], fit.beta)
    assert coefficients.set_index("name").loc["Fc2", "sd"] == fit.coefficient("Fc2").sd
    assert parameters["joint"].min() == 1
    assert list(segments.columns) == ["joint", "start", "end", "n_samples", "sign", "confidence", "log"]
    assert segments.groupby("joint").n_samples.sum().tolist() == [
        sum(one.n_samples for one in fit.segments_table() if one.joint == joint) for joint in (1, 2)
    ]


def test_records_are_a_sequence(fit):
    records = fit.coefficients_table()
    assert records[1:3] == (records[1], records[2])
    assert records[-1] in records
    assert len(repr(records)) < 300
