"""Options of several commands: logs, robot, prior, sampling, and the end of a command."""

from __future__ import annotations

import argparse
import itertools
import math
import re
import shlex
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping, Set
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from rich.console import RenderableType

from bayesid.cli import RedVerdictError
from bayesid.cli.terminal import console, note, show, verdict_parts, warn
from bayesid.effects import RigidBody
from bayesid.errors import BayesidError, InputError, printable
from bayesid.files.config import CONFIG, OF_MODEL, OF_READING, plain_config
from bayesid.files.writing import check_folder, check_place
from bayesid.identification.identified_model import IdentifiedModel
from bayesid.log.formats.stated import parse_columns
from bayesid.log.formats.table import ReadingNote
from bayesid.log.gains import Gains
from bayesid.log.kept_reading import in_words, read_alike
from bayesid.log.log import Log, RecordedMotion
from bayesid.log.reading import read_log, read_motion
from bayesid.posterior.sampler import Sampling
from bayesid.regression.knowledge import ParameterPrior, read_nominal
from bayesid.report.conclusion import Conclusion
from bayesid.robot import Robot, load_robot
from bayesid.robot.load import alias_note

_SUFFIXES = ".csv", ".html", ".json", ".png", ".svg", ".toml"
"""Endings of files that the commands read or write; `--out` of a folder has none of them."""
_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "deg": math.pi / 180.0, "mrad": 1e-3, "rad": 1.0}


def command_line() -> str:
    """The command line."""
    return printable(shlex.join(["bayesid", *sys.argv[1:]]))


def config_of(options: argparse.Namespace) -> dict[str, Any]:
    """Options of the model from the command line or a bayesid.toml, for the bayesid.toml of a result."""
    configured = {} if options.configured is None else options.configured.words
    stated = [name for name in OF_MODEL if f"--{name}" in {*options.given, *configured}]
    return plain_config({name: getattr(options, name.replace("-", "_")) for name in stated})


def robot_of(options: argparse.Namespace, notes: bool = False, of_log: bool = False) -> Robot:
    """The robot with the joints to identify; warns of its notes.

    Args:
        options: of the command.
        notes: whether to print its notes.
        of_log: whether a log of this robot is read, whose positions depend on its zero pose.
    """
    if options.robot is None:
        remedy = f"give --robot, or `robot` in {CONFIG}; `bayesid robot list` shows the built-in ones"
        raise InputError("no robot is given", "--robot", remedy)
    gravity = numbers(options.gravity, "--gravity", "give three numbers, m/s^2, as in 0,0,9.81")
    held = None if options.hold is None else _positions(options.hold)
    robot = load_robot(options.robot, options.tip, held, gravity)
    if robot.origin is not None and robot.origin.urdf is not None and not Path(options.robot).is_file():
        warn(f"{options.robot} is not built in; using {robot.origin.urdf} of an installed package")
    for remark in robot.notes if notes else ():
        warn(remark)
    if of_log and (note := alias_note(options.robot)):
        warn(note)
    return robot


def given_robot(options: argparse.Namespace) -> list[str]:
    """The robot's options as words of a command line."""
    given = {name: getattr(options, name) for name in ("robot", "tip", "hold", "gravity")}
    return [word for name, value in given.items() if value is not None for word in (f"--{name}", str(value))]


def given_reading(options: argparse.Namespace) -> list[str]:
    """The options of reading a log as words of a command line."""
    return in_words({name: value for name in OF_READING if (value := getattr(options, name)) is not None})


def _positions(text: str) -> dict[str, float]:
    words = [word.partition("=") for word in text.split(",")]
    try:
        return {name.strip(): float(position) for name, _, position in words}
    except ValueError:
        raise InputError(f"{text!r} are not positions", "--hold", "give JOINT=POSITION,.. in rad or m") from None


def numbers(
    text: str | None, option: str, remedy: str = "give numbers separated by commas"
) -> tuple[float, ...] | None:
    """The finite numbers of an option; None where it is not given."""
    try:
        found = None if text is None else tuple(float(word) for word in text.split(","))
    except ValueError:
        raise InputError(f"{text!r:.60} is not a list of numbers", option, remedy) from None
    if found is not None and not all(map(math.isfinite, found)):
        raise InputError(f"{text!r:.60} cannot be used", option, "give finite numbers")
    return found


