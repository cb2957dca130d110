"""Numbers of the robots that are choices."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """What a robot file may hold, and how a robot is looked at."""

    longest: float = 1e3
    """m; no link is so long. A table in mm is mostly not so far off that this would tell."""
    most_joints: int = 128
    """Moving joints of a robot; the most of example-robot-data has 48. What computes recurses over them."""
    most_links: int = 512
    """Links of a URDF; the most of example-robot-data has 120."""
    unlimited_effort: float = 1e6
    """N m or N; a limit from here on stands for none: bayesid's own URDFs have it, and no joint is so strong."""
    opposed: float = 1e-3
    """By how much the axes of two fingers may fail to oppose each other: written angles are rounded to that."""
    near_name: float = 0.8
    """Likeness from which a name is proposed: a letter of five; less, and `_description` makes all names alike."""
    named_joints: int = 8
    """Joints of a sentence that are named."""
    named_chains: int = 4
    """Chains that an error names."""
    reach_starts: int = 8
    """Random positions from which the reach is looked for: from two of them it is found on all built-in robots."""
    parallel_axes: float = 0.1
    """Sine of the angle below which axes count as parallel: those of a calibrated robot nearly are, and meet far
    away."""
    samples_at_once: int = 256
    """Samples of a regressor that are brought into link frames together: most of the time is Pinocchio's then."""
    bodies_remembered: int = 4
    """Sets of bodies that a robot remembers: a model has those of its links, and those that load its gears."""


TUNING = Tuning()
