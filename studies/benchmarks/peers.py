"""Comparison of bayesid with other methods: torque error on another log, feasibility, coverage, seconds.

    python -m bayesid.studies.benchmarks.peers [--parts real,simulated,unsigned] [--data DIR] [--logs ur10e,..]
                                               [--short]

Parts:
    real       the real logs, with their signs: identified from one log, or half of one, and predicted on another
    simulated  the same where the truth is known: coefficients and their 95 % intervals too
    unsigned   the real logs without their signs: sign(velocity), T-PBPR and bayesid

Methods with signs:
    ordinary, weighted   least squares of the base coefficients (IDIM-OLS and -WLS, Gautier 1997)
    weighted + SDP       the feasible robot nearest to the latter, in its metric
    figaroh, mujoco.sysid  by their own interfaces, if installed (extra `bench`)
    bayesid, off and auto  `identify` on the signed log with `complete="off"` and by default

All methods get the same filtered motion, unfiltered efforts, rows (in motion, without both ends) and standard terms.
Errors are those of predicted efforts, compared with the lightly filtered efforts of another log. "x" is the geometric
mean over joints, relative to bayesid by default: above 1 bayesid is better. `feasibility` defines feasible robots.
Prints tables of Markdown for docs/peers.md.
"""

from __future__ import annotations

import argparse
import platform
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

import bayesid
from bayesid.arrays import Array, Mask
from bayesid.effects import STANDARD
from bayesid.errors import SolverError
from bayesid.identification.identification import Identification
from bayesid.identification.options import Completeness
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.posterior.sampler import Sampling
from bayesid.robot import Robot
from bayesid.signs.search.beam import Beam
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import Search
from bayesid.studies.benchmarks.peer_methods import (
    Answer,
    Method,
    Recording,
    feasibility,
    ordinary,
    timed,
    weighted,
    weighted_feasible,
)
from bayesid.studies.benchmarks.peer_packages import installed, packages
from bayesid.studies.complete import half_of, read_part, robot_of
from bayesid.studies.complete_report import geometric_mean
from bayesid.studies.hidden import Case, Simulated, make_case
from bayesid.studies.real import DATA
from bayesid.studies.simulated import STRONG

PAIRS: tuple[tuple[str, str], ...] = (
    *permutations(("ur10e/a_50s", "ur10e/b_20s", "ur10e/c_unloaded"), 2),
    *(
        halves
        for log in ("ur10e/c_loaded", "panda/a", "tx40/a", "kr300/a", "dualarm/a", "lwr4/a")
        for halves in permutations((f"{log}:1", f"{log}:2"), 2)
    ),
)
"""Identified and predicted logs; :1 and :2 are halves."""
OURS, OFF = "bayesid", "bayesid, complete off"
CLASSES = (
    Simulated("peers", "right model", "random"),
    Simulated("peers", "Stribeck friction", "random", ("stribeck_friction",)),
    Simulated("peers", "load-dependent friction", "random", ("load_dependent_friction",)),
    Simulated("peers", "table wrong by 1 mm, 0.1 degrees", "random", length=1e-3, angle=float(np.radians(0.1))),
)
"""Of simulated logs: right model, one missing effect, wrong table."""
_SEEDS = 4
"""Robots of each class."""


# ---------------------------------------------------------------------------------------------------------------
# Logs
# ---------------------------------------------------------------------------------------------------------------
def read(data: Path, name: str) -> tuple[Robot, Log]:
    """A robot and its log, or half of it: robot/log, or robot/log:1."""
    return robot_of(data, name), read_part(data, name)


# ---------------------------------------------------------------------------------------------------------------
# Methods
# ---------------------------------------------------------------------------------------------------------------
def by_bayesid(complete: Completeness) -> Method:
    """`identify` on a log with signs."""

    @timed
    def answer(recording: Recording) -> Answer:
        return _as_answer(identify(recording.robot, recording.log, complete=complete))

    return answer


def _as_answer(result: Identification) -> Answer:
    model, coefficients = result.model, result.coefficients
    interval, effort = np.stack(result.interval_95), result.identified.effort
    return Answer(model, coefficients, result.beta, interval, effort, result.theta, 0.0)


