"""A design's folder: trajectory.csv for the controller, design.json, and a figure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.excitation.design import ExcitationDesign, Quality
from bayesid.files.tables import write_motion
from bayesid.files.writing import save_folder
from bayesid.simulation.trajectories import MotionLimits

DESIGN_FILES = frozenset({"design.json", "trajectory.csv", "excitation.svg"})
DESIGN_MARKER = "design.json"


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
        from bayesid.report.plot.designs import excitation_figure  # matplotlib takes a second to import

        write_motion(place / "trajectory.csv", design.motion)
        (place / "design.json").write_text(
            json.dumps(design_summary(design), indent=2, allow_nan=False) + "\n", encoding="utf-8"
        )
        excitation_figure(design).savefig(place / "excitation.svg", transparent=False, facecolor="white")

    return save_folder(folder, DESIGN_FILES, DESIGN_MARKER, write)


def design_summary(design: ExcitationDesign) -> dict[str, Any]:
    """design.json: figures, limits given and reached, and the series, from which the motion can be had again."""
    motion, series = design.motion, design.trajectory
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
            "given": _limits(design.limits),
            "reached": {
                "lower": motion.q.min(axis=0).tolist(),
                "upper": motion.q.max(axis=0).tolist(),
                "velocity": np.abs(motion.dq).max(axis=0).tolist(),
                "acceleration": np.abs(motion.ddq).max(axis=0).tolist(),
            },
        },
        "series": {
            "equation": "q_j(t) = centre_j + sum_h sine_jh sin(2 pi h frequency t) + cosine_jh cos(2 pi h frequency t)",
            "frequency": series.frequency,
            "centre": series.centre.tolist(),
            "sine": series.sine.tolist(),
            "cosine": series.cosine.tolist(),
        },
        "not_checked": ["collisions", "limits of the efforts"],
    }


def _figures(quality: Quality) -> dict[str, Any]:
    weakest = quality.joints.weakest
    return {
        "condition_number": quality.condition if np.isfinite(quality.condition) else None,
        "noise_tolerance": quality.tolerance,
        "weakest_group": {
            "joints": [j + 1 for j in quality.joints.groups[weakest]],
            "resolvability": float(quality.joints.resolvability[weakest]),
        },
        "segments": len(quality.segments.joint),
        "wrong_share": quality.segments.doubtful,
    }


def _limits(limits: MotionLimits) -> dict[str, Any]:
    return {key: np.atleast_1d(value).tolist() for key, value in vars(limits).items()}
