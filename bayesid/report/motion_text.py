"""Motions that were designed, and a log's, as text for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesid.excitation.design import ExcitationDesign
from bayesid.excitation.judgement import ExcitationJudgement
from bayesid.excitation.next_motion import NextMotion, PredictedKnowledge
from bayesid.excitation.resolvability import JointFlips
from bayesid.excitation.tuning import TUNING as EXCITATION
from bayesid.identification.identification import KNOWN
from bayesid.report.tuning import TUNING
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


def next_motion_text(design: NextMotion) -> str:
    """What will be known, what no motion tells, how far limits are used, and what was not checked."""
    run, predicted = design.run, design.predicted
    carried = f", with {run.payload} on the flange" if run.payload else ""
    lines = [
        f"{design.known.model.robot.name}: {run.duration:g} s at {run.rate:g} Hz, from rest to rest{carried}",
        *(_of_goal(design) if design.goal is not None else _of_rivals(predicted, design.of_random)),
        f"signs that will be certain: {predicted.certain_signs:.1%} of |effort| "
        f"(after a random motion {design.of_random.certain_signs:.1%})",
        "the random motion keeps limits of positions, velocities and accelerations, not of efforts and distances",
        *(f"- {sentence}" for sentence in design.never),
        "",
        table(["joint", "starts at", "lowest", "highest", "speed", "acceleration", "effort"], _joints(design)),
        "positions in rad (m where a joint slides); the others as shares of their limits, efforts with their band",
        *([] if run.clearance is None else [_clearance(design)]),
        f"checked: {'; '.join(design.checked)}",
        *(f"NOT checked: {sentence}" for sentence in design.unchecked),
    ]
    return "\n".join(lines)


def _of_goal(design: NextMotion) -> list[str]:
    after, random = design.predicted, design.of_random
    assert design.goal is not None
    lines = [
        f"coefficients not known to {KNOWN:.0%}: {after.open_now} now, {after.open} after this motion if the "
        f"model is right, {after.open_lacking} if what it may lack stays as large; {random.open} after a random motion"
    ]
    chosen = [k for k, name in enumerate(after.names) if name in design.goal.names]
    if not chosen:
        lines.append(f"aimed at {len(design.goal.names)} sums of them; those of which most is learned on the way:")
        chosen = list(range(len(after.names)))
    most = sorted(chosen, key=lambda k: after.sd[k] / after.sd_now[k])[: TUNING.next_coefficients]
    sds = after.sd_now, after.sd, random.sd
    rows = [[after.names[k], f"{after.mean[k]:.4g}", *(f"{sd[k]:.2g}" for sd in sds), after.units[k]] for k in most]
    return [*lines, table(["name", "value", "sd now", "sd then", "random motion", "unit"], rows)]


def _of_rivals(predicted: PredictedKnowledge, random: PredictedKnowledge) -> list[str]:
    rows = []
    for pair, value in predicted.log10_bayes_factors.items():
        told = "yes" if value >= EXCITATION.telling else "no"
        rows.append([*pair, f"{value:.3g}", told, f"{random.log10_bayes_factors[pair]:.3g}"])
    heading = ["if true", "against", "log10 Bayes factor", "told apart", "random motion"]
    lines = [
        table(heading, rows),
        "expected with the noise as it is known, of the form that imitates best; told apart from "
        f"{EXCITATION.telling:g} on",
    ]
    if all(value < EXCITATION.telling for value in predicted.log10_bayes_factors.values()):
        lines.append("this motion is not expected to tell any apart: a longer one may (--duration), or wider --limits")
    return lines


def _joints(design: NextMotion) -> list[list[str]]:
    motion, limits, n = design.motion, design.run.limits, design.known.model.robot.n_joints
    assert limits is not None
    speed, acceleration = (np.broadcast_to(limit, n) for limit in (limits.velocity, limits.acceleration))
    effort = design.largest_effort / design.feasibility.effort
    rows = []
    for j in range(n):
        positions = [f"{motion.q[0, j]:.3f}", f"{motion.q[:, j].min():.2f}", f"{motion.q[:, j].max():.2f}"]
        shares = [np.abs(motion.dq[:, j]).max() / speed[j], np.abs(motion.ddq[:, j]).max() / acceleration[j]]
        known = f"{effort[j]:.0%}" if np.isfinite(design.feasibility.effort[j]) else "no limit"
        rows.append([str(j + 1), *positions, *(f"{share:.0%}" for share in shares), known])
    return rows


def _clearance(design: NextMotion) -> str:
    clearance, q = design.run.clearance, design.motion.q
    assert clearance is not None
    distances = clearance.distance(q)
    least, (one, other) = clearance.nearest(q[int(distances.argmin())])
    return f"least distance: {least:.3f} m, {one} to {other} (to be kept: {clearance.margin:g} m)"
