"""The catalogue of effects that a model can hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from bayesid.errors import InputError
from bayesid.motion import Motion
from bayesid.robot import Robot
from bayesid.terms.base import ActuatorTerm, Cone, Parameter, Term
from bayesid.terms.friction import CoulombFriction, ViscousFriction
from bayesid.terms.offset import TorqueOffset
from bayesid.terms.rigid_body import RigidBody
from bayesid.terms.rotor import RotorInertia

__all__ = [
    "CATALOGUE", "DEFAULT", "ActuatorTerm", "Cone", "CoulombFriction", "Parameter", "RigidBody",
    "RotorInertia", "Term", "TorqueOffset", "ViscousFriction", "make_term", "make_terms",
]  # fmt: skip

CATALOGUE: Mapping[str, type[RigidBody] | type[ActuatorTerm]] = {
    term.name: term for term in (RigidBody, ViscousFriction, CoulombFriction, TorqueOffset, RotorInertia)
}
DEFAULT = ("rigid_body", "viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")


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
    actuators = robot.actuators(motion)
    return tuple(CATALOGUE[name].for_motion(actuators) for name in names)


def make_term(name: str, shape: Mapping[str, Iterable[float]]) -> Term:
    """A term from its catalogue name and shape, as model.toml keeps them."""
    return CATALOGUE[name](**{key: tuple(values) for key, values in shape.items()})
