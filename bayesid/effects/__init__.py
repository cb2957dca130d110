"""Effects on a robot's joints (terms and distortions), and models made of them."""

from __future__ import annotations

from bayesid.effects.bodies import RigidBody
from bayesid.effects.distortion import Distortion, RobotDistortion, SensorDistortion
from bayesid.effects.drive import RotorInertia, TorqueOffset
from bayesid.effects.effect import Effect, Numbers, Phrase, ReadableUnit, Scene, number
from bayesid.effects.friction import CoulombFriction, ViscousFriction
from bayesid.effects.parameters import Coefficient, Cone, Parameter
from bayesid.effects.term import ActuatorTerm, Term, WholeRobotTerm

__all__ = [
    "STANDARD",
    "ActuatorTerm",
    "Coefficient",
    "Cone",
    "CoulombFriction",
    "Distortion",
    "Effect",
    "Numbers",
    "Parameter",
    "Phrase",
    "ReadableUnit",
    "RigidBody",
    "RobotDistortion",
    "RotorInertia",
    "Scene",
    "SensorDistortion",
    "Term",
    "TorqueOffset",
    "ViscousFriction",
    "WholeRobotTerm",
    "number",
]

STANDARD = ("rigid_body", "viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")
"""The default terms, which every geared arm has: links, gear friction, zero errors and rotors."""
