"""Numbers of this package that are choices."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Choices; `TUNING` holds those in use."""

    # motions
    instants: int = 100
    """At which a motion is judged, at least; 667 instants give the same condition number to a percent."""
    shift: float = 0.5
    """Of its half range, within which a joint's centre stays around the middle, so that it has room to swing."""
    draws: int = 20
    """Random motions, the best of which is improved. Halved or doubled, simulated motions are others."""
    precision: float = 1e-3
    """Of the logarithm of the condition number, at which the improvement ends."""
    # parameters
    kg_per_m: float = 25.0
    """Mass of an arm per metre of stretched length: about 20 for the UR10e and the Panda, 32 for the KR5."""
    slenderness: float = 0.1
    """Radius of the first link relative to the reach."""
    shortest_reach: float = 0.1
    """m, of an arm whose joints all lie in one place."""
    weight: tuple[float, float] = (0.7, 1.4)
    """Least and largest mass of a random arm, relative to the usual."""
    taper: tuple[float, float] = (0.55, 0.9)
    """Mass of a link over that of the one before it: links grow lighter towards the tip."""
    of_either_sign: tuple[float, float] = (0.01, 0.05)
    """Share of the bodies' effort that a parameter without a sign of its own makes, as offsets do."""
    of_one_sign: tuple[float, float] = (0.05, 0.25)
    """The same where it cannot be negative, as friction and rotor inertia."""
    # effects
    trace: float = 1e-4
    """Share of an effect on the joint where it acts most, below which it does not act on another."""
    close: float = 0.01
    """How far from the level that is asked for an effect may end, relative to it."""
    smallest: float = 1.0 / 64.0
    """Of the largest magnitude of a distortion, where the search for its level begins; it is doubled from there."""
    xtol: float = 1e-6
    """Of a magnitude, relative to it, in that search."""
    grip: tuple[float, float] = (0.2, 0.04)
    """m, how far a simulated payload reaches from the flange, and its radius; a gripper with a workpiece."""


TUNING = Tuning()
