from dataclasses import dataclass, replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from effect_problems import Made, observed
from scipy.stats import multivariate_normal, norm

from bayesid.regression.knowledge import InformationMatrix
from bayesid.regression.selection.columns import Columns
from bayesid.regression.selection.scores import JointForms, joint_sets

COUNT, JOINT = 120, 1
FLOOR = np.array([0.7, 0.4])
UNIT = InformationMatrix(np.eye(1), np.zeros(1), 0.0)


@dataclass(frozen=True, eq=False)
class Form(Made):
    """A form by its name."""

    source: SimpleNamespace


def form(name, rows=None, shift=None, sd=(), positive=()):
    columns = Columns(
        {} if rows is None else {JOINT: rows},
        {} if shift is None else {JOINT: shift},
        np.array(sd, dtype=float),
        np.array(positive or [False] * len(sd)),
    )
    return Form(columns, (name.split(".")[0], (JOINT + 1,)), SimpleNamespace(name=name))


def scored(data, others, forms):
    """Where the joint is all that there is."""
    others, forms = ([replace(one, columns=one.columns.in_joint(JOINT)) for one in some] for some in (others, forms))
    return JointForms(data.in_joint(JOINT), others, forms)


@pytest.fixture
def problem():
    """Two model columns known from before, and forms of which one is a change without amplitude."""
    rng = np.random.default_rng(5)
    columns = np.zeros((COUNT, 2, 2))
    columns[:, JOINT] = rng.normal(size=(COUNT, 2))
    known = np.array([[3.0, 0.4], [0.4, 1.5]])
    expected = np.array([0.7, -1.2])
    forms = [
        form("spring", rng.normal(size=(COUNT, 2)), sd=(0.3, 0.1)),
        form("friction", rng.normal(size=(COUNT, 1)), sd=(0.2,)),
        form("clipping", shift=0.2 * rng.normal(size=COUNT)),
        form("delay", 0.5 * rng.normal(size=(COUNT, 1)), 0.1 * rng.normal(size=COUNT), sd=(0.4,)),
    ]
    effort = columns[:, JOINT] @ np.array([0.5, -0.9]) + 0.2 * forms[0].columns.rows[JOINT][:, 0]
    effort += 0.15 * rng.normal(size=COUNT)  # less than the floor: the scale stays at it
    used = np.ones((COUNT, 2), dtype=bool)
    used[[3, 50, 51], JOINT] = False
    data = observed(columns, np.column_stack([np.zeros(COUNT), effort]), used)
    information = InformationMatrix(known, known @ expected, float(expected @ known @ expected))
    data = replace(data, information=information, floor=FLOOR)
    return data, forms, np.linalg.inv(known), expected


def dense(problem, some, others=()):
    """Log density of the joint's used efforts, coefficients and amplitudes integrated out, as one large normal."""
    data, _, spread, expected = problem
    used = data.used[:, JOINT]
    model = data.columns[used, JOINT]
    mean, covariance = model @ expected, FLOOR[JOINT] ** 2 * np.eye(used.sum()) + model @ spread @ model.T
    for columns in [one.columns for one in (*others, *some)]:
        if JOINT in columns.rows:
            rows = columns.rows[JOINT][used] * columns.sd
            covariance += rows @ rows.T
        if JOINT in columns.shift:
            mean = mean + columns.shift[JOINT][used]
    return multivariate_normal(mean, covariance).logpdf(data.effort[used, JOINT])


@pytest.mark.parametrize("with_others", [False, True])
def test_scores_are_log_densities(problem, with_others):
    data, forms, *_ = problem
    rng = np.random.default_rng(8)
    more = form("more", rng.normal(size=(COUNT, 1)), 0.05 * rng.normal(size=COUNT), sd=(0.3,))
    others = [more] if with_others else []
    prepared = scored(data, others, forms)
    nothing = prepared.scores(np.zeros((1, 0), dtype=np.int64))[0]
    for size in (1, 2, 3):
        sets = np.array(list(combinations(range(len(forms)), size)))
        expected = [dense(problem, [forms[k] for k in some], others) - dense(problem, (), others) for some in sets]
        np.testing.assert_allclose(prepared.scores(sets) - nothing, expected, rtol=1e-8, atol=1e-8)


def test_an_amplitude_that_cannot_be_negative(problem):
    data, forms, *_ = problem
    rows = forms[1].columns.rows[JOINT]
    for side in (1.0, -1.0):
        sided = form("friction", side * rows, sd=(0.2,), positive=[True])
        free = form("friction", side * rows, sd=(0.2,))
        scores = [scored(data, [], [one]).scores(np.array([[0]]))[0] for one in (sided, free)]
        grid = np.linspace(0.0, 1.6, 4001)  # of the amplitude, by quadrature
        used = data.used[:, JOINT]
        model, spread, expected = data.columns[used, JOINT], problem[2], problem[3]
        normal = multivariate_normal(
            model @ expected, FLOOR[JOINT] ** 2 * np.eye(used.sum()) + model @ spread @ model.T
        )
        left = data.effort[used, JOINT] - np.outer(grid, side * rows[used, 0])
        density = np.exp(normal.logpdf(left) - dense(problem, [free])) * 2.0 * norm(0.0, 0.2).pdf(grid)
        assert scores[0] - scores[1] == pytest.approx(np.log(np.trapezoid(density, grid)), abs=1e-4)


def test_a_pair_of_effects_that_a_third_one_resembles():
    """One effect after the other would begin with the look-alike."""
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 9.0, 600)
    one, other = np.sign(np.sin(1.3 * t)), np.sin(0.7 * t + 0.4)
    alike = one + other + 0.15 * rng.normal(size=600)
    parts = {"dry": one, "spring": other, "hysteresis": alike, "drag": rng.normal(size=600)}
    forms = [form(name, x[:, None], sd=(1.0,)) for name, x in parts.items()]
    effort = 2.0 * one + 1.5 * other + 0.1 * rng.normal(size=600)
    data = observed(np.zeros((600, 2, 1)), np.column_stack([np.zeros(600), effort]))
    data = replace(data, information=UNIT, floor=np.full(2, 0.1))
    proposed = joint_sets(data, JOINT, [], forms, lambda _: -5.0)
    first = {size: next(some for some in proposed if len(some) == size) for size in (1, 2)}
    assert [one.source.name for one in first[1]] == ["hysteresis"]
    assert {one.source.name for one in first[2]} == {"dry", "spring"}


def test_no_set_holds_an_effect_twice():
    rng = np.random.default_rng(2)
    forms = [form(name, rng.normal(size=(COUNT, 1)), sd=(1.0,)) for name in ("a", "a.other", "b", "c")]
    data = observed(np.zeros((COUNT, 2, 1)), rng.normal(size=(COUNT, 2)))
    data = replace(data, information=UNIT, floor=FLOOR)
    proposed = joint_sets(data, JOINT, [], forms, lambda _: 0.0)
    assert {frozenset(one.key[0] for one in some) for some in proposed} >= {frozenset("ab"), frozenset("abc")}
    assert all(len({one.key for one in some}) == len(some) for some in proposed)
    assert joint_sets(data, JOINT, [], [], lambda _: 0.0) == []
