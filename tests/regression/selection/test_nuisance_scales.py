"""Effects that cannot be excluded: scales against densities on a grid, confounded coefficients, and the geometry."""

from copy import deepcopy
from dataclasses import replace
from functools import cached_property
from itertools import product

import numpy as np
import pytest
from effect_problems import RATE, observed
from effect_problems import made as made_effect
from oracles import (
    actuator_efforts,
    assert_close,
    dh_chain,
    joint_torques,
    parameters_of,
    random_clouds,
    random_motion,
    random_table,
)
from scipy.linalg import null_space, solve_triangular
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation
from scipy.stats import t

from bayesid.effects.catalogue import make_effect, make_terms
from bayesid.effects.model import Model
from bayesid.identification.pipeline import identify
from bayesid.regression.knowledge import KinematicTolerance, inverse_of
from bayesid.regression.selection.error_model import ErrorModel
from bayesid.regression.selection.modelled_log import kinematic_columns
from bayesid.regression.selection.nuisance_scales import TooNarrow, geometry_far_off, learn_scales, too_narrow
from bayesid.regression.selection.regression import Regression
from bayesid.robot import robot_from_table
from bayesid.signs.search.certified import Certified
from bayesid.simulation.logs import simulate
from bayesid.simulation.trajectories import random_trajectory

COUNT, FREE = 120, 3
ABSENT = 0.5
"""The belief that an effect is absent, half an observation of nothing."""


class Case:
    """Whitened columns of a model and of some groups, and efforts."""

    def __init__(self, sds, amplitudes, seed=0, least=None, there=None):
        rng = np.random.default_rng(seed)
        self.sds = [np.asarray(sd, dtype=float) for sd in sds]
        self.model = rng.normal(size=(COUNT, FREE)) * [1.0, 30.0, 0.02]
        self.rows = [rng.normal(size=(COUNT, len(sd))) + 0.4 * self.model[:, :1] for sd in self.sds]
        self.effort = self.model @ [2.0, -0.1, 80.0] + rng.normal(size=COUNT)
        for rows, values in zip(self.rows, amplitudes, strict=True):
            self.effort += rows @ np.asarray(values, dtype=float)
        self.least = least or [0.0] * len(sds)
        self.there = there or [False] * len(sds)

    def learned(self):
        effects = [made_effect("made", {0: rows}, sd) for rows, sd in zip(self.rows, self.sds, strict=True)]
        data = observed(self.model[:, None], self.effort[:, None])
        regression = Regression(data, effects, [ErrorModel(1.0, 0.0, 0.1, RATE)])
        pairs = zip(effects, self.there, self.least, strict=True)
        return learn_scales(regression, {id(one): least for one, there, least in pairs if there})

    @cached_property
    def left(self):
        """What the model's columns cannot make."""
        return null_space(self.model.T)

    def log_density(self, scales):
        """Of what of the efforts the model's columns cannot make: a normal one, by its covariance's triangular root."""
        sd = np.concatenate([sd * scale for sd, scale in zip(self.sds, scales, strict=True)])
        rows, effort = self.left.T @ np.hstack(self.rows) * sd, self.left.T @ self.effort
        root = np.linalg.cholesky(np.eye(len(rows)) + rows @ rows.T)
        white = solve_triangular(root, effort, lower=True)
        return -0.5 * (white @ white) - np.log(np.diag(root)).sum() - 0.5 * len(rows) * np.log(2.0 * np.pi)

    def posterior(self, scales):
        """Mean and covariance of all amplitudes, given their scales."""
        left = self.left
        rows = left.T @ np.hstack(self.rows)
        sd = np.concatenate([sd * scale for sd, scale in zip(self.sds, scales, strict=True)])
        covariance = np.linalg.inv(rows.T @ rows + np.diag(sd**-2.0))
        return covariance @ rows.T @ left.T @ self.effort, covariance


