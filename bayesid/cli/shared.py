"""Options of several commands, each with one line of help."""

from __future__ import annotations

import argparse
from typing import Any

from bayesid.cli.parser import Option, flag, option, path, seed, whole
from bayesid.files.config import CONFIG

TERMS = "rigid_body,viscous_friction,coulomb_friction,torque_offset,rotor_inertia"
"""`bayesid.effects.STANDARD`, spelled out: to import the catalogue for a help text takes a second."""
CHAIN = "--tip --hold --gravity"
"""Which joints of a robot, and how it is mounted."""
MOTION = "--degrees --columns --topic --joints --correct"
"""How a motion is to be read."""
READING = f"--gains --unsigned --encoding {MOTION}"
"""How a log is to be read, see `bayesid.read_log`."""
WORK = "work of the proof, about seconds"
_SHARED = dict(
    [
        path("result", "folder that `bayesid identify` wrote"),
        path("log", "log of the same robot"),
        option("--robot ROBOT", "name (`bayesid robot list`), TOML file or URDF"),
        option("--tip LINK", "URDF: last link (default: all but grippers)"),
        option("--hold JOINT=Q,..", "URDF: more joints that are held, rad or m"),
        option("--gravity X,Y,Z", "m/s^2 in the base frame; upside down: 0,0,9.81"),
        option("--terms NAME,..", "effects of the model (default: see below)", default=TERMS),
        path("--constraints TOML", "what parameters satisfy: total_mass = [27, 31]"),
        path("--nominal CSV", "parameters known before: name,mean,sd"),
        option("--cutoff HZ", "low-pass of the motion (default: from the data)", type=float),
        option("--gains K1,K2,..", "N m/A a joint; estimated: 12~20%% or unknown"),
        option("--unsigned JOINTS", "all, none or 1,3 (default: never negative)"),
        option("--encoding CODE", "of signs in readings without a minus: twos:16"),
        option("--degrees", "positions without a unit: degrees, or rad", action=argparse.BooleanOptionalAction),
        option("--columns t=..,q=..", "names of columns: t=Zeit,q=A{},i=I{}; or TOML"),
        option("--topic /NAME", "ROS bag: topic of the joint states"),
        option("--joints A,B,..", "ROS bag: names of joints from base to tip"),
        option("--correct q2=-q2,..", "exchange, turn, scale or shift joints"),
        path("--config FILE", f"options in TOML (default: {CONFIG}, if any)"),
        option("--max-memory GB", "most that a run may need (default: 80 %%)", type=float),
        option("--search-budget S", WORK, type=float),
        flag("--no-posterior", "skip sampling"),
        option("--posterior-budget S", "work of sampling, about seconds", default=60.0),
        option("--noise REL", "of each joint's RMS", default=0.05),
        option("--seed K", "of everything random", type=seed, default=0),
        option("--time-limit S", "of search and of sampling, s", default=600.0),
        option("--workers K", "processes (default: one a core)", type=whole),
        option("--scheduler ADDRESS", "of a Dask cluster: tcp://HOST:PORT"),
        option("--payload LABEL", "what the flange carries (default: nothing)", default=""),
        option("--duration S", "s", default=20.0),
        option("--rate HZ", "of the file", default=100.0),
        path("--out DIR", ""),
        flag("--force", "replace what is there"),
        flag("--strict", "exit code 3 where the verdict is bad"),
        flag("--quiet", "print only warnings and errors"),
    ]
)


def shared(names: str, help: str | None = None, **changes: Any) -> list[Option]:
    """Options of several commands, changed where a command means something else by them."""
    changes |= {} if help is None else {"help": help}
    return [(name, _SHARED[name] | changes) for name in names.split()]


def out(help: str, **changes: Any) -> list[Option]:
    """Where a command writes, and how it ends."""
    return [*shared("--out", help, **changes), *shared("--force --quiet")]


def reading_of_result() -> dict[str, list[Option]]:
    """How a log is to be read beside a result, by exact gains, where it differs from the result's log."""
    return {
        "how the log is read (default: as the result's log)": [
            *shared("--gains", "N m/A of each joint"),
            *shared(f"--unsigned --encoding {MOTION}"),
        ]
    }
