"""The catalogue: every effect that a model can hold, terms and distortions together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from bayesid.model import distortions, terms
from bayesid.model.distortions.base import Distortion
from bayesid.model.effects import Effect, effect_of
from bayesid.model.terms.base import ActuatorTerm, Term

FORMS: Mapping[str, type[Term] | type[Distortion]] = {**terms.CATALOGUE, **distortions.CATALOGUE}
"""Every form of every effect by its name, terms first."""


def main_forms() -> dict[str, type[Term] | type[Distortion]]:
    """The main form of every effect that a model may lack, in the order of the catalogue."""
    return {name: kind for name, kind in FORMS.items() if name == effect_of(name) and kind.can_be_missing}


def effect_names() -> list[str]:
    """Names of all effects that a model may lack."""
    return sorted(main_forms())


def make_effect(name: str, shape: Mapping[str, Iterable[float]]) -> Any:
    """A term or distortion from its name in the catalogue and its shape, as model.toml keeps them."""
    return FORMS[name](**{key: tuple(values) for key, values in shape.items()})  # type: ignore[arg-type]


def owner(symbol: str) -> type[ActuatorTerm]:
    """The term whose parameter has a symbol.

    Example:
        >>> owner("Fc").name
        'coulomb_friction'
    """
    kinds = [kind for kind in terms.CATALOGUE.values() if issubclass(kind, ActuatorTerm) and symbol in kind.symbols]
    return kinds[0]


def noun(name: str) -> str:
    """An effect with its article, any form of it."""
    phrases = [FORMS[form].phrase.noun for form in (name, effect_of(name)) if form in FORMS]
    return next(filter(None, phrases), name.replace("_", " ").replace(".", ", "))


__all__ = ["FORMS", "Effect", "effect_names", "main_forms", "make_effect", "noun", "owner"]
