import csv
import math

import numpy as np
import pytest
from scipy import stats

from bayesid.errors import InputError
from bayesid.study.agreement import agreement, rows, text


def run(mean, sd, names=None, expressions=None, unit="kg"):
    """The rows of one run's coefficients."""
    names = [f"m{c}" for c in range(len(mean))] if names is None else names
    expressions = names if expressions is None else expressions
    return [
        {"name": name, "expression": expression, "unit": unit, "mean": value, "sd": width, "rsd_percent": 3.0}
        for name, expression, value, width in zip(names, expressions, mean, sd, strict=True)
    ]


def simulated(truth, sd, inflation=1.0, seed=0):
    """Runs (K, C) whose standard deviations sd are too small by a factor."""
    rng = np.random.default_rng(seed)
    return [run(truth + inflation * width * rng.normal(size=len(truth)), width) for width in sd]


def uneven(n_runs, number, seed=0):
    """Truths (C,) of all sizes, and standard deviations (K, C) that differ tenfold between the runs."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-4, 2, number)
    return size * rng.normal(size=number), size * 10.0 ** rng.uniform(-1.5, -0.5, (n_runs, number))


def test_by_hand():
    """Means 1, 2, 4 with sd 1, 2, 1/2: weights 1, 1/4, 4; and what only two of three runs decide."""
    found = agreement([run([1.0, 7.0], [1.0, np.inf]), run([2.0, -3.0], [2.0, 3.0]), run([4.0, 7.0], [0.5, 4.0])])
    assert found.n_runs == 3
    assert found.names == ("m0", "m1")
    np.testing.assert_array_equal(found.runs, [3, 2])
    np.testing.assert_array_equal(found.dof, [2, 1])
    np.testing.assert_allclose(found.mean, [17.5 / 5.25, (-3.0 / 9 + 7.0 / 16) / (1 / 9 + 1 / 16)])
    np.testing.assert_allclose(found.sd, [1.0 / np.sqrt(5.25), 12.0 / 5.0])
    np.testing.assert_allclose(found.spread, [np.sqrt(7.0 / 3.0), 10.0 / np.sqrt(2.0)])
    np.testing.assert_allclose(found.typical_sd, [np.sqrt(1.75), 5.0 / np.sqrt(2.0)])
    np.testing.assert_allclose(found.ratio, [np.sqrt(4.0 / 3.0), 2.0])
    np.testing.assert_allclose(found.chi_square, [23.0 / 3.0, 4.0])
    np.testing.assert_allclose(found.p, [np.exp(-23.0 / 6.0), 2.0 * stats.norm.sf(2.0)])
    assert found.factor == pytest.approx(0.5 * (np.sqrt(23.0 / 6.0 / np.log(2.0)) + 2.0 / stats.norm.ppf(0.75)))


@pytest.mark.parametrize("n_runs", [2, 3, 7])
def test_right_standard_deviations_pass(n_runs):
    """Runs of very different precision: p is uniform, the ratio's square 1 on average, the mean as sure as it says."""
    truth, sd = uneven(n_runs, 4000)
    found = agreement(simulated(truth, sd))
    assert stats.kstest(found.p, "uniform").pvalue > 1e-3
    assert stats.kstest((found.mean - truth) / found.sd, "norm").pvalue > 1e-3
    square = found.ratio**2
    assert square.mean() == pytest.approx(1.0, abs=4.0 * square.std() / np.sqrt(4000))
    assert found.factor == pytest.approx(1.0, abs=0.05)
    assert np.mean(found.differing[found.compared]) == pytest.approx(0.01, abs=0.007)
    assert not found.beyond_chance


@pytest.mark.parametrize(("n_runs", "inflation"), [(2, 2.4), (3, 0.3), (7, 2.4)])
def test_the_factor_is_by_how_much_the_standard_deviations_are_wrong(n_runs, inflation):
    truth, sd = uneven(n_runs, 4000)
    found = agreement(simulated(truth, sd, inflation))
    assert found.factor == pytest.approx(inflation, rel=0.05)
    expected = stats.chi2.sf(stats.chi2.isf(0.01, n_runs - 1) / inflation**2, n_runs - 1)
    assert np.mean(found.differing[found.compared]) == pytest.approx(expected, abs=0.04)
    assert found.beyond_chance == (inflation > 1.0)


def test_false_alarms_are_rare_and_so_many_that_differ_are_chance():
    """Of 58 coefficients, as many as a UR10e has, about one set in 500; how many may differ by the binomial sum."""
    alarms = sum(agreement(simulated(*uneven(3, 58), seed=seed)).beyond_chance for seed in range(1000))
    assert alarms <= 8, "2 expected"
    for number in range(8):  # none of them by so much that it alone were more than chance
        found = two_runs([3.0] * number + [0.7] * (58 - number))
        so_many = 1.0 - sum(math.comb(58, k) * 0.01**k * 0.99 ** (58 - k) for k in range(number))
        assert found.differing.sum() == number
        assert found.beyond_chance == (so_many < 1e-3)


