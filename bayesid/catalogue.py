"""What a folder holds: every class with a name of its own, so that a new effect is a new file and nothing else."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from typing import Any


def named_classes(package: str) -> dict[str, Any]:
    """Name to class, of all classes in the modules of a package that set a `name` themselves.

    Args:
        package: its full name, as in sys.modules.
    """
    found = {}
    for module in pkgutil.iter_modules(importlib.import_module(package).__path__):
        path = f"{package}.{module.name}"
        for one in vars(importlib.import_module(path)).values():
            if inspect.isclass(one) and one.__module__ == path and isinstance(vars(one).get("name"), str):
                found[vars(one)["name"]] = one
    return found
