"""What acts on a robot's joints, terms and distortions, each in a file of this folder; and models made of them."""

from __future__ import annotations

from bayesid.effects.coulomb_friction import CoulombFriction
from bayesid.effects.distortion import Distortion
from bayesid.effects.effect import Scene
from bayesid.effects.parameters import Cone, Parameter
from bayesid.effects.rigid_body import RigidBody
from bayesid.effects.rotor_inertia import RotorInertia
from bayesid.effects.term import ActuatorTerm, Term, WholeRobotTerm
from bayesid.effects.torque_offset import TorqueOffset
from bayesid.effects.viscous_friction import ViscousFriction

__all__ = [
    "STANDARD",
    "ActuatorTerm",
    "Cone",
    "CoulombFriction",
    "Distortion",
    "Parameter",
    "RigidBody",
    "RotorInertia",
    "Scene",
    "Term",
    "TorqueOffset",
    "ViscousFriction",
    "WholeRobotTerm",
]

STANDARD = ("rigid_body", "viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")
"""The terms where none are named: what every geared arm has, its links, gear friction, zero errors and rotors."""
