"""What the command line takes: commands, options and their help."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import shtab

import bayesid
from bayesid import terms as catalogue
from bayesid.cli import commands as run
from bayesid.cli.messages import complain
from bayesid.signs import METHODS

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
  bayesid excite --robot ur10e --out motion
  bayesid report result --validation another_log.csv
  bayesid validate result another_log.csv
  bayesid discrepancy result another_log.csv --holdout a_third_log.csv --out extended
  bayesid simulate --robot panda --duration 20 --noise 0.05 --out log.csv
  bayesid study noise --trials 64 --workers 2

`bayesid COMMAND --help` tells more, with examples.
"""


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        complain(f"{message}; see `{self.prog} --help`", self.prog)
        self.exit(2)


def make_parser() -> argparse.ArgumentParser:
    """All commands, each with the function that runs it as `command`."""
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
    _add_report(commands)
    _add_excite(commands)
    _add_simulate(commands)
    demo = _command(commands, "demo", "the paper's experiment, simulated, end to end", ["bayesid demo --out demo"])
    _add_path(demo, "--out", default=Path("bayesid-demo"), help="result folder (default: %(default)s)")
    demo.add_argument("--seed", type=_seed, default=0, help="of trajectory and noise (default: 0)")
    _add_quiet(demo)
    demo.set_defaults(command=run.demo)
    _add_study(commands)
    _add_completion(commands, parser)
    return parser


