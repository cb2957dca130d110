"""The search for signs, compared with other methods and with targets: seconds, costs, certificates, memory.

    python -m bayesid.studies.benchmarks.search [--parts best,logs,kr5,scip,pbpr,scaling,memory] [--seeds 50] [--short]
                                       [--data DIR]

Parts:
    best     the best assignment against T-PBPR with every node solved through cvxpy
    logs     every log of `studies.real` and one run of the paper's experiment: the best assignment, a beam of width 50,
             the certificate, and the share of samples in motion whose signs it determines
    kr5      certificates of the paper's experiment over many seeds
    scip     the sign problem without the cone against SCIP (needs pyscipopt, in the extra `bench`); SCIP proves only
             the optimum, the certified search also lists all assignments near it
    pbpr     against T-PBPR with PBPR in its nodes, on two joints
    scaling  simulated logs of 40 to 3000 unknown segments
    memory   an hour at 1 kHz that is never stored

A sign problem is that of the pipeline's last search. Every search starts from scratch, on one thread. Times under two
seconds are the median of three. Times depend on the machine: compare ratios. The last lines list all targets, met or
missed.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from bayesid.identification.identification import Identification
from bayesid.log.log import Log
from bayesid.log.segments import find_segments
from bayesid.log.signals import prepare
from bayesid.robot import load_robot
from bayesid.signs.search.beam import beam, flip_joints
from bayesid.signs.search.protocol import SearchResult
from bayesid.studies.benchmarks.memory import hour_in_new_process
from bayesid.studies.benchmarks.nodes_through_cvxpy import tree_through_cvxpy
from bayesid.studies.benchmarks.problems import (
    SAME,
    Check,
    LogProblem,
    Searched,
    Table,
    arm_problem,
    cut,
    kr5_problem,
    long_log,
    real_problem,
    simulated_problem,
    timed,
)
from bayesid.studies.benchmarks.scip import against_scip, scip_installed
from bayesid.studies.pbpr import AnnealedLeastSquares, Annealing, feasible_inertia, make_bounds, total_mass
from bayesid.studies.real import DATA, LOGS
from bayesid.studies.record import Row
from bayesid.studies.simulated import STRONG

_QUICK = Annealing(runs=4, evaluations=20, growth=1e4)
"""Sufficient for two joints (docs/pbpr.md)."""
_SCIP_SECONDS = 60.0
"""Time limit of SCIP for each formulation of a problem, s."""
_SIZES = (40, 100, 300, 1000, 3000)
"""Segments of the simulated logs."""
_LONGEST = 400.0
"""s, of the simulated log: long enough for the largest of these sizes."""


@dataclass(frozen=True)
class Scale:
    """Size of the benchmark.

    Attributes:
        data: folder of the real logs.
        seeds: number of runs of the paper's experiment.
        short: whether to use fewer and shorter logs, for continuous integration.
    """

    data: Path
    seeds: int
    short: bool

    @property
    def logs(self) -> tuple[str, ...]:
        """Available real logs."""
        names = ("ur10e/b_20s",) if self.short else LOGS
        return tuple(name for name in names if (self.data / f"{name}.csv").is_file())

    @property
    def wide(self) -> int:
        """Width of the beam that the best assignments are compared with."""
        return 10 if self.short else 50


# ---------------------------------------------------------------------------------------------------------------
# best: against T-PBPR through cvxpy
# ---------------------------------------------------------------------------------------------------------------
def best(scale: Scale) -> list[Check]:
    """The best assignment against a plain implementation of T-PBPR."""
    problem = (real_problem(scale.data, scale.logs[0]) if scale.logs else kr5_problem()[1]).problem
    problem = problem.first(60) if scale.short else problem
    ours, seconds = timed(problem.best)
    (_, cost, nodes), theirs = timed(lambda: tree_through_cvxpy(problem))
    print(f"{problem.name}, {problem.unknown} segments: best assignment {seconds:.3f} s, cost {ours.cost:.3f};")
    print(f"T-PBPR (w = 5, s0 = 5) through cvxpy {theirs:.1f} s for {nodes} nodes, cost {cost:.3f}")
    ratio = theirs / seconds
    return [
        Check("best: faster than T-PBPR through cvxpy", f"{ratio:.0f} x", ">= 100 x", ratio >= 100.0),
        Check("best: cost minus T-PBPR's", *_excess((ours.cost - cost) / problem.energy)),
    ]


def _excess(share: float) -> tuple[str, str, bool]:
    """Value, target, and whether it is met, of a difference of costs as a share of the energy."""
    return f"{share:+.1e} of the energy", f"<= {SAME:g}", share <= SAME


# ---------------------------------------------------------------------------------------------------------------
# logs
# ---------------------------------------------------------------------------------------------------------------
def logs(scale: Scale) -> list[Check]:
    """Every log: best assignment, beam, certificate."""
    table = Table(
        "log",
        "segments",
        "best s",
        f"excess over beam {scale.wide}",
        "beam s",
        "proof s",
        "certified",
        "branches",
        "missed",
        "nodes",
        "sdps",
        "determined %",
        "of scored %",
        "pipeline again",
    )
    rows = [_log_row(table, real_problem(scale.data, name), scale.wide) for name in scale.logs]
    rows.append(_log_row(table, kr5_problem()[1], scale.wide))
    determined = min(row["scored"] for row in rows)
    return [
        _slowest("logs: slowest best assignment", [row["best_seconds"] for row in rows], 1.0),
        Check(f"logs: worst cost minus the beam's at w = {scale.wide}", *_excess(max(row["excess"] for row in rows))),
        _slowest("logs: slowest certified search", [row["proof_seconds"] for row in rows], 5.0),
        _all("logs: certified", [row["certified"] for row in rows]),
        Check(
            "logs: least share of scored samples determined", f"{100 * determined:.2f} %", ">= 97 %", determined >= 0.97
        ),
        _all("logs: the pipeline's own cost reproduced", [abs(row["again"]) <= 1e-9 for row in rows]),
    ]


def _log_row(table: Table, searched: Searched, width: int) -> Row:
    problem = searched.problem
    best, best_seconds = timed(problem.best)
    wide, wide_seconds = timed(lambda: _beam(problem, width))
    proof, proof_seconds = timed(problem.proof)
    determined, scored = _determined(searched.result, proof)
    excess = (best.cost - wide.cost) / problem.energy
    again = (searched.repeated().cost - searched.result.search.cost) / problem.energy
    table.row(
        problem.name,
        problem.unknown,
        best_seconds,
        excess,
        wide_seconds,
        proof_seconds,
        *_work(proof),
        100.0 * determined,
        100.0 * scored,
        again,
    )
    return {
        "best_seconds": best_seconds,
        "excess": excess,
        "proof_seconds": proof_seconds,
        "certified": proof.certified,
        "scored": scored,
        "again": again,
    }


def _work(proof: SearchResult) -> tuple[object, ...]:
    return proof.certified, len(proof.branches), proof.missed, proof.nodes, proof.solves


def _beam(problem: LogProblem, width: int) -> SearchResult:
    solver = problem.solver()
    return flip_joints(problem.normal_equations, solver, beam(problem.normal_equations, solver, width))


def _determined(result: Identification, proof: SearchResult) -> tuple[float, float]:
    """Shares of samples in motion whose sign the proof determines: of all, and of those above 5 % of their joint."""
    effort, segments = np.abs(result.signals.raw_effort), result.searched
    if proof.persistent is None:
        return 0.0, 0.0
    moving = segments.per_sample(np.ones(len(segments)), *effort.shape) > 0
    persistent = segments.per_sample(proof.persistent, *effort.shape) > 0
    strong = moving & (effort >= STRONG * effort.max(axis=0))
    return float(persistent[moving].mean()), float(persistent[strong].mean())


def _slowest(what: str, seconds: list[float], limit: float) -> Check:
    return Check(what, f"{max(seconds):.3f} s", f"<= {limit:g} s", max(seconds) <= limit)


def _all(what: str, passed: list[bool]) -> Check:
    return Check(what, f"{sum(passed)} of {len(passed)}", "all", all(passed))


# ---------------------------------------------------------------------------------------------------------------
# kr5
# ---------------------------------------------------------------------------------------------------------------
def kr5(scale: Scale) -> list[Check]:
    """The paper's experiment over many seeds."""
    rows = [_kr5_row(seed) for seed in range(min(scale.seeds, 5) if scale.short else scale.seeds)]
    seconds = [row["seconds"] for row in rows]
    worst = rows[int(np.argmax(seconds))]
    print(f"{len(rows)} seeds: certified search median {np.median(seconds):.3f} s")
    print(
        f"slowest: seed {worst['seed']}, {worst['segments']} segments, {worst['nodes']} nodes, {worst['solves']} sdps"
    )
    for row in rows:
        if row["wrong"] or not row["certified"]:
            print(f"seed {row['seed']}: {row['wrong']} strong segments wrong, certified {row['certified']}")
    return [
        _all("kr5: certified", [row["certified"] for row in rows]),
        _slowest("kr5: slowest certified search", seconds, 5.0),
        _all("kr5: every segment above 5 % right", [row["wrong"] == 0 for row in rows]),
    ]


