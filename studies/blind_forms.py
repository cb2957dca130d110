"""Torques of a joint that are outside of the catalogue, with the variables of each.

A form is drawn for a joint j and another joint k; its shape (M,) over a `Play` of `bayesid.studies.blind` has no scale.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bayesid.studies.blind import BEFORE, DURATION, OUTSIDE_SHAPES, Draft, either, on_joint, within


class Form(NamedTuple):
    """Variables such as "q{j}" or "t"; parameters and shape from (rng, play, j, k); whether its sign is fixed."""

    variables: tuple[str, ...]
    draw: Callable
    fixed: bool = False


def phase_of(rng):
    """A random phase."""
    return float(rng.uniform(0, 2 * np.pi))


def worn_region(rng, play, j, k):
    """Friction where the gear is worn or damaged."""
    centre, width = within(rng, play, j, 0.2, 0.8), float(rng.uniform(0.15, 0.4))
    return (
        {"centre": centre, "width": width},
        lambda p: np.exp(-(((p.q[:, j] - centre) / width) ** 2) / 2) * np.sign(p.dq[:, j]),
    )


def quadratic_drag(rng, play, j, k):
    """Churning of grease and oil."""
    return {}, lambda p: p.dq[:, j] * np.abs(p.dq[:, j])


def cubic_drag(rng, play, j, k):
    """Drag that grows with the cube of the speed."""
    return {}, lambda p: p.dq[:, j] ** 3


def eccentric_gear(rng, play, j, k):
    """Viscous friction that varies twice per turn."""
    phase = phase_of(rng)
    return {"phase": phase}, lambda p: (1 + np.sin(2 * p.q[:, j] + phase)) * p.dq[:, j]


def detent(rng, play, j, k):
    """Detent torque of two poles per turn: slower than a ripple, not gravity."""
    phase = phase_of(rng)
    return {"phase": phase}, lambda p: np.cos(2 * p.q[:, j] + phase)


def crossed_detent(rng, play, j, k):
    """Torque between magnets on two links."""
    phase = phase_of(rng)
    return {"phase": phase}, lambda p: np.sin(3 * p.q[:, k] + phase) * np.cos(2 * p.q[:, j])


def friction_by_other_speed(rng, play, j, k):
    """Friction in a common bearing or gear that is loaded by the other joint's speed."""
    return {}, lambda p: np.abs(p.dq[:, k]) * np.sign(p.dq[:, j])


def soft_stop(rng, play, j, k):
    """Rubber near one end of the joint's range."""
    side, width = either(rng), float(rng.uniform(0.15, 0.4))
    end = float(np.max(side * play.q[BEFORE:, j]))
    shape = {"side": side, "end": end, "width": width}
    return shape, lambda p: side * np.exp((side * p.q[:, j] - end) / width)


def loaded_drag(rng, play, j, k):
    """Viscous friction of teeth under load."""
    return {}, lambda p: np.abs(p.rigid[:, j]) * p.dq[:, j]


def slow_wave(rng, play, j, k):
    """A slow external disturbance."""
    frequency, phase = float(rng.uniform(0.05, 0.3)), phase_of(rng)
    return {"frequency": frequency, "phase": phase}, lambda p: np.sin(2 * np.pi * frequency * p.t + phase)


def beat(rng, play, j, k):
    """Two close frequencies of a drive."""
    frequency, apart = float(rng.uniform(0.5, 2.0)), float(rng.uniform(0.05, 0.15))
    first, second = 2 * np.pi * (frequency + np.array([-apart, apart]))
    return {"frequency": frequency, "apart": apart}, lambda p: np.sin(first * p.t) + np.sin(second * p.t)


def hose(rng, play, j, k):
    """A hose past both joints, stiffer the more they bend it."""
    rest = float(np.median(play.q[BEFORE:, j] + play.q[BEFORE:, k]))

    def shape(p):
        bend = p.q[:, j] + p.q[:, k] - rest
        return bend * np.abs(bend)

    return {"rest": rest}, shape


