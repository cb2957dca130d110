"""Normal equations against the rows, and sparse Hessians against full ones."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from conftest import random_motion, small_robot

from bayesid.effects import STANDARD
from bayesid.effects import model as model_module
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.effects.tuning import TUNING
from bayesid.log.segments import Segments
from bayesid.motion import Motion
from bayesid.regression.normal_equations import Hessians, HessianSums, join_moments, normal_equations


@pytest.fixture(scope="module")
def case():
    robot, motion = small_robot(3), random_motion(3, 250, seed=1)
    model = Model(robot, make_terms(STANDARD, robot, motion))
    coefficients = base_coefficients(model)
    effort = np.abs(np.random.default_rng(2).normal(size=(250, 3))) + np.array([0.1, 0.5, 1.0])
    joint, start, end = np.array([0, 0, 1, 2, 2]), np.array([0, 40, 3, 0, 100]), np.array([40, 170, 250, 99, 101])
    segments = Segments(joint, start, end, np.array([0, 0, 1, 0, 0]), np.ones(5, dtype=bool))
    return model, coefficients, motion, effort, segments


def test_cost_equals_the_sum_over_rows(case):
    model, coefficients, motion, effort, segments = case
    m = normal_equations(model, coefficients, motion, effort, segments)
    rng = np.random.default_rng(0)
    theta, signs = rng.normal(size=len(model.parameters)), np.array([1, -1, 1, -1, -1])
    sigma = np.array([0.5, 2.0, 3.0])
    torque = model.effort(motion, theta)
    by_hand = sum(
        np.sum((s * effort[a:b, j] - torque[a:b, j]) ** 2) / sigma[j] ** 2
        for j, a, b, s in zip(segments.joint, segments.start, segments.end, signs, strict=True)
    )
    assert m.scaled(sigma).cost(coefficients.project(theta), signs) == pytest.approx(by_hand, rel=1e-10)
    assert m.count.tolist() == [40, 130, 247, 99, 1]


def test_chunks_add_to_the_whole(case, monkeypatch):
    model, coefficients, motion, effort, segments = case
    whole = normal_equations(model, coefficients, motion, effort, segments)
    monkeypatch.setattr(model_module, "TUNING", replace(TUNING, chunk=37))
    chunked = normal_equations(replace(model), coefficients, motion, effort, segments)
    for name in ("hessian", "gradient", "energy"):
        np.testing.assert_allclose(getattr(chunked, name), getattr(whole, name), rtol=1e-11, atol=1e-9)


def test_residuals_by_joint_equal_those_of_the_rows(case):
    model, coefficients, motion, effort, segments = case
    m = normal_equations(model, coefficients, motion, effort, segments)
    theta = np.random.default_rng(5).normal(size=len(model.parameters))
    signs, torque = np.array([1, -1, 1, -1, 1]), model.effort(motion, theta)
    errors: list[list[float]] = [[], [], []]
    for j, a, b, s in zip(segments.joint, segments.start, segments.end, signs, strict=True):
        errors[j] += (s * effort[a:b, j] - torque[a:b, j]).tolist()
    by_hand = [np.sqrt(np.mean(np.square(values))) for values in errors]
    np.testing.assert_allclose(m.residual_sd(coefficients.project(theta), signs, 3), by_hand, rtol=1e-9)
    assert m.rms_effort(3)[2] == pytest.approx(np.sqrt(np.mean(effort[np.r_[0:99, 100:101], 2] ** 2)))


@pytest.fixture(scope="module")
def long_case():
    """Two joints of three with many segments, some of known sign; energies of no particular order."""
    robot, motion = small_robot(3), random_motion(3, 240, seed=7)
    model = Model(robot, make_terms(["rigid_body", "viscous_friction"], robot, motion))
    coefficients = base_coefficients(model)
    rng = np.random.default_rng(8)
    effort = np.abs(rng.normal(size=(240, 3))) * np.array([1.0, 3.0, 0.5])
    cuts = [np.sort(rng.choice(np.arange(1, 240), count, replace=False)) for count in (11, 0, 8)]
    start = np.concatenate([np.concatenate([[0], c]) for c in cuts])
    end = np.concatenate([np.concatenate([c, [240]]) for c in cuts])
    joint = np.repeat([0, 1, 2], [12, 1, 9])
    known = np.zeros(22, dtype=np.int64)
    known[[0, 5, 12, 20]] = [1, -1, 1, -1]
    segments = Segments(joint, start, end, known, np.ones(22, dtype=bool))
    return model, coefficients, motion, effort, segments


@pytest.fixture(scope="module")
def whole(long_case):
    return normal_equations(*long_case)


def same_sums(normal_equations, other):
    """All but the way the Hessian is shared out."""
    for name in ("joint", "known", "gradient", "energy", "count"):
        np.testing.assert_array_equal(getattr(normal_equations, name), getattr(other, name))
    np.testing.assert_allclose(normal_equations.hessian.total(), other.hessian.total(), rtol=1e-11, atol=1e-8)


@pytest.mark.parametrize("most", [0, 2, 100])
def test_parts_can_be_shared_from_the_start_or_afterwards(long_case, whole, most):
    streamed, compacted = normal_equations(*long_case, most_individual=most), whole.compact(most)
    np.testing.assert_array_equal(streamed.part, compacted.part)
    np.testing.assert_allclose(streamed.hessian[:], compacted.hessian[:], rtol=1e-11, atol=1e-8)
    same_sums(streamed, whole)
    same_sums(compacted, whole)


@pytest.mark.parametrize("most", [1, 5])
def test_the_strongest_unknown_segments_keep_a_part_of_their_own(whole, most):
    compacted = whole.compact(most)
    for j in range(3):
        unknown = np.flatnonzero((whole.joint == j) & (whole.known == 0))
        strongest = unknown[np.argsort(-whole.energy[unknown])][:most]
        assert np.all(compacted.individual[strongest])
        for k in strongest:
            np.testing.assert_allclose(compacted.hessian[compacted.part[k]], whole.hessian[k], rtol=1e-12)
        weak = np.setdiff1d(unknown, strongest)
        assert len(np.unique(compacted.part[weak])) == min(1, len(weak))


@pytest.mark.parametrize("most", [0, 2])
def test_a_part_is_of_one_joint_and_of_known_or_unknown_signs(whole, most):
    compacted = whole.compact(most)
    assert len(compacted.hessian) == len(np.unique(compacted.part)) <= (most + 2) * 3
    for part in np.unique(compacted.part):
        members = np.flatnonzero(compacted.part == part)
        assert len(np.unique(whole.joint[members])) == 1
        assert len(np.unique(whole.known[members] != 0)) == 1
        np.testing.assert_allclose(compacted.hessian[part], whole.hessian[members].sum(axis=0), rtol=1e-11, atol=1e-8)


def test_costs_residuals_and_scaling_do_not_see_the_parts(whole):
    rng = np.random.default_rng(9)
    beta, sigma = rng.normal(size=whole.gradient.shape[1]), np.array([0.5, 2.0, 3.0])
    signs = np.where(whole.known != 0, whole.known, rng.choice([-1, 1], 22))
    compacted = whole.compact(2)
    assert compacted.cost(beta, signs) == pytest.approx(whole.cost(beta, signs))
    np.testing.assert_allclose(compacted.residual_sd(beta, signs, 3), whole.residual_sd(beta, signs, 3), rtol=1e-9)
    np.testing.assert_allclose(compacted.rms_effort(3), whole.rms_effort(3))
    same_sums(compacted.scaled(sigma), whole.scaled(sigma))
    np.testing.assert_allclose(compacted.scaled(sigma).hessian[:], whole.scaled(sigma).compact(2).hessian[:], rtol=1e-9)


def test_joined_moments_keep_their_parts_apart(whole):
    first, other = whole.compact(1), whole.compact(2).scaled(np.array([0.5, 2.0, 3.0]))
    both = first.join(other)
    assert len(both.hessian) == len(first.hessian) + len(other.hessian)
    for chosen in ([3], [0, 1], [21]):
        chosen = np.array(chosen)
        np.testing.assert_array_equal(both.hessian_of(chosen), first.hessian_of(chosen))
        np.testing.assert_array_equal(both.hessian_of(22 + chosen), other.hessian_of(chosen))
    np.testing.assert_array_equal(both.individual, np.concatenate([first.individual, other.individual]))


def pieces(long_case, count):
    """The case cut into pieces of equal length, each with its own share of the segments."""
    model, coefficients, motion, effort, segments = long_case
    length = len(motion) // count
    for k in range(count):
        first, last = k * length, (k + 1) * length
        start, end = np.maximum(segments.start, first) - first, np.minimum(segments.end, last) - first
        overlaps = end > start
        cut = Segments(
            segments.joint[overlaps],
            start[overlaps],
            end[overlaps],
            segments.known[overlaps],
            segments.moving[overlaps],
        )
        piece = Motion(*(getattr(motion, name)[first:last] for name in ("t", "q", "dq", "ddq")))
        yield normal_equations(model, coefficients, piece, effort[first:last], cut, most_individual=2)


@pytest.mark.parametrize("count", [1, 6])
def test_pieces_join_to_the_whole(long_case, whole, count):
    """Rows are neither lost nor counted twice; segments that a border cuts are two, in the order of the pieces."""
    joined = join_moments(pieces(long_case, count), most_individual=2)
    for name in ("gradient", "energy", "count"):
        for joint in range(3):
            for sign in (-1, 0, 1):
                mine = (joined.joint == joint) & (joined.known == sign)
                all_of_it = (whole.joint == joint) & (whole.known == sign)
                total, expected = getattr(joined, name)[mine].sum(axis=0), getattr(whole, name)[all_of_it].sum(axis=0)
                np.testing.assert_allclose(total, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(joined.hessian.total(), whole.hessian.total(), rtol=1e-10, atol=1e-8)
    apart = list(pieces(long_case, count))
    np.testing.assert_array_equal(joined.gradient, np.concatenate([piece.gradient for piece in apart]))
    np.testing.assert_array_equal(joined.known, np.concatenate([piece.known for piece in apart]))


FELT = {0: [0, 1, 2, 4], 1: [2, 4], 2: [3]}


@dataclass
class Full:
    """Random matrices of parts of three joints, in full."""

    joint: np.ndarray
    dense: np.ndarray

    @classmethod
    def random(cls, seed, joint):
        rng, dense = np.random.default_rng(seed), np.zeros((len(joint), 5, 5))
        for matrix, j in zip(dense, joint, strict=True):
            rows = rng.normal(size=(7, len(FELT[j])))
            matrix[np.ix_(FELT[j], FELT[j])] = rows.T @ rows
        return cls(np.array(joint), dense)

    @property
    def made(self):
        return Hessians.make(self.joint, self.dense)


@pytest.fixture
def full():
    return Full.random(0, [1, 0, 2, 0, 1, 0, 2])


def same(found, expected):
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


def test_only_nonzero_columns_of_a_joint_are_stored(full):
    made = full.made
    assert [columns.tolist() for columns in made.columns] == list(FELT.values())
    assert [values.shape for values in made.values] == [(3, 4, 4), (2, 2, 2), (2, 1, 1)]
    same(made[:], full.dense)
    same(made[3], full.dense[3])
    same(made[np.array([4, 0])], full.dense[[4, 0]])


def test_sums(full):
    made, some = full.made, np.array([5, 0, 2, 1])
    same(made.total(), full.dense.sum(axis=0))
    same(made.of(some), full.dense[some].sum(axis=0))
    by_joint = made.by_joint(4)
    for j in range(4):
        same(by_joint[j], full.dense[full.joint == j].sum(axis=0))


def test_forms_weights_and_choice(full):
    beta, weights = np.random.default_rng(1).normal(size=(6, 5)), np.arange(7.0) - 2.5
    some = np.array([6, 1, 4, 3])
    same(full.made.forms(beta), np.einsum("wr,krs,ws->wk", beta, full.dense, beta))
    same(full.made.scaled(weights)[:], weights[:, None, None] * full.dense)
    same(full.made.chosen(some)[:], full.dense[some])
    same(full.made.chosen(some).forms(beta), np.einsum("wr,krs,ws->wk", beta, full.dense[some], beta))


def test_parts_are_joined_and_summed(full):
    other, more = Full.random(1, [2, 2, 0]), Full.random(2, full.joint)
    same(full.made.joined([other.made, more.made])[:], np.concatenate([full.dense, other.dense, more.dense]))
    into = np.array([3, 0, 1, 2, 3, 0, 1])
    expected = np.zeros((4, 5, 5))
    np.add.at(expected, into, full.dense)
    same(full.made.summed(into)[:], expected)


def test_a_joint_may_get_more_columns(full):
    """A term whose column is zero in the first chunk of a log, and not later."""
    sums, rng = HessianSums(5, np.array([0, 1, 0])), np.random.default_rng(3)
    expected = np.zeros((3, 5, 5))
    for part, columns in ((0, [1]), (2, [1, 4]), (1, [3]), (0, [0, 4]), (0, [1])):
        sparsity, rows = sums.feel([0, 1, 0][part], np.array(columns)), np.zeros((6, 5))
        rows[:, columns] = rng.normal(size=(6, len(columns)))
        sums.add_rows(part, rows[:, sparsity])
        expected[part] += rows.T @ rows
    same(sums.done()[:], expected)
