"""What the command line takes: commands, options and their help.

This module imports nothing that computes, so that a shell has its answer at once.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeAlias

from bayesid.cli.parser import MOTION, READING, ROBOT, SHARED, TERMS, Parser, share, whole
from bayesid.cli.tuning import TUNING
from bayesid.errors import missing
from bayesid.study import STUDIES

SHELLS = ("bash", "zsh", "tcsh")
_EXAMPLES = """examples:
  bayesid demo
  bayesid identify log.csv --robot ur10e --out result
  bayesid excite --robot ur10e --out motion
  bayesid report result --validation another_log.csv
  bayesid validate result another_log.csv
  bayesid predict result motion.csv --out torques.csv
  bayesid discrepancy result another_log.csv --holdout a_third_log.csv --out extended
  bayesid payload result loaded.csv --out payload
  bayesid track result another_log.csv --lag 0.05 --out tracked
  bayesid simulate --robot panda --duration 20 --noise 0.05 --out log.csv
  bayesid robot show kr6r900 --q 0,-90,90,0,0,0 --degrees --out skeleton.png
  bayesid study noise --trials 64 --workers 2

`bayesid COMMAND --help` says more, with examples.
"""


_ROBOT_HELP = SHARED["--robot"]["help"]


_EXACT = "N m/A of each joint, for a log of currents (default: those of the result, where it has its own)"


_Commands: TypeAlias = "argparse._SubParsersAction[Parser]"


def _share_reading(parser: Parser, *others: str) -> None:
    """How a log is to be read beside a result, whose gains are no unknowns any more."""
    share(parser, "--gains", help=_EXACT)
    share(parser, *READING[1:], *others)


def _add_out(parser: Parser, **changes: Any) -> None:
    share(parser, "--out", **changes)
    share(parser, "--quiet")


def make_parser() -> Parser:
    """All commands; each is run by the function that `bayesid.cli` names."""
    parser = Parser(
        prog="bayesid",
        description="Identify robot dynamics from joint positions and the absolute value of the motor currents.",
        epilog=_EXAMPLES,
    )
    parser.add_argument("--version", action="version", version=f"bayesid {version('bayesid')}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=Parser)
    for add in (
        _add_identify,
        _add_validate,
        _add_predict,
        _add_discrepancy,
        _add_payload,
        _add_track,
        _add_report,
        _add_excite,
        _add_simulate,
        _add_robot,
        _add_demo,
        _add_study,
        _add_completion,
    ):
        add(commands)
    parser.commands = dict(commands.choices)
    return parser


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """The options of one command, see `Parser.understand`."""
    return make_parser().understand(arguments)


def _command(commands: _Commands, name: str, purpose: str, examples: Sequence[str], more: str = "") -> Parser:
    """A command with its help: what it does and examples to copy."""
    lines = "\n".join(["examples:", *(f"  {example}" for example in examples), *([f"\n{more}"] if more else [])])
    parser = commands.add_parser(name, help=purpose, description=f"{purpose[0].upper()}{purpose[1:]}.", epilog=lines)
    parser.set_defaults(command=name)
    return parser


def _action(actions: _Commands, name: str, purpose: str, examples: Sequence[str]) -> Parser:
    parser = _command(actions, name, purpose, examples)
    parser.set_defaults(command="robot", action=name)
    return parser


def _add_identify(commands: _Commands) -> None:
    examples = [
        "bayesid identify log.csv --robot ur10e --out result",
        "bayesid identify currents.csv --robot my_robot.toml --gains 14.9,13.3,11.1,10.6,11.0,11.5",
        "bayesid identify monday.csv tuesday.csv --robot ur10e --search-budget 30",
        "bayesid identify 'week/*.csv' --each --robot ur10e --workers 2 --out week-by-day",
        "bayesid identify unloaded.csv --robot ur10e --payload 2.8~0.005@loaded.csv",
        "bayesid identify currents.csv --robot my_robot.toml --gains 12~20%,16~20%,10~20%,unknown,11,11",
        "bayesid identify kuka_rsi.csv --robot kr5 --gains 2.1,2.0,1.1,0.6,0.6,0.3",
        "bayesid identify messung.csv --robot kr5 --columns 't=Zeit [ms],q=Achse{} [Grad],tau=Moment{}'",
        "bayesid identify my_bag --robot robot.urdf --topic /joint_states",
        "bayesid identify left.csv --robot two_arms.urdf --tip left_flange --hold lift=0.2",
    ]
    parser = _command(commands, "identify", "signs, coefficients and feasible parameters from a log", examples)
    _add_logs(parser)
    share(parser, *ROBOT, "--terms")
    search = "certified: branch and bound, the best signs with a proof; beam: T-PBPR (default: %(default)s)"
    parser.add_argument("--search", choices=("certified", "beam"), default="certified", help=search)
    budget = "work of all searches, about seconds of an idle core; later models add up to 20 %% (default: %(default)g)"
    share(parser, "--search-budget", default=30.0, help=budget)
    width, first = (
        "of the beam: nodes kept each step (default: 5)",
        "of the beam: segments enumerated first (default: 5)",
    )
    parser.add_argument("--beam-width", type=int, default=5, metavar="W", help=width)
    parser.add_argument("--initial-segments", type=int, default=5, metavar="S0", help=first)
    share(parser, "--cutoff", "--max-memory", *READING)
    complete = (
        "what the log wants of the catalogue beyond the terms: auto adds effects that evidence and held-back blocks "
        "bear out, the rest widens the uncertainty; only-uncertainty adds none; off asks nothing (default: %(default)s)"
    )
    parser.add_argument("--complete", choices=("auto", "only-uncertainty", "off"), default="auto", help=complete)
    tolerance = (
        "how far the robot's geometry may be from its table, as sd; a log may show more, not less "
        "(default: 1mm,0.1deg, or what the log shows)"
    )
    parser.add_argument("--kinematic-tolerance", metavar="LENGTH,ANGLE", help=tolerance)
    share(parser, "--no-posterior", help="skip sampling; uncertainties leave the cone out")
    share(parser, "--posterior-budget", "--nominal", "--seed", "--time-limit")
    links = "scales of a link's mass and of its distances from its frame (default: from the robot and its efforts)"
    parser.add_argument("--links", metavar="KG,M", help=links)
    mode = "of the posterior that the model is written from, where it has several (default: 1, the heaviest)"
    parser.add_argument("--mode", type=whole, default=1, metavar="K", help=mode)
    each = "identify each log by itself, and say whether the results agree"
    parser.add_argument("--each", action="store_true", help=each)
    share(parser, "--workers", "--scheduler")
    parser.add_argument("--no-report", action="store_true", help="do not make report.html, which takes some seconds")
    _add_out(parser, help="result folder (default: bayesid-LOG; with --each bayesid-each-LOG)")


def _add_logs(parser: Parser) -> None:
    logs = (
        "t,q1..qn[,dq1..dqn],tau1..taun (or i1..in with --gains) as CSV, Parquet or MATLAB file, a ROS bag or a "
        "KUKA table; several logs of one robot count as one, also by a quoted pattern: 'runs/*.csv'; "
        "files of one run with a + between them are joined by time: positions.csv+currents.csv; or a TOML file that "
        'lists logs: tables [[logs]] with file = "loaded.csv" and, where the flange carries something, payload = '
        '"tool1" and mass = 2.8 or [2.8, 0.005]'
    )
    parser.add_argument("logs", type=Path, nargs="+", metavar="log", help=logs)
    payload = (
        "one more log, recorded with a payload of this mass on the flange, whose parameters act in its logs alone; the "
        "mass enters the posterior, and fixes the factor of uncertain gains "
        f"(default sd: {100 * TUNING.payload_mass_sd:g} %% of it; default label: payload)"
    )
    metavar = "[LABEL:]KG[~SD]@LOG"
    parser.add_argument("--payload", action="append", default=[], metavar=metavar, help=payload)
    carried = "one more log, recorded with a payload of unknown mass; logs with the same label carry the same"
    parser.add_argument("--log", action="append", default=[], metavar="LOG:payload=LABEL", help=carried)


def _add_validate(commands: _Commands) -> None:
    examples = ["bayesid validate result another_log.csv", "bayesid validate result another_log.csv --out validated"]
    parser = _command(commands, "validate", "a result's model against another log", examples)
    parser.add_argument("result", type=Path, help="folder that `bayesid identify` wrote")
    parser.add_argument("log", type=Path, help="log of the same robot")
    _share_reading(parser, "--cutoff")
    _add_out(parser, help="folder for summary, signed log and prediction (default: none)")


def _add_predict(commands: _Commands) -> None:
    examples = [
        "bayesid predict result motion.csv --out torques.csv",
        "bayesid predict result motion.csv --without-noise --out torques.csv",
    ]
    parser = _command(commands, "predict", "efforts of a motion by a result's model, with bands", examples)
    parser.add_argument("result", type=Path, help="folder that `bayesid identify` wrote")
    motion = "t,q1..qn[,dq1..dqn] in any format of logs; efforts need not be there"
    parser.add_argument("motion", type=Path, help=motion)
    share(parser, *MOTION, "--cutoff")
    noise = "sd and bands of the model's effort alone (default: of a measured effort, with its noise)"
    parser.add_argument("--without-noise", action="store_true", help=noise)
    columns = "file to write: t,tau1..taun,sd1..sdn,lower1..lowern,upper1..uppern, a row for every row of the motion"
    _add_out(parser, required=True, metavar="FILE.csv", help=columns)


def _add_discrepancy(commands: _Commands) -> None:
    examples = [
        "bayesid discrepancy result another_log.csv --holdout a_third_log.csv --out extended",
        "bayesid discrepancy 2026-03-14.csv 2026-05-02.csv 2026-07-30.csv --robot ur10e --out wear",
    ]
    purpose = "what a result's model lacks to explain another log, or what changed from log to log"
    parser = _command(commands, "discrepancy", purpose, examples)
    result = "folder that `bayesid identify` or `bayesid discrepancy` wrote; or, with --robot, the earliest of the logs"
    parser.add_argument("result", type=Path, help=result)
    logs = "log of the same robot; with --robot all later ones, also by a quoted pattern: 'weeks/*.csv'"
    parser.add_argument("logs", type=Path, nargs="*", metavar="log", help=logs)
    share(parser, "--robot", required=False, help=f"of logs without a result: {SHARED['--robot']['help']}")
    share(parser, "--tip", "--hold")
    share(parser, "--terms", default=None, help=f"with --robot: what effects are beyond (default: {TERMS})")
    holdout = "another log, to score by (default: stretches of the log); of several logs, one more like the last"
    parser.add_argument("--holdout", type=Path, metavar="LOG", help=holdout)
    _share_reading(parser, "--cutoff")
    budget = "work of the proof of signs, about seconds of an idle core: under a result's extended model (default: 3), "
    budget += "or in the first log (30)"
    share(parser, "--search-budget", help=budget)
    share(parser, "--no-posterior", help="skip sampling of the extended model, and of the first log's")
    share(parser, "--posterior-budget", "--seed", "--time-limit")
    _add_out(parser, help="folder of the extended model (default: bayesid-discrepancy-LOG, of the last log)")


def _add_payload(commands: _Commands) -> None:
    examples = [
        "bayesid payload result loaded.csv --out payload",
        "bayesid payload result loaded.csv --known-mass 2.805~0.005",
    ]
    purpose = "mass, centre of mass and inertia of what the robot carries"
    parser = _command(commands, "payload", purpose, examples)
    result = "folder that `bayesid identify` wrote, of the robot without the payload"
    parser.add_argument("result", type=Path, help=result)
    parser.add_argument("log", type=Path, help="log of the same robot with the payload")
    mass = "of the payload, if it is known, and its standard deviation: tells how far off all efforts are"
    parser.add_argument("--known-mass", metavar="KG[~SD]", help=mass)
    _share_reading(parser, "--cutoff")
    share(parser, "--search-budget", help="work of the proof of signs, about seconds of an idle core (default: 3)")
    budget = "work of sampling, about seconds of an idle machine; it ends when it has converged (default: %(default)g)"
    share(parser, "--posterior-budget", default=10.0, help=budget)
    share(parser, "--seed", "--time-limit")
    _add_out(parser, help="folder for payload.json (default: none)")


def _add_track(commands: _Commands) -> None:
    examples = [
        "bayesid track result another_log.csv --lag 0.05 --plot --out tracked",
        "my_logger | bayesid track result - --follow --rate 125 --lag 0.05 > signed_stream.csv",
    ]
    purpose = "signs, external torques and alarms sample by sample, as they come"
    parser = _command(commands, "track", purpose, examples)
    parser.add_argument("result", type=Path, help="folder that `bayesid identify` wrote")
    log = (
        "log of the same robot, which is replayed row by row; - for the standard input, which is read to its end first"
    )
    parser.add_argument("log", type=Path, help=log)
    lag = "that an instant may be judged later, with the samples up to then (default: %(default)g)"
    parser.add_argument("--lag", type=float, default=0.0, metavar="S", help=lag)
    follow = (
        "with -: rows as they come; each is answered at once by a row on the standard output, with the columns of "
        "signed_stream.csv, and alarms by a line of JSON each on the standard error"
    )
    parser.add_argument("--follow", action="store_true", help=follow)
    rate = "of the samples (default: from the log; needed with --follow)"
    parser.add_argument("--rate", type=float, metavar="HZ", help=rate)
    payload = "label of what the flange carries, one that the result knows (default: it carries nothing)"
    parser.add_argument("--payload", default="", metavar="LABEL", help=payload)
    alarms = "contacts, and changes, an hour that are accepted where nothing happens (default: %(default)g)"
    parser.add_argument("--false-alarms", type=float, default=0.01, metavar="PER_HOUR", help=alarms)
    plot = "a figure too: stream.png (default), or stream.svg"
    parser.add_argument("--plot", nargs="?", const="png", choices=("png", "svg"), help=plot)
    explain = "have `bayesid discrepancy` name each change, by the log from the alarm's time on; takes minutes"
    parser.add_argument("--explain", action="store_true", help=explain)
    _share_reading(parser)
    out = "folder for signed_stream.csv, alarms.json, stream.json (default: bayesid-track-LOG; with --follow: none)"
    _add_out(parser, help=out)


def _add_report(commands: _Commands) -> None:
    examples = ["bayesid report result", "bayesid report result --validation another_log.csv --out to_send.html"]
    parser = _command(commands, "report", "the report of a result folder, anew or with a validation", examples)
    parser.add_argument("result", type=Path, help="folder that `bayesid identify` wrote")
    validation = "another log of the same robot to try it on"
    parser.add_argument("--validation", type=Path, metavar="LOG", help=validation)
    _share_reading(parser, "--cutoff")
    _add_out(parser, metavar="FILE", help="default: report.html in the folder")


def _add_excite(commands: _Commands) -> None:
    purpose = (
        "a motion to record, for a robot or for what a result leaves open; or what a log's motion leaves undecided"
    )
    examples = [
        "bayesid excite --for result --effort-limits 330,330,150,56,56,56 --capsules 0.06 --floor=-0.8 --out next",
        "bayesid excite --for result --about Fc3,gains --out next",
        "bayesid excite --for found --between stribeck_friction:3,thermal_drift:3 --out next",
        "bayesid excite --robot ur10e --out motion",
        "bayesid excite --robot my_robot.toml --limits limits.toml --duration 30 --rate 250 --out motion",
        "bayesid excite --robot ur10e --log log.csv",
    ]
    parser = _command(commands, "excite", purpose, examples)
    result = "result or discrepancy folder: the motion whose recording settles most of what it leaves open"
    parser.add_argument("--for", type=Path, dest="result", metavar="RESULT_DIR", help=result)
    share(parser, "--robot", required=False, help=f"without --for, or for limits and shapes: {_ROBOT_HELP}")
    share(parser, *ROBOT[1:], "--terms")
    parser.add_argument("--log", type=Path, help="judge this log's motion; design none")
    _add_next_motion(parser)
    parser.add_argument("--duration", type=float, default=20.0, metavar="S", help="default: %(default)s")
    parser.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="of the file (default: %(default)s)")
    limits = (
        "of the joints: TOML with lower, upper, velocity, acceleration, jerk, effort, or a URDF (default: those of the "
        "robot's URDF, else +-2 rad, 3 rad/s, 15 rad/s^2)"
    )
    parser.add_argument("--limits", type=Path, metavar="FILE", help=limits)
    parser.add_argument("--harmonics", type=whole, default=5, help="swings of a joint in a period, about (default: 5)")
    parser.add_argument("--periods", type=whole, default=1, help="in the duration (default: 1)")
    share(parser, "--noise")
    share(parser, "--nominal", help="expected parameters, as for identify")
    share(parser, "--cutoff", help="of the log's low-pass (default: from the data)")
    share(parser, *READING, "--seed")
    _add_out(parser, default=Path("bayesid-motion"), help="folder (default: %(default)s)")


def _add_next_motion(parser: Parser) -> None:
    """What `excite --for` takes alone."""
    add = parser.add_section("with --for")
    about = "coefficients, parameters, effects, or gains, payload, signs (default: all not known to 10 %%)"
    add("--about", metavar="NAME,..", help=about)
    between = "hypotheses to tell apart, EFFECT:JOINT each (default: those that a discrepancy could not tell apart)"
    add("--between", metavar="A,B,..", help=between)
    add("--criterion", choices=("D", "A"), default="D", help="D: all together; A: mean variance")
    start = "pose at both ends, rad or m (default: where the result's log began)"
    add("--start", metavar="Q1,..", help=start)
    payload = "label of what the flange carries, one that the result knows (default: it carries nothing)"
    add("--payload", default="", metavar="LABEL", help=payload)
    efforts = "largest |effort| of each joint, N m (default: those of --limits or of the robot's URDF)"
    add("--effort-limits", metavar="L1,..", help=efforts)
    capsules = "radii of capsules about the links, m, one for all or one each, instead of the URDF's collision shapes"
    add("--capsules", metavar="R,..", help=capsules)
    add("--tool", metavar="X,Y,Z", help="with --capsules: end of the tool in the last link's frame, m")
    floor = "height of the floor over the base's origin, m, or none (default: 0)"
    add("--floor", default="0", metavar="Z", help=floor)
    add("--margin", type=float, default=0.01, metavar="M", help="least distance (default: %(default)s m)")
    meshes = "folder of the packages that the URDF's meshes are in; may be repeated"
    add("--meshes", type=Path, action="append", default=[], metavar="DIR", help=meshes)
    changes = "of the motion that are tried (default: as many as take some half a minute)"
    add("--changes", type=whole, help=changes)


def _add_simulate(commands: _Commands) -> None:
    examples = [
        "bayesid simulate --robot panda --duration 20 --noise 0.05 --out log.csv",
        "bayesid simulate --robot kr5 --effect coulomb_friction:2:0.2 --out log.csv",
    ]
    purpose = "a log of |effort| from a robot with random feasible parameters"
    parser = _command(commands, "simulate", purpose, examples)
    share(parser, *ROBOT)
    parser.add_argument("--duration", type=float, default=20.0, metavar="S", help="default: %(default)s")
    parser.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="default: %(default)s")
    share(parser, "--noise")
    effect = "hide an effect of docs/discrepancy.md, its RMS LEVEL times the joint's effort; may be repeated"
    parser.add_argument("--effect", action="append", default=[], metavar="NAME:JOINT:LEVEL", help=effect)
    share(parser, "--seed", help="of parameters, trajectory and noise (default: 0)")
    _add_out(parser, required=True, metavar="LOG.csv", help="log to write")


def _add_robot(commands: _Commands) -> None:
    examples = [
        "bayesid robot list",
        "bayesid robot new --out arm.toml",
        "bayesid robot new table.csv --convention modified --out arm.toml",
        "bayesid robot show arm.toml --q 0,-90,90,0,0,0 --degrees --out arm.png",
    ]
    purpose = "robot files: make one from a data sheet, look at one, list the built-in ones"
    parser = _command(commands, "robot", purpose, examples)
    actions = parser.add_subparsers(required=True, metavar="ACTION", parser_class=Parser)
    for add in (_add_robot_new, _add_robot_show, _add_robot_list):
        add(actions)
    parser.commands = dict(actions.choices)


def _add_robot_new(actions: _Commands) -> None:
    examples = [
        "bayesid robot new --out arm.toml",
        "bayesid robot new table.csv --convention modified --name 'KR 6' --out arm.toml",
        "bayesid robot new 'a[mm] alpha[deg] d[mm] theta[deg]\\n25 -90 400 0' --convention standard --out arm.toml",
    ]
    parser = _action(actions, "new", "a robot file from the table of a data sheet, or one to fill in", examples)
    table = (
        "Denavit-Hartenberg table with the columns a, alpha, d, theta, units in their names (a[mm], alpha [deg]), and "
        "a row a joint: a file, - for the standard input, or the text itself (default: a file to fill in)"
    )
    parser.add_argument("table", nargs="?", help=table)
    convention = "of the table; needed with one (docs/how-to/data-sheet-robot.md tells how to see which)"
    parser.add_argument("--convention", choices=("standard", "modified"), help=convention)
    parser.add_argument("--name", help="of the robot (default: the file's)")
    parser.add_argument("--force", action="store_true", help="replace an earlier file")
    _add_out(parser, required=True, metavar="FILE.toml", help="file to write")


def _add_robot_show(actions: _Commands) -> None:
    examples = [
        "bayesid robot show kr6r900 --q 0,-90,90,0,0,0 --degrees --out kr6r900.png",
        "bayesid robot show arm.toml --q 0.3,-1.2,0.8",
        "bayesid robot show two_arms.urdf --tip left_flange",
    ]
    parser = _action(actions, "show", "where joints and flange are, to compare with the controller", examples)
    parser.add_argument("robot", help=SHARED["--robot"]["help"])
    share(parser, "--tip", "--hold")
    parser.add_argument("--q", metavar="Q1,Q2,..", help="joint positions, rad or m (default: all zero)")
    degrees = "the positions are in degrees (m where a joint slides); --no-degrees: in rad, however large"
    share(parser, "--degrees", help=degrees)
    _add_out(parser, metavar="FILE", help="picture of the skeleton to write: .png, .svg or .pdf (default: none)")


def _add_robot_list(actions: _Commands) -> None:
    examples = ["bayesid robot list", "bayesid robot list | grep -i denso"]
    _action(actions, "list", "the built-in robots and where their tables are published", examples)


def _add_demo(commands: _Commands) -> None:
    purpose = "the paper's experiment, simulated, end to end"
    parser = _command(commands, "demo", purpose, ["bayesid demo --out demo"])
    share(parser, "--out", default=Path("bayesid-demo"), help="result folder (default: %(default)s)")
    share(parser, "--seed", help="of trajectory and noise (default: 0)")
    share(parser, "--posterior-budget")
    share(parser, "--quiet")


def _add_study(commands: _Commands) -> None:
    width = max(map(len, STUDIES))
    names = "\n".join(["studies:", *(f"  {name:<{width}}  {question}" for name, question in STUDIES.items())])
    examples = [
        "bayesid study noise --trials 64 --workers 2",
        "bayesid study noise --scheduler tcp://HOST:8786 --resume",
    ]
    parser = _command(commands, "study", "what the method bears, and whether it tells the truth", examples, names)
    parser.add_argument("name", choices=list(STUDIES), metavar="NAME", help="which one, see below")
    parser.add_argument("--trials", type=whole, metavar="N", help="how many (default: the study's own number)")
    share(parser, "--seed", help="of the first trials (default: 0)")
    share(parser, "--workers", "--scheduler")
    parser.add_argument("--resume", action="store_true", help="keep the rows that are there, run what is missing")
    floor = (
        "of real: all logs, each figure beside the least it may be; exit code 1 where one is worse (8 minutes, 2 cores)"
    )
    parser.add_argument("--floor", action="store_true", help=floor)
    _add_out(parser, help="folder for rows, report and figure (default: bayesid-study-NAME)")


def _add_completion(commands: _Commands) -> None:
    examples = [
        "bayesid completion bash > ~/.local/share/bash-completion/completions/bayesid",
        'bayesid completion zsh > "${fpath[1]}/_bayesid"',
    ]
    purpose = "a script that completes commands and options in your shell"
    parser = _command(commands, "completion", purpose, examples)
    parser.add_argument("shell", choices=SHELLS, help="%(choices)s")


def completion_command(options: argparse.Namespace) -> None:
    """Prints a script for the user's shell."""
    try:
        import shtab
    except ImportError:
        raise missing("shtab", "completion", "bayesid completion") from None
    main = make_parser()
    for parser in _parsers(main):
        for action in parser.paths:
            vars(action)["complete"] = shtab.FILE
    print(shtab.complete(main, shell=options.shell))


def _parsers(parser: Parser) -> Iterator[Parser]:
    yield parser
    for command in parser.commands.values():
        yield from _parsers(command)
