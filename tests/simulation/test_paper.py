import numpy as np
import pytest

from bayesid.effects.coefficients import base_coefficients
from bayesid.simulation.paper import TABLE_II, nominal_parameters, paper_model

ROWS = np.array([row.row for row in TABLE_II])
NOMINAL = np.array([row.nominal for row in TABLE_II])


@pytest.fixture(scope="module")
def model():
    return paper_model()


@pytest.fixture(scope="module")
def coefficients(model):
    return base_coefficients(model)


def test_the_table_has_27_independent_rows_of_the_papers_model(model, coefficients):
    assert model.robot.name == "kuka_kr5_sixx_r650"
    assert [term.name for term in model.terms] == ["rigid_body"]
    assert len(coefficients) == 36
    assert [row.number for row in TABLE_II] == list(range(1, 28))
    assert ROWS.shape == (27, 60)
    assert np.linalg.matrix_rank(ROWS) == 27


def test_weights_are_those_of_the_printed_expressions(model):
    names, (a1, a2, a3) = [parameter.name for parameter in model.parameters], (0.075, 0.27, 0.09)
    masses = {f"m{i}": a1**2 - a2**2 - a3**2 for i in range(3, 7)}
    by_hand = {
        1: {"J1yy": 1, "J2yy": 1, "J3zz": 1, "mc1x": 2 * a1, "m1": a1**2, "m2": a1**2 - a2**2, **masses},
        4: {"J3xz": 1},
        25: {"m6": -0.08, "mc5z": 1, "mc6z": -1},
    }
    for number, weights in by_hand.items():
        np.testing.assert_allclose(ROWS[number - 1], [weights.get(name, 0) for name in names], rtol=0, atol=1e-15)


def test_nominal_parameters_reproduce_the_table_to_its_printed_digits():
    np.testing.assert_allclose(ROWS @ nominal_parameters(), NOMINAL, atol=1e-9)
    assert nominal_parameters()[9::10].sum() == pytest.approx(28.0, abs=1e-12)
    assert np.all(paper_model().cone.smallest_eigenvalues(nominal_parameters()) >= 0.02)
    for row in TABLE_II:
        assert (round(row.nominal, 4), round(row.published, 4)) == (row.nominal, row.published)


def test_published_values_lie_near_the_nominal_ones():
    """The paper's largest error is 0.27; a slip of a digit or a sign in typing the table would be larger for most."""
    published = np.array([row.published for row in TABLE_II])
    assert np.abs(published - NOMINAL).max() < 0.27
    assert np.all((np.sign(published) == np.sign(NOMINAL)) | (NOMINAL == 0.0))


def test_sums_that_catch_typing_errors():
    """Column sums of the table as the design page prints it."""
    assert NOMINAL.sum() == pytest.approx(12.8218, abs=1e-9)
    assert sum(row.published for row in TABLE_II) == pytest.approx(12.7242, abs=1e-9)


def test_the_nine_coefficients_that_the_table_leaves_out_are_zero(coefficients):
    """They complete the table's 27 to all 36, so together they fix every coefficient of the nominal robot."""
    left_out = ("J2xy", "J2xz", "J2yz", "J2zz", "J3xy", "J4xy", "J4xz", "J4yz", "mc5x")
    rows = coefficients.projection[[coefficients.names.index(name) for name in left_out]]
    assert np.linalg.matrix_rank(np.vstack([ROWS, rows])) == 36
    np.testing.assert_allclose(rows @ nominal_parameters(), 0.0, atol=1e-9)
