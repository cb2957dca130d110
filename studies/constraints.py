"""What do constraints on the links change, and how tight is the proof's bound? A real log of a UR10e.

The maker publishes masses and centres of mass of the links, in the frames of the Denavit-Hartenberg table. Stated are
44 half spaces: each centre of mass within 0.1 m along each axis, each mass at most 1.3 times the published one, and the
total mass from 27 to 31 kg. One real log, its signs hidden, is identified with and without them. Errors are differences
from the published numbers.

A node of the proof has a lower bound of the cost of its decided segments (docs/certified-search.md). Its gap is the
least cost minus this bound, as a share of the cost and in nats, with the solver's usual and with its finest tolerance.
Nodes have random segments; every second node has random signs, the others the signs found.

The log is in $BAYESID_DATA; it is not part of bayesid.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.log.reading import read_log
from bayesid.posterior.sampler import Sampling
from bayesid.regression.stated import StatedParameters
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import SignProblem
from bayesid.studies import real
from bayesid.studies.preference import Witnessed
from bayesid.studies.record import Row
from bayesid.studies.study import Study, in_turn

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure

MASSES = np.array([7.369, 13.051, 3.989, 2.1, 1.98, 0.615])
"""kg, of the links."""
CENTRES = np.array(
    [
        [0.021, 0.0, 0.027],
        [0.38, 0.0, 0.158],
        [0.24, 0.0, 0.068],
        [0.0, 0.007, 0.018],
        [0.0, 0.007, 0.018],
        [0, 0, -0.026],
    ]
)
"""m, of the links, in their frames."""
_AROUND, _MOST, _TOTAL = 0.1, 1.3, (27.0, 31.0)
FROM = (2, 11)
"""Least number of decided segments of nodes of the second and the third class."""
NODES = 200
"""Random nodes of each class."""
LEAST_DRAWN = 1e-7
"""Gap in % that the figure shows for all smaller ones: rounding makes some negative."""


def published(p: StatedParameters) -> Iterator[Any]:
    """The half spaces."""
    yield [p.total_mass >= _TOTAL[0], p.total_mass <= _TOTAL[1]]
    for k, (mass, centre) in enumerate(zip(MASSES, CENTRES, strict=True), start=1):
        yield p.com_in_box(k, centre - _AROUND, centre + _AROUND)
        yield p.mass(k) <= _MOST * mass


def figures(result: Identification, log: Log) -> dict[str, float]:
    """Shares, errors and standard deviations of a result."""
    right, counted = real.right_signs(result, log)
    links, sd = (values[:60].reshape(6, 10) for values in (result.theta, result.parameter_sd[0]))
    centres = links[:, 6:9] / links[:, 9:]
    return {
        "signs right, %": 100.0 * float(right[counted].mean()),
        "proven": float(result.search.certified),
        "error of masses, kg": float(np.abs(links[:, 9] - MASSES).mean()),
        "error of centres of mass, m": float(np.abs(centres - CENTRES).mean()),
        "sd of masses, kg": float(sd[:, 9].mean()),
        "sd of first moments, kg m": float(sd[:, 6:9].mean()),
    }


def sd_of_open_parameters(results: list[Identification]) -> list[float]:
    """Geometric means over the links' parameters that only the prior determines without constraints."""
    spread: list[Array] = [result.parameter_sd[0][:60] for result in results]
    is_open = ~results[0].parameter_sd[1][:60]
    return [float(np.exp(np.log(sd[is_open]).mean())) for sd in spread]


@dataclass(frozen=True)
class Scenario:
    """A folder with a robot file and logs, and one of these logs."""

    folder: str
    log: str


def trial(scenario: Scenario, seed: int) -> Row:
    """The log without and with constraints, and gaps of bounds with them."""
    folder = Path(scenario.folder)
    log, seconds, results = read_log(folder / f"{scenario.log}.csv"), [], []
    for stated in (None, published, None, published):  # the first of each loads modules
        began, sampling = sum(os.times()[:4]), Sampling(rng=seed)
        results.append(identify(folder / "robot.toml", log.rectified(), constraints=stated, posterior=sampling))
        seconds.append(sum(os.times()[:4]) - began)
    without, with_them = (figures(result, log) for result in results[2:])
    open_sd = sd_of_open_parameters(results[2:])
    costliest = max(results[-1].constraints, key=lambda constraint: constraint.nats)
    return {
        "figures": [*without, "sd where the prior decides"],
        "without": [*without.values(), open_sd[0]],
        "with": [*with_them.values(), open_sd[1]],
        "costliest": costliest.label,
        "nats": costliest.nats,
        **gaps(folder, log, seed),
        "timings": {"without": seconds[2], "with": seconds[3]},
    }


