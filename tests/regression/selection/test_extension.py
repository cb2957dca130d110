import numpy as np
import pytest
from conftest import small_robot, smooth_motion
from oracles import assert_close

from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_effect, make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.effect import Scene
from bayesid.effects.model import Model
from bayesid.regression.knowledge import CoefficientPrior
from bayesid.regression.selection.columns import NO_COLUMNS
from bayesid.regression.selection.fitted_effects import FittedEffects
from bayesid.regression.selection.hypotheses import hypotheses, maker
from bayesid.regression.selection.modelled_log import ModelledLog
from bayesid.simulation.parameters import random_parameters

JOINTS = 3
ROBOT = small_robot(JOINTS, seed=2)
MOTION, OTHER = (smooth_motion(JOINTS, 9.0, 50.0, seed=seed) for seed in (4, 8))
NOT_THE_FIRST = slice(20, None)  # at the beginning a delayed motion is not known


class Case:
    """A model, its prior, and changed coefficients."""

    def __init__(self, terms=STANDARD):
        rng = np.random.default_rng(7)
        self.model = Model(ROBOT, make_terms(terms, ROBOT, MOTION))
        self.coefficients = base_coefficients(self.model)
        theta = random_parameters(self.model, rng=rng)
        root = rng.normal(size=(len(self.coefficients),) * 2)
        self.knowledge = CoefficientPrior(self.model, theta, root @ root.T + np.eye(len(root)))
        self.beta = self.coefficients.project(theta) * rng.uniform(0.9, 1.1, len(self.coefficients))
        self.effort = self.of(MOTION)
        make = maker(self.model, self.scene, np.ones_like(self.effort, bool))
        self.library = [one for group in hypotheses(make, self.scene) for one in group]

    def of(self, motion):
        """(N, n) efforts of the coefficients alone."""
        return self.model.columns(motion)[:, :, self.coefficients.selected] @ self.beta

    @property
    def scene(self):
        def effort_with(robot, motion):
            lifted = self.coefficients.lift(self.beta) + self.traceless
            return Model(robot, self.model.terms).effort(motion, lifted)

        links = self.knowledge.theta[: 10 * JOINTS]
        return Scene(ROBOT, MOTION, ROBOT.actuators(MOTION), self.effort, 0.9 * np.abs(self.effort), links, effort_with)

    @property
    def traceless(self):
        theta = self.knowledge.theta
        return theta - self.coefficients.lift(self.coefficients.project(theta))

    def found(self, name, joints=(), which=0):
        return [one for one in self.library if one.source.name == name and one.joints == joints][which]

    def explained(self, found, amplitudes):
        blank = np.zeros_like(self.effort)
        sd = tuple(np.ones(len(one)) for one in amplitudes)
        sizes = tuple(map(np.array, amplitudes))
        return FittedEffects(None, tuple(found), NO_COLUMNS, self.beta, sizes, sd, blank, (), 0.0, blank)

    def extended(self, found, amplitudes):
        return extended(self, self.explained(found, amplitudes))


def extended(case, fitted_effects):
    """Extension from a fit alone."""
    magnitude = np.abs(case.effort)
    used = np.ones(magnitude.shape, dtype=bool)
    return ModelledLog(case.knowledge, case.coefficients, MOTION, magnitude, used, 100.0).extended(fitted_effects)


def predicted(case, found, amplitudes):
    """(N, n) what an explanation says of the log at hand."""
    effort = case.effort.copy()
    for one, amplitude in zip(found, amplitudes, strict=True):
        for j, shift in one.columns.shift.items():
            effort[:, j] += shift
        for j, rows in one.columns.rows.items():
            effort[:, j] += rows @ np.array(amplitude)
    return effort


@pytest.fixture(scope="module")
def full():
    return Case()


@pytest.fixture(scope="module")
def poor():
    return Case(("rigid_body", "viscous_friction"))


TERMS = (
    ("joint_spring", (2,), 0, [3.1, -0.8]),
    ("hysteresis", (1,), 2, [1.7]),
    ("tool_wrench", (), 0, [5.0, -3.0, 1.0]),
    ("asymmetric_coulomb", (2,), 0, [0.3, 1.9]),
    ("payload", (), 1, [0.02, 0.001, -0.003, 0.03, 0.002, 0.015, 0.1, -0.06, 0.2, 1.3]),
)


@pytest.mark.parametrize(("name", "joints", "which", "amplitude"), TERMS, ids=[term[0] for term in TERMS])
def test_a_term_is_added_with_its_amplitudes(poor, name, joints, which, amplitude):
    found = [poor.found(name, joints, which)]
    extension = poor.extended(found, [amplitude])
    assert_close(extension.model.effort(MOTION, extension.theta), predicted(poor, found, [amplitude]), 1e-9)
    term = make_effect(name, found[0].source.shape)
    elsewhere = poor.of(OTHER) + term.columns(ROBOT, OTHER) @ np.array(amplitude)
    assert_close(extension.model.effort(OTHER, extension.theta), elsewhere, 1e-9)
    assert [one.name for one in extension.model.terms] == ["rigid_body", "viscous_friction", name]
    np.testing.assert_array_equal(extension.theta[-len(amplitude) :], amplitude)
    assert extension.knowledge is poor.knowledge


