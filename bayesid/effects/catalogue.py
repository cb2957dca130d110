"""The catalogue: every effect that a model can hold, terms and distortions together."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterable, Iterator, Mapping
from functools import cache, partial
from importlib.metadata import entry_points
from typing import Any

import numpy as np

from bayesid import effects
from bayesid.effects.distortion import Distortion
from bayesid.effects.effect import Effect, effect_of
from bayesid.effects.parameters import Coefficient
from bayesid.effects.term import ActuatorTerm, Term
from bayesid.errors import InputError, near_names
from bayesid.motion import Motion
from bayesid.robot import Robot


def _own() -> Iterator[type[Effect]]:
    """The classes in the files of this folder that set a `name` themselves."""
    for info in pkgutil.iter_modules(effects.__path__):
        module = importlib.import_module(f"{effects.__name__}.{info.name}")
        for value in vars(module).values():
            own = inspect.isclass(value) and value.__module__ == module.__name__
            if own and issubclass(value, Effect) and "name" in vars(value):
                yield value


_OWN = sorted(_own(), key=lambda kind: effect_of(kind.name))
TERMS: Mapping[str, type[Term]] = {kind.name: kind for kind in _OWN if issubclass(kind, Term)}
"""Name to class, of every form of every term of ours."""
DISTORTIONS: Mapping[str, type[Distortion]] = {kind.name: kind for kind in _OWN if issubclass(kind, Distortion)}
"""Name to class, of every form of every distortion of ours."""


@cache
def forms() -> Mapping[str, type[Term] | type[Distortion]]:
    """Every form of every effect by its name: terms, distortions, and what installed packages register.

    These are imported at the first call. Each of their entry points `bayesid.effects` names one class, of one form.

    Raises:
        InputError: an entry point cannot be loaded, is no effect class, or has the name of another effect; or a symbol
            is taken, or ends in a digit.
    """
    known: dict[str, Any] = {**TERMS, **DISTORTIONS}
    for point in sorted(entry_points(group="bayesid.effects"), key=lambda point: point.name):
        package = point.dist.name if point.dist is not None else point.module
        unusable = partial(InputError, field=f"effect {point.name} of the package {package}")
        remedy = f"fix or uninstall {package}"
        try:
            kind = point.load()
        except Exception as error:  # a third-party module may raise anything
            raise unusable(f"cannot be loaded ({type(error).__name__}: {error})", remedy=remedy) from None
        is_effect = inspect.isclass(kind) and issubclass(kind, Effect)
        if not is_effect or not isinstance(getattr(kind, "name", None), str):
            raise unusable(f"{point.value} is not an effect class with a name", remedy=remedy)
        if known.setdefault(kind.name, kind) is not kind:
            other = known[kind.name].__module__
            raise unusable(f"its effect {kind.name!r} has the name of one of {other}", remedy=remedy)
    _check_symbols(known)
    return known


def _check_symbols(known: Mapping[str, type[Effect]]) -> None:
    owners: dict[str, str] = {}
    for name, kind in known.items():
        for one in kind.coefficients if issubclass(kind, ActuatorTerm) else ():
            field = f"effect {name} of {kind.__module__}"
            if one.symbol[-1].isdigit():
                raise InputError(f"its symbol {one.symbol} ends in a digit", field, f"name it {one.symbol}_")
            if owners.setdefault(one.symbol, name) != name:
                said = f"its symbol {one.symbol} is that of {owners[one.symbol]}"
                raise InputError(said, field, "choose another symbol")


def main_forms() -> dict[str, type[Term] | type[Distortion]]:
    """The main form of every effect that a model may lack, in the order of the catalogue."""
    return {name: kind for name, kind in forms().items() if name == effect_of(name) and kind.can_be_missing}


def make_effect(name: str, shape: Mapping[str, Iterable[float]]) -> Any:
    """A term or distortion from its name in the catalogue and its shape, as model.toml keeps them."""
    return of_shape(forms()[name], shape)


def of_shape(kind: type[Effect], shape: Mapping[str, Iterable[float]]) -> Any:
    """An effect from its class and its shape."""
    return kind(**{key: _tuples(values) for key, values in shape.items()})


def _tuples(values: Any) -> Any:
    return tuple(map(_tuples, values)) if isinstance(values, list | tuple) else values


def make_terms(chosen: Iterable[str | Term], robot: Robot, motion: Motion) -> tuple[Term, ...]:
    """Terms of a model for a robot: those named, their shapes taken from the motion they will be fitted to, and given.

    Args:
        chosen: names of the catalogue, or terms of one's own.
        robot: the robot.
        motion: N samples of its joints.

    Raises:
        InputError: a name is not in the catalogue, a term comes twice, needs numbers that no motion shows, or does not
            suit the robot.
    """
    actuators, made = robot.actuators(motion), []
    known = {key: kind for key, kind in forms().items() if issubclass(kind, Term)}
    for one in check_terms(chosen):
        if isinstance(one, str) and one not in known:
            remedy = f"{near_names(one, known)} choose from {', '.join(known)}".strip()
            raise InputError(f"unknown term {one!r}", field="terms", remedy=remedy)
        term = known[one].for_motion(actuators) if isinstance(one, str) else one
        _check_fit(term, robot, motion)
        made.append(term)
    names = [parameter.name for term in made for parameter in term.parameters(robot)]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        remedy = "name each effect once, and choose other symbols for your own parameters"
        raise InputError(f"two terms have a parameter {twice[0]}", field="terms", remedy=remedy)
    return tuple(made)


def check_terms(chosen: Iterable[str | Term]) -> tuple[str | Term, ...]:
    """The terms one by one.

    Raises:
        InputError: they are a single string, or hold what is neither name nor term.
    """
    if isinstance(chosen, str) or not isinstance(chosen, Iterable):
        said = f"{chosen!r} is not a list of names or terms"
        raise InputError(said, field="terms", remedy=f"give one, as in [{effects.STANDARD[0]!r}]")
    listed = tuple(chosen)
    for one in listed:
        if isinstance(one, type) and issubclass(one, Effect):
            raise InputError(f"{one.__name__} is a class", field="terms", remedy=f"give a term: {one.__name__}()")
        if not isinstance(one, str | Term):
            remedy = "give a name of the catalogue or a bayesid.effects.Term"
            raise InputError(f"{one!r} is neither the name of a term nor a term", field="terms", remedy=remedy)
        if listed.count(one) > 1:
            said = f"term {one if isinstance(one, Term) else repr(one)} comes twice"
            raise InputError(said, field="terms", remedy="name each term once")
    return listed


def _check_fit(term: Term, robot: Robot, motion: Motion) -> None:
    try:
        term.check(robot.n_joints)
        some = motion[: min(len(motion), 8)]
        size, columns = len(term.parameters(robot)), term.columns(robot, some)
        expected = (len(some), robot.n_joints, size)
        if columns.shape != expected:
            raise ValueError(f"its columns are {columns.shape}, expected {expected}")
        if not np.isfinite(columns).all():
            raise ValueError("its columns are not finite")
        if term.cone(robot).size != size:
            raise ValueError(f"its cone is of {term.cone(robot).size} parameters, it has {size}")
    except (AttributeError, IndexError, NotImplementedError, TypeError, ValueError) as error:
        remedy = f"fix {type(term).__name__}, see docs/extending.md"
        raise InputError(f"does not suit the robot ({error})", f"term {term.name}", remedy) from error


def owner(symbol: str) -> tuple[type[ActuatorTerm], Coefficient]:
    """The term whose parameter has a symbol, and what it says of this parameter.

    Example:
        >>> owner("Fc")[0].name
        'coulomb_friction'
    """
    kinds = [kind for kind in forms().values() if issubclass(kind, ActuatorTerm)]
    return next((kind, one) for kind in kinds for one in kind.coefficients if one.symbol == symbol)


def noun(name: str) -> str:
    """An effect with its article, any form of it; its name where its package is not installed here."""
    known = [forms()[form].phrase.noun for form in (name, effect_of(name)) if form in forms()]
    return next(filter(None, known), name.replace("_", " ").replace(".", ", "))
