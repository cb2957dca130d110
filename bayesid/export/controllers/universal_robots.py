"""Universal Robots: a program in URScript that follows the motion by servoj.

Functions and their arguments: The URScript Programming Language, Universal Robots A/S, versions 3.2 and 5.
"""

from __future__ import annotations

from bayesid.errors import InputError
from bayesid.export.controllers.planned import PlannedMotion, decimals
from bayesid.export.tuning import TUNING

_CYCLE = 0.002
"""s, of the controller since version 5; four of them are one of version 3."""
_LOOKAHEAD, _GAIN, _STOP = 0.1, 300, 2.0
"""Of servoj, s and 1, and of stopj, rad/s^2: the manual's defaults."""


def urscript(planned: PlannedMotion) -> str:
    """motion.script: movej to the start pose, a servoj for each cycle of the motion, stopj.

    A cycle is the whole number of the controller's that is nearest to the rate's.

    Raises:
        InputError: the robot has not six joints that turn.
    """
    if planned.n_joints != 6 or any(planned.prismatic):
        said = f"{planned.n_joints} joints{', some prismatic,' if any(planned.prismatic) else ''} are none of a UR"
        raise InputError(said, planned.robot, "use joint_trajectory.yaml or motion.csv")
    cycle = _CYCLE * max(1, round(1.0 / (planned.rate * _CYCLE)))
    poses = [f"[{','.join(row)}]" for row in decimals(planned.sampled(cycle).q)]
    head = planned.head(
        "#",
        "URScript program of the motion, rad",
        f"a servoj each {1e3 * cycle:g} ms, which takes that long (t); the path lags by its lookahead time, "
        f"{_LOOKAHEAD:g} s",
        "set the payload before; keep the speed slider at 100 %",
    )
    lines = [
        *head,
        "def motion():",
        "  def to(q):",
        f"    servoj(q, 0, 0, {cycle:.3f}, {_LOOKAHEAD:g}, {_GAIN})",
        "  end",
        f"  movej({poses[0]}, {TUNING.urscript_approach})",
        "  sleep(1.0)",
        *(f"  to({pose})" for pose in poses),
        f"  stopj({_STOP:g})",
        "end",
    ]
    return "\n".join(lines) + "\n"
