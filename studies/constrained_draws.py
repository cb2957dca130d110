"""Are draws with constraints the unconstrained draws that satisfy them? Five forms of constraints on two logs.

The same log, its signs hidden, is identified without and with a constraint (`complete="off"`). Unconstrained draws are
kept where they satisfy the constraint by its definition. Both sets must agree: means within 0.1 standard deviations,
standard deviations within 7 %. Bounds are quantiles of the unconstrained draws, of which 20 to 60 % are kept. Errors
are Monte Carlo errors: jackknife over the walkers.

Logs: a simulated KR5, and a real UR10e where $BAYESID_DATA holds it, a simulated one elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayesid.arrays import Array, Mask
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.log.reading import read_log
from bayesid.posterior.inference import Posterior
from bayesid.posterior.sampler import Sampling
from bayesid.regression.stated import ConstraintFunction, StatedParameters
from bayesid.robot import load_robot
from bayesid.simulation.logs import simulate_log
from bayesid.studies import real
from bayesid.studies.record import Row
from bayesid.studies.study import Study, in_turn

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure

REAL = "ur10e/b_20s"
MEAN, SPREAD = 0.1, (0.93, 1.07)
"""Allowed difference of means, in standard deviations, and allowed ratios of standard deviations. Chosen."""
_CENTRE, _AXES = np.array([0.1, -0.05, 0.1]), np.array([1.0, 0.8, 0.9])
"""Of the ellipsoid: m in the link's frame, and relative lengths."""
_BUDGETS = {"free": 40.0, "constrained": 20.0}
"""Nominal seconds of sampling: Monte Carlo errors must be below half of the allowed differences."""

Values = Mapping[str, Array]
"""Parameters by name, (N,) draws of each."""


class Form(NamedTuple):
    """A form of constraint, whose bounds are quantiles of some quantities."""

    quantities: Callable[[Values], Array]  #: (N, k) of draws
    quantiles: tuple[float, float]
    constraints: Callable[[StatedParameters, Array, Array], list[Any]]  #: low <= quantities <= high, (k,) each


def _moment(values: Values, link: int) -> Array:
    return np.column_stack([values[f"mc{link}{axis}"] for axis in "xyz"])


def _stretch(values: Values, link: int) -> Array:
    """(N, 1) smallest scale of the ellipsoid for the link: weighted second moments about its centre."""
    inertia = np.column_stack([values[f"J{link}{axes}"] for axes in ("xx", "yy", "zz")])
    second, mass = 0.5 * inertia.sum(axis=1, keepdims=True) - inertia, values[f"m{link}"][:, None]
    about = second - 2.0 * _CENTRE * _moment(values, link) + _CENTRE**2 * mass
    stretch: Array = np.sqrt(about @ _AXES[:, None] ** -2.0 / mass)
    return stretch


def _norm_at_most(p: StatedParameters, low: Array, high: Array) -> list[Any]:
    import cvxpy as cp  # takes a second or two

    return [cp.norm(p.first_moment(3)) <= high[0]]


FORMS = {
    "interval of a sum": Form(
        lambda v: (v["m2"] + v["m3"])[:, None],
        (0.2, 0.6),
        lambda p, low, high: [p["m2"] + p["m3"] >= low[0], p["m2"] + p["m3"] <= high[0]],
    ),
    "ratio of masses": Form(
        lambda v: (v["m3"] / v["m2"])[:, None], (0.0, 0.4), lambda p, low, high: [p["m3"] <= high[0] * p["m2"]]
    ),
    "box of a centre of mass": Form(
        lambda v: _moment(v, 2) / v["m2"][:, None], (0.1, 0.8), lambda p, low, high: [p.com_in_box(2, [*low], [*high])]
    ),
    "norm of a first moment": Form(lambda v: np.linalg.norm(_moment(v, 3), axis=1)[:, None], (0.0, 0.4), _norm_at_most),
    "density in an ellipsoid": Form(
        lambda v: _stretch(v, 2),
        (0.0, 0.4),
        lambda p, low, high: [p.density_in_ellipsoid(2, _CENTRE.tolist(), (high[0] * _AXES).tolist())],
    ),
}


