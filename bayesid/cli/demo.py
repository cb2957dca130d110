"""Commands on simulated logs: `bayesid demo`, `bayesid simulate` and `bayesid study`.

The demo is the paper's experiment: KR5 Sixx, 13.33 s of |effort| with 5 % noise: signs, Table II, new torques.
"""

from __future__ import annotations

import argparse
import shlex
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayesid.arrays import Array
from bayesid.cli.bars import counts, stages
from bayesid.cli.options import check_file, check_new, check_taken, command_line, finish, given_robot, robot_of
from bayesid.cli.paper import DURATION, NOISE, SAMPLES, coefficient_table, letter_command, table_rows
from bayesid.effects.coefficients import base_coefficients
from bayesid.errors import InputError
from bayesid.identification.checks import State
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.number_text import percent
from bayesid.posterior.sampler import Sampling
from bayesid.progress import SILENT, Progress
from bayesid.regression.knowledge import ParameterPrior
from bayesid.regression.noise import relative_rms
from bayesid.report.conclusion import Conclusion, conclude, sentence
from bayesid.report.folders import IDENTIFICATION_FILES, collect_incomplete, save_identification
from bayesid.report.grading import unsaid
from bayesid.report.report_data import report_data
from bayesid.report.result_files import MARKER
from bayesid.report.verdicts import check_findings
from bayesid.report.words import counted
from bayesid.signs.search.beam import Beam
from bayesid.signs.search.certified import Certified
from bayesid.signs.search.protocol import Search
from bayesid.simulation.logs import parse_effect, simulate, simulate_log
from bayesid.simulation.paper import nominal_parameters, paper_model
from bayesid.simulation.trajectories import exciting_trajectory, random_trajectory

STRONG = 0.05
"""Share of its joint's maximum that a sample's |effort| must reach to count, as in the scores of docs/studies.md."""


@dataclass(frozen=True)
class Experiment:
    """One run of the paper's experiment."""

    log: Log  #: the simulated log of |effort|
    result: Identification  #: what was identified from it
    true_signs: Array  #: (S,) sign of each segment's largest noise-free effort
    strong: Array  #: (S,) whether the segment holds a sample of at least 5 % of its joint's maximum
    estimates: Array  #: (27,) of Table II
    sd: Array  #: (27,) their standard deviations
    torque_error: Array  #: (n,) relative RMS error of Newton-Euler on a new trajectory, with the feasible parameters
    new_log: Log  #: of that trajectory, with the same noise, and signs

    @property
    def wrong(self) -> int:
        """Strong segments with the wrong sign."""
        return int(np.sum((self.result.signs != self.true_signs) & self.strong))


def run_experiment(
    seed: int = 0,
    noise: float = NOISE,
    *,
    search: Search = Certified(),
    posterior: Sampling | bool = False,
    progress: Progress = SILENT,
) -> Experiment:
    """A new exciting trajectory, new noise, and the identification without signs.

    `noise` is relative to each joint's RMS effort; for the options see `bayesid.identify`.
    """
    model, theta = paper_model(), nominal_parameters()
    coefficients = base_coefficients(model)
    t = np.linspace(0.0, DURATION, SAMPLES)
    with progress.stage("simulate"):
        motion = exciting_trajectory(model, coefficients, DURATION, seed=seed).motion(t)
        log = simulate(model, theta, motion, rng=np.random.default_rng(seed), noise=noise)
    terms = ["rigid_body"]  # as in the paper
    result = identify(model.robot, log, terms, complete="off", search=search, posterior=posterior, progress=progress)
    true_signs, strong = _truth(result, model.effort(motion, theta))
    estimates, sd_of_estimates = table_rows(result)
    new = random_trajectory(model.robot.n_joints, DURATION, rng=seed + 1).motion(t)
    expected = model.robot.inverse_dynamics(new, theta)
    error = model.robot.inverse_dynamics(new, result.theta) - expected
    sd = noise * np.sqrt(np.mean(model.effort(motion, theta) ** 2, axis=0))
    measured = expected + sd * np.random.default_rng(seed + 1).standard_normal(expected.shape)
    signed = np.ones(len(sd), dtype=bool)
    return Experiment(
        log=log,
        result=result,
        true_signs=true_signs,
        strong=strong,
        estimates=estimates,
        sd=sd_of_estimates,
        torque_error=relative_rms(error, expected, np.ones_like(expected, dtype=bool)),
        new_log=Log(new.t, new.q, measured, signed, source="simulated, another trajectory"),
    )


def _truth(result: Identification, effort: Array) -> tuple[Array, Array]:
    segments, top = result.segments, np.abs(effort).max(axis=0)
    largest = np.empty(len(segments))
    for k, (j, a, b) in enumerate(zip(segments.joint, segments.start, segments.end, strict=True)):
        inside = effort[a:b, j]
        largest[k] = inside[np.argmax(np.abs(inside))]
    return np.sign(largest), np.abs(largest) >= STRONG * top[segments.joint]


