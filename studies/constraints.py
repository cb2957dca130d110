"""What constraints on the links of a UR10e say and cost, and how near the proof's lower bound comes with them.

The maker publishes masses and centres of mass of the links, in the frames of the Denavit-Hartenberg table. What is
stated is far from exact: each centre of mass to within 0.1 m along each axis, each mass at most 1.3 times the published
one, and all masses together from 27 to 31 kg: 44 half spaces. One real log, its signs hidden, is identified with them
and without. Errors are against the published numbers.

The lower bound of a node of the proof is that of its decided segments (docs/certified-search.md). Its gap is what it
leaves of the least cost, as a share of it: by the best multiple of the solver's multipliers, and by improved ones
(`bayesid.regression.dual`). Segments are decided in the order of their squared effort, with the signs found.

The log stands in $BAYESID_DATA; it is not part of bayesid.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.arrays import Array
from bayesid.errors import InputError
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.log.reading import read_log
from bayesid.posterior.sampler import Sampling
from bayesid.regression.stated import StatedParameters
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import SearchResult, SignProblem
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
DECIDED = (1, 2, 3, 5, 10, 20, 50, 100)
"""Numbers of segments for which gaps are shown."""


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
        **gaps(folder, log),
        "timings": {"without": seconds[2], "with": seconds[3]},
    }


def gaps(folder: Path, log: Log) -> Row:
    """Of bounds by two ways, as shares of the least cost, with the strongest segments decided."""
    search = Witnessed(Certified())
    result = identify(
        folder / "robot.toml", log.rectified(), complete="off", search=search, posterior=False, constraints=published
    )
    found = result.search
    problem = search.problem_of(found)
    counts = [count for count in DECIDED if count < len(problem.normal_equations)] + [len(problem.normal_equations)]
    parts = [_gaps(problem, found, count) for count in counts]
    names = ("share", "cost", "by_multiple", "improved")
    return {"decided": counts, **dict(zip(names, map(list, zip(*parts, strict=True)), strict=True))}


def _gaps(problem: SignProblem, found: SearchResult, count: int) -> tuple[float, ...]:
    """Share of the squared effort that is decided, its least cost, and the gaps of two bounds."""
    normal_equations, improved, by_multiple = problem.normal_equations, problem.solver(), problem.solver()
    by_multiple.is_cut = False
    decided = np.argsort(-normal_equations.energy, kind="stable")[:count]
    hessian, gradient = normal_equations.hessian_of(decided), found.signs[decided] @ normal_equations.gradient[decided]
    energy = float(normal_equations.energy[decided].sum())
    least = improved.prepared(hessian).solve_precisely(gradient).cost
    bounds = [solver.prepared(hessian).solve(gradient).lower_bound for solver in (by_multiple, improved)]
    return energy / problem.energy, energy + least, *((least - bound) / (energy + least) for bound in bounds)


def report(rows: Sequence[Row]) -> str:
    """Tables of the first trial."""
    row = rows[0]
    named = zip(row["figures"], row["without"], row["with"], strict=True)
    table = [("processor time, s", row["timings"]["without"], row["timings"]["with"]), *named]
    lines = [f"{'UR10e, ' + row['log']:<32}{'without':>10}{'with 44':>10}{'ratio':>8}"]
    lines += [f"{name:<32}{one:10.4g}{other:10.4g}{other / one:8.2f}" for name, one, other in table]
    lines += [f"constraint that costs most: {row['dearest']}, {row['nats']:.1f} nats", ""]
    lines += [f"{'gap of the lower bound with 44':<32}{'effort':>10}{'cost':>10}{'multiple':>10}{'improved':>10}"]
    for count, share, cost, one, other in _bounds(row):
        lines.append(f"{f'{count} segments decided':<32}{share:>10.1%}{cost:>10.1f}{one:>10.2%}{other:>10.3%}")
    worst = [max(row[key]) for key in ("by_multiple", "improved")]
    return "\n".join([*lines, "", f"largest gap: {worst[0]:.1%} by multiples, {worst[1]:.2%} improved"])


def _bounds(row: Row) -> Iterator[tuple[Any, ...]]:
    keys = ("decided", "share", "cost", "by_multiple", "improved")
    return zip(*(row[key] for key in keys), strict=True)


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Gaps over the segments decided."""
    from bayesid.studies.figures import COLOURS

    axes = figure.subplots()
    for key, label, colour in (
        ("by_multiple", "multiple of the solver's multipliers", COLOURS[1]),
        ("improved", "improved multipliers", COLOURS[0]),
    ):
        axes.plot(rows[0]["decided"], 100.0 * np.array(rows[0][key]), "o-", ms=4, color=colour, label=label)
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
