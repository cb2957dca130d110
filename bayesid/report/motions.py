"""Designed motions, for an unknown robot or after a result: their folders and their text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.arrays import Array
from bayesid.excitation.assessment import ExcitationAssessment
from bayesid.excitation.design import ExcitationDesign, Quality
from bayesid.excitation.next_motion import NextExperiment, PredictedKnowledge
from bayesid.excitation.resolvability import JointFlips
from bayesid.excitation.splines import DEGREE
from bayesid.excitation.tuning import TUNING as EXCITATION
from bayesid.export.controllers import PROGRAM_FOLDERS, PlannedMotion, Programs, check_programs, save_programs
from bayesid.files.writing import check_folder, save_folder, write_json, write_motion, write_table
from bayesid.identification.checks import Check, State
from bayesid.identification.identification import KNOWN
from bayesid.log.corrections import corrections
from bayesid.motion import Motion
from bayesid.number_text import percent
from bayesid.report.conclusion import Conclusion, sentence
from bayesid.report.summary import as_object, taken
from bayesid.report.tuning import TUNING
from bayesid.report.words import counted, table

DESIGN_MARKER, NEXT_MARKER = "design.json", "next_motion.json"
DESIGN_FILES = frozenset({DESIGN_MARKER, "trajectory.csv", "excitation.svg"})
NEXT_FILES = frozenset({NEXT_MARKER, "next_motion.svg", "predicted.csv"}) | PROGRAM_FOLDERS
_COUNT = "as in the uncorrected log"
_MODEL_COUNT = "this table, limits and --start as in the robot file"
_RESOLVABILITY = "resolvability: twice the natural log of the odds against flipping all signs of the joint"
_JOINT = ["joint", "starts at", "lowest", "highest", "speed", "acceleration"]


def save_design(design: ExcitationDesign, folder: str | Path) -> Path:
    """Writes trajectory.csv, design.json and excitation.svg; an earlier design there is replaced as a whole.

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier design.
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
    uncertain = zip(coefficients.names, coefficients.expressions, design.reached.uncertainty, strict=True)
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
            "coefficients": {name: {"expression": text, "left": uncertainty} for name, text, uncertainty in uncertain},
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
    flips = quality.joints
    group = {
        "joints": [j + 1 for j in flips.groups[flips.weakest]],
        "resolvability": flips.resolvability[flips.weakest],
    }
    return {
        "condition_number": quality.condition,
        "noise_tolerance": quality.tolerance,
        "weakest_group": group,
        "segments": len(quality.segments.joint),
        "wrong_share": quality.segments.doubtful,
    }


def _reached(motion: Motion) -> dict[str, Array]:
    fastest, hardest = (np.abs(values).max(axis=0) for values in (motion.dq, motion.ddq))
    ends = {"lower": motion.q.min(axis=0), "upper": motion.q.max(axis=0)}
    return ends | {"velocity": fastest, "acceleration": hardest}


def design_text(design: ExcitationDesign) -> str:
    """A table of the joints, figures at the start and reached, and coefficients that are not determined."""
    before, after, shares, names = design.start, design.reached, design.of_limits, design.coefficients.names
    resolved = [_resolved(value) for value in after.joints.resolvability[: design.motion.n_joints]]
    undecided, noise = [names[i] for i in design.undecided], percent(design.noise, 0)
    lines = [
        f"{design.model.robot.name}: {design.motion.t[-1]:g} s at {design.rate:g} Hz, "
        f"{counted(design.periods, 'period')}, from rest to rest",
        table([*_JOINT, "resolvability"], _joint_rows(design.motion, shares.dq, shares.ddq, resolved)),
        "positions in rad (m for sliding joints), speed and acceleration as shares of their limits;",
        f"{_RESOLVABILITY}, at a noise of {noise}",
        f"condition number {after.condition:.1f} (best random motion: {before.condition:.1f})",
        f"noise tolerance of the signs: {percent(after.tolerance, 0)} of the RMS effort "
        f"(best random motion: {percent(before.tolerance, 0)})",
        f"lowest resolvability: {_group(after.joints)}",
        f"not determined at a noise of {noise}: {len(undecided)} of {len(names)} coefficients, {', '.join(undecided)}"
        if undecided
        else f"all {len(names)} coefficients are determined at a noise of {noise}",
        "not checked: collisions and effort limits; run the motion slowly first",
    ]
    return "\n".join(lines)


