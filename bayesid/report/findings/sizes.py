"""What a result folder holds to show belongs together: shapes, kinds and indices, before anything is drawn of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayesid.report.findings.content import Findings

_SHAPES: Mapping[str, Mapping[str, str]] = {
    "samples": {
        "t": "N",
        **dict.fromkeys(("position", "velocity", "recorded", "signed", "predicted", "residual", "probability"), "Nn"),
        "used": "Nn",
        "every": "",
    },
    "segments": dict.fromkeys(("joint", "start", "end", "sign", "confidence", "moving", "ambiguous"), "S"),
    "correlation": {"lag": "L", "value": "nL", "bound": "n"},
    "coefficients": dict.fromkeys(
        ("name", "expression", "unit", "mean", "sd", "low", "high", "prior_sd", "nominal", "by_data"), "r"
    ),
    "alternatives": {**dict.fromkeys(("cost", "mass"), "B"), **dict.fromkeys(("branch", "joint", "start", "end"), "D")},
    "prediction": {
        "source": "",
        "t": "M",
        **dict.fromkeys(("measured", "predicted", "lower", "upper"), "Mn"),
        **dict.fromkeys(("rms_error", "relative_residual", "coverage"), "n"),
        "band": "",
        "seen": "",
    },
}
"""Part and array to its shape, a letter an axis, as in `bayesid.report.findings.content`."""
_KINDS = {
    "used": "b",
    "moving": "b",
    "ambiguous": "b",
    "by_data": "b",
    "seen": "b",
    "every": "iu",
    **dict.fromkeys(("joint", "sign", "branch"), "iu"),
    **dict.fromkeys(("name", "expression", "unit", "source", "band"), "U"),
}
"""Arrays to their kinds, as numpy calls them; all others hold numbers with fractions."""
_MAY_LACK = "coefficients", "alternatives", "prediction"
"""Parts in which something may be not known, or endless."""
_MOST = 1e30
"""Of a number that is shown: what is beyond cannot be squared in single precision."""


def check_sizes(findings: Findings) -> None:
    """Refuses findings whose arrays do not belong together.

    Raises:
        ValueError: they do not.
    """
    n = findings.n_joints
    sizes = {"n": n}
    _sized(findings.position_unit, "n", sizes, "position_unit")
    for part, shapes in _SHAPES.items():
        content = getattr(findings, part)
        for name, shape in shapes.items() if content is not None else ():
            values = np.asarray(getattr(content, name))
            _sized(values, shape, sizes, f"{part}.{name}")
            if values.size and values.dtype.kind not in _KINDS.get(name, "f"):
                raise ValueError(f"{part}.{name} holds values of another kind")
            if values.dtype.kind == "f" and not _in_range(values, part in _MAY_LACK):
                raise ValueError(f"{part}.{name} holds values that bayesid does not write")
    for name, values, most in (
        ("segments.joint", findings.segments.joint, n),
        ("alternatives.joint", findings.alternatives.joint, n),
        ("alternatives.branch", findings.alternatives.branch, sizes["B"]),
    ):
        if values.size and not (values.min() >= 0 and values.max() < most):
            raise ValueError(f"{name} counts beyond {most}")
    if not sizes["N"] or not n or findings.samples.every < 1:
        raise ValueError("samples holds none")
    if findings.draws is not None:
        _sized(findings.draws, "EWr", sizes, "posterior.nc")
    _check_summary(findings, sizes)


def _sized(values: Any, shape: str, sizes: dict[str, int], name: str) -> None:
    """Checks a shape, and notes the sizes of axes that come for the first time."""
    found = np.shape(values)
    if len(found) != len(shape) or any(sizes.setdefault(axis, k) != k for axis, k in zip(shape, found, strict=True)):
        raise ValueError(f"{name} has shape {found}")


def _in_range(values: Any, may_lack: bool) -> bool:
    known = values[np.isfinite(values)] if may_lack else values
    return bool(np.all(np.abs(known) < _MOST))


def _check_summary(findings: Findings, sizes: dict[str, int]) -> None:
    """What has a number a joint has as many as there are, and joints are those of the robot."""
    summary = findings.summary
    noise, posterior, after = summary.noise, summary.posterior, summary.low_pass_after_rectifier
    each: dict[str, Sequence[Any]] = {
        f"noise.{name}": value for name, value in vars(noise).items() if name != "assumed"
    }
    each |= {"search.noise_weights": summary.search.noise_weights, "signs.doubt": summary.signs.doubt}
    each["fit.relative_residual"] = summary.fit.relative_residual
    each |= {} if posterior is None else {"posterior.noise_scale": posterior.noise_scale}
    each |= {} if after is None else {"low_pass_after_rectifier.noise_before_sd": after.noise_before_sd}
    if summary.complete is not None:
        each |= {f"complete.held_back_error.{key}": one for key, one in vars(summary.complete.held_back_error).items()}
    for name, values in each.items():
        _sized(values, "n", sizes, f"summary.json, {name}")
    joints = [*summary.signed_joints, *(one.joint for one in summary.search.ambiguous or ())]
    joints += [joint for mode in summary.modes for joint in mode.turned_joints]
    joints += [joint for effect in (summary.complete.effects if summary.complete else ()) for joint in effect.joints]
    if not all(1 <= joint <= sizes["n"] for joint in joints):
        raise ValueError(f"summary.json names joints beyond {sizes['n']}")