def _kr5_row(seed: int) -> Row:
    experiment, searched = kr5_problem(seed)
    proof, seconds = timed(searched.problem.proof)
    return {
        "seed": seed,
        "segments": searched.problem.unknown,
        "wrong": experiment.wrong,
        "certified": proof.certified and experiment.result.search.certified,
        "seconds": seconds,
        "nodes": proof.nodes,
        "solves": proof.solves,
    }


# ---------------------------------------------------------------------------------------------------------------
# scip
# ---------------------------------------------------------------------------------------------------------------
def scip(scale: Scale) -> list[Check]:
    """The sign problem without the cone."""
    if not scip_installed():
        print("not run: pyscipopt is missing; pip install 'bayesid[bench]'")
        return []
    simulated = simulated_problem(long_log(20.0)).problem
    problems = [simulated.first(count) for count in ((12, 20) if scale.short else (12, 20, 30, 40, 60))]
    if not scale.short:
        real = (real_problem(scale.data, name).problem for name in scale.logs[:2])
        problems += [simulated, kr5_problem()[1].problem, *real]
    return against_scip(problems, 10.0 if scale.short else _SCIP_SECONDS)


# ---------------------------------------------------------------------------------------------------------------
# pbpr
# ---------------------------------------------------------------------------------------------------------------
def pbpr(scale: Scale) -> list[Check]:
    """Against annealing in every node, on an arm of two joints."""
    problem = arm_problem()
    bounds = make_bounds(problem.model, mass=20.0, reach=0.4)
    constraints = (feasible_inertia(), total_mass(10.0, 30.0))
    cone, coefficients = problem.model.cone, problem.coefficients
    solver = AnnealedLeastSquares(cone, coefficients, bounds, problem.energy, constraints, _QUICK)
    ours, seconds = timed(problem.best)
    width, initial = (1, 2) if scale.short else (5, 5)
    theirs, slow = timed(lambda: beam(problem.normal_equations, solver, width, initial))
    same = np.array_equal(ours.signs, theirs.signs)
    print(f"two joints, {problem.unknown} segments: best assignment {seconds:.3f} s, cost {ours.cost:.3f};")
    print(f"T-PBPR (w = {width}, s0 = {initial}) with PBPR in its nodes {slow:.1f} s, {theirs.solves} nodes solved;")
    print(f"{'the same' if same else 'other'} signs, {slow / seconds:.0f} x slower (no target)")
    return []


