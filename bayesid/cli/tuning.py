"""Numbers of the command line."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Values of the command line; `TUNING` holds those in use."""

    payload_mass_sd: float = 0.001
    """Default standard deviation of a payload's mass over the mass: the accuracy of common scales."""
    poses: int = 300
    """Poses of a log that are taken as free of collisions, at most; more take longer to check."""
    steps: int = 50
    """Rows of a stream whose median step is compared with the rate: a burst of rows does not matter."""
    off: float = 20.0
    """Ratio of step and rate that is an error: a wrong unit of time is at least a factor of 60."""
    first_part: float = 1.0
    """s at the beginning of a stream whose median time step gives its rate; these rows are answered without signs."""
    least_rows: int = 10
    """Rows that this takes at least: a few of them may have another step."""
    usual_rate: float = 100.0
    """Hz, with which options are checked before the rate is known; its value does not matter."""
    width: int = 78
    """Characters of a line without a terminal: two less than the usual 80."""
    patience: float = 1.0
    """s before a progress bar is shown."""
    between_lines: float = 10.0
    """s between lines of progress without a terminal."""


TUNING = Tuning()
