"""Reading options of a result's log, and reading other logs or motions by them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from bayesid.errors import InputError, printable
from bayesid.files.config import CONFIG, OF_READING, read_config
from bayesid.log.formats.stated import parse_columns
from bayesid.log.gains import Gains
from bayesid.log.log import Log, RecordedMotion

NAMING = ("columns", "joints", "topic", "encoding")
"""Options of names and encodings; another file of the same recorder may need others."""
OF_MOTION = ("columns", "correct", "degrees", "joints", "topic")
"""Options that apply to a motion."""
_KINDS: Mapping[str, type | tuple[type, ...]] = {
    "columns": dict,
    "correct": str,
    "degrees": bool,
    "encoding": str,
    "gains": (list, str),
    "joints": list,
    "topic": str,
    "unsigned": str,
}
"""Type of each option of `OF_READING` in a result's bayesid.toml."""
_REMEDY = "give it as `bayesid identify` wrote it"
Recorded = TypeVar("Recorded", Log, RecordedMotion)


def stored_reading(folder: Path, earlier: Mapping[str, Any]) -> dict[str, Any]:
    """Options by which a result's log was read: from bayesid.toml, or from model.toml of an older result.

    Raises:
        InputError: the file is not valid.
    """
    path = folder / CONFIG
    stored = read_config(path) if path.exists() else earlier
    table = {name: value for name, value in stored.items() if name in OF_READING}
    for name, value in table.items():
        if name == "unsigned" and not isinstance(value, str):
            table[name] = ",".join(map(str, value)) if isinstance(value, list) else str(value)
        elif name == "joints" and isinstance(value, str):
            table[name] = [joint.strip() for joint in value.split(",")]
        elif name == "columns" and isinstance(value, str):
            table[name] = parse_columns(value)
        elif not isinstance(value, _KINDS[name]):
            raise InputError(f"{name} = {value!r:.60} is not valid", str(path), _REMEDY)
    return table


def plain_reading(read_with: Mapping[str, Any]) -> dict[str, Any]:
    """The options as bayesid.toml holds them."""
    plain = (list, dict, bool, str)
    return {name: value if isinstance(value, plain) else str(value) for name, value in read_with.items()}


def exact_gains(stated: object) -> Gains | None:
    """Gains of an earlier log for another one: a list is for currents, text of exact numbers for torques."""
    if stated is None:
        return None
    words = stated.split(",") if isinstance(stated, str) else stated
    try:
        value = np.array([float(word) for word in words])  # type: ignore[attr-defined]
    except ValueError:  # uncertain gains; the result holds their estimates
        return None
    return Gains(value, np.zeros(len(value)), of_torques=isinstance(stated, str))


def read_alike(
    reader: Callable[..., Recorded], source: Any, kept: Mapping[str, Any], given: Mapping[str, Any], **more: Any
) -> Recorded:
    """What `read_log` or `read_motion` returns for a source by kept options; given options take precedence.

    Kept column names, joint names and encodings are dropped with a warning if the source is readable only without them.

    Raises:
        InputError: the source cannot be read, or its unit of angles is ambiguous.
    """
    stated = {name: value for name, value in given.items() if value is not None}
    options = {**kept, **stated}
    naming = [name for name in NAMING if name in kept and name not in stated]
    try:
        found = reader(source, **options, **more)
    except InputError as refused:
        if not naming:
            raise
        options = {name: value for name, value in options.items() if name not in naming}
        try:
            found = reader(source, **options, **more)
        except InputError as without:
            raise (without if refused.field in naming else refused) from None
        which = " and ".join(naming)
        warnings.warn(f"{found.source}: {refused.what}; read without the result's {which}", stacklevel=2)
    if options.get("degrees") is True and "degrees" not in stated:
        _check_degrees(reader, source, options, found, **more)
    return found


def _check_degrees(
    reader: Callable[..., Recorded], source: Any, options: Mapping[str, Any], found: Recorded, **more: Any
) -> None:
    """InputError if positions without a unit may be rad, although the result's log was in degrees."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            plain = reader(source, **{**options, "degrees": None}, **more)
    except InputError:
        return
    if not np.allclose(plain.q, found.q):
        what = f"positions reach {np.abs(plain.q).max():.4g}: rad, or degrees as in the result's log?"
        raise InputError(what, found.source, "give `degrees=True`, or `degrees=False` if they are rad")


def in_words(reading: Mapping[str, Any]) -> list[str]:
    """Reading options as words of the command line."""
    words: list[str] = []
    for name, value in sorted(reading.items()):
        if name == "degrees":
            words.append("--degrees" if value else "--no-degrees")
            continue
        text = value
        if isinstance(value, Mapping):
            text = ",".join(f"{key}={item}" for key, item in value.items())
        elif not isinstance(value, str):
            text = ",".join(f"{item:.12g}" if isinstance(item, float) else str(item) for item in value)
        words += [f"--{name}={text}"] if str(text).startswith("-") else [f"--{name}", printable(str(text))]
    return words


def as_corrected(reading: Mapping[str, Any]) -> str | None:
    """The kept correction of joints, or None."""
    text = reading.get("correct")
    return None if text is None else str(text)