def _joint_rows(motion: Motion, speed: Array, acceleration: Array, last: Sequence[str]) -> list[list[str]]:
    start, low, high = motion.q[0], motion.q.min(axis=0), motion.q.max(axis=0)
    used = [np.abs(values).max(axis=0) for values in (speed, acceleration)]
    return [
        [
            *(str(j + 1), f"{start[j]:z.3f}", f"{low[j]:.2f}", f"{high[j]:.2f}"),
            *(percent(share[j], 0) for share in used),
            more,
        ]
        for j, more in enumerate(last)
    ]


def _group(flips: JointFlips) -> str:
    group, cost = flips.groups[flips.weakest], flips.resolvability[flips.weakest]
    return f"all signs of joint{'s' * (len(group) > 1)} {', '.join(str(j + 1) for j in group)} ({_resolved(cost)})"


def _resolved(resolvability: float) -> str:
    return "> 1000" if resolvability > 1000.0 else f"{resolvability:.3g}"


def assessment_text(assessment: ExcitationAssessment) -> str:
    """A table of the joints, the condition number, and coefficients and signs that the log does not determine."""
    flips = assessment.joints
    of_joint = {} if flips is None else dict(zip(flips.groups, flips.resolvability.tolist(), strict=True))
    rows = [
        [
            *(
                str(j + 1),
                f"{assessment.reach[j]:.2f}",
                f"{assessment.speed[j]:.2f}",
                f"{assessment.acceleration[j]:.1f}",
            ),
            *(
                percent(assessment.idle[j], 0),
                _resolved(of_joint[j,]) if (j,) in of_joint else "known",
                percent(assessment.doubtful[j], 1),
            ),
        ]
        for j in range(len(assessment.reach))
    ]
    lines = [
        f"{assessment.source}: excitation: {assessment.state}",
        table(["joint", "range", "speed", "acceleration", "still", "resolvability", "doubtful"], rows),
        f"rad, rad/s, rad/s^2; {_RESOLVABILITY};",
        f"doubtful: expected energy with a wrong sign; both at a noise of {percent(assessment.noise, 0)}",
        f"condition number {assessment.condition:.1f}, with equal noise in all joints; that of `identify` weights "
        "joints by their noise",
        *([] if flips is None else [f"lowest resolvability: {_group(flips)}"]),
        *(f"- {remark}" for remark in assessment.remarks),
    ]
    return "\n".join(lines)


def assessment_conclusion(assessment: ExcitationAssessment, design: str) -> Conclusion:
    """Whether the motion suffices; if not, the command that designs another."""
    state: State = assessment.state
    count, few = len(assessment.coefficients), len(assessment.undecided)
    most = percent(EXCITATION.most_undetermined, 0)
    undetermined = f"; {few} of {count} coefficients are not determined (good: at most {most})" if few else ""
    doubtful = ""
    if (share := float(assessment.doubtful.max())) > EXCITATION.doubtful_energy:
        limit = percent(EXCITATION.doubtful_energy, 0)
        doubtful = f"; the sign of up to {percent(share, 0)} of a joint's energy is doubtful (good: at most {limit})"
    sentences: dict[State, str] = {
        "good": f"The motion determines the signs and most coefficients{undetermined}",
        "look": f"Usable with care{undetermined}{doubtful}",
        "bad": f"A joint or its signs cannot be identified from this motion{undetermined}",
    }
    action = Check("Excitation", state, "", f"`{design}` designs another motion")
    return Conclusion(state, sentence(state, sentences[state]), () if state == "good" else (action,))


def check_next_folder(folder: str | Path) -> Path:
    """The folder of `bayesid.files.writing.check_folder`, if a next motion may be written there."""
    place = check_folder(folder, NEXT_FILES, NEXT_MARKER)
    check_programs(place)
    return place


def save_next_motion(design: NextExperiment, folder: str | Path) -> Path:
    """Writes next_motion.json, predicted.csv, next_motion.svg, and a folder of programs for each speed.

    An earlier one there is replaced as a whole.

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier one.
    """
    check_next_folder(folder)

    def write(place: Path) -> None:
        from bayesid.report.plot.motions import planned_motion  # matplotlib takes a second to import

        programs = save_programs(planned(design), place, design.allowed_speeds)
        write_table(place / "predicted.csv", predicted_rows(design.predicted))
        write_json(place / NEXT_MARKER, next_summary(design, programs))
        planned_motion(picture(design)).savefig(place / "next_motion.svg", transparent=False, facecolor="white")

    return save_folder(folder, NEXT_FILES, NEXT_MARKER, write)


