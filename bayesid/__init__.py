"""Robot dynamics identification when the controller hides the sign of the motor currents.

    import bayesid
    result = bayesid.identify("ur10e", "log.csv")
    result.coefficient("Fc2").mean, result.predict("motion.csv").to_dataframe()
    result.validate("another_log.csv").relative_residual
    bayesid.plot.torques(result)
    bayesid.find_discrepancy(result, "another_log.csv").added

In the examples of docstrings `robot`, `log`, `motion`, `model`, `theta`, `result` and the like are what docs/python.md
makes. The names of __init__.pyi are promised, all else may change; each is loaded where it is first used.
"""

import ast
from importlib import import_module
from pathlib import Path

__version__ = "0.1.0"
_HOMES = {
    name.name: f"{__name__}.{line.module}"
    for line in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
    if isinstance(line, ast.ImportFrom)
    for name in line.names
}
"""Promised name to the module that has it, as the stub says."""
__all__ = sorted(_HOMES)


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> object:
    """A promised name; with what gives identifications comes what notebooks show of them, from rooms above theirs."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(import_module(_HOMES[name]), name)
    if name in ("identify", "find_discrepancy", "compare_logs", "Identification"):
        from bayesid.identification.identification import Identification

        Identification.notebook_view = _notebook_view
    return value


def _notebook_view(identification: object) -> str:
    """What a notebook shows of an identification: HTML with its summary, checks and a figure.

    Example:
        >>> "<svg" in result.notebook_view()
        True
    """
    from bayesid.report.pages.identification_page import identification_view  # jinja2, for pages alone

    return identification_view(identification)
