import numpy as np
import pytest

from bayesid.regression.selection.columns import NO_COLUMNS, Columns, Whitening, stacked, together
from bayesid.regression.selection.error_model import ErrorModel, alike

RATE, COUNT = 50.0, 90
ERROR = ErrorModel(0.3, 0.5, 0.1, RATE)
OTHER = ErrorModel(0.6, 0.5, 0.2, RATE)


@pytest.fixture
def used():
    """A tenth of the samples missing, at an end too."""
    mask = np.ones((COUNT, 2), dtype=bool)
    mask[20:27, 0] = mask[50:53, 0] = mask[:4, 1] = mask[70:72, 1] = False
    return mask


@pytest.fixture
def whitening(used):
    """The last of four columns shows in the second joint alone."""
    columns = np.random.default_rng(1).normal(size=(COUNT, 2, 4))
    columns[:, 0, 3] = 0.0
    return Whitening(columns * used[:, :, None], used)


def effects(count, shifted, seed=2):
    rng = np.random.default_rng(seed)
    found = []
    for k in range(count):
        rows = {j: rng.normal(size=(COUNT, 2)) for j in (0, 1)}
        shift = {1: rng.normal(size=COUNT)} if shifted and k != 1 else {}
        found.append(Columns(rows, shift, np.array([0.4, 1.7]) + k, np.array([True, False])))
    return found


def white(values, joint, used, error=ERROR):
    return error.whiten(values, used[:, joint])


def test_columns_of_the_model_are_whitened_where_they_show(whitening, used):
    for j, shows in ((0, [0, 1, 2]), (1, [0, 1, 2, 3])):
        found, products = whitening.always(j, ERROR, NO_COLUMNS)
        expected = white(whitening.columns[:, j][:, shows], j, used)
        np.testing.assert_array_equal(whitening.bare(j)[0], shows)
        np.testing.assert_allclose(found, expected, atol=1e-12)
        np.testing.assert_allclose(products.sum(axis=0), expected.T @ expected, atol=1e-10)


def test_columns_whitened_by_the_same_filter_are_cached(whitening, used):
    (beside,) = effects(1, shifted=False)
    larger = ErrorModel(0.3 * 7.0, 0.5 * 7.0, 0.1, RATE)
    assert whitening.always(1, larger, beside)[0] is whitening.always(1, ERROR, beside)[0]
    for error in (OTHER, ERROR):
        found = whitening.always(1, error, beside)[0][:, -2:]
        np.testing.assert_allclose(found, white(beside.rows[1], 1, used, error), atol=1e-12)


@pytest.mark.parametrize(("shifted", "at_once"), [(True, True), (True, False), (False, True)])
def test_products_of_a_group_are_those_of_whitened_columns(whitening, used, shifted, at_once):
    """Of three effects' columns, and changes behind them, with each other, the model's, others beside, and the rest."""
    group, (beside,) = effects(3, shifted), effects(1, shifted=False, seed=5)
    group = stacked(group) if at_once else group
    rest = white(np.random.default_rng(6).normal(size=COUNT), 1, used)
    stack, whole = together(group, 1)
    assert whole == at_once
    parts = [one.rows[1] for one in group]
    if shifted:
        parts = [np.column_stack([one.rows[1], one.shift.get(1, np.zeros(COUNT))]) for one in group]
    expected = [white(part, 1, used) for part in parts]
    products, across = whitening.group(stack, 1, ERROR, beside, keep=whole)
    for k, one in enumerate(expected):
        np.testing.assert_allclose(products[k], one.T @ one, atol=1e-10)
        np.testing.assert_allclose(across[k], one.T @ whitening.always(1, ERROR, beside)[0], atol=1e-10)
        np.testing.assert_allclose(stack[k] @ whitening.pulled_back(rest, 1, ERROR), one.T @ rest, atol=1e-10)
    again = whitening.group(stack, 1, ERROR, beside, keep=whole)[0]
    assert (again is products) == whole


def test_errors_are_alike_up_to_a_small_difference_in_size():
    larger = ErrorModel(0.3 * 1.0005, 0.5 * 1.0005, 0.1, RATE)
    assert larger.shape == ERROR.shape
    assert alike([ERROR, OTHER], [larger, OTHER])
    assert not alike([ERROR], [ErrorModel(0.3 * 1.002, 0.5 * 1.002, 0.1, RATE)])
    assert not alike([ERROR], [ErrorModel(0.3, 0.5, 0.1001, RATE)])
    assert not alike([ERROR], [ErrorModel(0.3001, np.sqrt(0.34 - 0.3001**2), 0.1, RATE)])


def test_the_cache_is_bounded(whitening, used):
    each = COUNT * 5 + 4 * 25  # innovations, and products fold by fold
    bounded = Whitening(whitening.columns, used, most_bytes=5 * each * 8)
    some = effects(12, shifted=False)
    first = [bounded.always(0, ERROR, effect)[0] for effect in some]
    for k in (11, 10, 9, 8, 7):
        assert bounded.always(0, ERROR, some[k])[0] is first[k]
    for k, effect in enumerate(some[:7]):
        again = bounded.always(0, ERROR, effect)[0]
        assert again is not first[k]
        np.testing.assert_allclose(again, first[k], atol=1e-12)
