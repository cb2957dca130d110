"""What is known of every joint at an instant, and what became of the samples."""

from __future__ import annotations

from dataclasses import dataclass

from bayesid.arrays import Array
from bayesid.monitor.alarms import Alarm

MOVING, REST, UNKNOWN = "moving", "rest", "unknown"
"""States of a joint: at rest nobody knows friction's direction; unknown while there is too little to go by, or since
the joint has changed."""


@dataclass(frozen=True)
class Tracked:
    """What is known of n joints at an instant.

    Attributes:
        t: the instant, s: that of the oldest sample that is still waited for, which is the tracker's lag before the
            newest one. At first, and after a gap, it stays that of the first sample for as long as it must be waited
            for, and of a record that says nothing it is the sample of which nothing is known; nan before any sample
            could be used. It never goes back, unless the clock was set back.
        probability: (n,) P(sign = +) of the effort; 0 or 1 where it is signed, 0.5 where nothing is known.
        effort: (n,) the reading with its likelier sign, N m; nan where there is none.
        effort_sd: (n,) sd of the effort about that, N m: by the doubt about its sign, and the sensor's noise.
        predicted: (n,) the model's effort, N m; nan before there are enough samples.
        predicted_sd: (n,) its sd, N m: by parameters and motion.
        residual: (n,) effort - predicted, N m.
        external: (n,) external torque of each joint by the momentum observer, N m; nan while it is not known.
        threshold: (n,) beyond which it is one, N m; inf while that is not known.
        state: (n,) of each joint: "moving", "rest" or "unknown".
        contact: joints (from 1) whose external torque is beyond the threshold.
        alarms: that this sample has raised.
        q: (n,) positions as estimated, rad.
        dq: (n,) velocities, rad/s.
        ddq: (n,) accelerations, rad/s^2.
        fresh: False if the sample brought nothing: it was late, repeated or not a number.

    Example:
        >>> tracker = bayesid.SignTracker(bayesid.load_model("result"), rate=50.0)
        >>> for t, q, effort in zip(log.t, log.q, log.effort):
        ...     now = tracker.update(t, q, effort)
        >>> now.state
        ('moving', 'moving', 'moving')
    """

    t: float
    probability: Array
    effort: Array
    effort_sd: Array
    predicted: Array
    predicted_sd: Array
    residual: Array
    external: Array
    threshold: Array
    state: tuple[str, ...]
    contact: tuple[int, ...]
    alarms: tuple[Alarm, ...]
    q: Array
    dq: Array
    ddq: Array
    fresh: bool = True


@dataclass
class Counts:
    """What became of the samples.

    Attributes:
        updates: samples that were taken.
        repeated: with the time of the sample before: left out.
        late: with an earlier time: left out.
        missing: without a finite time, position or velocity: left out.
        unread: efforts of single joints that were no numbers: their signs are the model's.
        gaps: pauses after which the tracker began anew.
        set_back: times that the clock was set back, after which it did so too.
    """

    updates: int = 0
    repeated: int = 0
    late: int = 0
    missing: int = 0
    unread: int = 0
    gaps: int = 0
    set_back: int = 0
