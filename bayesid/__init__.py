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

import lazy_loader

__version__ = "0.1.0"
_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """A promised name; with what gives identifications comes what notebooks show of them, from rooms above theirs."""
    value = _load(name)
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