@pytest.mark.parametrize(("sd", "amplitudes"), [([0.5], [1.3]), ([0.5, 2.0, 0.1], [0.9, -1.0, 0.2])])
def test_scale_of_a_group_maximises_the_penalised_evidence(sd, amplitudes):
    """On a grid of two per cent; the penalty makes zero a maximum too, which is left aside."""
    case = Case([sd], [amplitudes])
    grid = np.exp(np.arange(np.log(0.2), np.log(10.0), 0.02))
    densities = np.array([case.log_density([s]) for s in grid])
    penalised = densities - ABSENT * np.log(grid)
    peaks = [k for k in range(1, len(grid) - 1) if penalised[k] > max(penalised[k - 1], penalised[k + 1])]
    assert len(peaks) == 1
    found = case.learned()
    assert found.scales[0] == pytest.approx(grid[peaks[0]], rel=0.021)
    assert found.scales[0] < 0.95 * grid[np.argmax(densities)]


def test_scales_of_several_groups_are_a_common_maximum():
    case = Case([[0.5, 0.3], [1.0], [2.0, 0.7]], [[1.0, -0.4], [2.2], [0.9, 0.5]], seed=4)
    found = case.learned()

    def penalised(logarithms):
        return case.log_density(np.exp(logarithms)) - ABSENT * logarithms.sum()

    slope = approx_fprime(np.log(found.scales), penalised, 1e-6)
    assert np.abs(slope).max() < 0.05  # curvatures are about the number of amplitudes
    doubled = approx_fprime(np.log(2.0 * found.scales), penalised, 1e-6)
    assert np.all(doubled < -0.3)


def test_effects_that_the_log_cannot_show_vanish():
    """Columns of a thousandth of the error, and large ones of absent effects."""
    case = Case([[0.5], [1.0, 1.0], [0.8]], [[1.3], [0.0, 0.0], [0.0]], seed=7)
    case.rows[2] *= 1e-3
    found = case.learned()
    assert found.scales[0] > 1.0
    assert found.scales[2] == 0.0
    size = sum(turn.shape[1] for turn in found.turns)
    assert found.moments.shape == (size, size)
    np.testing.assert_array_equal(found.moments[-1], 0.0)
    absent = [Case([[1.0] * 4], [[0.0] * 4], seed=seed).learned().scales[0] for seed in range(20)]
    assert np.median(absent) < 0.1
    assert np.max(absent) < 0.3  # sqrt(4 / 120) is what four amplitudes of noise alone would be


