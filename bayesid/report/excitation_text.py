"""A design and a judgement as text for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.excitation.design import ExcitationDesign
from bayesid.excitation.judgement import ExcitationJudgement
from bayesid.excitation.resolvability import JointFlips
from bayesid.report.words import table

_UNCHECKED = "not checked: collisions with itself or the surroundings, and limits of the efforts; play it slowly first"


def design_text(design: ExcitationDesign) -> str:
    """A table of the joints, what the design has gained over its start, and what stays undecided."""
    before, after, shares, motion = design.start, design.reached, design.of_limits, design.motion
    timing = f"{motion.t[-1]:g} s at {design.rate:g} Hz, {_counted(design.periods, 'period')}"
    heading = ["joint", "starts at", "lowest", "highest", "speed", "acceleration", "resolvability"]
    rows = []
    for j in range(design.model.robot.n_joints):
        positions = [f"{motion.q[0, j]:.3f}", f"{motion.q[:, j].min():.2f}", f"{motion.q[:, j].max():.2f}"]
        used = [f"{np.abs(values[:, j]).max():.0%}" for values in (shares.dq, shares.ddq)]
        rows.append([str(j + 1), *positions, *used, f"{after.joints.resolvability[j]:.3g}"])
    lines = [
        f"{design.model.robot.name}: {timing}, from rest to rest",
        table(heading, rows),
        "positions in rad (m where a joint slides), speed and acceleration as shares of their limits;",
        f"resolvability: twice the log odds against all signs of the joint turned, at a noise of {design.noise:.0%}",
        f"condition number {before.condition:.1f} at the start, {after.condition:.1f} reached",
        f"noise that the signs bear: {before.tolerance:.0%} of the RMS at the start, {after.tolerance:.0%} reached",
        f"easiest to mistake: {_group(after.joints)}",
        _undecided([design.coefficients.names[i] for i in design.undecided], len(after.uncertainty), design.noise),
        _UNCHECKED,
    ]
    return "\n".join(lines)


def judgement_text(judgement: ExcitationJudgement) -> str:
    """A table of the joints, the condition number, and what the log leaves undecided."""
    flips, n = judgement.joints, len(judgement.reach)
    of_joint = {} if flips is None else dict(zip(flips.groups, flips.resolvability.tolist(), strict=True))
    rows = []
    for j in range(n):
        reached = [f"{judgement.reach[j]:.2f}", f"{judgement.speed[j]:.2f}", f"{judgement.acceleration[j]:.1f}"]
        resolved = f"{of_joint[j,]:.3g}" if (j,) in of_joint else "known"
        rows.append([str(j + 1), *reached, f"{judgement.idle[j]:.0%}", resolved, f"{judgement.doubtful[j]:.1%}"])
    heading = ["joint", "range", "speed", "acceleration", "still", "resolvability", "doubtful"]
    lines = [
        f"{judgement.source}: excitation is {judgement.light}",
        table(heading, rows),
        "rad, rad/s, rad/s^2; resolvability: twice the log odds against all signs of the joint turned;",
        f"doubtful: energy with the wrong sign, segments one by one; both at a noise of {judgement.noise:.0%}",
        f"condition number {judgement.condition:.1f}, all joints alike; `identify` weighs each by the noise it finds",
        *([] if flips is None else [f"easiest to mistake: {_group(flips)}"]),
        *(f"- {remark}" for remark in judgement.remarks),
    ]
    return "\n".join(lines)


def _group(flips: JointFlips) -> str:
    group, cost = flips.groups[flips.weakest], flips.resolvability[flips.weakest]
    return f"all signs of joint{'s' * (len(group) > 1)} {', '.join(str(j + 1) for j in group)} ({cost:.3g})"


def _undecided(names: Sequence[str], of: int, noise: float) -> str:
    if not names:
        return f"all {of} coefficients are decided at a noise of {noise:.0%}"
    return f"{len(names)} of {of} coefficients stay undecided at a noise of {noise:.0%}: {', '.join(names)}"


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"