def cable_past_other(rng, play, j, k):
    """A cable that the other joint tightens: it then pulls this joint towards its middle."""
    taut, middle = within(rng, play, k, 0.3, 0.6), within(rng, play, j, 0.3, 0.7)
    shape = {"taut": taut, "middle": middle}
    return shape, lambda p: np.maximum(0.0, p.q[:, k] - taut) * np.sin(p.q[:, j] - middle)


def wind_of_other(rng, play, j, k):
    """Drag of a part that the other joint moves."""
    return {}, lambda p: p.dq[:, k] * np.abs(p.dq[:, k])


def accelerating_only(rng, play, j, k):
    """A drive with more torque in one direction when it accelerates."""
    return {}, lambda p: np.abs(p.ddq[:, j])


def slipped_once(rng, play, j, k):
    """A cable that catches and slips: a torque that grows and then vanishes."""
    start, length = float(rng.uniform(0.1, 0.5)) * DURATION, float(rng.uniform(0.1, 0.3)) * DURATION
    shape = {"start": start, "length": length}
    return shape, lambda p: np.where((p.t >= start) & (p.t < start + length), (p.t - start) / length, 0.0)


OLD = {
    "tanh": Form(("q{j}", "dq{j}"), OUTSIDE_SHAPES["tanh"]),
    "coupling": Form(("q{j}", "q{k}"), OUTSIDE_SHAPES["coupling"]),
    "velocity_product": Form(("dq{j}", "dq{k}"), OUTSIDE_SHAPES["velocity_product"]),
    "remote_friction": Form(("q{k}", "dq{j}"), OUTSIDE_SHAPES["remote_friction"], fixed=True),
    "gaussian_process": Form(("q{j}", "dq{j}"), OUTSIDE_SHAPES["gaussian_process"]),
    "bursts": Form(("t",), OUTSIDE_SHAPES["bursts"]),
}
FRESH = {
    "worn_region": Form(("q{j}", "dq{j}"), worn_region, fixed=True),
    "quadratic_drag": Form(("dq{j}",), quadratic_drag, fixed=True),
    "cubic_drag": Form(("dq{j}",), cubic_drag, fixed=True),
    "eccentric_gear": Form(("q{j}", "dq{j}"), eccentric_gear, fixed=True),
    "detent": Form(("q{j}",), detent),
    "crossed_detent": Form(("q{j}", "q{k}"), crossed_detent),
    "friction_by_other_speed": Form(("dq{j}", "dq{k}"), friction_by_other_speed, fixed=True),
    "soft_stop": Form(("q{j}",), soft_stop, fixed=True),
    "loaded_drag": Form(("tau{j}", "dq{j}"), loaded_drag, fixed=True),
    "slow_wave": Form(("t",), slow_wave),
    "beat": Form(("t",), beat),
    "hose": Form(("q{j}", "q{k}"), hose, fixed=True),
    "cable_past_other": Form(("q{j}", "q{k}"), cable_past_other, fixed=True),
    "wind_of_other": Form(("dq{k}",), wind_of_other),
    "accelerating_only": Form(("ddq{j}",), accelerating_only),
}
FORMS = OLD | FRESH
"""Forms of the hidden effect "outside"."""
ONCE = FORMS | {"slipped_once": Form(("t",), slipped_once)}
"""Forms that are hidden in one log only."""


def draft_of(form, rng, play, j) -> Draft:
    """A form drawn for joint j (from 0) and another joint; its parameters list its variables, counted from 1."""
    k = (j + int(rng.integers(1, play.robot.n))) % play.robot.n
    variables, draw, fixed = ONCE[form]
    parameters, shape = draw(rng, play, j, k)
    named = sorted(x.format(j=j + 1, k=k + 1) for x in variables)
    known = {"form": form, "other_joint": k + 1, "variables": named}
    return on_joint(j, known | parameters, shape, 1.0 if fixed else either(rng))
