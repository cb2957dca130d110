"""The catalogue of effects that a model can hold: every term in a file of this folder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from bayesid.catalogue import named_classes
from bayesid.errors import InputError
from bayesid.motion import Motion
from bayesid.robot import Robot
from bayesid.terms.base import ActuatorTerm, Cone, Parameter, Scene, Term
from bayesid.terms.coulomb_friction import CoulombFriction
from bayesid.terms.rigid_body import RigidBody
from bayesid.terms.rotor_inertia import RotorInertia
from bayesid.terms.torque_offset import TorqueOffset
from bayesid.terms.viscous_friction import ViscousFriction

__all__ = [
    "CATALOGUE", "DEFAULT", "ActuatorTerm", "Cone", "CoulombFriction", "Parameter", "RigidBody",
    "RotorInertia", "Scene", "Term", "TorqueOffset", "ViscousFriction", "make_term", "make_terms",
]  # fmt: skip


CATALOGUE: Mapping[str, type[RigidBody] | type[ActuatorTerm]] = named_classes(__name__)
DEFAULT = ("rigid_body", "viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")


def make_terms(names: Iterable[str], robot: Robot, motion: Motion) -> tuple[Term, ...]:
    """The named terms, their shapes taken from the motion they will be fitted to.

    Raises:
        InputError: a name is not in the catalogue, comes twice, or needs a shape that no motion tells.
    """
    names = list(names)
    for name in names:
        if name not in CATALOGUE:
            raise InputError(f"unknown term {name!r}", "--terms", f"choose from {', '.join(CATALOGUE)}")
        if names.count(name) > 1:
            raise InputError(f"term {name!r} comes twice", "--terms", "name each term once")
    actuators = robot.actuators(motion)
    return tuple(CATALOGUE[name].for_motion(actuators) for name in names)


def make_term(name: str, shape: Mapping[str, Iterable[float]]) -> Term:
    """A term from its catalogue name and shape, as model.toml keeps them."""
    numbers: dict[str, Any] = {key: tuple(values) for key, values in shape.items()}
    return CATALOGUE[name](**numbers)