def test_coefficients_that_not_every_run_determines():
    """A missing, infinite, NaN or zero deviation is left out."""
    nan, inf = np.nan, np.inf
    first = run([1.0, 2.0, 3.0, 4.0, 5.0], [0.1, inf, 0.1, nan, inf], names=list("abcde"))
    second = run([1.1, 2.1, nan, 4.1, 5.0, 6.0], [0.1, 0.1, 0.1, 0.0, inf, 0.1], names=list("abcdef"))
    found = agreement([first, second])
    assert found.names == tuple("abcdef")
    np.testing.assert_array_equal(found.runs, [2, 1, 1, 0, 0, 1])
    np.testing.assert_array_equal(found.compared, [True, False, False, False, False, False])
    np.testing.assert_array_equal(found.shared, [True] * 5 + [False])
    np.testing.assert_allclose(found.mean, [1.05, 2.1, 3.0, nan, nan, 6.0])
    np.testing.assert_allclose(found.sd, [0.1 / np.sqrt(2.0), 0.1, 0.1, inf, inf, 0.1])
    for name in ("spread", "typical_sd", "ratio", "chi_square", "p"):
        np.testing.assert_array_equal(np.isfinite(getattr(found, name)), found.compared, err_msg=name)


def test_coefficients_differ_by_name_expression_and_unit():
    """The same name with a payload in its expression is another coefficient."""
    bare = run([1.0, 2.0], [0.1, 0.1], names=["m6", "Fv1"], expressions=["m6", "Fv1"])
    loaded = run([3.8, 2.0], [0.1, 0.1], names=["m6", "Fv1"], expressions=["m6 + mP", "Fv1"])
    found = agreement([bare, loaded, loaded])
    assert list(zip(found.names, found.expressions, found.runs, found.shared, strict=True)) == [
        ("m6", "m6", 1, False),
        ("Fv1", "Fv1", 3, True),
        ("m6", "m6 + mP", 2, False),
    ]


def test_what_cannot_be_compared():
    one = run([1.0], [0.1])
    for runs in ([], [one]):
        with pytest.raises(InputError, match=f"two runs or more, not {len(runs)}"):
            agreement(runs)
    with pytest.raises(InputError, match="twice"):
        agreement([one, one + one])
    with pytest.raises(KeyError, match="unit"):
        agreement([one, [{"name": "m0", "expression": "m0", "mean": 1.0, "sd": 0.1}]])
    for runs in ([one, run([1.0], [np.inf])], [one, run([1.0], [0.1], names=["m9"])], [[], []]):
        nothing = agreement(runs)
        assert text(nothing) == nothing.sentence
        assert "cannot be compared" in nothing.sentence
        assert np.isnan(nothing.factor)
        assert not nothing.beyond_chance


def two_runs(distances):
    """Two runs of sd 1 whose means differ by a multiple of the sd of their difference."""
    zero = np.zeros(len(distances))
    return agreement([run(zero, zero + 1.0), run(np.sqrt(2.0) * np.array(distances), zero + 1.0)])


def test_the_file_says_the_same(tmp_path):
    """Written and read as a table; rows may be text."""
    runs = [run([1.0, 7.0], [1.0, np.inf]), run([2.0, -3.0], [2.0, np.inf]), run([4.0, 7.0], [0.5, 4.0], unit="kg")]
    written = rows(agreement(runs))
    with (tmp_path / "agreement.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(written[0]))
        writer.writeheader()
        writer.writerows(written)
    with (tmp_path / "agreement.csv").open(newline="") as file:
        first, second = csv.DictReader(file)
    columns = "name expression unit runs mean sd spread typical_sd ratio chi_square dof p"
    assert list(first) == columns.split()
    assert [first[key] for key in ("name", "expression", "unit", "runs", "dof")] == ["m0", "m0", "kg", "3", "2"]
    assert float(first["p"]) == pytest.approx(np.exp(-23.0 / 6.0))
    assert [second[key] for key in ("runs", "mean", "sd", "dof")] == ["1", "7.0", "4.0", "0"]
    assert [second[key] for key in ("spread", "typical_sd", "ratio", "chi_square", "p")] == [""] * 5
    texts = [[{key: str(value) for key, value in row.items()} for row in one] for one in runs]
    assert rows(agreement(texts)) == written


def test_the_sentence_follows_the_scatter_of_the_runs():
    usual = 0.6745  # half of all differ by less
    for distances, *words in (
        ([usual] * 9, "agree as expected", "1.0 times", "0 of 9 differ"),
        ([0.1 * usual] * 9, "agree better than expected", "0.1 times"),
        ([usual] * 9 + [6.0], "some coefficients differ", "1 of 10 differ"),
        ([3.0 * usual] * 9, "3.0 times"),
        ([2.0 * usual], "2.0 times", "may be chance", "0 of 1 differ"),
    ):
        sentence = two_runs(distances).sentence
        assert all(word in sentence for word in words), sentence
