"""Classes of results and of options that few programs make by hand: for annotations and `isinstance`.

def worst(assessment: bayesid.types.ExcitationAssessment) -> float: ...
"""

from importlib import import_module

from bayesid import _promised

_HOMES = _promised(__file__)
__all__ = sorted(_HOMES)


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(import_module(_HOMES[name]), name)
    return value
