"""Effects of other packages, which these register under the entry point `bayesid.effects`."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from bayesid.effects.effect import Effect
from bayesid.errors import InputError

GROUP = "bayesid.effects"
"""Each entry point of this group names one class, of one form of an effect."""


@cache
def registered_effects() -> Mapping[str, type[Effect]]:
    """Name to class, of all that installed packages register; they are imported at the first call.

    Raises:
        InputError: an entry point cannot be loaded, is no effect's class, or has the name of another's effect.
    """
    known: dict[str, type[Effect]] = {}
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        kind = _loaded(point)
        if known.setdefault(kind.name, kind) is not kind:
            raise _unusable(point, f"its effect {kind.name!r} is registered by {known[kind.name].__module__} too")
    return known


def _loaded(point: EntryPoint) -> type[Effect]:
    try:
        kind = point.load()
    except Exception as error:  # whatever goes wrong in somebody's module
        raise _unusable(point, f"cannot be loaded ({type(error).__name__}: {error})") from None
    if not inspect.isclass(kind) or not issubclass(kind, Effect) or not isinstance(getattr(kind, "name", None), str):
        raise _unusable(point, f"{point.value} is no effect's class with a name")
    return kind


def _unusable(point: EntryPoint, what: str) -> InputError:
    package = point.dist.name if point.dist is not None else point.module
    return InputError(what, f"effect {point.name} of the package {package}", f"mend or uninstall {package}")
