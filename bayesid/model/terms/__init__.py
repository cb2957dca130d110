"""The terms: every one in a file of this folder."""

from __future__ import annotations

from collections.abc import Mapping

from bayesid.model.effects import Scene, named_classes
from bayesid.model.parameters import Cone, Parameter
from bayesid.model.terms.base import ActuatorTerm, Term, WholeRobotTerm
from bayesid.model.terms.coulomb_friction import CoulombFriction
from bayesid.model.terms.rigid_body import RigidBody
from bayesid.model.terms.rotor_inertia import RotorInertia
from bayesid.model.terms.torque_offset import TorqueOffset
from bayesid.model.terms.viscous_friction import ViscousFriction

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
]

CATALOGUE: Mapping[str, type[Term]] = named_classes(__name__, __path__)
"""Name to class, of every form of every term of ours."""
STANDARD = ("rigid_body", "viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")
"""The terms where none are named: what every geared arm has, its links, gear friction, zero errors and rotors."""