def methods(short: bool) -> dict[str, Method]:
    """All methods for logs with signs, bayesid's last."""
    plain: dict[str, Method] = {
        "ordinary least squares": ordinary,
        "weighted least squares": weighted,
        "weighted + SDP": weighted_feasible,
    }
    others = {} if short else packages()
    return {**plain, **others, OFF: by_bayesid("off"), OURS: by_bayesid("auto")}


# ---------------------------------------------------------------------------------------------------------------
# With signs
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Scored:
    """One method on one log.

    Attributes:
        method: its name.
        log: identified log.
        error: (n,) RMS torque error on the other log, N m; NaN if the method failed.
        seconds: of computing time.
        eigenvalue: smallest eigenvalue of the pseudo-inertias.
        negative: number of negative friction and rotor parameters.
        inside: number of coefficients inside their interval.
        counted: number of coefficients with truth and interval.
        coefficient_error: RMS over the coefficients, relative to the value that alone gives the log's efforts; NaN
            without truth.
        why: reason of a failure.
    """

    method: str
    log: str
    error: Array
    seconds: float = np.nan
    eigenvalue: float = np.nan
    negative: int = 0
    inside: int = 0
    counted: int = 0
    coefficient_error: float = np.nan
    why: str = ""


def score(name: str, method: Method, fitted: Recording, other: Recording, log: str, case: Case | None = None) -> Scored:
    """Identifies one log and predicts another one."""
    try:
        answer = method(fitted)
    except SolverError as error:
        return Scored(name, log, np.full(fitted.robot.n_joints, np.nan), why=str(error))
    eigenvalue, negative = feasibility(answer)
    scored = Scored(name, log, other.error(answer.effort(other.motion)), answer.seconds, eigenvalue, negative)
    return scored if case is None else _with_truth(scored, answer, fitted, case)


def _with_truth(scored: Scored, answer: Answer, fitted: Recording, case: Case) -> Scored:
    """Adds the scores of coefficients and intervals against the truth."""
    _, standard = case.standard(fitted.motion)
    rms = np.sqrt(np.mean(case.log.effort**2, axis=0))
    columns = fitted.model.columns(fitted.motion)[:, :, standard.selected] / rms[:, None]
    size = np.sqrt(np.mean(np.sum(columns**2, axis=1), axis=0) / fitted.robot.n_joints)
    unit = dict(zip(standard.names, 1.0 / size, strict=True))
    truth = case.truth(answer.model, answer.coefficients)
    compared = [k for k, name in enumerate(answer.coefficients.names) if name in unit and np.isfinite(truth[k])]
    relative = [(answer.beta[k] - truth[k]) / unit[answer.coefficients.names[k]] for k in compared]
    low, high = answer.interval[:, compared]
    known = np.isfinite(low) & np.isfinite(high)
    inside = int(np.sum((low <= truth[compared]) & (truth[compared] <= high)))
    error = float(np.sqrt(np.mean(np.square(relative))))
    return replace(scored, inside=inside, counted=int(known.sum()), coefficient_error=error)


def real(data: Path, pairs: Iterable[tuple[str, str]], used: Mapping[str, Method]) -> Iterator[Scored]:
    """Every method on every pair of logs."""
    for name, target in pairs:
        robot, log = read(data, name)
        fitted, other = Recording.of(robot, log), Recording.of(robot, read(data, target)[1])
        for key, method in used.items():
            yield score(key, method, fitted, other, f"{name} -> {target}")


def simulated(classes: Sequence[Simulated], seeds: int, used: Mapping[str, Method]) -> Iterator[Scored]:
    """Every method on the first half of simulated logs; the second half is predicted."""
    for scenario in classes:
        for seed in range(seeds):
            case = make_case(scenario, seed)
            fitted, other = (Recording.of(case.robot, half_of(case.log, which)) for which in (1, 2))
            for key, method in used.items():
                yield score(key, method, fitted, other, scenario.name, case)


# ---------------------------------------------------------------------------------------------------------------
# Without signs
# ---------------------------------------------------------------------------------------------------------------
SignMethod = Callable[[Recording], tuple[Array, Mask, Answer]]
"""Signs (N, n) of a log's samples, where (N, n) they are known, and the result."""


def by_velocity(recording: Recording) -> tuple[Array, Mask, Answer]:
    """The sign of the motor's velocity, then weighted least squares."""
    speed = recording.robot.actuators(recording.motion).dq
    signs = np.where(speed >= 0.0, 1.0, -1.0)
    signed = replace(recording.signals, raw_effort=signs * np.abs(recording.signals.raw_effort))
    return signs, recording.used, weighted(replace(recording, signals=signed))


