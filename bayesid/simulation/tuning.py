"""Constants of this package."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Constants; `TUNING` holds those in use. Without a source they are chosen, not measured."""

    # motions
    samples: int = 100
    """Fewest samples for a motion's condition number; 667 samples change it by less than 1 %."""
    shift: float = 0.5
    """Largest shift of a joint's centre from mid-range, as a share of half the range. More leaves less amplitude."""
    draws: int = 20
    """Random motions, of which the best is improved. Changing the number changes all simulated motions."""
    precision: float = 1e-3
    """SLSQP stops at this change of the condition number's logarithm."""
    # parameters
    kg_per_m: float = 25.0
    """Mass of an arm per metre of stretched length: about 20 for the UR10e and the Panda, 32 for the KR5."""
    slenderness: float = 0.1
    """Radius of the first link relative to the reach."""
    shortest_reach: float = 0.1
    """m, reach assumed for an arm whose joint origins coincide."""
    weight: tuple[float, float] = (0.7, 1.4)
    """Least and largest mass of a random arm, relative to `kg_per_m` times its length."""
    taper: tuple[float, float] = (0.55, 0.9)
    """Mass of a link over that of the one before it: links grow lighter towards the tip."""
    of_either_sign: tuple[float, float] = (0.01, 0.05)
    """Effort of a parameter of either sign (offsets), as a share of the bodies' effort."""
    of_one_sign: tuple[float, float] = (0.05, 0.25)
    """Effort of a nonnegative parameter (friction, rotor inertia), as a share of the bodies' effort."""
    # effects
    trace: float = 1e-4
    """An effect acts on a joint if its effort there exceeds this share of its effort on the joint of largest effort."""
    close: float = 0.01
    """Relative tolerance of a simulated effect's level."""
    smallest: float = 1.0 / 64.0
    """Smallest magnitude of a distortion in the search for its level, as a share of the largest; then it is doubled."""
    xtol: float = 1e-6
    """Relative tolerance of the magnitude in that search."""
    payload: tuple[float, float] = (0.2, 0.04)
    """m, length and radius of a simulated payload: a gripper with a workpiece."""


TUNING = Tuning()