@dataclass(frozen=True)
class Scenario:
    """A log, and the form of its constraint."""

    log: str
    form: str


@lru_cache(maxsize=1)
def _identified(log: str, seed: int) -> Identification:
    """Identification without constraints, the same for every form."""
    return _identify(log, seed, None)


def _identify(log: str, seed: int, constraints: ConstraintFunction | None) -> Identification:
    budget = _BUDGETS["free" if constraints is None else "constrained"]
    sampling = Sampling(budget=budget, min_ess=1e9, time_limit=3600.0, rng=seed)  # all of the budget
    if log == REAL:
        robot, data = load_robot(real.DATA / "ur10e" / "robot.toml"), read_log(real.DATA / f"{REAL}.csv").rectified()
    else:
        robot = load_robot(log)
        data, _ = simulate_log(robot, duration=10.0, rate=50.0, noise=0.05, effects=[], seed=seed)
    return identify(robot, data, complete="off", posterior=sampling, constraints=constraints)


def trial(scenario: Scenario, seed: int) -> Row:
    """Both runs, and how their draws compare."""
    free, form = _identified(scenario.log, seed), FORMS[scenario.form]
    every, names = _draws(free), [parameter.name for parameter in free.model.parameters]
    values = dict(zip(names, every.reshape(-1, len(names)).T, strict=True))
    quantities = form.quantities(values)
    low, high = np.quantile(quantities, form.quantiles, axis=0)
    low = np.where(form.quantiles[0] > 0.0, low, -np.inf)
    kept = np.all((low <= quantities) & (quantities <= high), axis=1).reshape(every.shape[:2])
    constrained = _identify(scenario.log, seed, lambda p: form.constraints(p, low, high))
    stated = constrained.model.cone.stated
    assert stated is not None
    filtered, drawn = moments(every, kept), moments(_draws(constrained))
    off = (drawn.mean - filtered.mean) / filtered.sd
    return {
        "kept": float(kept.mean()),
        "data": difference_of_data(free, constrained),
        "involved": stated.involved.any(axis=0).tolist(),
        "off": off.tolist(),
        "off_error": (np.hypot(drawn.mean_error, filtered.mean_error) / filtered.sd).tolist(),
        "ratio": (drawn.sd / filtered.sd).tolist(),
        "ratio_error": np.hypot(drawn.sd_error / drawn.sd, filtered.sd_error / filtered.sd).tolist(),
    }


class Moments(NamedTuple):
    """Means and standard deviations (P,) of draws, and their Monte Carlo errors."""

    mean: Array
    sd: Array
    mean_error: Array
    sd_error: Array


def moments(draws: Array, kept: Mask | None = None) -> Moments:
    """Of draws (D, W, P) of W independent walkers, or of those that are kept (D, W)."""
    weight = np.ones(draws.shape[:2]) if kept is None else kept.astype(float)
    centre, scale = draws.mean(axis=(0, 1)), draws.std(axis=(0, 1))
    sums = np.empty((3, *draws.shape[1:]))
    sums[0] = weight.sum(axis=0)[:, None]
    for walker in range(draws.shape[1]):
        z = (draws[:, walker] - centre) / scale
        sums[1, walker], sums[2, walker] = weight[:, walker] @ z, weight[:, walker] @ z**2
    total = sums.sum(axis=1)
    mean, sd = _mean_and_sd(total)
    without = _mean_and_sd(total[:, None] - sums)  # (W, P) each
    count = draws.shape[1]
    errors = [np.sqrt((count - 1) * values.var(axis=0)) for values in without]
    return Moments(centre + scale * mean, scale * sd, scale * errors[0], scale * errors[1])


def _mean_and_sd(sums: Array) -> tuple[Array, Array]:
    mean = sums[1] / sums[0]
    return mean, np.sqrt(sums[2] / sums[0] - mean**2)


def _draws(result: Identification) -> Array:
    """(D, W, P) of W walkers."""
    theta = _posterior(result).draws.theta
    return theta.reshape(len(theta), -1, theta.shape[-1])


