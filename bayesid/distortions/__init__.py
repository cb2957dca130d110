"""The catalogue of distortions: every one in a file of this folder."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterable, Mapping
from typing import Any

from bayesid.distortions.base import Distortion

__all__ = ["CATALOGUE", "Distortion", "make_distortion"]


def _distortions_of_this_folder() -> dict[str, type[Distortion]]:
    found: dict[str, Any] = {}
    for module in pkgutil.iter_modules(__path__):
        path = f"{__name__}.{module.name}"
        classes = [one for one in vars(importlib.import_module(path)).values() if inspect.isclass(one)]
        own = [one for one in classes if one.__module__ == path and isinstance(vars(one).get("name"), str)]
        found.update({vars(one)["name"]: one for one in own})
    return found


CATALOGUE: Mapping[str, type[Distortion]] = _distortions_of_this_folder()


def make_distortion(name: str, shape: Mapping[str, Iterable[float]]) -> Distortion:
    """A distortion from its catalogue name and numbers, as model.toml keeps them."""
    numbers: dict[str, Any] = {key: tuple(values) for key, values in shape.items()}
    return CATALOGUE[name](**numbers)
