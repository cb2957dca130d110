"""What constraints on the links of a UR10e say and cost, and how near the proof's lower bound comes with them.

The maker publishes masses and centres of mass of the links, in the frames of the Denavit-Hartenberg table. What is
stated is far from exact: each centre of mass to within 0.1 m along each axis, each mass at most 1.3 times the published
one, and all masses together from 27 to 31 kg: 44 half spaces. One real log, its signs hidden, is identified with them
and without. Errors are against the published numbers.

The lower bound of a node of the proof is that of its decided segments (docs/certified-search.md). Its gap is what it
leaves of the least cost, as a share of it and in nats: with the solver's usual tolerance, and with the finest that it
reaches. Nodes are random: so are their segments, and every second one's signs; the other ones have the signs found.

The log stands in $BAYESID_DATA; it is not part of bayesid.
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
from bayesid.errors import InputError
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
from bayesid.studies.real import DATA
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
"""Decided segments from which on a node is of the second class, and of the third."""
NODES = 200
"""Random nodes of each class."""
LEAST_DRAWN = 1e-7
"""Gap in % below which nodes are drawn there: rounding makes some negative."""


def published(p: StatedParameters) -> Iterator[Any]:
    """The half spaces."""
    yield [p.total_mass >= _TOTAL[0], p.total_mass <= _TOTAL[1]]
    for k, (mass, centre) in enumerate(zip(MASSES, CENTRES, strict=True), start=1):
        yield p.com_in_box(k, centre - _AROUND, centre + _AROUND)
        yield p.mass(k) <= _MOST * mass


def figures(result: Identification, log: Log) -> dict[str, float]:
    """Shares, errors and standard deviations of a result."""
    rows = real.grid_rows(result, log.t)
    moving = result.segments.per_sample(result.segments.moving, *result.probability.shape)[rows] > 0
    counted = real.is_strong(log.effort) & moving
    right = result.sample_signs[rows] == np.sign(log.effort)
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
    """Geometric means over the links' parameters that the prior decides without constraints."""
    spread: list[Array] = [result.parameter_sd[0][:60] for result in results]
    is_open = ~results[0].parameter_sd[1][:60]
    return [float(np.exp(np.log(sd[is_open]).mean())) for sd in spread]


@dataclass(frozen=True)
class Scenario:
    """A folder of a robot file and logs, and one of these."""

    folder: str
    log: str


def trial(scenario: Scenario, seed: int) -> Row:
    """The log without and with what is stated, and the gaps of bounds with it."""
    folder = Path(scenario.folder)
    log, seconds, results = read_log(folder / f"{scenario.log}.csv"), [], []
    for says in (None, published, None, published):  # the first of each loads modules
        began = sum(os.times()[:4])
        results.append(identify(folder / "robot.toml", log.rectified(), constraints=says, posterior=Sampling(rng=seed)))
        seconds.append(sum(os.times()[:4]) - began)
    without, with_them = (figures(result, log) for result in results[2:])
    open_sd = sd_of_open_parameters(results[2:])
    dearest = max(results[-1].constraints, key=lambda one: one.nats)
    return {
        "figures": [*without, "sd of what the prior decided"],
        "without": [*without.values(), open_sd[0]],
        "with": [*with_them.values(), open_sd[1]],
        "dearest": dearest.label,
        "nats": dearest.nats,
        **gaps(folder, log, seed),
        "timings": {"without": seconds[2], "with": seconds[3]},
    }


def gaps(folder: Path, log: Log, seed: int, nodes: int = NODES) -> Row:
    """Of bounds by two tolerances, in nats, for random nodes of every class, and these nodes' least costs."""
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
            turned = rng.choice([1, -1], len(decided)) if k % 2 else 1
            parts.append((len(decided), *_gaps(problem, decided, turned * result.search.signs[decided])))
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
    lines += [f"{name:<32}{one:10.4g}{other:10.4g}{other / one:8.2f}" for name, one, other in table]
    lines += [f"constraint that costs most: {row['dearest']}, {row['nats']:.1f} nats", ""]
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
        InputError: it is not there.
    """
    if not DATA.is_dir():
        raise InputError("the real logs are not here", "$BAYESID_DATA", "set it to their folder: see docs/results.md")
    return in_turn([Scenario(str(DATA / "ur10e"), "b_20s")])(trials, seed)


STUDY = Study("constraints", 1, plan, trial, report, draw)
