"""Options of several commands, each with one line of help."""

from __future__ import annotations

import argparse
from typing import Any

from bayesid.cli.parser import Option, flag, option, path, seed, whole
from bayesid.files.config import CONFIG

TERMS = "rigid_body,viscous_friction,coulomb_friction,torque_offset,rotor_inertia"
"""`bayesid.effects.STANDARD` as text, since importing the catalogue takes a second."""
CHAIN = "--tip --hold --gravity"
"""Which joints of a robot, and how it is mounted."""
MOTION = "--degrees --columns --topic --joints --correct"
"""Options for reading a motion."""
FIRST_READING = "--gains --columns --degrees --correct"
"""The most frequent options for reading a log; the short help shows them."""
READING = f"--gains --unsigned --encoding {MOTION}"
"""Options for reading a log, see `bayesid.read_log`."""
EXACT_GAINS = "drive gains of all joints, N m/A"
WORK = "work of the search, nominal seconds"
_SHARED = dict(
    [
        path("result", "folder that `bayesid identify` wrote"),
        path("log", "log of the same robot"),
        option("--robot ROBOT", "name (`bayesid robot list`), TOML file or URDF"),
        option("--tip LINK", "URDF: last link (default: all but grippers)"),
        option("--hold JOINT=Q,..", "URDF: joints fixed at a position, rad or m"),
        option("--gravity X,Y,Z", "in the base frame, m/s^2; on a ceiling: 0,0,9.81"),
        option("--terms NAME,..", "standard effects of the model (default: see below)", default=TERMS),
        path("--constraints TOML", "bounds on parameters: total_mass = [27, 31]"),
        path("--nominal CSV", "known parameters: name,mean,sd"),
        option("--cutoff HZ", "low-pass cut-off (default: from the data)", type=float),
        option("--gains K1,K2,..", "drive gains, N m/A; to estimate: 12~20%% or unknown"),
        option("--unsigned JOINTS", "joints of |effort|: all, none, 1,3 (default: auto)"),
        option("--encoding CODE", "code of signs in the log: twos:16, sign-bit:10"),
        option(
            "--degrees", "positions without a unit are in degrees, or in rad", action=argparse.BooleanOptionalAction
        ),
        option("--columns t=..,q=..", "t=Zeit,q=A{},i=I{}; {}: joint number; or TOML file"),
        option("--topic /NAME", "ROS bag: topic of the joint states"),
        option("--joints A,B,..", "the log's joint names, from base to tip"),
        option("--correct q2=-q2,..", "exchange, flip, scale or shift joints"),
        path("--config FILE", f"file or result with options (default: {CONFIG})"),
        option("--max-memory GB", "memory limit (default: 80 %% of the machine's)", type=float),
        option("--search-budget S", WORK, type=float),
        flag("--no-posterior", "skip sampling: faster, approximate intervals"),
        option("--posterior-budget S", "work of sampling, nominal seconds", default=60.0),
        option("--noise REL", "noise over each joint's RMS effort", default=0.05),
        option("--seed K", "seed of all random numbers", type=seed, default=0),
        option("--time-limit S", "limit of search, and of sampling, s", default=600.0),
        option("--workers K", "processes (default: one per core)", type=whole),
        option("--scheduler ADDRESS", "Dask cluster: tcp://HOST:PORT"),
        option("--payload LABEL", "label of the payload on the flange (default: none)", default=""),
        option("--duration S", "length of the motion, s", default=20.0),
        option("--rate HZ", "sampling rate of the file, Hz", default=100.0),
        path("--out DIR", ""),
        flag("--force", "replace an earlier result"),
        flag("--strict", "exit code 3 if the verdict is bad"),
        flag("--quiet", "print only warnings, errors and a bad verdict"),
    ]
)


def shared(names: str, help: str | None = None, **changes: Any) -> list[Option]:
    """Options of several commands; `help` and `changes` replace settings."""
    changes |= {} if help is None else {"help": help}
    return [(name, _SHARED[name] | changes) for name in names.split()]


def out(help: str, more: str = "--force --quiet", **changes: Any) -> list[Option]:
    """Options for output; `more` are those besides --out."""
    return [*shared("--out", help, **changes), *shared(more)]


def first_reading_of_result() -> list[Option]:
    """The most frequent options for reading a log with a result."""
    return [*shared("--gains", EXACT_GAINS), *shared("--columns --degrees --correct")]


def reading_of_result() -> dict[str, list[Option]]:
    """Further options for reading a log with a result."""
    return {
        "how the log is read": [
            *shared("--unsigned", "joints with |effort|: all, none or 1,3"),
            *shared("--encoding --topic --joints"),
        ]
    }