def by_search(terms: Sequence[str], complete: Completeness, search: Search, posterior: Sampling | bool) -> SignMethod:
    """`identify` on the log without its signs."""

    def answer(recording: Recording) -> tuple[Array, Mask, Answer]:
        found = timed(lambda hidden: _as_answer(results.setdefault(0, run(hidden))))
        results: dict[int, Identification] = {}
        of_log = found(replace(recording, log=recording.log.rectified()))
        return results[0].sample_signs, recording.used, of_log

    def run(hidden: Recording) -> Identification:
        return identify(hidden.robot, hidden.log, terms, complete=complete, search=search, posterior=posterior)

    return answer


def sign_methods() -> dict[str, SignMethod]:
    """Methods that find signs: sign(velocity), T-PBPR as in the paper and with our terms, bayesid."""
    tree = Beam(width=5, initial_segments=5)
    return {
        "sign(velocity), weighted": by_velocity,
        "T-PBPR as in the paper (rigid bodies)": by_search(("rigid_body",), "off", tree, False),
        "T-PBPR with our terms": by_search(STANDARD, "off", tree, False),
        OURS: by_search(STANDARD, "auto", Certified(), True),
    }


def unsigned(data: Path, pairs: Iterable[tuple[str, str]]) -> Iterator[tuple[Scored, float]]:
    """Torque errors on another signed log, and shares of right signs."""
    for name, target in pairs:
        robot, log = read(data, name)
        fitted, other = Recording.of(robot, log), Recording.of(robot, read(data, target)[1])
        for key, method in sign_methods().items():
            signs, _, answer = method(fitted)
            error = other.error(answer.effort(other.motion))
            yield Scored(key, f"{name} -> {target}", error, answer.seconds), right_share(fitted, signs)


def right_share(recording: Recording, signs: Array) -> float:
    """Share of the samples in motion with at least 5 % of their joint's largest |effort| whose sign (N, n) is right."""
    effort = recording.signals.raw_effort
    strong = recording.used & (np.abs(effort) >= STRONG * np.abs(effort).max(axis=0))
    return float((signs == np.sign(effort))[strong].mean())


# ---------------------------------------------------------------------------------------------------------------
# Tables
# ---------------------------------------------------------------------------------------------------------------
def times_ours(rows: Sequence[Scored], method: str) -> float:
    """Geometric mean over logs and joints of a method's torque error over bayesid's; NaN if it always failed."""
    ours = {row.log: row.error for row in rows if row.method == OURS}
    ratios = [row.error / ours[row.log] for row in rows if row.method == method and not row.why]
    return geometric_mean(np.concatenate(ratios)) if ratios else float("nan")


def _table(head: Sequence[str], lines: Iterable[Sequence[object]]) -> str:
    return "\n".join(f"| {' | '.join(map(str, cells))} |" for cells in [head, ["---"] * len(head), *lines]) + "\n"


def _names(rows: Sequence[Scored]) -> list[str]:
    return list(dict.fromkeys(row.method for row in rows))


def by_robot(rows: Sequence[Scored]) -> str:
    """Every method's torque error over bayesid's, by robot, and the ratio to the best other method."""
    robots = list(dict.fromkeys(row.log.partition("/")[0] for row in rows))
    chosen = {robot: [row for row in rows if row.log.startswith(f"{robot}/")] for robot in robots}
    lines: list[list[object]] = []
    for name in _names(rows):
        ratios = [times_ours(chosen[robot], name) for robot in robots]
        seconds = [row.seconds for row in rows if row.method == name and not row.why]
        median = f"{np.median(seconds):.1f}" if seconds else "-"
        lines.append([name, *(f"{ratio:.2f}" if np.isfinite(ratio) else "-" for ratio in ratios), median])
    peers = [name for name in _names(rows) if not name.startswith(OURS)]
    best = [1.0 / np.nanmin([times_ours(chosen[robot], name) for name in peers]) for robot in robots]
    lines.append(["**bayesid over the best of the others**", *(f"**{ratio:.2f}**" for ratio in best), ""])
    return _table(["torque error on another log, x bayesid's", *robots, "median s"], lines)


