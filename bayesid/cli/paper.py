"""`bayesid demo --paper`: the experiment of Gaz and De Luca as published, Algorithm 1 on a simulated KR5 Sixx.

Positions are sums of sines, slow enough for about as many segments as the paper's 39. |effort| is filtered. In each
joint the smallest samples are dropped, the same share as in the paper (2577 of 4002 are kept). A segment is a run of
kept samples. Rows are weighted by 1 / (5 % of the joint's RMS effort). One tree decides the signs, and least squares in
the cone gives the coefficients. All other parts of bayesid are off: cuts at minima or reversals, further search rounds,
smoothing, model selection, proof and posterior.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from rich.console import RenderableType

from bayesid.arrays import Array, Integers
from bayesid.cli.bars import stages
from bayesid.cli.options import check_new, command_line, finish
from bayesid.cli.terminal import table
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.files.writing import save_table
from bayesid.identification.checks import Check, State
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify_with
from bayesid.log.log import Log
from bayesid.log.segments import Segments
from bayesid.log.signals import Signals, prepare
from bayesid.number_text import percent
from bayesid.parallel import one_blas_thread
from bayesid.progress import SILENT, Progress, Steps, no_steps
from bayesid.regression.least_squares import constant_stretches
from bayesid.regression.normal_equations import NormalEquations, normal_equations
from bayesid.report.conclusion import conclude
from bayesid.report.folders import IDENTIFICATION_FILES, collect_incomplete, save_identification
from bayesid.report.result_files import MARKER
from bayesid.signs.rounds import SegmentSigns
from bayesid.signs.search.algorithm1 import Node, algorithm1
from bayesid.signs.search.beam import Beam
from bayesid.signs.search.protocol import SearchResult, SignProblem
from bayesid.signs.tuning import TUNING
from bayesid.simulation.logs import simulate
from bayesid.simulation.paper import TABLE_II, nominal_parameters, paper_model
from bayesid.simulation.trajectories import MotionLimits, random_trajectory

SAMPLES = 667
"""Of each joint, as in the paper."""
DURATION = 13.33
"""s, as there."""
NOISE = 0.05
"""Standard deviation relative to each joint's RMS effort, as in the demo."""
LEFT = 2577 / 4002
"""Share of the samples that the paper's thresholds leave."""
SEGMENTS = 35, 45
"""About as many as the paper's 39."""
KNOWN = 0.25
"""Relative standard deviation up to which the paper calls a coefficient known."""
SEARCH = Beam(width=5, initial_segments=5)
"""s0 and w of the paper."""
_KNOWN_IN_PAPER = 27
"""Coefficients that the paper knows to 25 %. One has the nominal value 0, which has no relative standard deviation."""
_VERDICTS: Mapping[State, str] = {
    "good": "All signs are right, as in the paper",
    "look": "All signs are right, but fewer coefficients are known than in the paper",
    "bad": "This run does not reproduce the paper",
}
_NO_CONFIDENCES = "Algorithm 1 gives no proof and no confidences, which the report checks; `bayesid demo` has both"
_SLOW = MotionLimits(velocity=2.0, acceleration=8.0)
_SINES = 3
"""Sines and cosines a joint. Within these limits two fifths of random motions have the paper's number of segments."""
_MOTIONS = 40
"""Random motions; of those with that number of segments the one is taken that leaves the coefficients the least sum of
variances (A-optimal)."""


@dataclass(frozen=True)
class LetterExperiment:
    """One run of the paper's experiment to the letter."""

    segments: Segments  #: S segments over the samples that are left
    truth: Integers  #: (S,) their true signs
    search: SearchResult  #: Algorithm 1
    nodes: tuple[Node, ...]  #: of its tree
    identification: Identification  #: by least squares in the cone, with these signs

    @property
    def wrong(self) -> int:
        """Segments with the wrong sign."""
        return int(np.sum(self.search.signs != self.truth))

    @property
    def expected_nodes(self) -> int:
        """2^s0 + 2 w (S - s0)."""
        return int(2**SEARCH.initial_segments + 2 * SEARCH.width * (len(self.segments) - SEARCH.initial_segments))

    @cached_property
    def table(self) -> tuple[Array, Array]:
        """(27,) estimates of Table II, and their standard deviations."""
        return table_rows(self.identification)

    @property
    def known(self) -> int:
        """Coefficients of Table II that are known to 25 %."""
        estimates, sd = self.table
        return int(np.sum(sd < KNOWN * np.abs(estimates)))

    @property
    def true_branch(self) -> list[Node]:
        """The nodes whose signs are all right, from the root on, as far as the tree holds them."""
        right, branch = {0}, list[Node]()
        for node in self.nodes:
            if node.parent in right and all(self.truth[k] == s for k, s in zip(node.segments, node.signs, strict=True)):
                right.add(node.number)
                branch.append(node)
        return branch


