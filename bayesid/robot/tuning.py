"""Chosen constants of the robots."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Limits of robot files, and constants of their evaluation."""

    longest: float = 1e3
    """m; longer links are refused. Tables in mm mostly pass."""
    most_joints: int = 128
    """Maximum number of moving joints (recursion depth); example-robot-data has at most 48."""
    most_links: int = 512
    """Maximum number of URDF links; example-robot-data has at most 120."""
    unlimited_effort: float = 1e6
    """N m or N; effort limits from here on count as none, as in URDFs written by bayesid."""
    opposed: float = 1e-3
    """Tolerance of opposite finger axes: rounding of written angles."""
    near_name: float = 0.8
    """Similarity above which a name is proposed: four of five letters. With less, all `_description` names match."""
    named_joints: int = 8
    """Maximum number of joints named in a sentence."""
    named_chains: int = 4
    """Maximum number of chains named in an error."""
    reach_starts: int = 8
    """Random start positions of the search for the reach; two of them suffice for all built-in robots."""
    parallel_axes: float = 0.1
    """Sine of the angle below which axes count as parallel: nearly parallel axes of calibrated robots meet far away."""
    samples_at_once: int = 256
    """Samples of a regressor transformed together: they fit into the processor's cache."""
    bodies_remembered: int = 4
    """Cached sets of link parameters: the current ones and those of load-dependent effects."""


TUNING = Tuning()