def by_log(rows: Sequence[Scored]) -> str:
    """Every method on every log: error by joint, feasibility, seconds."""
    lines: list[list[object]] = []
    for row in rows:
        pair = [other for other in rows if other.log == row.log]
        joints = " ".join(f"{value:.3g}" for value in row.error)
        if row.why:
            lines.append([row.log, row.method, "-", f"failed: {row.why}", "-", "-", "-"])
            continue
        links = f"{row.eigenvalue:.1e}"
        ratio = f"{times_ours(pair, row.method):.2f}"
        lines.append([row.log, row.method, ratio, joints, links, row.negative, f"{row.seconds:.1f}"])
    head = ["log -> predicted", "method", "x", "error by joint, N m", "least eigenvalue", "negative", "s"]
    return _table(head, lines)


def by_class(rows: Sequence[Scored]) -> str:
    """Simulated logs: errors and intervals."""
    lines: list[list[object]] = []
    for kind in dict.fromkeys(row.log for row in rows):
        of_kind = [row for row in rows if row.log == kind]
        for name in _names(of_kind):
            chosen = [row for row in of_kind if row.method == name and not row.why]
            if not chosen:
                continue
            counted = sum(row.counted for row in chosen)
            coverage = f"{sum(row.inside for row in chosen) / counted:.1%}" if counted else "none"
            error = geometric_mean([row.coefficient_error for row in chosen])
            ours = geometric_mean([row.coefficient_error for row in of_kind if row.method == OURS])
            torque = geometric_mean(np.concatenate([row.error for row in chosen]))
            of_ours = geometric_mean(np.concatenate([row.error for row in of_kind if row.method == OURS]))
            feasible = sum(row.eigenvalue >= -1e-6 and not row.negative for row in chosen)
            cells = [f"{torque / of_ours:.2f}", f"{error / ours:.2f}", coverage, f"{feasible} of {len(chosen)}"]
            lines.append([kind, name, *cells, f"{np.median([row.seconds for row in chosen]):.1f}"])
    head = ["simulated", "method", "torque error, x", "coefficients' error, x", "in 95 % interval", "feasible", "s"]
    return _table(head, lines)


def by_sign(rows: Sequence[tuple[Scored, float]]) -> str:
    """Logs without signs: right signs, and torque errors."""
    scored = [row for row, _ in rows]
    lines = []
    for row, right in rows:
        ratio = times_ours([other for other in scored if other.log == row.log], row.method)
        lines.append([row.log, row.method, f"{right:.2%}", f"{ratio:.2f}", f"{row.seconds:.1f}"])
    return _table(["log without signs -> predicted", "method", "right signs", "torque error, x", "s"], lines)


def versions() -> str:
    """Versions of the packages."""
    names = ("figaroh", "mujoco.sysid", "numpy", "scipy", "cvxpy", "clarabel")
    others = ", ".join(f"{name} {installed(name) or 'not installed'}" for name in names)
    return f"bayesid {bayesid.__version__}, {others}, Python {platform.python_version()}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description="Comparison of bayesid with other methods.")
    parser.add_argument("--parts", default="real,simulated,unsigned")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the real logs")
    parser.add_argument("--logs", default="", help="robots of the real logs, all by default")
    parser.add_argument("--short", action="store_true", help="one simulated log, without other packages")
    options = parser.parse_args(arguments)
    robots = options.logs.split(",") if options.logs else [pair[0].partition("/")[0] for pair in PAIRS]
    with_real = options.data.is_dir() and not options.short
    pairs = [pair for pair in PAIRS if with_real and pair[0].partition("/")[0] in robots]
    parts = options.parts.split(",")
    print(versions(), flush=True)
    with threadpool_limits(1):
        if pairs and "real" in parts:
            rows = list(real(options.data, pairs, methods(False)))
            print(by_robot(rows), by_log(rows), sep="\n", flush=True)
        if "simulated" in parts:
            classes, seeds = (CLASSES[1:2], 1) if options.short else (CLASSES, _SEEDS)
            print(by_class(list(simulated(classes, seeds, methods(options.short)))), flush=True)
        if pairs and "unsigned" in parts:
            print(by_sign(list(unsigned(options.data, pairs))), flush=True)
    if not with_real and not options.short:
        print(f"no real logs in {options.data}; set BAYESID_DATA")


if __name__ == "__main__":
    main()