def _command(
    commands: argparse._SubParsersAction[_Parser], name: str, told: str, examples: Sequence[str], more: str = ""
) -> _Parser:
    """A command with its help: what it does and examples to copy."""
    lines = "\n".join(["examples:", *(f"  {example}" for example in examples), *([f"\n{more}"] if more else [])])
    return commands.add_parser(
        name, help=told, description=f"{told[0].upper()}{told[1:]}.", epilog=lines,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip


def _add_identify(commands: argparse._SubParsersAction[_Parser]) -> None:
    parser = _command(
        commands, "identify", "signs, coefficients and feasible parameters from a log",
        [
            "bayesid identify log.csv --robot ur10e --out result",
            "bayesid identify currents.csv --robot my_robot.toml --gains 14.9,13.3,11.1,10.6,11.0,11.5",
            "bayesid identify monday.csv tuesday.csv --robot ur10e --search-budget 30",
            "bayesid identify 'week/*.csv' --each --robot ur10e --workers 2 --out week-by-day",
            "bayesid identify kuka_rsi.csv --robot kr5 --gains 2.1,2.0,1.1,0.6,0.6,0.3",
            "bayesid identify my_bag --robot robot.urdf --topic /joint_states",
        ],
    )  # fmt: skip
    _add_path(
        parser, "logs", nargs="+", metavar="log",
        help="t,q1..qn[,dq1..dqn],tau1..taun (or i1..in with --gains) as CSV, Parquet or MATLAB file, a ROS bag or a "
        "KUKA table; several logs of one robot count as one, "
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
    _add_reading(parser)
    parser.add_argument("--no-posterior", action="store_true", help="skip sampling; uncertainties leave the cone out")
    parser.add_argument(
        "--posterior-budget", type=float, default=60.0, metavar="S",
        help="seconds that sampling may take; it ends when it has converged (default: %(default)g)",
    )  # fmt: skip
    _add_path(
        parser, "--nominal", metavar="CSV",
        help="parameters known beforehand, from CAD or a data sheet: name,mean,sd, names as in parameters.csv",
    )  # fmt: skip
    parser.add_argument("--seed", type=_seed, default=0, help="of everything random (default: 0)")
    _add_repeatable(parser)
    parser.add_argument(
        "--each", action="store_true", help="identify each log by itself, and tell whether the results agree"
    )
    _add_workers(parser)
    parser.add_argument("--no-report", action="store_true", help="do not make report.html, which takes some seconds")
    _add_path(parser, "--out", help="result folder (default: bayesid-LOG; with --each bayesid-each-LOG)")
    _add_quiet(parser)
    parser.set_defaults(command=run.identify)


def _add_validate(commands: argparse._SubParsersAction[_Parser]) -> None:
    examples = ["bayesid validate result another_log.csv", "bayesid validate result another_log.csv --out validated"]
    parser = _command(commands, "validate", "a result's model against another log", examples)
    _add_path(parser, "result", help="folder that `bayesid identify` wrote")
    _add_path(parser, "log", help="log of the same robot")
    _add_reading(parser)
    parser.add_argument("--cutoff", type=float, metavar="HZ", help="of the motion's low-pass (default: from the data)")
    _add_path(parser, "--out", help="folder for summary, signed log and prediction (default: none)")
    _add_quiet(parser)
    parser.set_defaults(command=run.validate)


def _add_discrepancy(commands: argparse._SubParsersAction[_Parser]) -> None:
    examples = ["bayesid discrepancy result another_log.csv --holdout a_third_log.csv --out extended"]
    parser = _command(commands, "discrepancy", "what a result's model lacks to explain another log", examples)
    _add_path(parser, "result", help="folder that `bayesid identify` or `bayesid discrepancy` wrote")
    _add_path(parser, "log", help="log of the same robot")
    _add_path(parser, "--holdout", metavar="LOG", help="another log, to score by (default: stretches of the log)")
    _add_reading(parser)
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
    _add_path(parser, "--out", help="folder of the extended model (default: bayesid-discrepancy-LOG)")
    _add_quiet(parser)
    parser.set_defaults(command=run.discrepancy)


def _add_report(commands: argparse._SubParsersAction[_Parser]) -> None:
    parser = _command(
        commands, "report", "the report of a result folder, anew or with a validation",
        ["bayesid report result", "bayesid report result --validation another_log.csv --out to_send.html"],
    )  # fmt: skip
    _add_path(parser, "result", help="folder that `bayesid identify` wrote")
    _add_path(parser, "--validation", metavar="LOG", help="another log of the same robot to try it on")
    _add_reading(parser)
    parser.add_argument("--cutoff", type=float, metavar="HZ", help="of the motion's low-pass (default: from the data)")
    _add_path(parser, "--out", metavar="FILE", help="default: report.html in the folder")
    _add_quiet(parser)
    parser.set_defaults(command=run.report)


def _add_excite(commands: argparse._SubParsersAction[_Parser]) -> None:
    parser = _command(
        commands, "excite", "a motion that shows coefficients and signs, or what a log's motion leaves undecided",
        [
            "bayesid excite --robot ur10e --out motion",
            "bayesid excite --robot my_robot.toml --limits limits.toml --duration 30 --rate 250 --out motion",
            "bayesid excite --robot ur10e --log log.csv",
        ],
    )  # fmt: skip
    parser.add_argument("--robot", required=True, help="built-in name, DH file (.toml) or URDF file")
    parser.add_argument("--terms", default=",".join(catalogue.DEFAULT), help="of the model (default: %(default)s)")
    _add_path(parser, "--log", help="judge this log's motion; design none")
    parser.add_argument("--duration", type=float, default=20.0, metavar="S", help="default: %(default)s")
    parser.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="of the file (default: %(default)s)")
    _add_path(
        parser, "--limits", metavar="FILE",
        help="of the joints: TOML with lower, upper, velocity, acceleration, or a URDF (default: those of the robot's "
        "URDF, else +-2 rad, 3 rad/s, 15 rad/s^2)",
    )  # fmt: skip
    parser.add_argument("--harmonics", type=_whole, default=5, help="sines and cosines a joint (default: 5)")
    parser.add_argument("--periods", type=_whole, default=1, help="in the duration (default: 1)")
    parser.add_argument("--noise", type=float, default=0.05, metavar="REL", help="of each joint's RMS (default: 0.05)")
    _add_path(parser, "--nominal", metavar="CSV", help="expected parameters, as for identify")
    parser.add_argument("--cutoff", type=float, metavar="HZ", help="of the log's low-pass (default: from the data)")
    _add_reading(parser)
    parser.add_argument("--seed", type=_seed, default=0, help="of everything random (default: 0)")
    _add_path(parser, "--out", default=Path("bayesid-motion"), help="folder (default: %(default)s)")
    _add_quiet(parser)
    parser.set_defaults(command=run.excite)


def _add_completion(commands: argparse._SubParsersAction[_Parser], main: argparse.ArgumentParser) -> None:
    parser = _command(
        commands, "completion", "a script that completes commands and options in your shell",
        [
            "bayesid completion bash > ~/.local/share/bash-completion/completions/bayesid",
            'bayesid completion zsh > "${fpath[1]}/_bayesid"',
        ],
    )  # fmt: skip
    parser.add_argument("shell", choices=run.SHELLS, help="%(choices)s")
    parser.set_defaults(command=run.completion, parser=main)


def _add_simulate(commands: argparse._SubParsersAction[_Parser]) -> None:
    examples = [
        "bayesid simulate --robot panda --duration 20 --noise 0.05 --out log.csv",
        "bayesid simulate --robot kr5 --effect coulomb_friction:2:0.2 --out log.csv",
    ]
    parser = _command(
        commands, "simulate", "a log of |effort| from a robot with random feasible parameters", examples
    )
    parser.add_argument("--robot", required=True, help="built-in name, DH file (.toml) or URDF file")
    parser.add_argument("--duration", type=float, default=20.0, metavar="S", help="default: %(default)s")
    parser.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="default: %(default)s")
    parser.add_argument("--noise", type=float, default=0.05, metavar="REL", help="of each joint's RMS (default: 0.05)")
    parser.add_argument(
        "--effect", action="append", default=[], metavar="NAME:JOINT:LEVEL",
        help="hide an effect of docs/discrepancy.md, its RMS LEVEL times the joint's effort; may be repeated",
    )  # fmt: skip
    parser.add_argument("--seed", type=_seed, default=0, help="of parameters, trajectory and noise (default: 0)")
    _add_path(parser, "--out", required=True, metavar="LOG.csv", help="log to write")
    _add_quiet(parser)
    parser.set_defaults(command=run.simulate)