def test_a_change_moves_the_models_own_parameters(full):
    found, amplitudes = [full.found("coulomb_friction", (2,)), full.found("torque_offset", (3,))], [[-0.6], [1.9]]
    assert [one.changes for one in found] == [("Fc2",), ("offset3",)]
    extension = full.extended(found, amplitudes)
    assert extension.model == full.model
    assert_close(extension.model.effort(MOTION, extension.theta), predicted(full, found, amplitudes), 1e-9)
    columns, names = full.model.columns(OTHER), [parameter.name for parameter in full.model.parameters]
    elsewhere = full.of(OTHER) - 0.6 * columns[:, :, names.index("Fc2")] + 1.9 * columns[:, :, names.index("offset3")]
    assert_close(extension.model.effort(OTHER, extension.theta), elsewhere, 1e-9)


def test_the_prior_of_changed_parameters_is_wider(full):
    found = [full.found("coulomb_friction", (2,)), full.found("joint_spring", (1,))]
    extension = full.extended(found, [[-0.6], [2.0, 0.3]])
    expected = full.knowledge.widened(("Fc2",), found[0].columns.sd)
    np.testing.assert_array_equal(extension.knowledge.precision, expected.precision)
    at = full.coefficients.names.index("Fc2")
    before, after = (np.linalg.inv(one.precision)[at, at] for one in (full.knowledge, extension.knowledge))
    assert after == pytest.approx(before + found[0].columns.sd[0] ** 2, rel=1e-6)


def test_parameters_stay_where_the_log_says_nothing(full):
    """Equal coefficients give the earlier parameters, not those of least norm."""
    same = full.coefficients.project(full.knowledge.theta)
    fitted_effects = full.explained([], [])
    object.__setattr__(fitted_effects, "beta", same)
    extension = extended(full, fitted_effects)
    np.testing.assert_allclose(extension.theta, full.knowledge.theta, atol=1e-9)
    assert np.abs(full.coefficients.lift(same) - full.knowledge.theta).max() > 0.1


DISTORTIONS = (
    ("gain_error", (2,), [0.13], 1e-9),
    ("clipping", (1,), [], 1e-9),
    ("dead_zone.shrinking", (2,), [], 1e-9),
    ("base_tilt", (), [0.004, -0.007, 0.0, 0.0], 2e-4),
    ("delay", (1,), [0.002], 1e-4),
)


@pytest.mark.parametrize(("name", "joints", "amplitude", "tolerance"), DISTORTIONS)
def test_a_distortion_is_added_where_its_numbers_have_moved(poor, name, joints, amplitude, tolerance):
    """The explanation is linear in the numbers: exact for gains and fixed numbers, else to second order of a step."""
    found = [poor.found(name, joints, 3 if not amplitude else 0)]
    extension = poor.extended(found, [amplitude])
    (added,) = extension.model.distortions
    assert added == found[0].source.moved(np.array(amplitude))
    extended, expected = extension.model.effort(MOTION, extension.theta), predicted(poor, found, [amplitude])
    assert_close(extended[NOT_THE_FIRST], expected[NOT_THE_FIRST], tolerance)
    assert np.abs(extended - poor.effort)[NOT_THE_FIRST].max() > 20.0 * tolerance * np.abs(poor.effort).max()
    assert extension.model.terms == poor.model.terms
    if name in ("gain_error", "clipping", "dead_zone", "dead_zone.shrinking"):
        number = {"gain_error": "gain", "clipping": "limit"}.get(name, "width")
        by_hand = make_effect(name, {"joints": joints, number: getattr(added, number)})
        factor = np.where(np.arange(3) == 1, 1.13, 1.0) if name == "gain_error" else 1.0
        assert_close(extension.model.effort(OTHER, extension.theta), by_hand.measured(poor.of(OTHER) * factor), 1e-9)


def test_terms_come_before_distortions_whatever_was_found_first(poor):
    """A spring of joint 2 is scaled by the gain of joint 2, which the explanation does not say: to 0.13 of it."""
    found = [poor.found("gain_error", (2,)), poor.found("joint_spring", (2,)), poor.found("torque_offset", (3,))]
    amplitudes = [[0.13], [3.1, -0.8], [0.7]]
    extension = poor.extended(found, amplitudes)
    spring = make_effect("joint_spring", {"joints": (2,)}).columns(ROBOT, MOTION) @ np.array([3.1, -0.8])
    expected = predicted(poor, found, amplitudes) + 0.13 * spring
    assert_close(extension.model.effort(MOTION, extension.theta), expected, 1e-9)
