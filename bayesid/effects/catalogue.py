"""The catalogue: every effect that a model can hold.

An effect is a term (adds efforts) or a distortion (changes motion or readings). Its forms are classes, named
`effect.form`, as `viscous_friction.saturating`; the main form has the name of the effect alone.
"""

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


def _bundled_classes() -> Iterator[type[Effect]]:
    """The classes of this package that set their own `name`."""
    for info in pkgutil.iter_modules(effects.__path__):
        module = importlib.import_module(f"{effects.__name__}.{info.name}")
        for value in vars(module).values():
            defined_here = inspect.isclass(value) and value.__module__ == module.__name__
            if defined_here and issubclass(value, Effect) and "name" in vars(value):
                yield value


_BUNDLED = sorted(_bundled_classes(), key=lambda kind: effect_of(kind.name))
TERMS: Mapping[str, type[Term]] = {kind.name: kind for kind in _BUNDLED if issubclass(kind, Term)}
"""Name to class, for every form of bayesid's own terms."""
DISTORTIONS: Mapping[str, type[Distortion]] = {kind.name: kind for kind in _BUNDLED if issubclass(kind, Distortion)}
"""Name to class, for every form of bayesid's own distortions."""


@cache
def forms() -> Mapping[str, type[Term] | type[Distortion]]:
    """Every form of every effect by its name: terms, distortions, and what installed packages register.

    Packages are imported at the first call. Each entry point `bayesid.effects` names one class.

    Raises:
        InputError: an entry point cannot be loaded, is not an effect class, or has the name of another effect; or its
            symbol is taken or ends in a digit.
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
        field = f"effect {name} of {kind.__module__}"
        for symbol in (
            [coefficient.symbol for coefficient in kind.coefficients] if issubclass(kind, ActuatorTerm) else ()
        ):
            if symbol[-1].isdigit():
                raise InputError(f"its symbol {symbol} ends in a digit", field, f"name it {symbol}_")
            if owners.setdefault(symbol, name) != name:
                raise InputError(f"its symbol {symbol} is that of {owners[symbol]}", field, "choose another symbol")


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
    """Terms of a model; the numbers of named terms are taken from the motion.

    Args:
        chosen: names of the catalogue, or your own terms.
        robot: the robot.
        motion: N samples of its joints.

    Raises:
        InputError: a name is not in the catalogue, a term comes twice, must be fitted to a log, or does not suit the
            robot.
    """
    actuators, made = robot.actuators(motion), []
    known = {key: kind for key, kind in forms().items() if issubclass(kind, Term)}
    for choice in check_terms(chosen):
        if isinstance(choice, str) and choice not in known:
            remedy = f"{near_names(choice, known)} choose from {', '.join(known)}".strip()
            raise InputError(f"unknown term {choice!r}", field="terms", remedy=remedy)
        term = known[choice].for_motion(actuators) if isinstance(choice, str) else choice
        _check_fit(term, robot, motion)
        made.append(term)
    names = [parameter.name for term in made for parameter in term.parameters(robot)]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        remedy = "name each effect once, and choose other symbols for your own parameters"
        raise InputError(f"two terms have a parameter {twice[0]}", field="terms", remedy=remedy)
    return tuple(made)


def check_terms(chosen: Iterable[str | Term]) -> tuple[str | Term, ...]:
    """The terms as a tuple; InputError for a single string, or if one is neither a name nor a term."""
    if isinstance(chosen, str) or not isinstance(chosen, Iterable):
        what = f"{chosen!r} is not a list of names or terms"
        raise InputError(what, field="terms", remedy=f"give one, as in [{effects.STANDARD[0]!r}]")
    listed = tuple(chosen)
    for item in listed:
        if isinstance(item, type) and issubclass(item, Effect):
            raise InputError(f"{item.__name__} is a class", field="terms", remedy=f"give a term: {item.__name__}()")
        if not isinstance(item, str | Term):
            remedy = "give a name of the catalogue or a bayesid.effects.Term"
            raise InputError(f"{item!r} is neither the name of a term nor a term", field="terms", remedy=remedy)
        if listed.count(item) > 1:
            what = f"term {item if isinstance(item, Term) else repr(item)} comes twice"
            raise InputError(what, field="terms", remedy="name each term once")
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
            raise ValueError(f"its cone has {term.cone(robot).size} parameters, expected {size}")
    except (AttributeError, IndexError, NotImplementedError, TypeError, ValueError) as error:
        remedy = f"fix {type(term).__name__}, see docs/extending.md"
        raise InputError(f"does not suit the robot ({error})", f"term {term.name}", remedy) from error


def owner(symbol: str) -> tuple[type[ActuatorTerm], Coefficient]:
    """The term and the coefficient that have a symbol."""
    kinds = [kind for kind in forms().values() if issubclass(kind, ActuatorTerm)]
    return next((kind, found) for kind in kinds for found in kind.coefficients if found.symbol == symbol)


def noun(name: str) -> str:
    """Noun of an effect with its article; its name if its package is not installed."""
    known = [forms()[form].phrase.noun for form in (name, effect_of(name)) if form in forms()]
    return next(filter(None, known), name.replace("_", " ").replace(".", ", "))
