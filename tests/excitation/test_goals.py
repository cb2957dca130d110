"""Goals by name, and the information about them."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import smooth_motion
from open_results import open_known

from bayesid.cli.terminal import in_options
from bayesid.effects.bodies import CarriedPayload
from bayesid.errors import InputError
from bayesid.excitation.gaussian_posterior import reference_motion
from bayesid.excitation.goal import CRITERIA, Goal, goal_of, undetermined_coefficients


@pytest.fixture(scope="module")
def known():
    return open_known(model_error_covariance=0.5)


def with_gains(known, *joints):
    """The same, with sd 0.1, 0.2 .. of the logarithms of some gains (0-based joints)."""
    r, g = len(known), len(joints)
    precision = np.zeros((r + g, r + g))
    precision[:r, :r] = known.precision
    precision[r:, r:] = np.diag(np.arange(1.0, g + 1.0) ** -2.0 * 100.0)
    names = (*known.names, *(f"log_gain{j + 1}" for j in joints))
    return replace(
        known,
        names=names,
        units=(*known.units, *g * ("",)),
        mean=np.append(known.mean, np.zeros(g)),
        precision=precision,
        model_error_covariance=np.zeros_like(precision),
        gains=np.array(joints),
    )


def test_the_default_goal_is_all_undetermined_coefficients(known):
    sd = np.sqrt(np.diag(np.linalg.inv(known.precision) + known.model_error_covariance))
    want = [name for name, one, mean in zip(known.names, sd, known.mean, strict=True) if one > 0.1 * abs(mean)]
    assert 0 < len(want) < len(known)
    assert goal_of(known).names == tuple(want)
    sure = replace(
        known, precision=1e12 * known.precision, model_error_covariance=np.zeros_like(known.model_error_covariance)
    )
    assert undetermined_coefficients(sure) == []
    assert goal_of(sure).names == known.names


def test_a_coefficient_by_its_name(known):
    goal = goal_of(known, ["Fc3", "Fv1", "Fc3"])
    assert goal.names == ("Fc3", "Fv1")
    assert goal.remarks == ()
    np.testing.assert_array_equal(np.flatnonzero(goal.forms[0]), [known.names.index("Fc3")])
    np.testing.assert_allclose(
        goal.required_sd, 0.1 * np.abs(known.mean[[known.names.index(one) for one in goal.names]])
    )
    assert goal_of(known, ["viscous_friction"]).names == ("Fv1", "Fv2", "Fv3")
    assert goal_of(known, ["rigid_body"]).names == known.names[:17]


def test_a_parameter_that_is_not_identifiable_alone_gives_a_remark(known):
    goal = goal_of(known, ["mc2x"])
    assert goal.names == ("mc2x",)
    assert "mc2x + a3 m3" in goal.remarks[0]
    goal = goal_of(known, ["J2yy"])
    step = np.zeros(len(known.theta))
    step[[one.name for one in known.model.parameters].index("J2yy")] = 1.0
    moved = known.coefficients.project(step)
    want = tuple(name for name, change in zip(known.names, moved, strict=True) if abs(change) > 1e-6)
    assert goal.names == want == ("J1zz", "J2xx")
    assert "J1zz, J2xx" in goal.remarks[0]
    goal = goal_of(known, ["J1xx", "Fc1"])
    assert goal.names == ("Fc1",)
    assert "J1xx" in goal.remarks[0]
    with pytest.raises(InputError, match="do not depend on it"):
        goal_of(known, ["J1xx"])


def test_the_goal_of_gains_is_their_ratios(known):
    unsure = with_gains(known, 0, 2)
    goal = goal_of(unsure, ["gains"])
    assert goal.names == ("gain3/gain1",)
    assert "common factor" in goal.remarks[0]
    np.testing.assert_allclose(goal.required_sd, 0.1)
    before = goal.scaled_covariance(np.linalg.inv(unsure.precision))
    np.testing.assert_allclose(before, (0.1**2 + 0.2**2) / 0.1**2)
    assert goal_of(unsure).names[-1] == "gain3/gain1"
    assert "gain3/gain1" not in goal_of(with_gains(known, 2)).names  # one alone has no ratio
    with pytest.raises(InputError, match="gains are exact"):
        goal_of(known, ["gains"])


def test_an_unknown_payload_is_that_of_the_last_link(known):
    goal = goal_of(known, ["payload"])
    assert any("once with it" in sentence for sentence in goal.remarks)
    assert {"J3xx", "mc3x"} < set(goal.names)
    assert not {"Fc3", "Fv3"} & set(goal.names)


def test_a_payload_of_the_result_has_its_own_coefficients():
    terms = ("rigid_body", CarriedPayload(label=("tool",)), "viscous_friction", CarriedPayload(label=("box",)))
    known = open_known(n=2, terms=terms)
    goal = goal_of(known, ["payload"], "tool")
    assert goal.remarks == ()
    assert not {"Fv1", "Fv2"} & set(goal.names)
    assert len(goal.names) == 10
    of_tool = known.model.places[1]
    names = [parameter.name for parameter in known.model.parameters[of_tool]]
    assert [name.split(".")[0] for name in goal.names] == [name.split(".")[0] for name in names], goal.names


def test_the_goal_payload_needs_a_payload_on_the_flange():
    known = open_known(n=2, terms=("rigid_body", CarriedPayload(label=("tool",))))
    with pytest.raises(InputError, match="as tool"):
        goal_of(known, ["payload"])


def test_signs_are_the_efforts_of_random_motions(known):
    """The trace over the goal's forms is the mean squared effort error over noise variance, per second."""
    goal = goal_of(known, ["signs"])
    motion = reference_motion(known.model.robot)
    columns, weights = known.columns(motion), known.weights(motion)
    variance = np.einsum("njr,rs,njs->nj", columns, known.covariance_now, columns)
    want = np.sum(weights * variance) / (motion.t[-1] - motion.t[0])
    assert np.trace(goal.scaled_covariance(known.covariance_now)) == pytest.approx(want, rel=1e-6)


