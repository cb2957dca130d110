"""Folders of motions that were designed: for a robot nobody knows, and after a result."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bayesid.excitation.design import ExcitationDesign, Quality
from bayesid.excitation.next_motion import NextMotion, PredictedKnowledge
from bayesid.excitation.splines import DEGREE
from bayesid.excitation.tuning import TUNING
from bayesid.export.controllers import PROGRAM_FOLDERS, PlannedMotion, Programs, check_programs, save_programs
from bayesid.files.tables import write_json, write_motion, write_table
from bayesid.files.writing import check_folder, save_folder
from bayesid.motion import Motion

DESIGN_FILES = frozenset({"design.json", "trajectory.csv", "excitation.svg"})
DESIGN_MARKER = "design.json"
NEXT_MARKER = "next_motion.json"
NEXT_FILES = frozenset({NEXT_MARKER, "next_motion.svg", "predicted.csv"}) | PROGRAM_FOLDERS


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
    motion, spline = design.motion, design.trajectory
    return {
        "robot": design.model.robot.name,
        "terms": [term.name for term in design.model.terms],
        "duration": float(motion.t[-1]),
        "rate": design.rate,
        "periods": design.periods,
        "noise": design.noise,
        "start": _figures(design.start),
        "reached": _figures(design.reached),
        "joint_resolvability": design.reached.joints.resolvability[: design.model.robot.n_joints].tolist(),
        "undecided": [design.coefficients.names[i] for i in design.undecided],
        "coefficients": {
            name: {"expression": expression, "left": float(uncertainty)}
            for name, expression, uncertainty in zip(
                design.coefficients.names, design.coefficients.expressions, design.reached.uncertainty, strict=True
            )
        },
        "limits": {
            "given": {key: np.atleast_1d(value).tolist() for key, value in vars(design.limits).items()},
            "reached": _reached(motion),
        },
        "spline": {
            "period": spline.duration,
            "degree": DEGREE,
            "knots": spline.basis.knots.tolist(),
            "control_points": spline.control.tolist(),
        },
        "not_checked": ["collisions", "limits of the efforts"],
    }


def _figures(quality: Quality) -> dict[str, Any]:
    weakest = quality.joints.weakest
    return {
        "condition_number": quality.condition,
        "noise_tolerance": quality.tolerance,
        "weakest_group": {
            "joints": [j + 1 for j in quality.joints.groups[weakest]],
            "resolvability": float(quality.joints.resolvability[weakest]),
        },
        "segments": len(quality.segments.joint),
        "wrong_share": quality.segments.doubtful,
    }


def _reached(motion: Motion) -> dict[str, list[float]]:
    return {
        "lower": motion.q.min(axis=0).tolist(),
        "upper": motion.q.max(axis=0).tolist(),
        "velocity": np.abs(motion.dq).max(axis=0).tolist(),
        "acceleration": np.abs(motion.ddq).max(axis=0).tolist(),
    }


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
        effort_band=(effort - TUNING.band * sd, effort + TUNING.band * sd),
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
            "rsd_now_percent": _percent(now, mean),
            "rsd_percent": _percent(after, mean),
        }
        for name, unit, (mean, now, after, lacking) in zip(predicted.names, predicted.units, numbers, strict=True)
    ]


def _percent(sd: float, mean: float) -> object:
    return 100.0 * sd / abs(mean) if mean else ""


def next_summary(design: NextMotion, programs: Programs) -> dict[str, Any]:
    """next_motion.json: what will be known, what no motion tells, limits given and reached, what was not checked."""
    motion, limits = design.motion, design.run.limits
    assert limits is not None
    clearance = design.run.clearance
    return {
        "robot": design.known.model.robot.name,
        "duration": design.run.duration,
        "rate": design.run.rate,
        "start": list(design.run.start or ()),
        "payload": design.run.payload,
        "about": [] if design.goal is None else list(design.goal.names),
        "information_gain_nats": design.predicted.gain,
        "open_now": design.predicted.open_now,
        "open": design.predicted.open,
        "open_if_model_lacks_as_much": design.predicted.open_lacking,
        "open_after_random_motion": design.of_random.open,
        "certain_signs": design.predicted.certain_signs,
        "log10_bayes_factors": _factors(design.predicted),
        "log10_bayes_factors_of_random_motion": _factors(design.of_random),
        "no_motion_tells": list(design.never),
        "checked": list(design.checked),
        "not_checked": list(design.unchecked),
        "limits": {
            name: None if (limit := getattr(limits, name)) is None else np.atleast_1d(limit).tolist()
            for name in ("lower", "upper", "velocity", "acceleration", "jerk", "effort")
        },
        "reached": {
            **_reached(motion),
            "effort_with_band": design.largest_effort.tolist(),
            "distance": None if clearance is None else float(clearance.distance(motion.q).min()),
        },
        "margin": None if clearance is None else clearance.margin,
        "programs": {"folders": [folder.name for folder in programs.folders], "files": list(programs.files)},
        "not_written": dict(programs.left_out),
        "control_points": design.trajectory.control.tolist(),
        "seconds": design.seconds,
    }


def _factors(predicted: PredictedKnowledge) -> list[dict[str, object]]:
    return [
        {"true": true, "against": other, "expected": value}
        for (true, other), value in predicted.log10_bayes_factors.items()
    ]