def check_file(options: argparse.Namespace, out: Path) -> None:
    """Checks that a file can be written into an existing folder, and replaces no other.

    Raises:
        InputError: it cannot, or there is one and --force was not given.
    """
    if out.is_dir():
        seen = f"is a folder, but `bayesid {options.command}` writes one file"
        raise InputError(seen, str(out), "give --out the name of a file")
    check_place(out)
    if not out.parent.is_dir():
        raise InputError(
            f"cannot be written (there is no folder {out.parent})", str(out), "create it, or correct --out"
        )
    if out.exists():
        _keep(options, out, "exists already")


def check_new(options: argparse.Namespace, folder: Path, files: Set[str], marker: str) -> Path:
    """The folder of `bayesid.files.writing.check_folder`, if it replaces no other.

    Raises:
        InputError: it cannot be written, or holds an earlier result and --force was not given.
    """
    _check_no_file(options, folder)
    folder = check_folder(folder, files, marker)
    check_taken(options, folder)
    return folder


def check_taken(options: argparse.Namespace, folder: Path, alternative: str = "") -> None:
    """Raises InputError if a folder is not empty and --force was not given; `alternative` is a further remedy."""
    _check_no_file(options, folder)
    if folder.is_dir() and any(folder.iterdir()):
        _keep(options, folder, "holds an earlier result", alternative)


def _check_no_file(options: argparse.Namespace, folder: Path) -> None:
    named = options.out is not None and folder.suffix in _SUFFIXES and not folder.is_dir()
    if named or folder.is_file():
        message = f"{'is' if folder.is_file() else 'names'} a file, but `bayesid {options.command}` writes a folder"
        raise InputError(message, str(folder), "give --out a folder")


def _keep(options: argparse.Namespace, path: Path, reason: str, alternative: str = "") -> None:
    if not options.force:
        names = (path.with_name(f"{path.stem}-{k}{path.suffix}") for k in itertools.count(2))
        free = next(name for name in names if not name.exists())
        raise InputError(
            reason, str(path), f"give {alternative}--out {shlex.quote(str(free))}, or --force to replace it"
        )


def reading_options(options: argparse.Namespace, identified: IdentifiedModel | None = None) -> dict[str, Any]:
    """Keyword arguments of `bayesid.read_log`; None for defaults, or a result's values.

    Raises:
        InputError: uncertain gains are given with a result.
    """
    gains: Any = options.gains
    with suppress(ValueError):  # uncertain ones stay text
        gains = None if gains is None else [float(word) for word in gains.split(",")]
    if identified is not None and isinstance(gains, str):
        remedy = "leave it out to use the result's gains, or give exact ones"
        raise InputError(f"{gains!r:.60} are uncertain: only `bayesid identify` estimates gains", "--gains", remedy)
    return {"gains": gains, "unsigned": options.unsigned, "encoding": options.encoding, **motion_options(options)}


def motion_options(options: argparse.Namespace) -> dict[str, Any]:
    """Keyword arguments of `bayesid.log.reading.read_motion`."""
    joints = None if options.joints is None else [name.strip() for name in options.joints.split(",")]
    columns = None if options.columns is None else parse_columns(options.columns)
    return {
        "joints": joints,
        "columns": columns,
        "degrees": options.degrees,
        "topic": options.topic,
        "correct": options.correct,
    }


@contextmanager
def warned(options: argparse.Namespace) -> Iterator[None]:
    """Prints each warning in one line, which `finish` does not repeat; a note on the reading is a plain line."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        yield
    for warning in caught:
        vars(options).setdefault("warned", set()).add(str(warning.message))
        if not issubclass(warning.category, ReadingNote):
            warn(str(warning.message))
        elif not options.quiet:
            note(str(warning.message))


def read(options: argparse.Namespace, path: Path, reading: Mapping[str, Any], robot: Robot) -> Log:
    """A log of a robot, read with `reading_options`."""
    with warned(options):
        return read_log(path, **reading, robot=robot)


def read_for(options: argparse.Namespace, identified: IdentifiedModel, path: Path) -> Log:
    """A log of a result's robot, read like the result's log except for the given `reading_options`."""
    given = reading_options(options, identified)
    kept = kept_reading(options, identified.reading, given)
    with warned(options):
        return read_alike(read_log, path, kept, given, robot=identified.model.robot)


def read_motion_for(options: argparse.Namespace, identified: IdentifiedModel, path: Path) -> RecordedMotion:
    """A motion of a result's robot, read like `read_for`."""
    given = motion_options(options)
    kept = kept_reading(options, identified.motion_reading, given)
    with warned(options):
        return read_alike(read_motion, path, kept, given, robot=identified.model.robot)