def test_an_unknown_name_is_refused_with_similar_names(known):
    for name, other in {"Fc9": "Fc1", "viscous_frictoin": "viscous_friction", "mc3": "mc3x"}.items():
        with pytest.raises(InputError) as caught:
            goal_of(known, ["Fc1", name])
        said = in_options(str(caught.value))
        assert said.startswith("--about")
        assert repr(name) in said
        assert other in said
        assert "\n" not in said


def test_information_gain_is_a_mutual_information(known):
    """Mutual information of the combinations, with an error of the required sd, and the recording, by determinants."""
    rng = np.random.default_rng(4)
    motion = smooth_motion(3, 0.3, 20.0, seed=9)
    r, rows = len(known), known.columns(motion) * np.sqrt(known.weights(motion))[:, :, None]
    rows = rows.reshape(-1, r)
    goal = Goal(("a", "b"), rng.normal(size=(2, r)), np.array([0.3, 2.5]))
    prior = np.linalg.inv(known.precision)
    mixed = np.vstack([goal.forms, rows]) @ prior @ np.vstack([goal.forms, rows]).T
    mixed += np.diag(np.concatenate([goal.required_sd**2, np.ones(len(rows))]))
    logs = [np.linalg.slogdet(block)[1] for block in (mixed[:2, :2], mixed[2:, 2:], mixed)]
    want = 0.5 * (logs[0] + logs[1] - logs[2])
    after = known.covariance(known.information(motion))
    assert want > 0.1
    assert goal.gain(prior, after) == pytest.approx(want, rel=1e-6)


def test_the_criteria_are_a_determinant_and_a_trace():
    goal = Goal(("a", "b"), np.array([[1.0, 0.0, 2.0], [0.0, -1.0, 0.0]]), np.array([0.5, 4.0]))
    covariance = np.array([[2.0, 0.3, 0.0], [0.3, 1.0, -0.4], [0.0, -0.4, 0.5]])
    variance = 2.0 + 4.0 * 0.5, 1.0, -0.3 + 2.0 * 0.4  # of both sums, and their covariance, by hand
    a, b, c = variance[0] / 0.25, variance[1] / 16.0, variance[2] / 2.0
    assert CRITERIA["D"](goal, covariance) == pytest.approx(np.log((1.0 + a) * (1.0 + b) - c**2))
    assert CRITERIA["A"](goal, covariance) == pytest.approx((a + b) / 2.0)
