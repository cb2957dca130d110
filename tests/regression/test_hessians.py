"""Hessians held in the columns that joints feel, against the same matrices held in full."""

from dataclasses import dataclass

import numpy as np
import pytest

from bayesid.regression.moments import Hessians, HessianSums

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


def test_only_what_a_joint_feels_is_held(full):
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


def test_a_joint_may_come_to_feel_more(full):
    """A term whose column is zero in the first chunk of a log, and not later."""
    sums, rng = HessianSums(5, np.array([0, 1, 0])), np.random.default_rng(3)
    expected = np.zeros((3, 5, 5))
    for part, columns in ((0, [1]), (2, [1, 4]), (1, [3]), (0, [0, 4]), (0, [1])):
        felt, rows = sums.feel([0, 1, 0][part], np.array(columns)), np.zeros((6, 5))
        rows[:, columns] = rng.normal(size=(6, len(columns)))
        sums.add_rows(part, rows[:, felt])
        expected[part] += rows.T @ rows
    same(sums.done()[:], expected)