def kept_reading(options: argparse.Namespace, kept: dict[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """The reading options of a result's log; prints those that are used, and warns of those that are overridden."""
    applied = {name: value for name, value in kept.items() if given.get(name) is None}
    if applied and not options.quiet:
        if isinstance(gains := applied.get("gains"), Gains):
            applied["gains"] = gains.value.tolist()
        note(f"read like the result's log: {shlex.join(in_words(applied))}")
    for name, value in kept.items():
        if given.get(name) is not None and not _alike(value, given[name]):
            scale = "; the model has the scale of the result's gains" * (name == "gains")
            warn(f"--{name} differs from that of the result's log{scale}")
    return kept


def _alike(kept: Any, given: Any) -> bool:
    return np.array_equal(kept.value, given) if isinstance(kept, Gains) else bool(kept == given)


def finish(
    options: argparse.Namespace,
    *parts: RenderableType,
    conclusion: Conclusion | None = None,
    last: str = "",
    warnings: Iterable[str] = (),
    incomplete: Iterable[str] = (),
) -> None:
    """Ends a command: prints warnings, results, the verdict with actions, and the last line.

    Raises:
        BayesidError: the result is `incomplete`; it is printed before.
        RedVerdictError: the verdict is bad, and --strict was given.
    """
    for warning in warnings:
        if warning not in vars(options).get("warned", ()):
            warn(warning)
    if not options.quiet:
        show(*parts, *([] if conclusion is None else verdict_parts(conclusion)))
        if last:
            console().print(printable(last), soft_wrap=True)  # unfolded, since it holds a command or a path
    bad = conclusion is not None and conclusion.state == "bad"
    strict = getattr(options, "strict", False)
    if conclusion is not None and bad and options.quiet and not strict:
        note(conclusion.sentence)
    for message in incomplete:
        raise BayesidError(message)
    if conclusion is not None and bad and strict:
        raise RedVerdictError(conclusion.sentence)


def term_names(options: argparse.Namespace) -> list[str]:
    """Names of the model's terms."""
    terms = [name.strip() for name in options.terms.split(",")]
    if RigidBody.name not in terms:
        raise InputError(f"{RigidBody.name} is missing", "--terms", "add it")
    return terms


def prior(
    options: argparse.Namespace, known: Mapping[str, tuple[float, float]] = MappingProxyType({})
) -> ParameterPrior:
    """The prior of the parameters, with the geometry's tolerance.

    Args:
        options: of the command.
        known: mean and standard deviation of parameters that other options state.
    """
    nominal = {} if options.nominal is None else read_nominal(options.nominal)
    for name in known:
        if name in nominal:
            raise InputError(f"{name} is stated by --payload too", str(options.nominal), "state it once")
    nominal |= known
    links, tolerance = getattr(options, "links", None), getattr(options, "kinematic_tolerance", None)
    mass, reach = (None, None) if links is None else _links(links)
    length, angle = (None, None) if tolerance is None else _tolerance(tolerance)
    return ParameterPrior(link_mass=mass, link_reach=reach, nominal=nominal, length_sd=length, angle_sd=angle)


def _links(text: str) -> tuple[float, float]:
    remedy = "give mass and size of a typical link in kg and m, as in 30,0.5"
    scales = numbers(text, "--links", remedy) or ()
    if len(scales) != 2:
        raise InputError(f"{text!r} are not scales of links", "--links", remedy)
    return scales[0], scales[1]


def _tolerance(text: str) -> tuple[float, float]:
    found = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(mm|cm|m)\s*,\s*([0-9.eE+-]+)\s*(deg|mrad|rad)\s*", text)
    try:
        length, angle = (float(found[k]) * _UNITS[found[k + 1]] if found else math.nan for k in (1, 3))
    except ValueError:
        length = angle = math.nan
    if not (0.0 <= length < math.inf and 0.0 <= angle < math.inf):
        remedy = "give a length and an angle with their units, as in 1mm,0.1deg; 0mm,0deg for an exact table"
        raise InputError(f"{text!r} is not a tolerance", "--kinematic-tolerance", remedy)
    return length, angle


def sampling(options: argparse.Namespace) -> Sampling | bool:
    """Settings of the sampler; False with --no-posterior."""
    mode = getattr(options, "mode", 1)
    chosen = Sampling(budget=options.posterior_budget, time_limit=options.time_limit, rng=options.seed, mode=mode)
    return False if options.no_posterior else chosen
