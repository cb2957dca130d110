"""Constraints from a TOML file."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any

from bayesid.errors import InputError, near_names, printable
from bayesid.files.bounded import LARGEST, read_source, toml_of, whole_number
from bayesid.regression.stated import ConstraintFunction, Stated, StatedParameters

_REMEDY = "see docs/how-to/what-you-know-of-the-robot.md"


def read_constraints(path: str | Path) -> ConstraintFunction:
    """Constraints from a TOML file, as a function of the parameters.

    Keys are `total_mass`, `[link.K]` with `mass`, `com_box`, `hull` and `ellipsoid`, and `[bounds]` with names of
    parameters. Intervals are [low, high], or [value, value] for an equality. Paths of meshes are relative to the file.

    Raises:
        InputError: the file cannot be read or has unexpected content. The function raises it too, if the model has
            no such link or parameter.
    """
    where = printable(str(path))
    table = toml_of(read_source(path, _REMEDY), where, _REMEDY)
    _check_keys(table, ("total_mass", "link", "bounds"), "", where)
    makers: list[Callable[[StatedParameters], Stated]] = []
    if "total_mass" in table:
        makers.append(_interval(lambda p: p.total_mass, "total_mass", table["total_mass"], where))
    for number, link in _table(table, "link", where).items():
        if (k := whole_number(number)) is None:
            raise InputError(f"link.{number} is not a link", where, "number links from 1, as in [link.2]")
        if not isinstance(link, dict):
            raise InputError(f"link.{number} is not a table", where, "write it as [link.2]")
        _check_keys(link, tuple(_OF_LINKS), f"link.{number}.", where)
        folder = Path(path).parent
        makers += [_OF_LINKS[key](k, f"link.{number}.{key}", value, where, folder) for key, value in link.items()]
    for name, value in _table(table, "bounds", where).items():
        makers.append(_interval(itemgetter(name), f"bounds.{name}", value, where))
    if not makers:
        raise InputError("has no constraints", where, _REMEDY)

    def stated_on(p: StatedParameters) -> list[Stated]:
        stated = []
        for make in makers:
            try:
                stated.append(make(p))
            except InputError as error:
                raise InputError(error.what, " ".join(filter(None, (where, error.where))), error.remedy) from None
        return stated

    return stated_on


def _table(table: Mapping[str, Any], key: str, where: str) -> dict[str, Any]:
    found = table.get(key, {})
    if not isinstance(found, dict):
        raise InputError(f"{key} is not a table", where, _REMEDY)
    return found


def _check_keys(table: Mapping[str, Any], known: tuple[str, ...], before: str, where: str) -> None:
    for key in table:
        if key not in known:
            remedy = near_names(key, known) or f"choose from {', '.join(known)}"
            raise InputError(f"unknown key {before + key!r:.60}", where, remedy)


def _numbers(value: Any, count: int, label: str, where: str, example: str) -> list[float]:
    plain = isinstance(value, list) and len(value) == count
    if not plain or any(isinstance(number, bool) or not isinstance(number, int | float) for number in value):
        raise InputError(f"{label} is not a list of {count} numbers", where, f"write it as in {example}")
    numbers = [float(number) for number in value]
    if not all(math.isfinite(number) and abs(number) <= LARGEST for number in numbers):
        raise InputError(f"{label} has a number that cannot be used", where, f"write it as in {example}")
    return numbers


def _interval(
    of: Callable[[StatedParameters], Any], label: str, value: Any, where: str
) -> Callable[[StatedParameters], Stated]:
    low, high = _numbers(value, 2, label, where, f"{label.rpartition('.')[2]} = [3, 5]")
    if low > high:
        raise InputError(f"{label} = [{low:g}, {high:g}] is empty", where, "give [low, high] with low <= high")
    return lambda p: Stated(label, [of(p) == low] if low == high else [low <= of(p), of(p) <= high])


def _mass(k: int, label: str, value: Any, where: str, _: Path) -> Callable[[StatedParameters], Stated]:
    return _interval(lambda p: p.mass(k), label, value, where)


def _box(k: int, label: str, value: Any, where: str, _: Path) -> Callable[[StatedParameters], Stated]:
    example = "com_box = [[-0.1, -0.1, 0.0], [0.1, 0.1, 0.3]]"
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(f"{label} has no two corners", where, f"write it as in {example}")
    low, high = (_numbers(corner, 3, label, where, example) for corner in value)
    return lambda p: Stated(label, p.com_in_box(k, low, high))


def _hull(k: int, label: str, value: Any, where: str, folder: Path) -> Callable[[StatedParameters], Stated]:
    if not isinstance(value, str) or not value:
        raise InputError(f"{label} names no file", where, 'write it as in hull = "link2.stl"')
    return lambda p: Stated(label, p.com_in_hull(k, folder / value))


def _ellipsoid(k: int, label: str, value: Any, where: str, _: Path) -> Callable[[StatedParameters], Stated]:
    example = "ellipsoid = {centre = [0, 0, 0.2], semi_axes = [0.1, 0.1, 0.3]}"
    keys = ("centre", "semi_axes")
    if not isinstance(value, dict) or not all(key in value for key in keys):
        raise InputError(f"{label} has no centre and semi_axes", where, f"write it as in {example}")
    _check_keys(value, keys, f"{label}.", where)
    centre, axes = (_numbers(value[key], 3, f"{label}.{key}", where, example) for key in keys)
    return lambda p: Stated(label, p.density_in_ellipsoid(k, centre, axes))


_OF_LINKS = {"mass": _mass, "com_box": _box, "hull": _hull, "ellipsoid": _ellipsoid}
"""Keys of a link."""
