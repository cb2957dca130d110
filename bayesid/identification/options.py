"""What a user may choose of an identification, beside search and sampling, and what was chosen as plain values."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from typing import Any, Literal, get_args

from bayesid.errors import InputError
from bayesid.log.log import Log
from bayesid.log.segments import USUAL, Cutting

Completeness = Literal["auto", "off", "only-uncertainty"]
"""What the catalogue has a say in, beyond the terms asked for."""
COMPLETENESS = get_args(Completeness)


def check_completeness(value: str) -> str:
    """The value itself.

    Raises:
        InputError: it is none of those there are.
    """
    if value not in COMPLETENESS:
        raise InputError(f"complete = {value!r}", field="complete", remedy=f"give one of {', '.join(COMPLETENESS)}")
    return value


@dataclass(frozen=True, kw_only=True)
class Preparation:
    """How a log is made ready.

    Attributes:
        cutoff: of the motion's low-pass, Hz; from the data by default.
        cutting: thresholds by which efforts are cut into segments, and small ones left out.
        max_memory: GB that the run may need; 0.8 of the machine's memory by default.

    Raises:
        InputError: a limit that is none.

    Example:
        >>> preparation = bayesid.Preparation(cutoff=8.0)
        >>> bayesid.identify(robot, log, terms, preparation=preparation, posterior=False).signals.cutoff
        8.0
    """

    cutoff: float | None = None
    cutting: Cutting = USUAL
    max_memory: float | None = None

    def __post_init__(self) -> None:
        if self.max_memory is not None and not self.max_memory > 0.0:
            raise InputError(
                f"a memory of {self.max_memory:g} GB", field="Preparation.max_memory", remedy="give more than 0"
            )


def plain_options(options: Mapping[str, object]) -> dict[str, object]:
    """Options as plain values: those of an option object stand under its name, as in `search.budget`."""
    plain: dict[str, object] = {}
    for name, value in options.items():
        if is_dataclass(value) and not isinstance(value, type):
            plain[name] = type(value).__name__.lower()
            inner = plain_options({field.name: getattr(value, field.name) for field in fields(value)})
            plain |= {f"{name}.{key}": item for key, item in inner.items()}
        else:
            plain[name] = value if _is_plain(value) else repr(value)
    return plain


def call_of_log(log: Log) -> str:
    """Python that reads a log again; `log` where it never was a file."""
    carried = {piece.source: piece.payload for piece in log.pieces} or {log.source: ""}
    if not all(os.path.isfile(source) or os.path.isdir(source) for source in carried):  # a pipe is read once only
        return "log"
    unsigned = ",".join(str(j) for j, signed in enumerate(log.signed, start=1) if not signed) or "none"
    options = "".join(f", {name}={value!r}" for name, value in {"unsigned": unsigned, **log.read_with}.items())
    read = [
        f"bayesid.read_log({source!r}{options})" + (f".carrying({payload!r})" if payload else "")
        for source, payload in carried.items()
    ]
    return read[0] if len(read) == 1 else f"bayesid.join_logs([{', '.join(read)}])"


def call_of(function: str, *given: str, **options: tuple[object, object]) -> str:
    """Python that calls a function of `bayesid` again.

    Args:
        function: its name.
        given: arguments, as Python.
        options: name to value and usual value; those that are usual are left out.
    """
    named = [f"{name}={_as_python(value)}" for name, (value, usual) in options.items() if repr(value) != repr(usual)]
    return f"bayesid.{function}({', '.join([*given, *named])})"


def _as_python(value: object) -> str:
    """Option objects by what differs from their defaults; long tables in short."""
    if is_dataclass(value) and not isinstance(value, type):
        parts = [(one.name, getattr(value, one.name), _usual(one)) for one in fields(value)]
        changed = ", ".join(f"{name}={_as_python(part)}" for name, part, usual in parts if repr(part) != repr(usual))
        return f"bayesid.{type(value).__name__}({changed})"
    return "{...}" if isinstance(value, Mapping) and value else repr(value)


def _usual(field: Field[Any]) -> object:
    return field.default if field.default_factory is MISSING else field.default_factory()


def _is_plain(value: object) -> bool:
    if isinstance(value, Mapping):
        return all(map(_is_plain, value.values()))
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    return value is None or isinstance(value, str | bool | int | float)
