"""Motions that were designed, for a robot nobody knows and after a result: their folders, and their text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.arrays import Array
from bayesid.excitation.design import ExcitationDesign, Quality
from bayesid.excitation.judgement import ExcitationJudgement
from bayesid.excitation.next_motion import NextMotion, PredictedKnowledge
from bayesid.excitation.resolvability import JointFlips
from bayesid.excitation.splines import DEGREE
from bayesid.excitation.tuning import TUNING as EXCITATION
from bayesid.export.controllers import PROGRAM_FOLDERS, Programs, check_programs, save_programs
from bayesid.export.planned_motion import PlannedMotion
from bayesid.files.writing import check_folder, save_folder, write_json, write_motion, write_table
from bayesid.identification.identification import KNOWN
from bayesid.motion import Motion
from bayesid.report.summary import as_object, taken
from bayesid.report.tuning import TUNING
from bayesid.report.words import counted, table

DESIGN_FILES = frozenset({"design.json", "trajectory.csv", "excitation.svg"})
DESIGN_MARKER = "design.json"
NEXT_MARKER = "next_motion.json"
NEXT_FILES = frozenset({NEXT_MARKER, "next_motion.svg", "predicted.csv"}) | PROGRAM_FOLDERS
_RESOLVABILITY = "resolvability: twice the log odds against all signs of the joint turned"
_JOINT = ["joint", "starts at", "lowest", "highest", "speed", "acceleration"]


# ---------------------------------------------------------------------------------------------------------------
# For a robot nobody knows
# ---------------------------------------------------------------------------------------------------------------
def save_design(design: ExcitationDesign, folder: str | Path) -> Path:
    """Writes trajectory.csv, design.json and excitation.svg.

    Args:
        design: what to write.
        folder: where; an earlier design there is replaced as a whole.

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier design.

    Example:
        >>> sorted(path.name for path in bayesid.save_design(design, "design").iterdir())
        ['design.json', 'excitation.svg', 'trajectory.csv']
    """

    def write(place: Path) -> None:
        from bayesid.report.plot.motions import excitation_figure  # matplotlib takes a second to import

        write_motion(place / "trajectory.csv", design.motion)
        write_json(place / DESIGN_MARKER, design_summary(design))
        excitation_figure(design).savefig(place / "excitation.svg", transparent=False, facecolor="white")

    return save_folder(folder, DESIGN_FILES, DESIGN_MARKER, write)


def design_summary(design: ExcitationDesign) -> dict[str, Any]:
    """design.json: figures, limits given and reached, and the B-spline of a period, which is the motion."""
    spline, coefficients, n = design.trajectory, design.coefficients, design.model.robot.n_joints
    left = zip(coefficients.names, coefficients.expressions, design.reached.uncertainty, strict=True)
    return as_object(
        {
            "robot": design.model.robot.name,
            "terms": [term.name for term in design.model.terms],
            "duration": design.motion.t[-1],
            **taken(design, "rate", "periods", "noise"),
            "start": _figures(design.start),
            "reached": _figures(design.reached),
            "joint_resolvability": design.reached.joints.resolvability[:n],
            "undecided": [coefficients.names[i] for i in design.undecided],
            "coefficients": {name: {"expression": text, "left": uncertainty} for name, text, uncertainty in left},
            "limits": {
                "given": {key: np.atleast_1d(value) for key, value in vars(design.limits).items()},
                "reached": _reached(design.motion),
            },
            "spline": {
                "period": spline.duration,
                "degree": DEGREE,
                "knots": spline.basis.knots,
                "control_points": spline.control,
            },
            "not_checked": ["collisions", "limits of the efforts"],
        }
    )


def _figures(quality: Quality) -> dict[str, Any]:
    joints, weakest = quality.joints, quality.joints.weakest
    return {
        "condition_number": quality.condition,
        "noise_tolerance": quality.tolerance,
        "weakest_group": {
            "joints": [j + 1 for j in joints.groups[weakest]],
            "resolvability": joints.resolvability[weakest],
        },
        "segments": len(quality.segments.joint),
        "wrong_share": quality.segments.doubtful,
    }


def _reached(motion: Motion) -> dict[str, Array]:
    return {
        "lower": motion.q.min(axis=0),
        "upper": motion.q.max(axis=0),
        "velocity": np.abs(motion.dq).max(axis=0),
        "acceleration": np.abs(motion.ddq).max(axis=0),
    }


def design_text(design: ExcitationDesign) -> str:
    """A table of the joints, what the design has gained over its start, and what stays undecided."""
    before, after, shares, names = design.start, design.reached, design.of_limits, design.coefficients.names
    timing = f"{design.motion.t[-1]:g} s at {design.rate:g} Hz, {counted(design.periods, 'period')}"
    rows = _joint_rows(
        design.motion,
        shares.dq,
        shares.ddq,
        [f"{after.joints.resolvability[j]:.3g}" for j in range(design.motion.n_joints)],
    )
    open_names, noise = [names[i] for i in design.undecided], design.noise
    undecided = f"{len(open_names)} of {len(names)} coefficients stay undecided at a noise of {noise:.0%}"
    lines = [
        f"{design.model.robot.name}: {timing}, from rest to rest",
        table([*_JOINT, "resolvability"], rows),
        "positions in rad (m where a joint slides), speed and acceleration as shares of their limits;",
        f"{_RESOLVABILITY}, at a noise of {noise:.0%}",
        f"condition number {before.condition:.1f} at the start, {after.condition:.1f} reached",
        f"noise that the signs bear: {before.tolerance:.0%} of the RMS at the start, {after.tolerance:.0%} reached",
        f"easiest to mistake: {_group(after.joints)}",
        f"{undecided}: {', '.join(open_names)}"
        if open_names
        else f"all {len(names)} coefficients are decided at a noise of {noise:.0%}",
        "not checked: collisions with itself or the surroundings, and limits of the efforts; play it slowly first",
    ]
    return "\n".join(lines)


def _joint_rows(motion: Motion, speed: Array, acceleration: Array, last: Sequence[str]) -> list[list[str]]:
    """Positions of each joint, the largest shares of its limits, and what else there is to say."""
    rows = []
    for j, more in enumerate(last):
        positions = [f"{motion.q[0, j]:.3f}", f"{motion.q[:, j].min():.2f}", f"{motion.q[:, j].max():.2f}"]
        used = [f"{np.abs(values[:, j]).max():.0%}" for values in (speed, acceleration)]
        rows.append([str(j + 1), *positions, *used, more])
    return rows


def _group(flips: JointFlips) -> str:
    group, cost = flips.groups[flips.weakest], flips.resolvability[flips.weakest]
    return f"all signs of joint{'s' * (len(group) > 1)} {', '.join(str(j + 1) for j in group)} ({cost:.3g})"


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
        f"rad, rad/s, rad/s^2; {_RESOLVABILITY};",
        f"doubtful: energy with the wrong sign, segments one by one; both at a noise of {judgement.noise:.0%}",
        f"condition number {judgement.condition:.1f}, all joints alike; `identify` weighs each by the noise it finds",
        *([] if flips is None else [f"easiest to mistake: {_group(flips)}"]),
        *(f"- {remark}" for remark in judgement.remarks),
    ]
    return "\n".join(lines)


# ---------------------------------------------------------------------------------------------------------------
# After a result
# ---------------------------------------------------------------------------------------------------------------
def check_next_folder(folder: str | Path) -> Path:
    """The folder, if a next motion may be written there, as `bayesid.files.writing.check_folder` has it."""
    place = check_folder(folder, NEXT_FILES, NEXT_MARKER)
    check_programs(place)
    return place


def save_next_motion(design: NextMotion, folder: str | Path) -> Path:
    """Writes next_motion.json, predicted.csv, next_motion.svg, and a folder of programs for each speed.

    Args:
        design: what to write.
        folder: where; an earlier one there is replaced as a whole.

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier one.

    Example:
        >>> design = bayesid.design_next(result, run=bayesid.RunSettings(duration=4.0), changes=10)
        >>> sorted(path.name for path in bayesid.save_next_motion(design, "next").iterdir())[:4]
        ['next_motion.json', 'next_motion.svg', 'predicted.csv', 'speed_10']
    """
    check_next_folder(folder)

    def write(place: Path) -> None:
        from bayesid.report.plot.motions import planned_motion  # matplotlib takes a second to import

        programs = save_programs(planned(design), place, design.slow)
        write_table(place / "predicted.csv", predicted_rows(design.predicted))
        write_json(place / NEXT_MARKER, next_summary(design, programs))
        planned_motion(picture(design)).savefig(place / "next_motion.svg", transparent=False, facecolor="white")

    return save_folder(folder, NEXT_FILES, NEXT_MARKER, write)


def planned(design: NextMotion) -> PlannedMotion:
    """The motion as programs take it."""
    joints = design.known.model.robot.joints
    return PlannedMotion(
        robot=design.known.model.robot.name,
        joint_names=tuple(joint.name or f"joint{j}" for j, joint in enumerate(joints, start=1)),
        prismatic=tuple(joint.prismatic for joint in joints),
        at=design.trajectory.motion,
        duration=design.run.duration,
        rate=design.run.rate,
        checked=design.checked,
        not_checked=design.unchecked,
    )


def picture(design: NextMotion) -> Any:
    """What `bayesid.report.plot.motions` draws."""
    from bayesid.report.plot.motions import MotionPicture, extreme_poses

    robot, motion, limits = design.known.model.robot, design.motion, design.run.limits
    assert limits is not None
    effort, sd = design.effort_band
    distance = None if design.run.clearance is None else design.run.clearance.distance(motion.q)
    return MotionPicture(
        robot=robot.name,
        joint_names=planned(design).joint_names,
        motion=motion,
        limits=limits,
        effort=effort,
        effort_band=(effort - EXCITATION.band * sd, effort + EXCITATION.band * sd),
        poses=extreme_poses(robot, motion, distance),
        distance=distance,
        margin=None if design.run.clearance is None else design.run.clearance.margin,
        not_checked="; ".join(design.unchecked),
    )


def predicted_rows(predicted: PredictedKnowledge) -> list[dict[str, object]]:
    """predicted.csv: one row a coefficient or gain, its sd now and after the recording."""
    columns = (predicted.mean, predicted.sd_now, predicted.sd, predicted.sd_lacking)
    numbers = np.column_stack(columns).tolist()
    return [
        {
            "name": name,
            "unit": unit,
            "mean": mean,
            "sd_now": now,
            "sd": after,
            "sd_if_model_lacks_as_much": lacking,
            "rsd_now_percent": 100.0 * now / abs(mean) if mean else "",
            "rsd_percent": 100.0 * after / abs(mean) if mean else "",
        }
        for name, unit, (mean, now, after, lacking) in zip(predicted.names, predicted.units, numbers, strict=True)
    ]


def next_summary(design: NextMotion, programs: Programs) -> dict[str, Any]:
    """next_motion.json: what will be known, what no motion tells, limits given and reached, what was not checked."""
    run, after, limits, clearance = design.run, design.predicted, design.run.limits, design.run.clearance
    assert limits is not None
    given = taken(limits, "lower", "upper", "velocity", "acceleration", "jerk", "effort")
    return as_object(
        {
            "robot": design.known.model.robot.name,
            **taken(run, "duration", "rate", start=run.start or (), payload=run.payload),
            "about": () if design.goal is None else design.goal.names,
            "information_gain_nats": after.gain,
            **taken(after, "open_now", "open", open_if_model_lacks_as_much=after.open_lacking),
            "open_after_random_motion": design.of_random.open,
            "certain_signs": after.certain_signs,
            "log10_bayes_factors": _factors(after),
            "log10_bayes_factors_of_random_motion": _factors(design.of_random),
            "no_motion_tells": design.never,
            "checked": design.checked,
            "not_checked": design.unchecked,
            "limits": {name: None if limit is None else np.atleast_1d(limit) for name, limit in given.items()},
            "reached": {
                **_reached(design.motion),
                "effort_with_band": design.largest_effort,
                "distance": None if clearance is None else clearance.distance(design.motion.q).min(),
            },
            "margin": None if clearance is None else clearance.margin,
            "programs": {"folders": [folder.name for folder in programs.folders], "files": programs.files},
            "not_written": programs.left_out,
            "control_points": design.trajectory.control,
            "seconds": design.seconds,
        }
    )


def _factors(predicted: PredictedKnowledge) -> list[dict[str, object]]:
    return [
        {"true": true, "against": other, "expected": value}
        for (true, other), value in predicted.log10_bayes_factors.items()
    ]


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
        table([*_JOINT, "effort"], _joints(design)),
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
    known = np.isfinite(design.feasibility.effort)
    efforts = [f"{effort[j]:.0%}" if known[j] else "no limit" for j in range(n)]
    return _joint_rows(motion, motion.dq / speed, motion.ddq / acceleration, efforts)


def _clearance(design: NextMotion) -> str:
    clearance, q = design.run.clearance, design.motion.q
    assert clearance is not None
    distances = clearance.distance(q)
    least, (one, other) = clearance.nearest(q[int(distances.argmin())])
    return f"least distance: {least:.3f} m, {one} to {other} (to be kept: {clearance.margin:g} m)"