@one_blas_thread
def run_to_the_letter(seed: int = 0, *, progress: Progress = SILENT) -> LetterExperiment:
    """New trajectory, new noise, and Algorithm 1.

    Args:
        seed: of trajectory and noise.
        progress: of long stages.

    Raises:
        SolverError: an optimisation failed.
    """
    model, theta = paper_model(), nominal_parameters()
    coefficients = base_coefficients(model)
    with progress.stage("trajectory") as steps:
        log, signals, segments, raw = _recorded(model, coefficients, theta, seed, steps)
    sigma = TUNING.first_noise * raw.rms_effort(model.robot.n_joints)
    problem = SignProblem(raw.scaled(sigma), model.cone, coefficients)
    width, initial = SEARCH.width, SEARCH.initial_segments
    with progress.stage("Algorithm 1") as steps:
        search, nodes = algorithm1(problem, width, initial, steps=steps)
    searched = SegmentSigns(segments, search, rounds=1, unresolved=0, weights=sigma, near=search.branches)
    identification = identify_with(model, log, signals, searched, SEARCH, progress)
    truth = np.where(segments.sums(model.effort(signals.motion, theta)) >= 0.0, 1, -1)
    return LetterExperiment(segments, truth, search, nodes, identification)


class _Recorded(NamedTuple):
    log: Log  # of |effort|
    signals: Signals  # filtered
    segments: Segments
    normal_equations: NormalEquations  # of the segments


def _recorded(
    model: Model, coefficients: BaseCoefficients, theta: Array, seed: int, steps: Steps = no_steps
) -> _Recorded:
    """Of random motions with about the paper's number of segments the one that shows most, as it would be logged."""
    t, n = np.linspace(0.0, DURATION, SAMPLES), model.robot.n_joints
    found, tried = list[tuple[float, _Recorded]](), 0
    while not found or tried < _MOTIONS:
        number = int(np.random.default_rng([seed, tried]).integers(2**32))
        motion = random_trajectory(n, DURATION, rng=number, limits=_SLOW, harmonics=_SINES).motion(t)
        log = simulate(model, theta, motion, rng=np.random.default_rng(number), noise=NOISE)
        signals = prepare(log)
        segments = _segments(signals)
        if SEGMENTS[0] <= len(segments) <= SEGMENTS[1]:
            raw = normal_equations(model, coefficients, signals.motion, signals.effort, segments)
            gram = raw.scaled(raw.rms_effort(n)).hessian.total()
            found.append((float(np.trace(np.linalg.inv(gram))), _Recorded(log, signals, segments, raw)))
        tried += 1
        steps(min(tried, _MOTIONS), _MOTIONS)
    return min(found, key=itemgetter(0))[1]


def _segments(signals: Signals) -> Segments:
    """Runs of samples above their joint's threshold."""
    kept = signals.effort >= np.quantile(signals.effort, 1.0 - LEFT, axis=0)
    runs = constant_stretches(kept)
    return replace(runs, known=np.zeros(len(runs), dtype=np.int64))


