"""Commands, options and their help, as tables.

This module, `bayesid.cli.shared` and `bayesid.cli.parser` import no numerical module, for a fast `--help`. Each option
has one line; `--help` shows 12 options at most, `--help-all` all.
"""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from bayesid.cli.parser import WIDTH, Command, flag, make_parser, option, path, several, whole
from bayesid.cli.shared import (
    CHAIN,
    EXACT_GAINS,
    FIRST_READING,
    READING,
    TERMS,
    WORK,
    first_reading_of_result,
    out,
    reading_of_result,
    shared,
)
from bayesid.errors import missing
from bayesid.study import STUDIES

_AS_THE_RESULT = "Without options, a log or motion is read as the result's log."
_STANDARD_TERMS = f"terms by default:\n  {TERMS}"
_IDENTIFY = Command(
    "identify",
    "identify signs and dynamic parameters from a log",
    [
        "bayesid identify log.csv --robot ur10e --out result",
        "bayesid identify currents.csv --robot my_robot.toml --gains 12,16~20%,unknown",
        "bayesid identify log.csv --robot kr5r650 --columns 't=Zeit [ms],q=A{} [Grad]'",
        "bayesid identify 'week/*.csv' --each --robot ur10e --out week-by-day",
        "bayesid identify unloaded.csv --robot ur10e --payload 2.8~0.005@loaded.csv",
        "bayesid identify left.csv --robot two_arms.urdf --tip left_flange",
    ],
    [
        path("logs", "one or more: CSV, Parquet, MATLAB, ROS bag, KUKA", nargs="+", metavar="log"),
        *shared(f"--robot {FIRST_READING} --config"),
        option(
            "--complete HOW",
            "effects beyond --terms: auto, only-uncertainty, off",
            choices=("auto", "only-uncertainty", "off"),
            default="auto",
        ),
        *shared("--no-posterior"),
        *out("result folder (default: bayesid-LOG)"),
    ],
    sections={
        "robot": shared(CHAIN),
        "how the log is read": shared("--unsigned --encoding --topic --joints --cutoff --max-memory"),
        "several logs": [
            several("--payload LABEL:KG@LOG", "another log, with a payload (see below)"),
            flag("--each", "identify each log alone, and compare"),
            *shared("--workers", "with --each: processes (default: one per core)"),
            *shared("--scheduler", "with --each: Dask cluster, tcp://HOST:PORT"),
        ],
        "model": [
            *shared("--terms --nominal --constraints"),
            option("--links KG,M", "mass, size of a typical link (default: estimated)"),
            option("--kinematic-tolerance L,A", "sd of lengths and angles (default: 1mm,0.1deg)"),
        ],
        "search and sampling": [
            option("--search certified|beam", "with proof, or T-PBPR (default: %(default)s)"),
            *shared("--search-budget", f"{WORK} (default: 30)", default=30.0),
            option("--beam-width W", "beam: nodes kept per step", type=int, default=5),
            option("--initial-segments S0", "beam: segments enumerated first", type=int, default=5),
            flag("--anyway", "search even if the log looks misread"),
            *shared("--posterior-budget --seed --time-limit"),
            option("--mode K", "which mode of the posterior to write", type=whole, default=1),
        ],
        "result": [flag("--no-report", "skip report.html"), *shared("--strict")],
    },
    details="""logs:
  a quoted pattern selects several logs: 'runs/*.csv'
  files of one recording are joined by time: positions.csv+currents.csv
  a TOML file lists them: [[logs]] file = "a.csv", payload = "tool1", mass = 2.8

--complete: auto adds effects that the log shows; auto and only-uncertainty
  widen intervals by effects that the log cannot exclude

payloads: LABEL@LOG, KG@LOG or LABEL:KG~SD@LOG (default sd: 0.1 %)

"""
    + _STANDARD_TERMS,
)
_VALIDATE = Command(
    "validate",
    "validate a result on another log",
    ["bayesid validate result another_log.csv", "bayesid validate result another_log.csv --out validated"],
    [
        *shared("result log"),
        *first_reading_of_result(),
        *shared("--strict"),
        *out("folder: also write summary, signed log, prediction"),
    ],
    sections={**reading_of_result(), "more": shared("--cutoff")},
    more=_AS_THE_RESULT,
)
_PREDICT = Command(
    "predict",
    "predict the efforts of a motion, with bands",
    [
        "bayesid predict result motion.csv --out torques.csv",
        "bayesid predict result motion.csv --without-noise --out torques.csv",
    ],
    [
        *shared("result"),
        path("motion", "log, or a table t,q1..qn[,dq1..dqn]"),
        *shared("--columns --degrees --correct"),
        flag("--without-noise", "bands of the model, without measurement noise"),
        *out("file, or existing folder (default: torques.csv)", default=Path("torques.csv"), metavar="FILE.csv"),
    ],
    sections={"how the motion is read": shared("--topic --joints --cutoff")},
    more=_AS_THE_RESULT,
    details="a folder gets prediction.csv\ncolumns: t,tau1..taun,sd1..sdn,lower1..lowern,upper1..uppern",
)
_DISCREPANCY = Command(
    "discrepancy",
    "find what a model lacks, or what changed between logs",
    [
        "bayesid discrepancy result another_log.csv --holdout third.csv --out extended",
        "bayesid discrepancy march.csv may.csv july.csv --robot ur10e --out wear",
    ],
    [
        *shared("result", "result folder, or with --robot the earliest log"),
        path("logs", "log of the same robot; with --robot all later logs", nargs="*", metavar="log"),
        *shared("--robot", "without a result: name, TOML file or URDF"),
        *shared("--config", "without a result: file with options"),
        path("--holdout LOG", "test log (default: held-back blocks of the log)"),
        *first_reading_of_result(),
        *shared("--no-posterior"),
        *out("folder (default: bayesid-discrepancy-LOG)"),
    ],
    sections={
        "robot, without a result": shared(CHAIN),
        **reading_of_result(),
        "model, search and sampling": [
            *shared("--terms", "without a result: standard effects (see below)", default=None),
            *shared("--constraints", "without a result: as in identify"),
            *shared("--cutoff"),
            *shared("--search-budget", f"{WORK} (see below)"),
            *shared("--posterior-budget --seed --time-limit"),
        ],
        "more": shared("--strict"),
    },
    more=_AS_THE_RESULT,
    details=f"--search-budget by default: 3 with a result, 30 for the first of several logs\n\n{_STANDARD_TERMS}",
)
_PAYLOAD = Command(
    "payload",
    "identify mass, centre of mass and inertia of a payload",
    ["bayesid payload result loaded.csv --out payload", "bayesid payload result loaded.csv --known-mass 2.805~0.005"],
    [
        *shared("result", "result of the robot without the payload"),
        *shared("log", "log of the same robot with the payload"),
        option("--known-mass KG[~SD]", "weighed mass; calibrates the scale of the efforts"),
        option("--common-sd SHARE", "sd of the torque scale, as 2%% (see --help-all)"),
        *first_reading_of_result(),
        *shared("--strict"),
        *out("folder for payload.json"),
    ],
    sections={
        **reading_of_result(),
        "search and sampling": [
            *shared("--cutoff"),
            *shared("--search-budget", f"{WORK} (default: 3)"),
            *shared("--posterior-budget", default=10.0),
            *shared("--seed --time-limit"),
        ],
    },
    more=_AS_THE_RESULT,
    details="--common-sd by default: 10 % for torques, 0 with exact gains, else estimated",
    moved={"--no-posterior": "a payload is always sampled; --posterior-budget 0 is fastest"},
)
_TRACK = Command(
    "track",
    "track signs, external torques and alarms online",
    [
        "bayesid track result another_log.csv --lag 0.05 --plot --out tracked",
        "my_logger | bayesid track result - --follow > signed_stream.csv",
    ],
    [
        *shared("result"),
        *shared("log", "log of the same robot; -: standard input"),
        option("--lag S", "output delay for surer signs, s", default=0.0),
        flag("--follow", "live: answer each row of standard input at once"),
        option("--rate HZ", "sampling rate (default: by the time stamps)", type=float),
        *first_reading_of_result(),
        option(
            "--plot",
            "also draw stream.png; --plot svg: stream.svg",
            nargs="?",
            const="png",
            choices=("png", "svg"),
            metavar="KIND",
        ),
        *out("folder (default: bayesid-track-LOG)"),
    ],
    sections={
        "alarms": [
            option("--false-alarms PER_HOUR", "accepted rate of false alarms", default=0.01),
            flag("--explain", "find the effect behind each change; takes minutes"),
        ],
        **reading_of_result(),
        "more": shared("--payload --strict"),
    },
    more=_AS_THE_RESULT,
    details="with --follow each row is answered by a row of signed_stream.csv; alarms are\n"
    "  lines of JSON on the standard error; a folder is written only with --out;\n"
    "  without --rate the first second is answered without signs",
)
_REPORT = Command(
    "report",
    "make the report of a result folder again",
    ["bayesid report result", "bayesid report result --out to_send.html"],
    [*shared("result --strict"), *out("file (default: report.html in the folder)", metavar="FILE")],
    moved={"--validation": "`bayesid validate RESULT LOG` adds another log to the report"},
)
_FOR_RESULT = [
    option("--capsules R,..", "radii of capsules around the links, m"),
    option("--about NAME,..", "goal (default: all not known to 10 %%)"),
    option("--between A,B,..", "hypotheses to distinguish, EFFECT:JOINT each"),
    option("--criterion D|A", "determinant, or mean variance"),
    option("--start Q1,..", "pose at both ends, rad or m (default: of the log)"),
    *shared("--payload"),
    option("--tool X,Y,Z", "with --capsules: tip of the tool, m"),
    option("--floor Z", "height of the floor, m, or none (default: 0)", default="0"),
    option("--margin M", "least distance, m", default=0.01),
    several("--meshes DIR", "folder of the URDF's meshes; may be repeated", type=Path),
]
_FOR_ROBOT = [
    *shared("--terms"),
    option("--harmonics K", "harmonics per period", type=whole, default=5),
    option("--periods K", "periods in the duration", type=whole, default=1),
    *shared("--noise --nominal --cutoff --seed"),
]
FOR_RESULT = [name for name, _ in _FOR_RESULT]
"""Options of `excite` that need `--for`."""
FOR_ROBOT = [name for name, _ in _FOR_ROBOT] + READING.split() + ["--no-degrees", "--config"]
"""Options without effect with `--for`: the result has its own terms, noise and parameters."""
_EXCITE = Command(
    "excite",
    "design a motion to record, or assess the motion of a log",
    [
        "bayesid excite --robot ur10e --log log.csv",
        "bayesid excite --robot my_robot.toml --limits limits.toml --out motion",
        "bayesid excite --for result --capsules 0.06 --floor=-0.8 --out next",
        "bayesid excite --for found --between stribeck_friction:3,thermal_drift:3",
    ],
    [
        path("--for RESULT", "design for what this result does not determine", dest="result"),
        *shared("--robot", "needed without --for; with it: limits and shapes"),
        path("--log LOG", "assess the motion of this log"),
        path("--limits FILE", "joint limits: TOML or URDF (see --help-all)"),
        *shared(f"{FIRST_READING} --config"),
        *out("folder (default: bayesid-motion)", "--quiet", default=Path("bayesid-motion")),
    ],
    sections={
        "robot": shared(CHAIN),
        "motion": [
            *shared("--duration --rate"),
            option("--changes K", "steps of the search (default: 10 to 30 s)", type=whole),
        ],
        "more": shared("--strict --force"),
        "with --for": _FOR_RESULT,
        "without --for": _FOR_ROBOT,
        "how the log is read, without --for": shared("--unsigned --encoding --topic --joints"),
    },
    moved={"--effort-limits": "give --limits FILE with a line effort = [..], N m"},
    details="limits: lower, upper, velocity, acceleration, jerk, effort (N m); default: of\n"
    "  the robot's URDF, else +-2 rad, 3 rad/s, 15 rad/s^2\n\n"
    "--about: coefficients, parameters, effects, gains, payload, signs\n\n" + _STANDARD_TERMS,
)
_FLOOR = Command(
    "floor",
    "measure the smallest error of any model from a repeated motion",
    [
        "bayesid floor monday.csv tuesday.csv --robot ur10e",
        "bayesid floor monday.csv tuesday.csv --robot ur10e --out floor.json",
    ],
    [
        path("log", "recording of a motion"),
        path("again", "second recording of the same motion"),
        *shared("--robot"),
        *shared("--gains", EXACT_GAINS),
        *shared("--unsigned --columns --degrees --correct --config --strict"),
        *out("JSON file with the table (default: none)", metavar="FILE"),
    ],
    sections={"robot": shared(CHAIN), "how the logs are read": shared("--encoding --topic --joints")},
)
_SIMULATE = Command(
    "simulate",
    "simulate a log of |effort| with random feasible parameters",
    [
        "bayesid simulate --robot panda --duration 20 --noise 0.05 --out log.csv",
        "bayesid simulate --robot panda --effect joint_spring:2:0.2 --out log.csv",
    ],
    [
        *shared("--robot --duration --rate --noise --seed"),
        several("--effect NAME:JOINT:RMS", "add an effect; RMS as a share of the joint's effort"),
        *out("log to write", required=True, metavar="LOG.csv"),
    ],
    sections={"robot": shared(CHAIN)},
)
_ROBOT_NEW = Command(
    "new",
    "make a robot file from a data sheet's table, or a template",
    [
        "bayesid robot new --out arm.toml",
        "bayesid robot new table.csv --convention modified --name 'KR 6' --out arm.toml",
    ],
    [
        option("table", "file, - or the table as text (default: template)", nargs="?"),
        option("--convention NAME", "Denavit-Hartenberg: standard or modified", choices=("standard", "modified")),
        option("--name NAME", "robot's name (default: the file's)"),
        *out("file to write", required=True, metavar="FILE.toml"),
    ],
    details="""table: Denavit-Hartenberg, one row per joint, with units in the header, as in
  'a[mm] alpha[deg] d[mm] theta[deg]\\n25 -90 400 0'
convention: see docs/how-to/data-sheet-robot.md""",
)
_ROBOT_SHOW = Command(
    "show",
    "show joint and flange positions, to check a file",
    [
        "bayesid robot show kr6r900 --q 0,-90,90,0,0,0 --degrees --out kr6r900.png",
        "bayesid robot show two_arms.urdf --tip left_flange",
    ],
    [
        option("robot", "name (`bayesid robot list`), TOML file or URDF"),
        option("--q Q1,Q2,..", "joint positions, rad or m (default: zeros)"),
        *shared("--degrees", "unit of --q: degrees or rad"),
        *shared(CHAIN),
        *out("picture: .png, .svg or .pdf", metavar="FILE"),
    ],
)
_LISTED = "bayesid robot list", "bayesid robot list | grep -i denso"
_ROBOT_FILES = Command(
    "robot",
    "make, show and list robot files",
    ["bayesid robot list", "bayesid robot new --out arm.toml", "bayesid robot show arm.toml --out arm.png"],
    commands=[_ROBOT_NEW, _ROBOT_SHOW, Command("list", "list the built-in robots", _LISTED)],
)
_DEMO = Command(
    "demo",
    "run the paper's experiment in simulation",
    ["bayesid demo --out demo", "bayesid demo --search beam --paper --out letter"],
    [
        option("--search certified|beam", "with proof, or T-PBPR (default: %(default)s)"),
        flag("--paper", "exactly the paper's search; writes nodes.csv"),
        *shared("--seed --posterior-budget --strict"),
        *out("result folder (default: bayesid-demo)", default=Path("bayesid-demo")),
    ],
)