def _posterior(result: Identification) -> Posterior:
    assert result.posterior is not None
    return result.posterior


def difference_of_data(free: Identification, constrained: Identification) -> float:
    """Relative difference of the two likelihoods: the larger one of their gradients and their noise."""
    first, second = (_posterior(result).target.likelihood for result in (free, constrained))
    if first.gradient.shape != second.gradient.shape:
        return np.inf
    gradient = np.linalg.norm(first.gradient - second.gradient) / np.linalg.norm(first.gradient)
    return float(max(gradient, np.max(np.abs(second.sigma / first.sigma - 1.0))))


def report(rows: Sequence[Row]) -> str:
    """One line per log and form, with Monte Carlo errors."""
    lines = [
        f"{'':<46}{'largest difference of means, sd':^34}{'ratio of sd':^44}",
        f"{'log':<12}{'constraint':<26}{'kept':>8}"
        f"{'involved':>12}{'all':>8}{'error':>8}{'involved':>18}{'all':>18}{'error':>8}",
    ]
    for row in rows:
        off, ratio, named = np.abs(row["off"]), np.array(row["ratio"]), np.array(row["involved"])
        lines.append(
            f"{row['log']:<12}{row['form']:<26}{row['kept']:>8.1%}"
            f"{off[named].max():>12.3f}{off.max():>8.3f}{max(row['off_error']):>8.3f}"
            f"{_range(ratio[named]):>18}{_range(ratio):>18}{max(row['ratio_error']):>8.3f}"
        )
    good = sum(agrees(row) for row in rows)
    lines += ["", "error: largest Monte Carlo error (one standard deviation) of any parameter"]
    lines += [f"relative difference of the two likelihoods: at most {max(row['data'] for row in rows):.1g}"]
    required = f"means within {MEAN:g} sd, ratios {SPREAD[0]:g} to {SPREAD[1]:g}, all parameters"
    return "\n".join([*lines, f"{required}: {good} of {len(rows)}"])


def _range(values: Array) -> str:
    return f"{values.min():.3f} to {values.max():.3f}"


def agrees(row: Row) -> bool:
    """Whether draws with a constraint agree with the kept draws without it."""
    ratio = np.array(row["ratio"])
    return bool(np.max(np.abs(row["off"])) <= MEAN and ratio.min() >= SPREAD[0] and ratio.max() <= SPREAD[1])


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Differences of means and ratios of sds of all parameters, by form."""
    from bayesid.studies.figures import COLOURS, MARKERS

    means, spreads = figure.subplots(1, 2)
    for log, colour, marker in zip(dict.fromkeys(row["log"] for row in rows), COLOURS, MARKERS, strict=False):
        for axes, key in ((means, "off"), (spreads, "ratio")):
            for row in (row for row in rows if row["log"] == log):
                at = list(FORMS).index(row["form"]) + 0.3 * np.linspace(-1.0, 1.0, len(row[key]))
                axes.plot(row[key], at, marker, ms=2, color=colour, label=log)
    for axes, limits, words in (
        (means, (-MEAN, MEAN), "difference of means, sd"),
        (spreads, SPREAD, "ratio of standard deviations"),
    ):
        for limit in limits:
            axes.axvline(limit, color="#999999", lw=0.8)
        axes.set_xlabel(words)
        axes.set_yticks(range(len(FORMS)), list(FORMS) if axes is means else [], fontsize=8)
        axes.invert_yaxis()
    entries = dict(zip(*reversed(means.get_legend_handles_labels()), strict=True))
    spreads.legend(entries.values(), entries.keys(), fontsize=8)


def plan(trials: int, seed: int) -> Sequence[tuple[Scenario, int]]:
    """All forms of a log, then of the next: they share one identification without constraints."""
    second = REAL if (real.DATA / f"{REAL}.csv").is_file() else "ur10e"
    return in_turn([Scenario(log, form) for log in ("kr5", second) for form in FORMS])(trials, seed)


STUDY = Study("constrained_draws", 2 * len(FORMS), plan, trial, report, draw)
