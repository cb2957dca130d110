"""Reports for people: verdicts, tables, arrays, figures and pages."""

from importlib import import_module


def __getattr__(name: str) -> object:
    """`bayesid.report.plot`, which imports matplotlib, where it is first used."""
    if name == "plot":
        return import_module("bayesid.report.plot")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
