"""Numbers of the command line that are choices."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Their values; the sentence under each says where it is from."""

    payload_mass_sd: float = 0.001
    """Standard deviation of a payload's mass where none is given, as a share of it: a common scale's."""
    poses: int = 300
    """Poses of a log that the robot is known to have been in without touching itself."""
    steps: int = 50
    """Rows of a stream after which the time between them is compared with the rate."""
    off: float = 20.0
    """Factor between the two from which on the time is not in seconds, or the rate another stream's."""
    width: int = 78
    """Characters of a line of sentences where there is no terminal: two less than the usual 80."""
    patience: float = 1.0
    """s; what ends sooner is not worth a progress bar."""
    between_lines: float = 10.0
    """s from one line of progress to the next where no terminal shows a bar: six a minute of a log that others read."""


TUNING = Tuning()
