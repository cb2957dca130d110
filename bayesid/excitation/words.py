"""What a design and a judgement say on a terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.excitation.design import ExcitationDesign
from bayesid.excitation.judgement import ExcitationJudgement
from bayesid.excitation.resolvability import JointFlips

_UNCHECKED = "not checked: collisions with itself or the surroundings, and limits of the efforts; play it slowly first"


def design_text(design: ExcitationDesign) -> str:
    """A table of the joints, what the design has gained over its start, and what stays undecided."""
    before, after, shares, n = design.start, design.reached, design.of_limits, design.model.robot.n_joints
    seconds = design.motion.t[-1]
    head = f"{design.model.robot.name}: {seconds:g} s at {design.rate:g} Hz, {_counted(design.periods, 'period')}, "
    rows = [
        [
            str(j + 1), f"{design.motion.q[0, j]:.3f}", f"{design.motion.q[:, j].min():.2f}",
            f"{design.motion.q[:, j].max():.2f}", f"{np.abs(shares.dq[:, j]).max():.0%}",
            f"{np.abs(shares.ddq[:, j]).max():.0%}", f"{after.joints.resolvability[j]:.3g}",
        ]
        for j in range(n)
    ]  # fmt: skip
    heading = ["joint", "starts at", "lowest", "highest", "speed", "acceleration", "resolvability"]
    return "\n".join([
        head + "from rest to rest",
        _table(heading, rows),
        "positions in rad (m where a joint slides), speed and acceleration as shares of their limits;",
        f"resolvability: twice the log odds against all signs of the joint turned, at a noise of {design.noise:.0%}",
        f"condition number {before.condition:.1f} at the start, {after.condition:.1f} reached",
        f"noise that the signs bear: {before.tolerance:.0%} of the RMS at the start, {after.tolerance:.0%} reached",
        f"easiest to mistake: {_group(after.joints)}",
        _undecided([design.coefficients.names[i] for i in design.undecided], len(after.left), design.noise),
        _UNCHECKED,
    ])  # fmt: skip


def judgement_text(judgement: ExcitationJudgement) -> str:
    """A table of the joints, the condition number, and what the log leaves undecided."""
    flips, n = judgement.joints, len(judgement.reach)
    of_joint = {} if flips is None else dict(zip(flips.groups, flips.resolvability.tolist(), strict=True))
    rows = [
        [
            str(j + 1), f"{judgement.reach[j]:.2f}", f"{judgement.speed[j]:.2f}", f"{judgement.acceleration[j]:.1f}",
            f"{judgement.idle[j]:.0%}", f"{of_joint[j,]:.3g}" if (j,) in of_joint else "known",
            f"{judgement.doubtful[j]:.1%}",
        ]
        for j in range(n)
    ]  # fmt: skip
    heading = ["joint", "range", "speed", "acceleration", "still", "resolvability", "doubtful"]
    lines = [
        f"{judgement.source}: excitation is {judgement.light}",
        _table(heading, rows),
        "rad, rad/s, rad/s^2; resolvability: twice the log odds against all signs of the joint turned;",
        f"doubtful: energy with the wrong sign, segments one by one; both at a noise of {judgement.noise:.0%}",
        f"condition number {judgement.condition:.1f}, all joints alike; `identify` weighs each by the noise it finds",
        *([] if flips is None else [f"easiest to mistake: {_group(flips)}"]),
        *(f"- {one}" for one in judgement.told),
    ]
    return "\n".join(lines)


def _table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    widths = [max(map(len, column)) for column in zip(heading, *rows, strict=True)]
    lines = [[cell.rjust(width) for cell, width in zip(row, widths, strict=True)] for row in (heading, *rows)]
    return "\n".join("  ".join(line) for line in lines)


def _group(flips: JointFlips) -> str:
    group, found = flips.groups[flips.weakest], flips.resolvability[flips.weakest]
    return f"all signs of joint{'s' * (len(group) > 1)} {', '.join(str(j + 1) for j in group)} ({found:.3g})"


def _undecided(names: Sequence[str], of: int, noise: float) -> str:
    if not names:
        return f"all {of} coefficients are decided at a noise of {noise:.0%}"
    return f"{len(names)} of {of} coefficients stay undecided at a noise of {noise:.0%}: {', '.join(names)}"


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"