def planned(design: NextExperiment) -> PlannedMotion:
    """The motion for programs: positions as in the uncorrected log."""
    robot, settings = design.known.model.robot, design.settings
    positions, _ = corrections(design.correct, robot.n_joints)
    joints = [(robot.joints[j], j + 1) for j in np.argsort(positions.order)]

    def recorded(t: Array) -> Motion:
        motion = design.trajectory.motion(t)
        q, dq, ddq = positions.recorded(motion.q, zero=True), *map(positions.recorded, (motion.dq, motion.ddq))
        return Motion(motion.t, q, dq, ddq, payload=motion.payload)

    as_logged = PlannedMotion(
        robot=robot.name,
        joint_names=tuple(joint.name or f"joint{j}" for joint, j in joints),
        prismatic=tuple(joint.prismatic for joint, _ in joints),
        at=recorded,
        duration=settings.duration,
        rate=settings.rate,
        checked=design.checked,
        not_checked=design.unchecked,
    )
    if design.correct is None:
        return as_logged
    return replace(as_logged, convention=f"the convention of the uncorrected log ({design.correct})")


def picture(design: NextExperiment) -> Any:
    """The input of `bayesid.report.plot.motions.planned_motion`."""
    from bayesid.report.plot.motions import MotionPicture, extreme_poses

    robot, motion, limits, clearance = design.known.model.robot, design.motion, design.limits, design.clearance
    effort, sd = design.effort_band
    distance = None if clearance is None else clearance.distance(motion.q)
    return MotionPicture(
        robot=robot.name,
        joint_names=planned(design).joint_names,
        motion=motion,
        limits=limits,
        effort=effort,
        effort_band=(effort - EXCITATION.effort_sds * sd, effort + EXCITATION.effort_sds * sd),
        poses=extreme_poses(robot, motion, distance),
        distance=distance,
        margin=None if clearance is None else clearance.margin,
        not_checked="\n".join(f"Not checked: {sentence}." for sentence in design.unchecked),
        sliding=tuple(joint.prismatic for joint in robot.joints),
    )


def predicted_rows(predicted: PredictedKnowledge) -> list[dict[str, object]]:
    """predicted.csv: one row per coefficient or gain, with its sd now and after the recording."""
    columns = {
        "name": predicted.names,
        "unit": predicted.units,
        "mean": predicted.mean,
        "sd_now": predicted.sd_now,
        "sd": predicted.sd,
        "sd_if_model_lacks_as_much": predicted.sd_lacking,
    }
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*map(list, columns.values()), strict=True)]
    for row in rows:
        for name in ("sd_now", "sd"):
            row[f"r{name}_percent"] = 100.0 * row[name] / abs(row["mean"]) if row["mean"] else ""
    return rows


def next_summary(design: NextExperiment, programs: Programs) -> dict[str, Any]:
    """next_motion.json: predicted knowledge, what no motion shows, limits given and reached, checks."""
    settings, after, limits, clearance = design.settings, design.predicted, design.limits, design.clearance
    given = taken(limits, "lower", "upper", "velocity", "acceleration", "jerk", "effort")
    distance = None if clearance is None else clearance.distance(design.motion.q).min()
    return as_object(
        {
            "robot": design.known.model.robot.name,
            **taken(settings, "duration", "rate", start=settings.start or (), payload=settings.payload),
            "about": () if design.goal is None else design.goal.names,
            "information_gain_nats": after.gain,
            **taken(after, "open_now", "open", "certain_signs", open_if_model_lacks_as_much=after.open_lacking),
            "open_after_random_motion": design.of_random.open,
            "log10_bayes_factors": _factors(after),
            "log10_bayes_factors_of_random_motion": _factors(design.of_random),
            "no_motion_tells": design.remarks,
            **taken(design, "checked", "seconds", not_checked=design.unchecked),
            "limits": {name: None if limit is None else np.atleast_1d(limit) for name, limit in given.items()},
            "reached": {**_reached(design.motion), "effort_with_band": design.largest_effort, "distance": distance},
            "margin": None if clearance is None else clearance.margin,
            "programs": {"folders": [folder.name for folder in programs.folders], "files": programs.files},
            "not_written": programs.left_out,
            "control_points": design.trajectory.control,
            **({} if design.correct is None else {"programs_count_before": design.correct}),
        }
    )


