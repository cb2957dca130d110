"""What a user may choose of an identification, beside search and sampling, and what was chosen as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Literal, get_args

from bayesid.errors import InputError
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
        raise InputError(f"complete = {value!r}", "--complete", f"give one of {', '.join(COMPLETENESS)}")
    return value


@dataclass(frozen=True, kw_only=True)
class Preparation:
    """How a log is made ready.

    Attributes:
        cutoff: of the motion's low-pass, Hz; from the data by default.
        cutting: thresholds by which efforts are cut into segments, and small ones left out.
    """

    cutoff: float | None = None
    cutting: Cutting = USUAL


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


def _is_plain(value: object) -> bool:
    if isinstance(value, Mapping):
        return all(map(_is_plain, value.values()))
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    return value is None or isinstance(value, str | bool | int | float)