def letter_command(options: argparse.Namespace) -> None:
    """Runs the experiment, writes its result folder with all nodes of the tree, and prints a summary."""
    if options.search != "beam" and "--search" in options.given:
        raise InputError("--paper runs the paper's search", "--search", "leave it out, or give --search beam")
    folder = check_new(options, options.out, IDENTIFICATION_FILES, MARKER)
    with stages(options) as progress, collect_incomplete() as incomplete:
        experiment = run_to_the_letter(options.seed, progress=progress)
        run_by = replace(experiment.identification.provenance, command=command_line())
        result = replace(experiment.identification, provenance=run_by)
        save_identification(result, folder, with_log=True, progress=progress)
        save_table(folder / "nodes.csv", node_rows(experiment.nodes))
    conclusion = conclude(_checks(experiment), _VERDICTS)
    finish(
        options,
        *_lines(experiment),
        coefficient_table(*experiment.table),
        f"{len(result.coefficients)} coefficients in total, see coefficients.csv",
        conclusion=conclusion,
        last=f"{_NO_CONFIDENCES}; open {folder}/report.html; all nodes: {folder}/nodes.csv",
        warnings=result.warnings,
        incomplete=incomplete,
    )


def _checks(experiment: LetterExperiment) -> list[Check]:
    count, known = len(experiment.segments), experiment.known
    right, nodes, enough = count - experiment.wrong, len(experiment.nodes), known >= _KNOWN_IN_PAPER - 1
    return [
        Check("Signs", "bad" if experiment.wrong else "good", f"{right} of {count} segments have the right sign"),
        Check("Nodes", "good" if nodes == experiment.expected_nodes else "bad", f"{nodes} nodes"),
        Check("Coefficients", "good" if enough else "look", f"{known} are known to {percent(KNOWN, 0)}"),
    ]


def table_rows(result: Identification) -> tuple[Array, Array]:
    """(27,) a result's estimates of Table II, and (27,) their standard deviations."""
    rows = np.array([row.row for row in TABLE_II]) @ np.linalg.pinv(result.coefficients.projection)
    return rows @ result.beta, np.sqrt(np.einsum("ir,rs,is->i", rows, result.covariance, rows))


def coefficient_table(estimates: Array, sds: Array) -> RenderableType:
    """Table II: nominal values, the paper's estimates, and ours (27,) with their standard deviations."""
    rows = []
    for row, estimate, sd in zip(TABLE_II, estimates, sds, strict=True):
        values = (f"{value:.4f}" for value in (row.nominal, row.published, estimate, sd))
        relative = percent(sd / abs(row.nominal), 1) if row.nominal else "-"
        rows.append([str(row.number), row.expression, *values, row.unit, relative])
    headings = ["#", "coefficient", "nominal", "paper", "estimate", "sd", "unit", "relative sd"]
    return table(headings, rows, left=["coefficient", "unit"])


def node_rows(nodes: Sequence[Node]) -> list[dict[str, object]]:
    """nodes.csv: one row per node, in the order of the search."""
    return [
        {
            "depth": node.depth,
            "node": node.number,
            "parent": node.parent,
            "signs": "".join("+" if sign > 0 else "-" for sign in node.signs),
            "ols_cost": node.ols_cost,
            "cone_cost": node.cone_cost,
            "feasible": int(node.feasible),
            "lmi_margin": node.min_eigenvalue,
            "fate": node.fate,
        }
        for node in nodes
    ]


def _lines(experiment: LetterExperiment) -> list[str]:
    count, kept = len(experiment.segments), int((experiment.segments.end - experiment.segments.start).sum())
    branch, known = experiment.true_branch, experiment.known
    infeasible = [node.depth for node in branch if not node.feasible]
    depths = len({node.depth for node in experiment.nodes})
    s0, w = SEARCH.initial_segments, SEARCH.width
    return [
        f"KUKA KR5 Sixx: {DURATION} s, {SAMPLES} samples per joint, noise {percent(NOISE, 0)}, signs removed",
        f"samples above the thresholds: {kept} of {experiment.identification.log.effort.size} (paper: 2577 of 4002)",
        f"segments: {count} (paper: 39)",
        f"nodes: {len(experiment.nodes)} = 2^{s0} + {2 * w} ({count} - {s0}) (paper: {2**s0 + 2 * w * (39 - s0)})",
        f"signs: {count - experiment.wrong} of {count} right (paper: all)",
        f"coefficients of Table II known to {percent(KNOWN, 0)}: {known} (paper: {_KNOWN_IN_PAPER}; one of them is zero"
        " here)",
        f"depths at which least squares with the right signs is infeasible: {len(infeasible)} of {depths}",
        "",
    ]