def _factors(predicted: PredictedKnowledge) -> list[dict[str, object]]:
    factors = predicted.log10_bayes_factors.items()
    return [{"true": true, "against": other, "expected": value} for (true, other), value in factors]


def next_motion_text(design: NextExperiment) -> str:
    """Predicted knowledge, what no motion shows, use of the limits, and checks."""
    settings, predicted = design.settings, design.predicted
    carried = f", with {settings.payload} on the flange" if settings.payload else ""
    lines = [
        f"{design.known.model.robot.name}: {settings.duration:g} s at {settings.rate:g} Hz, from rest to rest{carried}",
        *(_of_rivals(predicted, design.of_random) if design.goal is None else _of_goal(design, design.goal.names)),
        f"certain signs: {percent(predicted.certain_signs, 1)} of |effort| "
        f"(random motion: {percent(design.of_random.certain_signs, 1)})",
        "the random motion ignores limits of efforts and distances",
        *(f"- {sentence}" for sentence in design.remarks),
        "",
        table([*_JOINT, "effort"], _joints(design)),
        *([] if design.correct is None else [f"programs: positions {_COUNT} ({design.correct}); {_MODEL_COUNT}"]),
        "positions in rad (m for sliding joints); others as shares of their limits, efforts with their band",
        *_clearance(design),
        *(f"NOT checked: {sentence}" for sentence in design.unchecked),
        f"checked: {'; '.join(design.checked)}",
    ]
    return "\n".join(lines)


def _of_goal(design: NextExperiment, names: Sequence[str]) -> Iterator[str]:
    after, random = design.predicted, design.of_random
    yield (
        f"coefficients not known to {percent(KNOWN, 0)}: {after.open_now} now, {after.open} after this motion "
        f"({after.open_lacking} if the model error stays as large), {random.open} after a random motion"
    )
    if 2 * (after.open_now - after.open_lacking) < after.open_now - after.open:
        yield "less than half of this remains if the model error stays: complete the model first (bayesid discrepancy)"
    chosen = [k for k, name in enumerate(after.names) if name in names]
    if not chosen:
        yield f"goal: {len(names)} combinations of coefficients; coefficients that improve most:"
        chosen = list(range(len(after.names)))
    most = sorted(chosen, key=lambda k: after.sd[k] / after.sd_now[k])[: TUNING.next_coefficients]
    sds = after.sd_now, after.sd, random.sd
    rows = [[after.names[k], f"{after.mean[k]:.4g}", *(f"{sd[k]:.2g}" for sd in sds), after.units[k]] for k in most]
    yield table(["name", "value", "sd now", "sd after", "random motion", "unit"], rows)
    if worse := [after.names[k] for k in most if after.sd[k] >= random.sd[k]]:
        yield f"no better than the random motion: {', '.join(worse)}; try more --changes, or wider --limits"


def _of_rivals(predicted: PredictedKnowledge, random: PredictedKnowledge) -> Iterator[str]:
    threshold, factors = EXCITATION.decisive, predicted.log10_bayes_factors
    rows = [
        [*pair, f"{value:.3g}", "yes" if value >= threshold else "no", f"{random.log10_bayes_factors[pair]:.3g}"]
        for pair, value in factors.items()
    ]
    yield table(["if true", "against", "log10 Bayes factor", "distinguished", "random motion"], rows)
    yield f"expected log10 Bayes factor against the most similar form; {threshold:g} or more distinguishes"
    if max(factors.values(), default=-np.inf) < threshold:
        yield "this motion distinguishes none of them: try a longer --duration or wider --limits"


def _joints(design: NextExperiment) -> list[list[str]]:
    motion, limits, n = design.motion, design.limits, design.known.model.robot.n_joints
    speed, acceleration = (np.broadcast_to(limit, n) for limit in (limits.velocity, limits.acceleration))
    known = np.isfinite(design.feasibility.effort)
    shares = design.largest_effort / design.feasibility.effort
    efforts = [percent(share, 0) if shown else "no limit" for share, shown in zip(shares, known, strict=True)]
    return _joint_rows(motion, motion.dq / speed, motion.ddq / acceleration, efforts)


def _clearance(design: NextExperiment) -> Iterator[str]:
    if (clearance := design.clearance) is not None:
        distances = clearance.distance(design.motion.q)
        least, (first, second) = clearance.nearest(design.motion.q[int(distances.argmin())])
        yield f"least distance: {least:.3f} m, {first} to {second} (required: {clearance.margin:g} m)"