# ---------------------------------------------------------------------------------------------------------------
# scaling
# ---------------------------------------------------------------------------------------------------------------
def scaling(scale: Scale) -> list[Check]:
    """One simulated log, cut to different lengths."""
    log = long_log(60.0 if scale.short else _LONGEST)
    signals = prepare(log)
    segments = find_segments(signals, load_robot("ur10e").actuators(signals.motion))
    begins = np.sort(segments.start[segments.moving])
    table = Table("log s", "segments", "best s", "proof s", "certified", "branches", "missed", "nodes", "sdps")
    sizes = [size for size in _SIZES if size < len(begins)]
    rows = [_size_row(table, cut(log, int(begins[size]))) for size in sizes]
    logarithm = np.log([[row[key] for key in ("segments", "best_seconds", "proof_seconds")] for row in rows])
    exponents = np.polyfit(logarithm[:, 0], logarithm[:, 1:], 1)[0]
    print(
        f"seconds grow with the number of segments to the power {exponents[0]:.2f} (best), {exponents[1]:.2f} (proof)"
    )
    checks = [_all("scaling: certified", [row["certified"] for row in rows])]
    for size, row in zip(sizes, rows, strict=True):
        if size == 1000:
            checks.append(_slowest(f"scaling: certified search of {row['segments']}", [row["proof_seconds"]], 30.0))
    return checks


