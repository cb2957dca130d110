"""The command line: every command is a thin layer over the Python interface.

Exit codes: 0 done, 2 bad input (one line on stderr), 1 a fault of ours.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from tqdm import tqdm

import bayesid
from bayesid import terms as catalogue
from bayesid.agreement import text as agreement_text
from bayesid.demo import run_demo
from bayesid.errors import BayesidError, InputError
from bayesid.log import find_logs
from bayesid.report.words import paragraph
from bayesid.results import VALIDATION_FILES, check_folder, check_place
from bayesid.signs import METHODS, Progress
from bayesid.simulation import parse_effect, simulate_log
from bayesid.tables import recorded_segments
from bayesid.terms import RigidBody

STUDIES = {
    "noise": "how much noise in the efforts can the signs bear?",
    "duration": "how short may a log be?",
    "excitation": "how poor may the excitation be?",
    "cutoff": "which cut-off of the low-pass is right, and does the automatic one find it?",
    "threshold": "how deep must a minimum be to cut there, and which small efforts should be dropped?",
    "beam_width": "how wide must the beam of T-PBPR be?",
    "initial_segments": "how many segments should T-PBPR enumerate first?",
    "prior": "what does the prior decide, and what do values from a drawing change?",
    "scaling": "what does a larger robot or a longer log cost?",
    "paper": "the paper's experiment, its numbers beside ours",
    "real": "real logs with their signs hidden: which come back right?",
    "calibration": "do confidences and standard deviations mean what they say?",
    "misfit": "the same with an effect that the model does not hold",
    "sbc": "does the sampler sample the posterior?",
    "discrepancy": "is the missing effect named? Blind cases played by MuJoCo",
    "real_discrepancy": "the same on real logs of a UR10e",
}
"""Modules of the package `studies`, which is loaded only where one is run."""
_EXAMPLES = """examples:
  bayesid demo
  bayesid identify log.csv --robot ur10e --out result
  bayesid identify monday.csv tuesday.csv --robot ur10e --search-budget 30
  bayesid identify 'week/*.csv' --each --robot ur10e --workers 2 --out week-by-day
  bayesid identify currents.csv --robot my_robot.toml --gains 14.9,13.3,11.1,10.6,11.0,11.5
  bayesid validate result another_log.csv
  bayesid discrepancy result another_log.csv --holdout a_third_log.csv --out extended
  bayesid simulate --robot panda --duration 20 --noise 0.05 --out log.csv
  bayesid study noise --trials 64 --workers 2