def _study(name: str, question: str) -> str:
    return textwrap.fill(question, WIDTH, initial_indent=f"  {name:<19} ", subsequent_indent=22 * " ")


_STUDY = Command(
    "study",
    "test the method on simulated and real logs",
    ["bayesid study noise --trials 64 --workers 2", "bayesid study noise --scheduler tcp://HOST:8786 --resume"],
    [
        option("name", "see below", choices=STUDIES.keys(), metavar="NAME"),
        option("--trials N", "number of trials (default: the study's)", type=whole),
        *shared("--seed", "seed of the first trial"),
        *shared("--workers --scheduler"),
        flag("--resume", "keep the trials that are done"),
        flag("--floor", "study `real`: exit code 1 if a figure is too low"),
        *out("folder (default: bayesid-study-NAME)"),
    ],
    more="\n".join(["studies:", *(_study(name, question) for name, question in STUDIES.items())]),
)
_COMPLETION = Command(
    "completion",
    "print a script for completion in your shell",
    ["bayesid completion bash > ~/.local/share/bash-completion/completions/bayesid"],
    [option("shell", "your shell", choices=("bash", "zsh", "tcsh"))],
)
BAYESID = Command(
    "bayesid",
    "identify robot dynamics from joint positions and |motor current|",
    [
        "bayesid demo",
        "bayesid identify log.csv --robot ur10e --out result",
        "bayesid validate result another_log.csv",
        "bayesid discrepancy result another_log.csv --out extended",
        "bayesid excite --for result --out next",
    ],
    [option("--version", action="version", version=f"bayesid {version('bayesid')}", help="show the version")],
    commands=[
        *(_IDENTIFY, _VALIDATE, _PREDICT, _DISCREPANCY, _PAYLOAD, _TRACK, _REPORT, _FLOOR, _EXCITE, _SIMULATE),
        *(_ROBOT_FILES, _DEMO, _STUDY, _COMPLETION),
    ],
    more="Help on a command, with examples: `bayesid COMMAND --help`.\n\n"
    "exit codes: 0 done, 1 failed, 2 bad input or a file that would be replaced,\n"
    "  3 bad verdict with --strict, 130 interrupted, 143 terminated",
)
"""The whole command line."""


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """The options of one command, see `Parser.understand`."""
    return make_parser(BAYESID).understand(arguments)


def completion_command(options: argparse.Namespace) -> None:
    """Prints a script for the user's shell."""
    try:
        import shtab
    except ImportError:
        raise missing("shtab", "completion", "bayesid completion") from None
    print(shtab.complete(make_parser(BAYESID, files=shtab.FILE), shell=options.shell))