def _size_row(table: Table, log: Log) -> Row:
    problem = simulated_problem(log).problem
    _, best_seconds = timed(problem.best)
    proof, proof_seconds = timed(problem.proof)
    table.row(f"{log.t[-1]:.1f}", problem.unknown, best_seconds, proof_seconds, *_work(proof))
    return {
        "segments": problem.unknown,
        "best_seconds": best_seconds,
        "proof_seconds": proof_seconds,
        "certified": proof.certified,
    }


# ---------------------------------------------------------------------------------------------------------------
# memory
# ---------------------------------------------------------------------------------------------------------------
def memory(scale: Scale) -> list[Check]:
    """An hour at 1 kHz."""
    row = hour_in_new_process(60.0 if scale.short else 3600.0)
    speed, peak = row["samples"] / row["normal_equations_seconds"], row["peak"] / 1e9
    print(f"{row['samples']} time steps, {row['segments']} segments, {row['separate']} with a separate Hessian;")
    print(f"best assignment {row['best_seconds']:.2f} s, certified search {row['seconds']:.2f} s,")
    print(f"certified: {row['certified']}, the bound {100 * row['gap']:.4f} % below the cost;")
    print(f"signs right for {100 * row['right']:.3f} % of the samples")
    return [
        Check("memory: normal equations", f"{speed:,.0f} steps/s", ">= 50,000 steps/s", speed >= 50_000),
        Check(
            "memory: the bound below the cost, as a share", f"{100 * row['gap']:.4f} %", "<= 0.1 %", row["gap"] <= 1e-3
        ),
        Check("memory: certified search", f"{row['seconds']:.0f} s", "<= 60 s", row["seconds"] <= 60.0),
        Check("memory: peak of the process", f"{peak:.2f} GB", "<= 1.5 GB", peak <= 1.5),
    ]


PARTS: dict[str, Callable[[Scale], list[Check]]] = {
    "best": best,
    "logs": logs,
    "kr5": kr5,
    "scip": scip,
    "pbpr": pbpr,
    "scaling": scaling,
    "memory": memory,
}


@threadpool_limits.wrap(limits=1, user_api="blas")
def main() -> None:
    """Prints every part, then all targets."""
    parser = argparse.ArgumentParser(description="The search for signs, compared with other methods and targets.")
    parser.add_argument("--parts", default=",".join(PARTS), help=f"of {', '.join(PARTS)}")
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--short", action="store_true", help="a few minutes, for continuous integration")
    parser.add_argument("--data", type=Path, default=DATA)
    options = parser.parse_args()
    chosen = options.parts.split(",")
    unknown = [part for part in chosen if part not in PARTS]
    if unknown:
        parser.error(f"unknown part {', '.join(unknown)}; choose from {', '.join(PARTS)}")
    scale = Scale(options.data, options.seeds, options.short)
    if not scale.logs:
        print(f"no real logs in {options.data} (set BAYESID_DATA): simulated ones only\n")
    checks = []
    for part in chosen:
        began = time.perf_counter()
        print(f"== {part}", flush=True)
        checks += PARTS[part](scale)
        print(f"({time.perf_counter() - began:.0f} s)\n", flush=True)
    for check in checks:
        print(check)


if __name__ == "__main__":
    main()
