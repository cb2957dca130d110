"""The catalogue of effects that a model can hold."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from bayesid.errors import InputError
from bayesid.motion import Motion
from bayesid.robot import Robot
from bayesid.terms.base import ActuatorTerm, Cone, Parameter, Term
from bayesid.terms.friction import CoulombFriction, ViscousFriction
from bayesid.terms.offset import TorqueOffset
from bayesid.terms.rigid_body import RigidBody
from bayesid.terms.rotor import RotorInertia

__all__ = [
    "CATALOGUE", "DEFAULT", "STANDSTILL", "ActuatorTerm", "Cone", "CoulombFriction", "Parameter", "RigidBody",
    "RotorInertia", "Term", "TorqueOffset", "ViscousFriction", "make_term", "make_terms",
]  # fmt: skip

CATALOGUE: Mapping[str, Callable[..., Term]] = {
    term.name: term for term in (RigidBody, ViscousFriction, CoulombFriction, TorqueOffset, RotorInertia)
}
DEFAULT = tuple(CATALOGUE)
STANDSTILL = 0.01
"""Share of an actuator's highest speed below which it stands still: friction's direction is then unknown."""
_SLOWEST = 1e-6
"""Highest speed, rad/s, of an actuator that never moves: its friction is zero, not 0/0."""


def make_terms(names: Iterable[str], robot: Robot, motion: Motion) -> tuple[Term, ...]:
    """The named terms, their shapes taken from the motion they will be fitted to.

    Raises:
        InputError: a name is not in the catalogue, or comes twice.
    """
    names = list(names)
    for name in names:
        if name not in CATALOGUE:
            raise InputError(f"unknown term {name!r}", "--terms", f"choose from {', '.join(CATALOGUE)}")
        if names.count(name) > 1:
            raise InputError(f"term {name!r} comes twice", "--terms", "name each term once")
    top_speed = np.maximum(np.abs(robot.actuators(motion).dq).max(axis=0), _SLOWEST)
    shapes = {"coulomb_friction": {"smoothing": tuple(float(v) for v in STANDSTILL * top_speed)}}
    return tuple(make_term(name, shapes.get(name, {})) for name in names)


def make_term(name: str, shape: Mapping[str, Iterable[float]]) -> Term:
    """A term from its catalogue name and shape, as model.toml keeps them."""
    return CATALOGUE[name](**{key: tuple(values) for key, values in shape.items()})