def _add_study(commands: argparse._SubParsersAction[_Parser]) -> None:
    width = max(map(len, STUDIES))
    parser = _command(
        commands, "study", "what the method bears, and whether it tells the truth",
        ["bayesid study noise --trials 64 --workers 2", "bayesid study noise --scheduler tcp://HOST:8786 --resume"],
        "\n".join(["studies:", *(f"  {name:<{width}}  {told}" for name, told in STUDIES.items())]),
    )  # fmt: skip
    parser.add_argument("name", choices=list(STUDIES), metavar="NAME", help="which one, see below")
    parser.add_argument("--trials", type=_whole, metavar="N", help="how many (default: the study's own number)")
    parser.add_argument("--seed", type=_seed, default=0, help="of the first trials (default: 0)")
    _add_workers(parser)
    parser.add_argument("--resume", action="store_true", help="keep the rows that are there, run what is missing")
    _add_path(parser, "--out", help="folder for rows, report and figure (default: bayesid-study-NAME)")
    _add_quiet(parser)
    parser.set_defaults(command=run.study)


def _add_path(parser: argparse.ArgumentParser, name: str, **options: Any) -> None:
    """An argument that the shell can complete."""
    action = parser.add_argument(name, type=Path, **options)
    vars(action)["complete"] = shtab.FILE


def _add_reading(parser: _Parser) -> None:
    """How a log is to be read, see `bayesid.read_log`."""
    parser.add_argument("--gains", metavar="K1,K2,..", help="N m/A of each joint, for a log of currents")
    parser.add_argument(
        "--unsigned", metavar="JOINTS", help="all, none, or joints as in 1,3 (default: those never negative)"
    )
    parser.add_argument(
        "--degrees", action=argparse.BooleanOptionalAction, default=None,
        help="positions and velocities without a unit are in degrees; --no-degrees: in rad, however large",
    )  # fmt: skip
    parser.add_argument("--topic", metavar="/NAME", help="of a ROS bag with joint states of several topics")
    parser.add_argument("--joints", metavar="A,B,..", help="names of a ROS bag's joints, from base to tip")


def _add_quiet(parser: _Parser) -> None:
    parser.add_argument("--quiet", action="store_true", help="print nothing but warnings and errors")


def _add_repeatable(parser: _Parser) -> None:
    parser.add_argument(
        "--repeatable", action="store_true", help="budgets count work, not seconds: the same result on a busy machine"
    )


def _add_workers(parser: _Parser) -> None:
    parser.add_argument("--workers", type=_whole, metavar="K", help="processes on this machine (default: one a core)")
    parser.add_argument(
        "--scheduler", metavar="tcp://HOST:PORT", help="of a Dask cluster, to run on its workers instead"
    )


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 up")
    return int(text)


def _whole(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 up")
    return int(text)
