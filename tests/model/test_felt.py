"""Columns without those that a joint does not feel, against all of them."""

import numpy as np
import pytest

from bayesid.model.felt import FeltColumns

COUNT, SIZE = 7, 6


@pytest.fixture
def dense():
    """Joint 1 feels all but the second column, joint 2 the second and the last two, joint 3 nothing."""
    columns = np.random.default_rng(3).normal(size=(COUNT, 3, SIZE))
    columns[:, 0, 1] = 0.0
    columns[:, 1, [0, 2, 3]] = 0.0
    columns[:, 2] = 0.0
    columns[2, 1, 4] = 0.0  # by chance
    return columns


def test_all_columns_come_back(dense):
    felt = FeltColumns.of(dense)
    assert [those.tolist() for those in felt.felt] == [[0, 2, 3, 4, 5], [1, 4, 5], []]
    np.testing.assert_array_equal(felt.dense, dense)
    assert (len(felt), felt.size, felt.nbytes) == (COUNT, SIZE, 8 * COUNT * 8)


@pytest.mark.parametrize("columns", [[0, 2, 5], [1, 4], [0, 1, 2, 3, 4, 5], [3]])
def test_some_columns(dense, columns):
    chosen = FeltColumns.of(dense).chosen(np.array(columns))
    assert chosen.size == len(columns)
    np.testing.assert_array_equal(chosen.dense, dense[:, :, columns])
    assert all(values.flags.c_contiguous for values in chosen.values)


def test_columns_of_a_joint_among_others(dense):
    felt = FeltColumns.of(dense)
    for asked in ([1, 4, 5], [0, 1, 4, 5], [1, 2, 3, 4, 5]):
        np.testing.assert_array_equal(felt.of_joint(1, np.array(asked)), dense[:, 1, asked])
