"""The terms: every one in a file of this folder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from bayesid.errors import InputError
from bayesid.model.effects import Scene, named_classes
from bayesid.model.parameters import Cone, Parameter
from bayesid.model.robot import Robot
from bayesid.model.terms.base import ActuatorTerm, Term, WholeRobotTerm
from bayesid.model.terms.coulomb_friction import CoulombFriction
from bayesid.model.terms.rigid_body import RigidBody
from bayesid.model.terms.rotor_inertia import RotorInertia
from bayesid.model.terms.torque_offset import TorqueOffset
from bayesid.model.terms.viscous_friction import ViscousFriction
from bayesid.motion import Motion

__all__ = [
    "CATALOGUE",
    "STANDARD",
    "ActuatorTerm",
    "Cone",
    "CoulombFriction",
    "Parameter",
    "RigidBody",
    "RotorInertia",
    "Scene",
    "Term",
    "TorqueOffset",
    "ViscousFriction",
    "WholeRobotTerm",
    "make_terms",
]

CATALOGUE: Mapping[str, type[Term]] = named_classes(__name__, __path__)
"""Name to class, of every form of every term."""
STANDARD = ("rigid_body", "viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")
"""The terms where none are named: what every geared arm has, its links, gear friction, zero errors and rotors."""


def make_terms(names: Iterable[str], robot: Robot, motion: Motion) -> tuple[Term, ...]:
    """The named terms, their shapes taken from the motion they will be fitted to.

    Raises:
        InputError: a name is not in the catalogue, comes twice, or needs numbers that no motion shows.

    Example:
        >>> [term.name for term in bayesid.make_terms(["rigid_body", "coulomb_friction"], robot, motion)]
        ['rigid_body', 'coulomb_friction']
    """
    names = term_names(names)
    for name in names:
        if name not in CATALOGUE:
            raise InputError(f"unknown term {name!r}", "--terms", f"choose from {', '.join(CATALOGUE)}")
        if names.count(name) > 1:
            raise InputError(f"term {name!r} comes twice", "--terms", "name each term once")
    actuators = robot.actuators(motion)
    return tuple(CATALOGUE[name].for_motion(actuators) for name in names)


def term_names(names: Iterable[str]) -> tuple[str, ...]:
    """The names one by one.

    Raises:
        InputError: they are one text, of which the names would be the letters, or no names at all.
    """
    if isinstance(names, str) or not isinstance(names, Iterable):
        raise InputError(f"{names!r} is no list of names", "--terms", f"give one, as in [{STANDARD[0]!r}]")
    return tuple(names)