def gaps(folder: Path, log: Log, seed: int, nodes: int = NODES) -> Row:
    """Least costs of random nodes of every class, and the gaps of their bounds with two tolerances, nats."""
    search = Witnessed(Certified())
    result = identify(
        folder / "robot.toml", log.rectified(), complete="off", search=search, posterior=False, constraints=published
    )
    problem, rng = search.problem_of(result.search), np.random.default_rng(seed)
    every = len(problem.normal_equations)
    parts = []
    for low, high in pairwise((1, *FROM, every + 1)):
        for k in range(nodes):
            decided = rng.choice(every, rng.integers(low, high), replace=False)
            flips = rng.choice([1, -1], len(decided)) if k % 2 else 1
            parts.append((len(decided), *_gaps(problem, decided, flips * result.search.signs[decided])))
    return dict(zip(("decided", "cost", "usual", "finer"), map(list, zip(*parts, strict=True)), strict=True))


def _gaps(problem: SignProblem, decided: Integers, signs: Integers) -> tuple[float, ...]:
    """Least cost of segments with signs, and the gaps of two bounds."""
    normal_equations, usual, finer = problem.normal_equations, problem.solver(), problem.solver()
    usual.finest = np.inf
    hessian, gradient = normal_equations.hessian_of(decided), signs @ normal_equations.gradient[decided]
    least = finer.prepared(hessian).solve_precisely(gradient).cost
    bounds = [solver.prepared(hessian).solve(gradient).lower_bound for solver in (usual, finer)]
    return float(normal_equations.energy[decided].sum()) + least, *(least - bound for bound in bounds)


def report(rows: Sequence[Row]) -> str:
    """Tables of the first trial."""
    row = rows[0]
    named = zip(row["figures"], row["without"], row["with"], strict=True)
    table = [("processor time, s", row["timings"]["without"], row["timings"]["with"]), *named]
    lines = [f"{'UR10e, ' + row['log']:<32}{'without':>10}{'with 44':>10}{'ratio':>8}"]
    lines += [f"{name:<32}{before:10.4g}{after:10.4g}{after / before:8.2f}" for name, before, after in table]
    lines += [f"constraint that costs most: {row['costliest']}, {row['nats']:.1f} nats", ""]
    lines += [f"{'gap of the lower bound with 44':<32}{'median':>10}{'90 %':>10}{'largest':>10}{'nats':>10}"]
    decided, cost = np.array(row["decided"]), np.array(row["cost"])
    for low, high in pairwise((1, *FROM, decided.max() + 1)):
        chosen = (low <= decided) & (decided < high)
        for key in ("usual", "finer"):
            gap = np.array(row[key])[chosen]
            label = f"{low} to {high - 1} segments" if low < high - 1 else "1 segment"
            shares = "".join(f"{value:>10.3%}" for value in np.quantile(gap / cost[chosen], [0.5, 0.9, 1.0]))
            lines.append(f"{f'{label}, {key}':<32}{shares}{gap.max():>10.3g}")
    return "\n".join(lines)


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Gaps over the segments decided."""
    from bayesid.studies.figures import COLOURS

    axes = figure.subplots()
    for key, label, colour in (
        ("usual", "usual tolerance", COLOURS[1]),
        ("finer", "finest tolerance reached", COLOURS[0]),
    ):
        shares = 100.0 * np.array(rows[0][key]) / np.array(rows[0]["cost"])
        axes.plot(rows[0]["decided"], np.maximum(shares, LEAST_DRAWN), "o", ms=3, alpha=0.6, color=colour, label=label)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("segments decided")
    axes.set_ylabel("gap of the lower bound, %")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.legend(fontsize=8)


def plan(trials: int, seed: int) -> Sequence[tuple[Scenario, int]]:
    """The log, with one seed after the other.

    Raises:
        InputError: it is missing.
    """
    return in_turn([Scenario(str(real.data_folder() / "ur10e"), "b_20s")])(trials, seed)


STUDY = Study("constraints", 1, plan, trial, report, draw)