def demo_command(options: argparse.Namespace) -> None:
    """Runs the experiment, writes its result folder with the log, and prints signs, Table II and torque errors."""
    if options.paper:
        letter_command(options)
        return
    folder = check_new(options, options.out, IDENTIFICATION_FILES, MARKER)
    search = Beam() if options.search == "beam" else Certified()
    truth = nominal_parameters()  # shown in the report beside the estimates; not used by the identification
    with stages(options) as progress, collect_incomplete() as incomplete:
        sampling = Sampling(budget=options.posterior_budget, rng=options.seed)
        experiment = run_experiment(options.seed, search=search, posterior=sampling, progress=progress)
        parameters = zip(experiment.result.model.parameters, truth.tolist(), strict=True)
        stated = ParameterPrior(nominal={parameter.name: (value, np.nan) for parameter, value in parameters})
        run_by = replace(experiment.result.provenance, command=command_line())
        result = replace(experiment.result, prior=stated, provenance=run_by)
        with progress.stage("validate"):
            validation = result.validate(experiment.new_log)
        save_identification(result, folder, with_log=True, validation=validation, progress=progress)
    errors = _error_lines(experiment, validation.relative_residual)
    parts = *_signs_lines(experiment), coefficient_table(experiment.estimates, experiment.sd), *errors
    checks = check_findings(replace(report_data(result), folder=str(folder)).with_validation(validation))
    conclusion = conclude(checks)
    finish(
        options,
        *parts,
        conclusion=conclusion,
        last=f"open {folder}/report.html",
        warnings=unsaid(result.warnings, () if options.quiet else conclusion.actions),
        incomplete=incomplete,
    )


def _signs_lines(experiment: Experiment) -> list[str]:
    """Signs in order of time, one line per joint; weak segments in brackets, wrong ones marked."""
    result = experiment.result
    lines = [
        f"KUKA KR5 Sixx: {DURATION} s, {SAMPLES} samples per joint, noise {percent(NOISE, 0)}, signs removed",
        "signs of the segments; in brackets: |effort| below 5 % of the joint's maximum; !: wrong",
    ]
    for j in range(result.model.robot.n_joints):
        marks = ""
        for k in np.flatnonzero(result.segments.joint == j):
            sign = "+" if result.signs[k] > 0 else "-"
            wrong = "!" if result.signs[k] != experiment.true_signs[k] else ""
            marks += f"{sign}{wrong}" if experiment.strong[k] else f"({sign}{wrong})"
        lines.append(f"  joint {j + 1}: {marks}")
    return [*lines, f"{experiment.wrong} of {int(experiment.strong.sum())} segments above 5 % have a wrong sign", ""]


def _error_lines(experiment: Experiment, of_measured: Array) -> list[str]:
    return [
        f"{len(experiment.result.coefficients)} coefficients in total, see coefficients.csv",
        "",
        "torque error on a new trajectory, Newton-Euler with the feasible parameters, joints 1 to 6",
        "  against the true torques:  " + "  ".join(percent(error, 2) for error in experiment.torque_error),
        "  against measured ones:     " + "  ".join(percent(error, 2) for error in of_measured),
        "  (the report shows the second line: true torques are unknown on a real robot)",
    ]


def simulate_command(options: argparse.Namespace) -> None:
    """Writes a log without signs, and the same log with signs."""
    check_file(options, options.out)
    truth = options.out.with_name(f"{options.out.stem}_signed.csv")
    check_file(options, truth)
    robot = robot_of(options, notes=True)
    effects = [parse_effect(text, robot) for text in options.effect]
    unsigned, signed = simulate_log(robot, options.duration, options.rate, options.noise, effects, options.seed)
    unsigned.save(options.out)
    signed.save(truth)
    words = ["bayesid", "identify", str(options.out), *given_robot(options)]
    finish(options, last=f"written to {options.out}, signed log in {truth}; next: {shlex.join(words)}")


def study_command(options: argparse.Namespace) -> None:
    """Writes a folder with the trials' rows, a report and a figure."""
    if options.floor and options.trials is not None:
        raise InputError("--floor runs all logs", "--trials", "leave it out")
    from bayesid.studies import load  # takes long to import, and needs pyarrow
    from bayesid.studies.study import check_results, run_study, save_results

    study, folder = load(options.name, floor=options.floor), options.out or Path(f"bayesid-study-{options.name}")
    check_results(folder)
    if not options.resume:
        check_taken(options, folder, "--resume to continue, ")
    with counts(options, "trials") as show:
        finished = run_study(
            study,
            options.trials,
            options.seed,
            workers=options.workers,
            scheduler=options.scheduler,
            out=folder,
            resume=options.resume,
            progress=show,
        )
        text = save_results(finished, folder)
    failed = [f"trial {row['trial']} failed: {row['error']}" for row in finished.failed]
    below, conclusion = len(finished.short), None
    summary = f"{counted(below, 'figure')} below the floor" if below else "All figures reach their floors"
    if options.floor:
        state: State = "bad" if below else "good"
        conclusion = Conclusion(state, sentence(state, summary))
    missed = [f"{options.name}: {summary}: see {folder}/report.txt"] * bool(below)
    last = f"written to {folder}/; open {folder}/report.txt"
    finish(options, text, conclusion=conclusion, last=last, warnings=failed, incomplete=missed)
