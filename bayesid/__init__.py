"""Robot dynamics identification when the controller hides the sign of the motor currents.

    import bayesid
    result = bayesid.identify("ur10e", "log.csv")
    result.coefficient("Fc2").mean, result.predict("motion.csv").to_dataframe()
    result.validate("another_log.csv").relative_residual
    bayesid.plot.torques(result)
    bayesid.find_discrepancy(result, "another_log.csv").added

In the examples of docstrings `robot`, `log`, `motion`, `model`, `theta`, `result` and the like are what docs/python.md
makes. docs/versions.md says what is promised. Each name of __init__.pyi is loaded where it is first used.
"""

import ast
from importlib import import_module
from pathlib import Path

__version__ = "0.1.0"


def _promised(file: str) -> dict[str, str]:
    """Name to the module that has it, of the stub of a module; a submodule has its own."""
    lines = ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8")).body
    imports = [line for line in lines if isinstance(line, ast.ImportFrom)]
    return {one.name: f"{__name__}.{line.module or one.name}" for line in imports for one in line.names}


_HOMES = _promised(__file__)
__all__ = sorted(_HOMES)


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = import_module(_HOMES[name])
    globals()[name] = value = home if _HOMES[name] == f"{__name__}.{name}" else getattr(home, name)
    return value