"""


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}; see `{self.prog} --help`\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code."""
    options = _parser().parse_args(arguments)
    command: Callable[[argparse.Namespace], None] = options.command
    try:
        command(options)
    except InputError as error:
        print(f"bayesid: {error}", file=sys.stderr)
        return 2
    except (OSError, BayesidError) as error:
        print(f"bayesid: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as stop:
        print(f"bayesid: interrupted; {stop or 'nothing was written'}", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="bayesid",
        description="Identify robot dynamics from joint positions and the absolute value of the motor currents.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"bayesid {bayesid.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=_Parser)
    _add_identify(commands)
    _add_validate(commands)
    _add_discrepancy(commands)
    _add_simulate(commands)
    demo = commands.add_parser("demo", help="the paper's experiment, simulated, end to end")
    demo.add_argument("--out", type=Path, default=Path("bayesid-demo"), help="result folder (default: %(default)s)")
    demo.add_argument("--seed", type=_seed, default=0, help="of trajectory and noise (default: 0)")
    demo.set_defaults(command=_demo)
    _add_study(commands)
    return parser


def _add_identify(commands: argparse._SubParsersAction[_Parser]) -> None:
    parser = commands.add_parser("identify", help="signs, coefficients and feasible parameters from a log")
    parser.add_argument(
        "logs", type=Path, nargs="+", metavar="log",
        help="CSV: t,q1..qn[,dq1..dqn],tau1..taun (or i1..in with --gains); several logs of one robot count as one, "
        "also by a quoted pattern: 'runs/*.csv'",
    )  # fmt: skip
    parser.add_argument("--robot", required=True, help="built-in name, DH file (.toml) or URDF file")
    parser.add_argument("--terms", default=",".join(catalogue.DEFAULT), help="of the model (default: %(default)s)")
    parser.add_argument(
        "--search", choices=METHODS, default=METHODS[0],
        help="certified: the best signs with a proof; beam: T-PBPR (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--search-budget", type=float, default=10.0, metavar="S",
        help="seconds for the proof; a beam stands by where they do not suffice (default: %(default)g)",
    )  # fmt: skip
    parser.add_argument(
        "--beam-width", type=int, default=5, metavar="W", help="of the beam: nodes kept each step (default: 5)"
    )
    parser.add_argument(
        "--initial-segments",
        type=int,
        default=5,
        metavar="S0",
        help="of the beam: segments enumerated first (default: 5)",
    )
    parser.add_argument("--cutoff", type=float, metavar="HZ", help="of the motion's low-pass (default: from the data)")
    parser.add_argument("--gains", help="N m/A of each joint, for a log of currents: K1,K2,..")
    parser.add_argument("--unsigned", help="all, none, or joints as in 1,3 (default: those never negative)")
    parser.add_argument("--no-posterior", action="store_true", help="skip sampling; uncertainties leave the cone out")
    parser.add_argument(
        "--posterior-budget", type=float, default=60.0, metavar="S",
        help="seconds that sampling may take; it ends when it has converged (default: %(default)g)",
    )  # fmt: skip
    parser.add_argument(
        "--nominal", type=Path, metavar="CSV",
        help="parameters known beforehand, from CAD or a data sheet: name,mean,sd, names as in parameters.csv",
    )  # fmt: skip
    parser.add_argument("--seed", type=_seed, default=0, help="of everything random (default: 0)")
    _add_repeatable(parser)
    parser.add_argument(
        "--each", action="store_true", help="identify each log by itself, and tell whether the results agree"
    )
    _add_workers(parser)
    parser.add_argument("--out", type=Path, help="result folder (default: bayesid-LOG; with --each bayesid-each-LOG)")
    parser.add_argument("--quiet", action="store_true", help="print nothing but warnings and errors")
    parser.set_defaults(command=_identify)


def _add_validate(commands: argparse._SubParsersAction[_Parser]) -> None:
    parser = commands.add_parser("validate", help="a result's model against another log")
    parser.add_argument("result", type=Path, help="folder that `bayesid identify` wrote")
    parser.add_argument("log", type=Path, help="CSV log of the same robot")
    parser.add_argument("--gains", help="N m/A of each joint, for a log of currents: K1,K2,..")
    parser.add_argument("--unsigned", help="all, none, or joints as in 1,3 (default: those never negative)")
    parser.add_argument("--cutoff", type=float, metavar="HZ", help="of the motion's low-pass (default: from the data)")
    parser.add_argument("--out", type=Path, help="folder for summary, signed log and prediction (default: none)")
    parser.set_defaults(command=_validate)


def _add_discrepancy(commands: argparse._SubParsersAction[_Parser]) -> None:
    parser = commands.add_parser("discrepancy", help="what a result's model lacks to explain another log")
    parser.add_argument("result", type=Path, help="folder that `bayesid identify` or `bayesid discrepancy` wrote")
    parser.add_argument("log", type=Path, help="CSV log of the same robot")
    parser.add_argument(
        "--holdout", type=Path, metavar="LOG", help="another log, to score by (default: stretches of the log)"
    )
    parser.add_argument("--gains", help="N m/A of each joint, for logs of currents: K1,K2,..")
    parser.add_argument("--unsigned", help="all, none, or joints as in 1,3 (default: those never negative)")
    parser.add_argument("--cutoff", type=float, metavar="HZ", help="of the motion's low-pass (default: from the data)")
    parser.add_argument(
        "--search-budget", type=float, default=3.0, metavar="S",
        help="seconds for the proof of the signs under the extended model (default: %(default)g)",
    )  # fmt: skip
    parser.add_argument("--no-posterior", action="store_true", help="skip sampling of the extended model")
    parser.add_argument(
        "--posterior-budget", type=float, default=60.0, metavar="S",
        help="seconds that sampling may take; it ends when it has converged (default: %(default)g)",
    )  # fmt: skip
    parser.add_argument("--seed", type=_seed, default=0, help="of everything random (default: 0)")
    _add_repeatable(parser)
    parser.add_argument("--out", type=Path, help="folder of the extended model (default: bayesid-discrepancy-LOG)")
    parser.add_argument("--quiet", action="store_true", help="print nothing but warnings and errors")
    parser.set_defaults(command=_discrepancy)


def _add_simulate(commands: argparse._SubParsersAction[_Parser]) -> None:
    parser = commands.add_parser("simulate", help="a log of |effort| from a robot with random feasible parameters")
    parser.add_argument("--robot", required=True, help="built-in name, DH file (.toml) or URDF file")
    parser.add_argument("--duration", type=float, default=20.0, metavar="S", help="default: %(default)s")
    parser.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="default: %(default)s")
    parser.add_argument("--noise", type=float, default=0.05, metavar="REL", help="of each joint's RMS (default: 0.05)")
    parser.add_argument(
        "--effect", action="append", default=[], metavar="NAME:JOINT:LEVEL",
        help="hide an effect of docs/discrepancy.md, its RMS LEVEL times the joint's effort; may be repeated",
    )  # fmt: skip
    parser.add_argument("--seed", type=_seed, default=0, help="of parameters, trajectory and noise (default: 0)")
    parser.add_argument("--out", type=Path, required=True, metavar="LOG.csv", help="log to write")
    parser.set_defaults(command=_simulate)


def _add_study(commands: argparse._SubParsersAction[_Parser]) -> None:
    width = max(map(len, STUDIES))
    parser = commands.add_parser(
        "study", help="what the method bears, and whether it tells the truth",
        epilog="\n".join(["studies:", *(f"  {name:<{width}}  {told}" for name, told in STUDIES.items())]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("name", choices=STUDIES, metavar="NAME", help="which one, see below")
    parser.add_argument("--trials", type=_whole, metavar="N", help="how many (default: the study's own number)")
    parser.add_argument("--seed", type=_seed, default=0, help="of the first trials (default: 0)")
    _add_workers(parser)
    parser.add_argument("--resume", action="store_true", help="keep the rows that are there, run what is missing")
    parser.add_argument("--out", type=Path, help="folder for rows, report and figure (default: bayesid-study-NAME)")
    parser.add_argument("--quiet", action="store_true", help="print nothing but warnings and errors")
    parser.set_defaults(command=_study)


def _add_repeatable(parser: _Parser) -> None:
    parser.add_argument(
        "--repeatable", action="store_true", help="budgets count work, not seconds: the same result on a busy machine"
    )


def _add_workers(parser: _Parser) -> None:
    parser.add_argument("--workers", type=_whole, metavar="K", help="processes on this machine (default: one a core)")
    parser.add_argument(
        "--scheduler", metavar="tcp://HOST:PORT", help="of a Dask cluster, to run on its workers instead"
    )


# ---------------------------------------------------------------------------------------------------------------
# Commands
# ---------------------------------------------------------------------------------------------------------------
def _identify(options: argparse.Namespace) -> None:
    logs, settings = find_logs(options.logs), _settings(options)
    if options.each:
        _identify_each(options, logs, settings)
        return
    if options.workers is not None or options.scheduler is not None:
        said = "one identification runs in one process"
        raise InputError(said, "--workers or --scheduler", "leave it out, or add --each for one result a log")
    folder = check_folder(options.out or Path(f"bayesid-{logs[0].stem}"))
    if any(path.resolve().parent == folder.resolve() for path in logs):
        raise InputError("holds the log, which the result would replace", str(folder), "give --out a new folder")
    gains = _gains(options.gains)
    log = bayesid.join_logs([bayesid.read_log(path, gains, options.unsigned) for path in logs])
    with _Bars(options.quiet) as bars:
        result = bayesid.identify(options.robot, log, **settings, progress=bars.show)
    bayesid.save_identification(result, folder)
    for warning in result.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if not options.quiet:
        print(identification_table(result))
        print(f"written to {folder}/")


def _settings(options: argparse.Namespace) -> dict[str, Any]:
    """Keyword arguments of `bayesid.identify`."""
    terms = [name.strip() for name in options.terms.split(",")]
    if RigidBody.name not in terms:
        raise InputError(f"{RigidBody.name} is missing", "--terms", "add it: a robot has links")
    return {
        "terms": terms, "search": options.search, "search_budget": options.search_budget,
        "beam_width": options.beam_width, "initial_segments": options.initial_segments, "cutoff": options.cutoff,
        "posterior": not options.no_posterior, "posterior_budget": options.posterior_budget, "seed": options.seed,
        "nominal": None if options.nominal is None else bayesid.read_nominal(options.nominal),
        "repeatable": options.repeatable,
    }  # fmt: skip


def _identify_each(options: argparse.Namespace, logs: Sequence[Path], settings: Mapping[str, Any]) -> None:
    folder = options.out or Path(f"bayesid-each-{logs[0].stem}")
    with _CountBar(" logs", options.quiet) as bar:
        found = bayesid.identify_separately(
            options.robot, logs, folder, gains=_gains(options.gains), unsigned=options.unsigned,
            workers=options.workers, scheduler=options.scheduler, progress=bar.show, **settings,
        )  # fmt: skip
    for one in found.runs:
        for warning in one.warnings:
            print(f"warning: {one.log}: {warning}", file=sys.stderr)
        if one.error:
            print(f"bayesid: {one.log}: {one.error.removeprefix(f'{one.log}: ')}", file=sys.stderr)
    if not options.quiet:
        print(separate_table(found))
        print(f"written to {folder}/")
    failed = [one for one in found.runs if one.error]
    if failed:
        said = f"{len(failed)} of {len(found.runs)} logs have no result"
        if all(one.bad_input for one in failed):
            raise InputError(said, str(folder), "see above; the other results are complete")
        raise BayesidError(f"{folder}: {said}; see above; the other results are complete")


def _validate(options: argparse.Namespace) -> None:
    if options.out is not None:
        check_folder(options.out, VALIDATION_FILES)
    stored = bayesid.load_model(options.result)
    log = bayesid.read_log(options.log, _gains(options.gains), options.unsigned)
    result = bayesid.validate(stored.model, stored.theta, stored.noise, log, options.cutoff, stored.draws)
    print("joint   RMS error, N m   relative residual   in the 95 % band")
    figures = zip(result.rms_error, result.relative_residual, result.coverage, strict=True)
    for j, (error, relative, inside) in enumerate(figures, start=1):
        print(f"{j:>5}   {error:>14.4g}   {relative:>17.1%}   {inside:>16.1%}")
    print(f"the band holds {result.band}")
    if options.out is not None:
        print(f"written to {bayesid.save_validation(result, options.out)}/")


def _discrepancy(options: argparse.Namespace) -> None:
    folder = check_folder(options.out or Path(f"bayesid-discrepancy-{options.log.stem}"))
    for path in (options.result, options.log, *([] if options.holdout is None else [options.holdout])):
        if path.resolve() == folder.resolve() or path.resolve().parent == folder.resolve():
            said = f"holds {path.name}, which the result would replace"
            raise InputError(said, str(folder), "give --out a new folder")
    stored, gains = bayesid.load_model(options.result), _gains(options.gains)
    logs = [options.log] if options.holdout is None else [options.log, options.holdout]
    log, *holdout = [bayesid.read_log(path, gains, options.unsigned) for path in logs]
    with _Bars(options.quiet) as bars:
        result = bayesid.find_discrepancy(
            stored, log, holdout[0] if holdout else None, cutoff=options.cutoff, search_budget=options.search_budget,
            posterior=not options.no_posterior, posterior_budget=options.posterior_budget, seed=options.seed,
            progress=bars.show, repeatable=options.repeatable,
        )  # fmt: skip
    bayesid.save_discrepancy(result, folder)
    for warning in result.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if not options.quiet:
        print(discrepancy_table(result))
        print(f"written to {folder}/")


def _simulate(options: argparse.Namespace) -> None:
    if options.out.is_dir():
        raise InputError("is a folder", str(options.out), "give --out the name of a file")
    check_place(options.out)
    robot = bayesid.load_robot(options.robot)
    effects = [parse_effect(text, robot) for text in options.effect]
    unsigned, signed = simulate_log(robot, options.duration, options.rate, options.noise, effects, options.seed)
    truth = options.out.with_name(f"{options.out.stem}_signed.csv")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    bayesid.write_log(options.out, unsigned)
    bayesid.write_log(truth, signed)
    print(f"written to {options.out}, with the signs in {truth}")


def _demo(options: argparse.Namespace) -> None:
    with _Bars(quiet=False) as bars:
        text = run_demo(options.out, options.seed, bars.show)
    print(text)


def _study(options: argparse.Namespace) -> None:
    try:
        from studies import load, run_study
        from studies.results import check_results, save_results
    except ModuleNotFoundError as error:
        remedy = "run it where bayesid was cloned, or install it from there"
        raise InputError(f"the studies are not installed ({error})", f"study {options.name}", remedy) from None
    study, folder = load(options.name), options.out or Path(f"bayesid-study-{options.name}")
    check_results(folder)
    with _CountBar(" trials", options.quiet) as bar:
        finished = run_study(
            study, options.trials, options.seed, workers=options.workers, scheduler=options.scheduler, out=folder,
            resume=options.resume, progress=bar.show,
        )  # fmt: skip
    text = save_results(finished, folder)
    for row in finished.failed:
        print(f"warning: trial {row['trial']} failed: {row['error']}", file=sys.stderr)
    if not options.quiet:
        print(text)
        print(f"written to {folder}/")


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 up")
    return int(text)


def _whole(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 up")
    return int(text)


def _gains(text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError(f"{text!r} is not a list of numbers", "--gains", "give K1,K2,.. in N m/A") from None


# ---------------------------------------------------------------------------------------------------------------
# What the user sees
# ---------------------------------------------------------------------------------------------------------------
def identification_table(result: bayesid.Identification) -> str:
    """The table that ends `bayesid identify`."""
    fit, search = result.fit, result.search
    segments, _, confidence = recorded_segments(result)
    recorded = result.log.clock(result.signals.motion.t)[0] >= 0  # the pause between joined logs is not
    lines = [
        f"{result.model.robot.name}: {len(result.log)} rows, {len(segments)} segments "
        f"({len(search.signs)} searched), {len(result.coefficients)} coefficients "
        f"({int((result.sd < 0.1 * np.abs(result.beta)).sum())} known to 10 %), "
        f"condition number {fit.condition:.0f}",
        f"search: {search.method}, {search.solves} cone problems, {result.timings['search']:.1f} s; {_proven(result)}",
        _sampled(result),
        "joint   segments   least sure   |effort| sure to 99 %   relative residual",
    ]
    sure = np.maximum(result.probability, 1.0 - result.probability)[recorded] >= 0.99
    effort = np.abs(result.signals.raw_effort)[recorded]
    share = (effort * sure).sum(axis=0) / np.maximum(effort.sum(axis=0), 1e-300)
    for j in range(result.model.robot.n_joints):
        here = segments.joint == j
        lines.append(
            f"{j + 1:>5}   {here.sum():>8}   {confidence[here].min():>10.2f}   {share[j]:>21.1%}"
            f"   {fit.relative_residual[j]:>17.1%}"
        )
    return "\n".join(lines)


def separate_table(found: bayesid.Separate) -> str:
    """The tables that end `bayesid identify --each`."""
    width = max(len("log"), *(len(str(one.log)) for one in found.runs))
    lines = [f"{'log':<{width}}   samples   segments   certified   converged   worst relative residual"]
    for one in found.runs:
        told = one.figures
        if told:
            proven, sampled = (_yes_or_no(told[key]) for key in ("certified", "converged"))
            lines.append(
                f"{one.log!s:<{width}}   {told['n_samples']:>7}   {told['n_segments']:>8}   {proven:>9}"
                f"   {sampled:>9}   {told['worst_relative_residual']:>23.1%}"
            )
    few = "fewer than two results: nothing to compare"
    return "\n".join([*lines, "", few if found.agreement is None else agreement_text(found.agreement)])


def _yes_or_no(value: object) -> str:
    return "-" if value == "" else "yes" if value else "NO"


def _proven(result: bayesid.Identification) -> str:
    search = result.search
    if search.certified:
        others = len(search.branches) - 1
        named = f"{others or 'no'} other assignment{'s' * (others != 1)} within {search.within:.0f}"
        return f"certified: none costs less, {named}, {result.settled_share:.1%} of samples settled"
    if search.lower_bound is None:
        return "not certified"
    return f"not certified: cost {search.cost:.1f}, proven lower bound {search.lower_bound:.1f}"


def _sampled(result: bayesid.Identification) -> str:
    posterior = result.posterior
    if posterior is None:
        return "posterior: not sampled"
    state = "converged" if posterior.converged else "NOT CONVERGED"
    modes = "" if len(posterior.modes) == 1 else f", {len(posterior.modes)} modes"
    return (
        f"posterior: {state}, R-hat {posterior.max_rhat:.3f}, effective sample size {posterior.min_ess:.0f}{modes}, "
        f"{posterior.seconds:.1f} s"
    )


def discrepancy_table(result: bayesid.Discrepancy) -> str:
    """The tables that end `bayesid discrepancy`."""
    lines = [paragraph(result), "", f"gap on {result.holdout}, RMS in N m:", "joint     before      after      floor"]
    gaps = zip(result.before, result.after, result.floor.rms, strict=True)
    lines += [f"{j:>5}   {b:>8.4g}   {a:>8.4g}   {f:>8.4g}" for j, (b, a, f) in enumerate(gaps, start=1)]
    if result.found:
        lines += ["", f"{'effect':<24} {'joints':<8} log10 Bayes factor   probability   not told from"]
    for one in result.found:
        joints = ",".join(map(str, one.joints)) or "all"
        figures = f"{one.verdict.gain / np.log(10.0):>18.1f}   {one.verdict.probability:>11.3f}"
        lines.append(f"{one.effect:<24} {joints:<8} {figures}   {', '.join(one.verdict.equivalent)}".rstrip())
    return "\n".join(lines)


class _Bars:
    """Progress bars on a terminal, one for each stage; none when quiet."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._bar: tqdm[NoReturn] | None = None
        self._stage = ""

    def __enter__(self) -> _Bars:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    @property
    def show(self) -> Progress:
        """The callback."""
        return self._show

    def _show(self, stage: str, done: int, total: int) -> None:
        if self._bar is None or stage != self._stage:
            if self._bar is not None:
                self._bar.close()
            self._stage = stage
            disable = True if self._quiet else None  # None: only on a terminal
            self._bar = tqdm(total=total, desc=stage, unit="", delay=1.0, disable=disable, leave=False)
        self._bar.update(done - self._bar.n)


class _CountBar:
    """A progress bar with rate and time left, on a terminal."""

    def __init__(self, unit: str, quiet: bool) -> None:
        self._unit = unit
        self._disable = True if quiet else None  # None: only on a terminal
        self._bar: tqdm[NoReturn] | None = None

    def __enter__(self) -> _CountBar:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def show(self, done: int, total: int, failed: int) -> None:
        """The callback; what was done before the first call does not count for the rate."""
        if self._bar is None:
            self._bar = tqdm(total=total, initial=done, unit=self._unit, disable=self._disable, smoothing=0.05)
        if failed:
            self._bar.set_postfix_str(f"{failed} failed", refresh=False)
        self._bar.update(done - self._bar.n)


if __name__ == "__main__":
    sys.exit(main())
