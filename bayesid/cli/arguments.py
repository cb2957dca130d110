"""What the command line takes: commands, options and their help, as tables.

This module and `bayesid.cli.parser` import nothing that computes, so that a shell has its answer at once.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from bayesid.cli.parser import Command, Option, flag, make_parser, option, path, seed, several, whole
from bayesid.cli.tuning import TUNING
from bayesid.errors import missing
from bayesid.study import STUDIES

TERMS = "rigid_body,viscous_friction,coulomb_friction,torque_offset,rotor_inertia"
"""`bayesid.effects.STANDARD`, spelled out: to import the catalogue for a help text takes a second."""
ROBOT = "--robot --tip --hold --gravity"
"""Which robot, and which of its joints."""
MOTION = "--degrees --columns --topic --joints --correct"
"""How a motion is to be read."""
READING = f"--gains --unsigned --encoding {MOTION}"
"""How a log is to be read, see `bayesid.read_log`."""

_ROBOT = (
    "built-in name (`bayesid robot list`), DH file (.toml), URDF, or name of example-robot-data, robot_descriptions"
)
_WORK = "work of the proof of signs, about seconds of an idle core"
_GAINS = (
    "N m/A of each joint, for a log of currents: exact, or to be estimated where uncertain, as in 12~20%%,16~1.5,10 "
    "(sd), 'unknown' for one or all, or a CSV file with the columns gain,sd; uncertain ones may correct torques too; "
    "--gains=-12,.. where the first is negative"
)
_ENCODING = (
    "how efforts without a minus hold a sign: twos:16 (two's complement, bits), sign-bit:10, offset:2048 (zero), "
    "direction:1 (what a column of directions holds below zero), or magnitude (default: what they show)"
)
_COLUMNS = (
    'names of the log\'s columns, as in t="Zeit [ms]",q="Achse{} [Grad]",i="Strom{} [A]", or a TOML file with such '
    "lines (default: the usual names)"
)
_CORRECT = (
    "joints to exchange, turn round, scale or shift (rad), as in q1=q3,q3=q1,tau2=-tau2,tau3=0.001*tau3,q5=q5+1.5708; "
    "tau=-tau for all"
)
_CONSTRAINTS = (
    "what parameters satisfy: total_mass = [27, 31], tables [link.2] with mass, com_box, hull (a mesh file) or "
    "ellipsoid, a table [bounds] with m3 = [3, 5]"
)
_SHARED = dict(
    [
        path("result", "folder that `bayesid identify` wrote"),
        path("log", "log of the same robot"),
        option("--robot", _ROBOT, required=True),
        option("--tip LINK", "of a URDF: link or joint where the chain ends (default: all chains but grippers)"),
        option("--hold JOINT=Q,..", "of a URDF: more joints that are held, at these positions (rad, m)"),
        option(
            "--gravity X,Y,Z",
            "in the base frame, m/s^2 (default: the file's): 0,0,9.81 upside down, 0,0,0 for efforts without weight",
        ),
        option("--terms", "of the model (default: %(default)s)", default=TERMS),
        path("--constraints TOML", _CONSTRAINTS),
        path("--nominal CSV", "parameters known beforehand: name,mean,sd, names as in parameters.csv"),
        option("--cutoff HZ", "of the motion's low-pass (default: from the data)", type=float),
        option("--gains K1,K2,..", _GAINS),
        option("--unsigned JOINTS", "all, none, or joints as in 1,3 (default: those never negative)"),
        option("--encoding CODE", _ENCODING),
        option(
            "--degrees",
            "positions and velocities without a unit are in degrees; --no-degrees: in rad, however large",
            action=argparse.BooleanOptionalAction,
        ),
        option('--columns T="..",Q="..{}",..', _COLUMNS),
        option("--topic /NAME", "of a ROS bag with joint states of several topics"),
        option("--joints A,B,..", "names of a ROS bag's joints, from base to tip"),
        option("--correct q2=-q2,..", _CORRECT),
        option("--max-memory GB", "above which the run does not begin (default: 0.8 of the machine's)", type=float),
        option("--search-budget S", _WORK, type=float),
        flag("--no-posterior", "skip sampling"),
        option("--posterior-budget S", "most work of sampling, about seconds of an idle machine", default=60.0),
        option("--noise REL", "of each joint's RMS", default=0.05),
        option("--seed", "of everything random (default: 0)", type=seed, default=0),
        option(
            "--time-limit S",
            "s on the clock for search and sampling each; budgets repeat exactly, this may not",
            default=600.0,
        ),
        option("--workers K", "processes on this machine (default: one a core)", type=whole),
        option("--scheduler tcp://HOST:PORT", "of a Dask cluster, to run on its workers instead"),
        option("--payload LABEL", "what the flange carried, as the result knows it (default: nothing)", default=""),
        option("--duration S", "s", default=20.0),
        option("--rate HZ", "of the file", default=100.0),
        path("--out", ""),
        flag("--force", "replace what is there"),
        flag("--strict", "exit code 3 where the verdict is bad"),
        flag("--quiet", "print nothing but warnings and errors"),
    ]
)
"""Options of several commands."""


def _shared(names: str, help: str | None = None, **changes: Any) -> list[Option]:
    """Options of several commands, changed where a command means something else by them."""
    changes |= {} if help is None else {"help": help}
    return [(name, _SHARED[name] | changes) for name in names.split()]


def _out(help: str, **changes: Any) -> list[Option]:
    return [*_shared("--out", help, **changes), *_shared("--force --quiet")]


_READING = [
    *_shared("--gains", "N m/A of each joint, for a log of currents (default: as the result's log was read)"),
    *_shared(f"--unsigned --encoding {MOTION}"),
]
"""How a log is to be read beside a result, whose gains are no unknowns any more."""

# ---------------------------------------------------------------------------------------------------------------
# Commands
# ---------------------------------------------------------------------------------------------------------------
_LOGS = (
    "t,q1..qn[,dq1..dqn],tau1..taun (or i1..in with --gains) as CSV, Parquet or MATLAB file, a ROS bag or KUKA table; "
    "logs of a robot count as one, also by a quoted pattern: 'runs/*.csv'; files of one run with a + between them are "
    "joined by time: positions.csv+currents.csv; or a TOML file that lists logs: tables [[logs]] with "
    'file = "loaded.csv" and, where the flange carries something, payload = "tool1" and mass = 2.8 or [2.8, 0.005]'
)
_MASS = (
    "one more log, with a payload of this mass on the flange; the mass enters the posterior, and fixes the factor of "
    f"uncertain gains (default sd: {100 * TUNING.payload_mass_sd:g} %% of it; default label: payload)"
)
_COMPLETE = (
    "auto: add detected effects, and let the rest of the catalogue widen the uncertainty; only-uncertainty: add none; "
    "off: neither (default: %(default)s)"
)
_TOLERANCE = "sd of the robot's geometry; a log may show more (default: 1mm,0.1deg, or what the log shows)"
_IDENTIFY = Command(
    "identify",
    "signs, coefficients and feasible parameters from a log",
    [
        "bayesid identify log.csv --robot ur10e --out result",
        "bayesid identify monday.csv tuesday.csv --robot ur10e --search-budget 30",
        "bayesid identify 'week/*.csv' --each --robot ur10e --workers 2 --out week-by-day",
        "bayesid identify unloaded.csv --robot ur10e --payload 2.8~0.005@loaded.csv",
        "bayesid identify currents.csv --robot my_robot.toml --gains 12~20%,16~20%,10~20%,unknown,11,11",
        "bayesid identify messung.csv --robot kr5r650 --columns 't=Zeit [ms],q=Achse{} [Grad],tau=Moment{}'",
        "bayesid identify my_bag --robot robot.urdf --topic /joint_states",
        "bayesid identify left.csv --robot two_arms.urdf --tip left_flange --hold lift=0.2",
    ],
    [
        path("logs", _LOGS, nargs="+", metavar="log"),
        several("--payload [LABEL:]KG[~SD]@LOG", _MASS),
        several(
            "--log LOG:payload=LABEL", "one more log, with a payload of unknown mass; the same label, the same payload"
        ),
        *_shared(f"{ROBOT} --terms"),
        option("--search certified|beam", "branch and bound with a proof, or T-PBPR (default: %(default)s)"),
        *_shared("--search-budget", f"{_WORK}; later models add up to 20 %% (default: 30)", default=30.0),
        option("--beam-width W", "of the beam: nodes kept each step", type=int, default=5),
        option("--initial-segments S0", "of the beam: segments enumerated first", type=int, default=5),
        *_shared(f"--cutoff --max-memory {READING}"),
        option("--complete auto|only-uncertainty|off", _COMPLETE),
        option("--kinematic-tolerance LENGTH,ANGLE", _TOLERANCE),
        *_shared("--no-posterior", "skip sampling; uncertainties leave the cone out"),
        *_shared("--posterior-budget --nominal --seed --time-limit"),
        *_shared("--constraints"),
        option("--links KG,M", "scales of a link's mass and of its distances from its frame (default: from the robot)"),
        option(
            "--mode K", "of several, that the model is written from (default: 1, the heaviest)", type=whole, default=1
        ),
        flag("--anyway", "search the signs of a log that looks misread too"),
        flag("--each", "identify each log by itself, and say whether the results agree"),
        *_shared("--workers --scheduler"),
        flag("--no-report", "do not make report.html, which takes some seconds"),
        *_shared("--strict"),
        *_out("result folder (default: bayesid-LOG; with --each bayesid-each-LOG)"),
    ],
)
_VALIDATE = Command(
    "validate",
    "a result's model against another log",
    ["bayesid validate result another_log.csv", "bayesid validate result another_log.csv --out validated"],
    [
        *_shared("result log"),
        *_READING,
        *_shared("--cutoff"),
        *_shared("--strict"),
        *_out("folder for summary, signed log and prediction (default: none)"),
    ],
)
_ROWS = "file to write: t,tau1..taun,sd1..sdn,lower1..lowern,upper1..uppern, a row for every row of the motion"
_PREDICT = Command(
    "predict",
    "efforts of a motion by a result's model, with bands",
    [
        "bayesid predict result motion.csv --out torques.csv",
        "bayesid predict result motion.csv --without-noise --out torques.csv",
    ],
    [
        *_shared("result"),
        path("motion", "t,q1..qn[,dq1..dqn] in any format of logs; efforts need not be there"),
        *_shared(f"{MOTION} --cutoff"),
        flag("--without-noise", "bands of the model's effort alone (default: of a measured one, with noise)"),
        *_out(f"{_ROWS} (default: torques.csv)", default=Path("torques.csv"), metavar="FILE.csv"),
    ],
)
_LATER = "log of the same robot; with --robot all later ones, also by a quoted pattern: 'weeks/*.csv'"
_HOLDOUT = "another log, to score by (default: stretches of the log); of several logs, one more like the last"
_DISCREPANCY = Command(
    "discrepancy",
    "what a result's model lacks to explain another log, or what changed from log to log",
    [
        "bayesid discrepancy result another_log.csv --holdout a_third_log.csv --out extended",
        "bayesid discrepancy 2026-03-14.csv 2026-05-02.csv 2026-07-30.csv --robot ur10e --out wear",
    ],
    [
        *_shared("result", "folder of `bayesid identify` or `discrepancy`; or, with --robot, the earliest of the logs"),
        path("logs", _LATER, nargs="*", metavar="log"),
        *_shared("--robot", f"of logs without a result: {_ROBOT}", required=False),
        *_shared("--tip --hold --gravity"),
        *_shared("--terms", f"with --robot: what effects are beyond (default: {TERMS})", default=None),
        *_shared("--constraints", f"with --robot: {_CONSTRAINTS}"),
        path("--holdout LOG", _HOLDOUT),
        *_READING,
        *_shared("--cutoff"),
        *_shared("--search-budget", f"{_WORK} (default: 3 with a result, 30 in the first of several logs)"),
        *_shared("--no-posterior", "skip sampling of the extended model, and of the first log's"),
        *_shared("--posterior-budget --seed --time-limit"),
        *_shared("--strict"),
        *_out("folder of the extended model (default: bayesid-discrepancy-LOG, of the last log)"),
    ],
)
_PAYLOAD = Command(
    "payload",
    "mass, centre of mass and inertia of what the robot carries",
    ["bayesid payload result loaded.csv --out payload", "bayesid payload result loaded.csv --known-mass 2.805~0.005"],
    [
        *_shared("result", "folder that `bayesid identify` wrote, of the robot without the payload"),
        *_shared("log", "log of the same robot with the payload"),
        option("--known-mass KG[~SD]", "of the payload, if it is known: tells how far off all efforts are"),
        option(
            "--common-sd SHARE",
            "sd of what all torques may be off by together, as in 2%% (default: 10%% where no gains are stated, 0 "
            "where they are exact, or as the result has estimated)",
        ),
        *_READING,
        *_shared("--cutoff"),
        *_shared("--search-budget", f"{_WORK} (default: 3)"),
        *_shared("--posterior-budget", default=10.0),
        *_shared("--seed --time-limit"),
        *_shared("--strict"),
        *_out("folder for payload.json (default: none)"),
    ],
)
_FOLLOW = (
    "with -: rows as they come; each is answered at once by a row on the standard output, with the columns of "
    "signed_stream.csv, and alarms by a line of JSON each on the standard error"
)
_PLOT = "a figure too: stream.png (default), or stream.svg"
_TRACK = Command(
    "track",
    "signs, external torques and alarms sample by sample, as they come",
    [
        "bayesid track result another_log.csv --lag 0.05 --plot --out tracked",
        "my_logger | bayesid track result - --follow --rate 125 --lag 0.05 > signed_stream.csv",
    ],
    [
        *_shared("result"),
        *_shared("log", "log of the same robot, replayed row by row; - for the standard input, read to its end first"),
        option("--lag S", "output delay that allows smoothing, s", default=0.0),
        flag("--follow", _FOLLOW),
        option("--rate HZ", "of the samples (default: from the log; needed with --follow)", type=float),
        *_shared("--payload"),
        option("--false-alarms PER_HOUR", "contacts, and changes, accepted where nothing happens", default=0.01),
        option("--plot", _PLOT, nargs="?", const="png", choices=("png", "svg")),
        flag("--explain", "have `bayesid discrepancy` name each change; takes minutes"),
        *_READING,
        *_shared("--strict"),
        *_out("folder for stream and alarms (default: bayesid-track-LOG; with --follow: none)"),
    ],
)
_REPORT = Command(
    "report",
    "the report of a result folder, anew or with a validation",
    ["bayesid report result", "bayesid report result --validation another_log.csv --out to_send.html"],
    [
        *_shared("result"),
        path("--validation LOG", "another log of the same robot to try it on"),
        *_READING,
        *_shared("--cutoff --strict"),
        *_out("default: report.html in the folder", metavar="FILE"),
    ],
)
FOR_RESULT = [
    option(
        "--about NAME,..", "coefficients, parameters, effects, gains, payload, signs (default: all not known to 10 %%)"
    ),
    option("--between A,B,..", "hypotheses to tell apart, EFFECT:JOINT each (default: what a discrepancy left open)"),
    option("--criterion D|A", "D: all together; A: mean variance"),
    option("--start Q1,..", "pose at both ends, rad or m (default: where the result's log began)"),
    *_shared("--payload"),
    option("--effort-limits L1,..", "largest |effort| of each joint, N m (default: of --limits or the robot's URDF)"),
    option("--capsules R,..", "radii of capsules about the links, m, one or one each, instead of the URDF's shapes"),
    option("--tool X,Y,Z", "with --capsules: end of the tool in the last link's frame, m"),
    option("--floor Z", "height of the floor over the base's origin, m, or none (default: 0)", default="0"),
    option("--margin M", "least distance, m", default=0.01),
    several("--meshes DIR", "folder of the packages that the URDF's meshes are in; may be repeated", type=Path),
    option("--changes", "of the motion that are tried (default: as many as take some half a minute)", type=whole),
]
"""Options of `excite` that mean nothing without `--for`."""
FOR_ROBOT = [
    *_shared("--terms"),
    option("--harmonics", "swings of a joint in a period, about", type=whole, default=5),
    option("--periods", "in the duration", type=whole, default=1),
    *_shared("--noise"),
    *_shared("--nominal", "expected parameters, as for identify"),
    *_shared("--cutoff", "of the log's low-pass (default: from the data)"),
    *_shared(f"{READING} --seed"),
]
"""Those that mean nothing with it: the result has its own terms, noise and parameters."""
_LIMITS = (
    "of the joints: TOML with lower, upper, velocity, acceleration, jerk, effort, or a URDF (default: those of the "
    "robot's URDF, else +-2 rad, 3 rad/s, 15 rad/s^2)"
)
_FOR = "result or discrepancy folder: the motion whose recording settles most of what it leaves open"
_EXCITE = Command(
    "excite",
    "a motion to record, for a robot or for what a result leaves open; or what a log's motion leaves undecided",
    [
        "bayesid excite --for result --effort-limits 330,330,150,56,56,56 --capsules 0.06 --floor=-0.8 --out next",
        "bayesid excite --for found --between stribeck_friction:3,thermal_drift:3 --out next",
        "bayesid excite --robot my_robot.toml --limits limits.toml --duration 30 --rate 250 --out motion",
        "bayesid excite --robot ur10e --log log.csv",
    ],
    [
        path("--for RESULT_DIR", _FOR, dest="result"),
        *_shared("--robot", f"without --for, or for limits and shapes: {_ROBOT}", required=False),
        *_shared("--tip --hold --gravity"),
        path("--log", "judge this log's motion; design none"),
        *_shared("--duration --rate"),
        path("--limits FILE", _LIMITS),
        *FOR_ROBOT,
        *_shared("--strict", "with --log: exit code 3 where the verdict is bad"),
        *_out("folder (default: %(default)s)", default=Path("bayesid-motion")),
    ],
    sections={"with --for": FOR_RESULT},
)
_EFFECT = "hide an effect of docs/discrepancy.md, its RMS LEVEL times the joint's effort; may be repeated"
_SIMULATE = Command(
    "simulate",
    "a log of |effort| from a robot with random feasible parameters",
    [
        "bayesid simulate --robot panda --duration 20 --noise 0.05 --out log.csv",
        "bayesid simulate --robot kr5-paper --effect coulomb_friction:2:0.2 --out log.csv",
    ],
    [
        *_shared(f"{ROBOT} --duration --rate --noise"),
        several("--effect NAME:JOINT:LEVEL", _EFFECT),
        *_shared("--seed", "of parameters, trajectory and noise (default: 0)"),
        *_out("log to write", required=True, metavar="LOG.csv"),
    ],
)
_TABLE = (
    "Denavit-Hartenberg table with the columns a, alpha, d, theta, units in their names (a[mm], alpha [deg]), and a "
    "row a joint: a file, - for the standard input, or the text itself (default: a file to fill in)"
)
_CONVENTION = "of the table; needed with one (docs/how-to/data-sheet-robot.md tells how to see which)"
_ROBOT_NEW = Command(
    "new",
    "a robot file from the table of a data sheet, or one to fill in",
    [
        "bayesid robot new --out arm.toml",
        "bayesid robot new table.csv --convention modified --name 'KR 6' --out arm.toml",
        "bayesid robot new 'a[mm] alpha[deg] d[mm] theta[deg]\\n25 -90 400 0' --convention standard --out arm.toml",
    ],
    [
        option("table", _TABLE, nargs="?"),
        option("--convention", _CONVENTION, choices=("standard", "modified")),
        option("--name", "of the robot (default: the file's)"),
        *_out("file to write", required=True, metavar="FILE.toml"),
    ],
)
_ROBOT_SHOW = Command(
    "show",
    "where joints and flange are, to compare with the controller",
    [
        "bayesid robot show kr6r900 --q 0,-90,90,0,0,0 --degrees --out kr6r900.png",
        "bayesid robot show two_arms.urdf --tip left_flange",
    ],
    [
        option("robot", _ROBOT),
        *_shared("--tip --hold --gravity"),
        option("--q Q1,Q2,..", "joint positions, rad or m (default: all zero)"),
        *_shared("--degrees", "the positions are in degrees (m where a joint slides); --no-degrees: in rad"),
        *_out("picture of the skeleton to write: .png, .svg or .pdf (default: none)", metavar="FILE"),
    ],
)
_LISTED = "bayesid robot list", "bayesid robot list | grep -i denso"
_ROBOT_FILES = Command(
    "robot",
    "robot files: make one from a data sheet, look at one, list the built-in ones",
    ["bayesid robot list", "bayesid robot new --out arm.toml", "bayesid robot show arm.toml --out arm.png"],
    commands=[_ROBOT_NEW, _ROBOT_SHOW, Command("list", "the built-in robots", _LISTED)],
)
_DEMO = Command(
    "demo",
    "the paper's experiment, simulated, end to end",
    ["bayesid demo --out demo", "bayesid demo --search beam --paper --out letter"],
    [
        option("--search certified|beam", "branch and bound with a proof, or T-PBPR (default: %(default)s)"),
        flag("--paper", "the paper's search to the letter, none of what bayesid adds; every node is in nodes.csv"),
        *_shared("--seed", "of trajectory and noise (default: 0)"),
        *_shared("--posterior-budget --strict"),
        *_out("result folder (default: %(default)s)", default=Path("bayesid-demo")),
    ],
)
_FLOOR = "of real: all logs, each figure beside the least it may be; exit code 1 where one is worse (8 minutes)"
_STUDY = Command(
    "study",
    "what the method bears, and whether it tells the truth",
    ["bayesid study noise --trials 64 --workers 2", "bayesid study noise --scheduler tcp://HOST:8786 --resume"],
    [
        option("name", "which one, see below", choices=STUDIES.keys(), metavar="NAME"),
        option("--trials N", "how many (default: the study's own number)", type=whole),
        *_shared("--seed", "of the first trials (default: 0)"),
        *_shared("--workers --scheduler"),
        flag("--resume", "keep the rows that are there, run what is missing"),
        flag("--floor", _FLOOR),
        *_out("folder for rows, report and figure (default: bayesid-study-NAME)"),
    ],
    more="\n".join(["studies:", *(f"  {name:<19} {question}" for name, question in STUDIES.items())]),
)
_COMPLETION = Command(
    "completion",
    "a script that completes commands and options in your shell",
    ["bayesid completion bash > ~/.local/share/bash-completion/completions/bayesid"],
    [option("shell", "%(choices)s", choices=("bash", "zsh", "tcsh"))],
)
BAYESID = Command(
    "bayesid",
    "identify robot dynamics from joint positions and the absolute value of the motor currents",
    [
        "bayesid demo",
        "bayesid identify log.csv --robot ur10e --out result",
        "bayesid validate result another_log.csv",
        "bayesid discrepancy result another_log.csv --out extended",
        "bayesid excite --for result --out next",
    ],
    [option("--version", action="version", version=f"bayesid {version('bayesid')}")],
    commands=[
        *(_IDENTIFY, _VALIDATE, _PREDICT, _DISCREPANCY, _PAYLOAD, _TRACK, _REPORT, _EXCITE, _SIMULATE),
        *(_ROBOT_FILES, _DEMO, _STUDY, _COMPLETION),
    ],
    more="`bayesid COMMAND --help` says more, with examples.\n\n"
    "exit codes: 0 done, 1 failed, 2 bad input or a file that would be replaced, 3 a bad verdict with --strict,\n"
    "  130 interrupted, 143 terminated",
)
"""The whole command line; each command is run by the function that `bayesid.cli` names."""


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