@pytest.mark.parametrize("amplitude", [0.2, 6.0])
def test_a_stated_tolerance_never_shrinks_but_may_grow(amplitude):
    amplitudes, there = [[amplitude, 2.0 * amplitude], [0.9]], [True, False]
    case = Case([[1.0, 2.0], [0.5]], amplitudes, seed=2, least=[1.0, 0.0], there=there)
    found = case.learned()
    if amplitude == 6.0:
        assert 3.0 < found.scales[0] < 9.0
    else:
        assert found.scales[0] == 1.0
    np.testing.assert_array_equal(found.turns[0], np.diag([1.0, 2.0]))
    mean, covariance = case.posterior(found.scales)
    turn = np.diag([1.0, 2.0, *found.turns[1].ravel()])
    moments = turn @ found.moments @ turn.T
    np.testing.assert_allclose(moments, covariance + np.outer(mean, mean), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("amplitude", [0.3, 5.0])
def test_the_scale_of_a_certain_group_is_its_posterior_mean_square(amplitude):
    """By densities of all rows, on an even grid, beside another group that is searched for."""
    case = Case([[1.0, 0.5, 2.0], [0.5]], [amplitude * np.array([0.9, -0.6, 1.7]), [1.3]], seed=6, there=[True, False])
    found = case.learned()
    grid = np.linspace(0.005, 20.0, 2000)
    densities = np.array([case.log_density([s, found.scales[1]]) for s in grid])
    densities += t(4, scale=np.sqrt(0.5)).logpdf(grid)
    weight = np.exp(densities - densities.max())
    assert found.scales[0] == pytest.approx(np.sqrt(weight @ grid**2 / weight.sum()), rel=0.02)
    assert (found.scales[0] < 1.0) == (amplitude < 1.0)


def with_collinear(part, sd=(0.5, 2.0), seed=3, *, there=False):
    """A group whose columns' sum is in the model's span, but for a part of it; and the difference's size."""
    case = Case([sd], [[0.9, -1.1]], seed=seed, there=[there])
    inside = case.model @ [0.7, 0.03, -9.0]
    beside = null_space(np.column_stack([case.model, case.rows[0]]).T)[:, 0]
    target = inside + part * np.linalg.norm(inside) * beside
    case.rows[0][:, 1] = target - case.rows[0][:, 0]
    return case


@pytest.mark.parametrize("part", [0.0, 0.02])
def test_directions_in_the_span_of_the_model_are_left_out(part):
    """Only the amplitudes that are no multiple of (1, 1) count, in units of what was believed of them."""
    case = with_collinear(part)
    found = case.learned()
    (turn,) = found.turns
    assert turn.shape == (2, 1)
    sd = np.array([0.5, 2.0])
    alone, both = turn[:, 0] / sd, np.array([1.0, 1.0]) / sd
    assert np.linalg.norm(alone) == pytest.approx(1.0)
    if part == 0.0:
        assert alone @ both == pytest.approx(0.0, abs=1e-6)
    else:
        assert abs(alone @ both) < 0.05 * np.linalg.norm(both)


@pytest.mark.parametrize(("part", "there"), [(0.5, False), (0.0, True)])
def test_directions_of_their_own_and_of_what_is_there_in_any_case_are_kept(part, there):
    (turn,) = with_collinear(part, there=there).learned().turns
    assert turn.shape == (2, 2)
    np.testing.assert_allclose(turn @ turn.T, np.diag([0.25, 4.0]), atol=1e-9)


def test_inverse_in_mixed_units_and_with_a_column_of_nothing():
    """A model's column that is zero on all rows that are looked at; what the others say is the same without it."""
    units = np.array([1e-5, 3.0, 0.0, 1e6, 40.0])
    rows = np.random.default_rng(1).normal(size=(30, 5))
    found, kept = inverse_of((rows * units).T @ (rows * units)), [0, 1, 3, 4]
    assert np.isfinite(found).all()
    scaled = (found * np.outer(units, units))[np.ix_(kept, kept)]
    np.testing.assert_allclose(scaled, np.linalg.inv(rows[:, kept].T @ rows[:, kept]), rtol=1e-6)


NAMES = ("J1zz", "mc2x", "mc2y", "Fc2", "offset2")
SD = np.array([0.1, 0.2, np.inf, 0.05, 0.5])
OF_LINKS = np.array([True, True, True, False, False])


@pytest.mark.parametrize(
    ("moves", "expected"),
    [
        ([0.25, 1.0, 9.0, 0.08, 0.0], ("mc2x", "J1zz")),  # times: 2.5, 5, unknown, 1.6, 0
        ([0.25, 0.4, 9.0, 0.2, 0.0], None),  # most of it is friction
        ([0.15, 0.3, 9.0, 0.05, 0.0], None),  # too small
    ],
)
def test_an_effect_that_mostly_looks_like_links_names_what_it_moves(moves, expected):
    found = too_narrow([(("gravity_spring", (2,)), np.array(moves))], NAMES, SD, OF_LINKS)
    assert found == (() if expected is None else (TooNarrow(("gravity_spring",), (2,), expected),))


def test_effects_of_one_joint_are_one_statement():
    first, second = np.array([0.3, 0.5, 0.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0, 0.0, 2.0])
    effects = [(("joint_spring", (2,)), first), (("base_tilt", ()), first), (("cable_drag", (2,)), second)]
    springs, tilt = too_narrow(effects, NAMES, SD, OF_LINKS)
    assert springs == TooNarrow(("cable_drag", "joint_spring"), (2,), ("mc2x", "offset2", "J1zz"))
    assert tilt == TooNarrow(("base_tilt",), (), ("J1zz", "mc2x"))


@pytest.mark.parametrize(
    ("scale", "expected"), [(1.9, ()), (3.5, (TooNarrow(("kinematics",), (), ("mc2x", "J1zz"), 3.5),))]
)
def test_a_geometry_far_off_names_what_it_makes_uncertain(scale, expected):
    by_geometry = np.array([0.25, 0.9, 1.0, 0.01, 0.2])
    assert geometry_far_off(scale, by_geometry, NAMES, SD) == expected


def test_a_geometry_error_without_effect_is_not_reported():
    assert geometry_far_off(9.0, np.full(5, 0.01), NAMES, SD) == ()


def arm(alpha):
    """Two parallel axes, horizontal if alpha is a right angle."""
    rows = [{"a": 0.0, "alpha": alpha, "d": 0.0, "theta": 0.3}, {"a": 0.45, "alpha": 0.0, "d": 0.0, "theta": -0.2}]
    return robot_from_table({"convention": "modified", "joints": rows}, "an arm in a plane")


TERMS = ("rigid_body", "viscous_friction", "coulomb_friction")
MOTION = random_trajectory(2, 8.0, rng=6).motion(np.arange(401) / 50.0)
LINKS = [0.1, 0, 0, 0.2, 0, 0.3, 0.9, 0.35, 0, 3.0, 0.05, 0, 0, 0.1, 0, 0.12, 0.4, -0.1, 0, 1.5]
FRICTION = [0.8, 0.5, 2.0, 1.1]
SPRING = (6.0, -2.5)
"""N m per sine and cosine of the first joint: gravity of a first link with other first moments."""


def identified_arm(spring=(0.0, 0.0), alpha=np.pi / 2.0):
    robot = arm(alpha)
    model = Model(robot, make_terms(TERMS, robot, MOTION)).extend(make_effect("gravity_spring", {"joints": [1]}))
    log = simulate(model, np.array([*LINKS, *FRICTION, *spring]), MOTION, rng=np.random.default_rng(3), noise=0.02)
    return identify(robot, log, TERMS, search=Certified(budget=2.0), posterior=False)


@pytest.mark.parametrize("spring", [(0.0, 0.0), SPRING])
def test_a_counterbalance_is_gravity_to_the_log_and_its_coefficients_are_named(spring):
    """A spring makes the first link's first moments wrong by many standard deviations, without a visible residual."""
    result = identified_arm(spring)
    assert "gravity_spring" not in {effect.effect for effect in result.model_selection.effects}
    (found,) = [one for one in result.model_selection.too_narrow if one.joints == (1,)]
    assert "gravity_spring" in found.effects
    assert found.times is None
    truth = result.coefficients.project(np.array([*LINKS, *FRICTION]))
    off = np.abs(result.fit.beta - truth) / result.fit.sd
    wrong = {name for name, times in zip(result.coefficients.names, off.tolist(), strict=True) if times > 5.0}
    assert bool(wrong) == any(spring)
    assert wrong <= set(found.coefficients)
    assert not {"Fc1", "Fv1", "Fc2", "Fv2"} & set(found.coefficients[:2])


def test_a_log_that_tells_them_apart_names_none():
    """About vertical axes there is no gravity that a spring could look like; only a rotor like its link's inertia."""
    (found,) = identified_arm(alpha=0.0).model_selection.too_narrow
    assert found == TooNarrow(("rotor_inertia",), (1,), ("J1zz",))


JOINTS = 3
TOLERANCE = KinematicTolerance(length=0.002, angle=0.005)
STEP = 1e-5
"""m or rad, of central differences: their error is some 1e-9 of the efforts, and so is that of the columns."""
CLOSE = 1e-6


def made(seed=4, coupled=False):
    table = random_table("modified", JOINTS, seed, coupled=coupled)
    return table, random_motion(JOINTS, samples=5, seed=seed), random_clouds(JOINTS, seed=seed)


def columns_of(table, motion, clouds, tolerance=TOLERANCE):
    return kinematic_columns(robot_from_table(table, "test"), motion, parameters_of(clouds), tolerance)


def slope(table, motion, clouds, joint, key):
    """(N, n) derivative of the efforts by one number of the table: point masses, the principle of virtual work."""
    efforts = []
    for step in (STEP, -STEP):
        changed = deepcopy(table)
        changed["joints"][joint][key] += step
        torques = joint_torques(dh_chain(changed), clouds, np.array(table["gravity"]), motion)
        gears = table.get("transmission")
        efforts.append(torques if gears is None else actuator_efforts(torques, np.array(gears)))
    return (efforts[0] - efforts[1]) / (2.0 * STEP)


def displacement(row, key):
    """(6,) of a joint's own frame, by a number of its row: shift and turn, as its own axes see them.

    A frame is reached from the one before it by a turn alpha about x, a step a along x, a turn theta about z and a step
    d along z; a turn about the x axis of the frame before carries the origin, which is off that axis, along.
    """
    to_own = Rotation.from_euler("z", row["theta"]).inv()
    along_x = to_own.apply([1.0, 0.0, 0.0])
    changes = {
        "a": (along_x, np.zeros(3)),
        "alpha": (to_own.apply(np.cross([1.0, 0.0, 0.0], [row["a"], 0.0, row["d"]])), along_x),
        "d": (np.array([0.0, 0.0, 1.0]), np.zeros(3)),
        "theta": (np.zeros(3), np.array([0.0, 0.0, 1.0])),
    }
    return np.concatenate(changes[key])


@pytest.mark.parametrize("coupled", [False, True])
def test_numbers_of_the_table_are_displacements_of_joints(coupled):
    """Of every one of them, the second joint of three sliding; of a coupled one, efforts are the motors'."""
    table, motion, clouds = made(coupled=coupled)
    unit = columns_of(table, motion, clouds).reshape(5, JOINTS, JOINTS, 6) / np.repeat(
        [TOLERANCE.length, TOLERANCE.angle], 3
    )
    for joint, key in product(range(JOINTS), ("a", "alpha", "d", "theta")):
        expected = slope(table, motion, clouds, joint, key)
        found = unit[:, :, joint] @ displacement(table["joints"][joint], key)
        np.testing.assert_allclose(found, expected, rtol=0, atol=CLOSE * np.abs(unit).max())  # a shifted base: nothing


def test_in_the_standard_convention_they_are_the_numbers_of_the_table():
    """After those of the base: d, theta, a and alpha of each row; links' frames, and what is stated in them, go along.

    Of a sliding joint d changes nothing, and of the row of the last link everything is about its own frame.
    """
    table, motion, clouds = random_table("standard", JOINTS, 8), random_motion(JOINTS, 5, 8), random_clouds(JOINTS, 8)
    columns = columns_of(table, motion, clouds)
    assert columns.shape == (5, JOINTS, 6 + 4 * JOINTS)
    unit = columns[:, :, 6:].reshape(5, JOINTS, JOINTS, 4) / ([TOLERANCE.length, TOLERANCE.angle] * 2)
    for joint, (k, key) in product(range(JOINTS), enumerate(("d", "theta", "a", "alpha"))):
        expected = slope(table, motion, clouds, joint, key)
        assert joint < JOINTS - 1 or np.abs(expected).max() > 1e-3 * np.abs(unit).max()
        np.testing.assert_allclose(unit[:, :, joint, k], expected, rtol=0, atol=CLOSE * np.abs(unit).max())


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_of_a_known_robot_only_later_joints_are_elsewhere(convention):
    """Not its base, and its links' parameters stay about the axes that they were identified about."""
    table, motion, links = random_table(convention, JOINTS, 8), random_motion(JOINTS, 5, 8), random_clouds(JOINTS, 8)
    robot, parameters = robot_from_table(table, "test"), parameters_of(links)
    known = kinematic_columns(robot, motion, parameters, TOLERANCE, known=True)
    assert known.shape == (5, JOINTS, 6 * (JOINTS - 1))
    every = kinematic_columns(robot, motion, parameters, TOLERANCE)
    assert convention == "standard" or np.array_equal(known, every[:, :, 6:])
    step, shifted = 1e-5, []
    for sign in (1.0, -1.0):
        joint = replace(robot.joints[2], placement=robot.joints[2].placement @ shift_along_y(sign * step))
        there = replace(robot, joints=(*robot.joints[:2], joint))
        shifted.append(there.inverse_dynamics(motion, parameters))
    assert_close(known[:, :, 7], TOLERANCE.length * (shifted[0] - shifted[1]) / (2.0 * step), CLOSE)


def shift_along_y(length):
    move = np.eye(4)
    move[1, 3] = length
    return move


@pytest.mark.parametrize(("length", "angle", "kept"), [(0.0, 0.005, [3, 4, 5]), (0.002, 0.0, [0, 1, 2])])
def test_exact_geometry_has_no_columns(length, angle, kept):
    table, motion, clouds = made()
    every = columns_of(table, motion, clouds).reshape(5, JOINTS, JOINTS, 6)
    found = columns_of(table, motion, clouds, KinematicTolerance(length=length, angle=angle))
    np.testing.assert_array_equal(found, every[..., kept].reshape(5, JOINTS, -1))


def test_an_invalid_tolerance_is_refused():
    for length, angle in ((-1e-3, 0.1), (1e-3, -0.1), (np.nan, 0.1), (1e-3, np.inf)):
        with pytest.raises(ValueError, match="_sd"):
            KinematicTolerance(length=length, angle=angle)
