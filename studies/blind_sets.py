"""Simulated cases by kind: sets of effects, torques outside of the catalogue, shared errors, wrong tables.

Uses `bayesid.studies.blind`, and no other code of bayesid.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from bayesid.studies.blind import (
    DRAFTS,
    EFFECTS,
    NO_TROUBLE,
    NOISE,
    ORDER,
    OUTSIDE,
    Draft,
    Hidden,
    Trouble,
    drawn_scene,
    first_torques,
    ratio_of,
    simulation,
    sized,
    stream,
    truth_of,
    write_case,
)
from bayesid.studies.blind_forms import FORMS, ONCE, draft_of

PAIRS_APART, PAIRS_TOGETHER, TRIPLES = "pairs, different joints", "pairs, same joint", "triples"
SINGLE, NOTHING, BEYOND = "single", "nothing", "outside"
LOG_ONLY, HOLDOUT_ONLY = "outside, log only", "outside, holdout only"
TABLE, SENSOR = "DH error", "sensor, same joint"
STRIBECK = "Stribeck in all logs"
TROUBLES = {
    "AR(1) 0.9 in all logs": Trouble(memory=0.9),
    "AR(1) 0.97 in all logs": Trouble(memory=0.97),
    "DH wrong by 5 mm in all logs": Trouble(length=5e-3),
    "8-bit readings in all logs": Trouble(bits=8),
    STRIBECK: Trouble(stribeck=0.5),
}
KINDS = (
    *(PAIRS_APART, PAIRS_TOGETHER, TRIPLES, SINGLE, NOTHING, *TROUBLES),
    *(BEYOND, LOG_ONLY, HOLDOUT_ONLY, TABLE, SENSOR),
)
KINEMATIC = "kinematic_error"
"""Name of a wrong table in the truth."""
SIZES = 3.0, 10.0
"""RMS of an effect over that of the noise."""
LEAST, MOST = 0.5, 2.0
"""Size in the hold-out log over that in the log; the range widens if no draw is inside."""
STEPS = {"a": 5e-3, "d": 5e-3, "alpha": float(np.deg2rad(0.5)), "theta": float(np.deg2rad(0.5))}
"""Error of the wrong number, m and rad."""
ROBOTS, LITTLE_NOISE = 20, (0.003, 0.01)
"""Robots tried until the wrong number shows; later ones have this noise."""
PARALLEL = 1e-9
"""Sine of the angle between parallel axes, up to rounding."""

WHOLE_ROBOT = ("payload", "base_tilt", "tool_wrench")
SENSORS = ("dead_zone", "clipping", "delay")
OF_JOINT = tuple(name for name in EFFECTS if name not in WHOLE_ROBOT)
TORQUES = tuple(name for name in OF_JOINT if name not in ORDER)
"""Effects of a single joint, and those of them that are torques."""

SLIDING = ("coulomb_friction", "asymmetric_coulomb", "stribeck_friction", "hysteresis")
"""Forms of sliding friction: any two of them in a joint are a third one."""
LASTING = ("viscous_friction", "coulomb_friction", "asymmetric_coulomb", "stribeck_friction", "torque_offset")
"""Effects that may drift: a constant one together with a drift is a drift to another end value."""
ONE_EFFECT = {
    *(frozenset(pair) for pair in combinations(SLIDING, 2)),
    *(frozenset((name, "thermal_drift")) for name in LASTING),
    frozenset(("asymmetric_coulomb", "torque_offset")),  # Coulomb friction and an offset, its offset changed
}
"""Pairs that are physically one effect when they share a joint."""


class Case(NamedTuple):
    """A case: effects in the order in which they act; form outside of the catalogue, or wrong number of the table."""

    kind: str
    seed: int
    effects: tuple[str, ...]
    form: str
    size: float
    robot: str
    style: str


# --- Plan ------------------------------------------------------------------------------------------------------------
def allowed(names, places):
    """Whether no two effects in a joint are physically one."""
    return not any(
        a[1] == b[1] and frozenset((a[0], b[0])) in ONE_EFFECT
        for a, b in combinations(zip(names, places, strict=True), 2)
    )


def evenly(rng, sets):
    """Sets of names in random order, those with the least frequent names first."""
    waiting, seen, order = [sets[i] for i in rng.permutation(len(sets))], Counter(), []
    while waiting:
        counts = [[seen[name] for name in names] for names in waiting]
        best = min(range(len(waiting)), key=lambda i: (max(counts[i]), sum(counts[i])))
        order.append(waiting.pop(best))
        seen.update(order[-1])
    return order


def possible(kind):
    """Sets of effects, or forms, from which a kind's cases are made in turn."""
    if kind == PAIRS_TOGETHER:
        return [pair for pair in combinations(OF_JOINT, 2) if frozenset(pair) not in ONE_EFFECT]
    sets = {PAIRS_APART: combinations(EFFECTS, 2), TRIPLES: combinations(EFFECTS, 3), SINGLE: zip(EFFECTS)}
    sets[SENSOR] = ((torque, sensor) for sensor in SENSORS for torque in TORQUES)
    forms = {BEYOND: FORMS, LOG_ONLY: ONCE, HOLDOUT_ONLY: ONCE, TABLE: STEPS}
    return list(sets[kind]) if kind in sets else [(form,) for form in forms.get(kind, ("",))]


def of_kind(kind, count, seed):
    """A number of cases of a kind; a larger number begins with the same cases."""
    number = 100 + KINDS.index(kind)
    made, order = [], evenly(stream(seed, number), possible(kind))
    for turn in range(count):
        rng, chosen = np.random.default_rng([seed, number, turn]), order[turn % len(order)]
        named = kind in (PAIRS_APART, PAIRS_TOGETHER, TRIPLES, SINGLE, SENSOR)
        outside = (OUTSIDE,) if kind in (BEYOND, LOG_ONLY, HOLDOUT_ONLY) else (KINEMATIC,) if kind == TABLE else ()
        effects, form = (tuple(first_torques(chosen)), "") if named else (outside, chosen[0])
        size = float(np.exp(rng.uniform(*np.log(SIZES)))) if effects and kind != TABLE else 0.0
        robot = ("kr5", "random", "random", "kr5", "random")[turn % 5]
        style = "standard" if kind in TROUBLES or turn % 2 else "bare"
        made.append(Case(kind, int(rng.integers(2**31)), effects, form, size, robot, style))
    return made


# --- What is hidden --------------------------------------------------------------------------------------------------
def drawn(case, name, rng, play, joint):
    """An effect drawn for this joint; None if it acts on the whole robot but must be in the joint."""
    if name == OUTSIDE:
        return draft_of(case.form, rng, play, joint)
    draft = DRAFTS[name](rng, play, joint)
    anywhere = name in WHOLE_ROBOT or case.kind not in (PAIRS_TOGETHER, SENSOR)
    return draft if draft.joint == joint or (anywhere and draft.joint is None) else None


def shown(case, name, rng, plays, efforts, sd, joint):
    """The effect at its size in this joint, with a similar size in the other log; None if that is not possible."""
    for attempt in range(15):
        draft = drawn(case, name, rng, plays[0], joint)
        effect = None if draft is None else sized(name, draft, plays, efforts, sd, case.size)
        if effect is None:
            continue
        slack = 1.0 if attempt < 10 else 2.0
        low, high = LEAST / slack * case.size, MOST * slack * case.size
        if case.kind in (LOG_ONLY, HOLDOUT_ONLY) or low <= effect.holdout_size <= high:
            return effect
    return None


def places(case, rng, n):
    """A joint for each effect; three effects are not all in one joint."""
    if case.kind in (PAIRS_TOGETHER, SENSOR):
        return [int(rng.integers(n))] * 2
    return [*rng.permutation(n)[:2].tolist(), int(rng.integers(n))][: len(case.effects)]


def all_shown(case, scene):
    """The effects, each at its size in the log, or in the hold-out log if only that has them."""
    rng, plays = stream(case.seed, 12), scene.plays[:0:-1] if case.kind == HOLDOUT_ONLY else scene.plays[1:]
    for _ in range(40):
        joints = places(case, rng, scene.robot.n)
        efforts, hidden = [play.healthy() for play in plays], []
        if not allowed(case.effects, joints):
            continue
        for name, joint in zip(case.effects, joints, strict=True):
            effect = shown(case, name, rng, plays, efforts, scene.noise, joint)
            if effect is None:
                break
            hidden.append(effect)
            efforts = [effect.act(p, e) for p, e in zip(plays, efforts, strict=True)]
        else:
            return tuple(hidden)
    raise RuntimeError(f"{case}: no joints give the size")


def with_wrong_number(robot, row, number, step):
    """The robot with one number of its table changed; later links move with that row's frame."""
    joints = [dict(other) for other in robot.table["joints"]]
    joints[row][number] += step
    return replace(robot, table={**robot.table, "joints": joints})


def kinematic_error(number, row, step):
    """Efforts of the robot with a wrong number, proportional to the magnitude."""

    def act(p, efforts, magnitude):
        changed = with_wrong_number(p.robot, row, number, magnitude * step).rigid_efforts(p.q, p.dq, p.ddq)
        return efforts + changed - p.rigid

    return Draft(None, {"row": row + 1, "number": number, "value": step}, act)


def visible_table_errors(case, scene):
    """Errors of this number that show in both logs, in all rows where it is identifiable, with their sizes.

    The last row only moves the last link. With parallel axes the d of two rows are one number.
    """
    rng, plays, found = stream(case.seed, 13), scene.plays[1:], []
    for row, dh in enumerate(scene.robot.table["joints"][:-1]):
        draft = kinematic_error(case.form, row, float(rng.choice([-1, 1])) * STEPS[case.form])
        if case.form == "d" and abs(np.sin(dh["alpha"])) < PARALLEL:
            continue
        healthy = [play.healthy() for play in plays]
        size, later = (ratio_of(draft.act(p, e, 1.0), e, scene.noise) for p, e in zip(plays, healthy, strict=True))
        if size >= SIZES[0] and later >= LEAST * size:
            found.append((size, Hidden(KINEMATIC, draft, 1.0, later)))
    return found


# --- Cases -----------------------------------------------------------------------------------------------------------
def scene_of(case, seed, noise=NOISE):
    """Robot and motions, with slow parts where Stribeck friction must show."""
    trouble = TROUBLES.get(case.kind, NO_TROUBLE)
    slow, preexisting = "stribeck_friction" in case.effects or None, trouble.stribeck > 0 or None
    return drawn_scene(seed, case.robot, case.style, slow or preexisting, preexisting, trouble, noise)


def simulate(case):
    """The three logs of a case, and the size of the hidden effects."""
    if case.kind != TABLE:
        scene = scene_of(case, case.seed)
        hidden = all_shown(case, scene)
        logs = () if case.kind == HOLDOUT_ONLY else hidden, () if case.kind == LOG_ONLY else hidden
        return simulation(scene, *logs), case.size
    for turn, seed in enumerate(stream(case.seed, 14).integers(2**31, size=200)):  # until the number shows
        scene = scene_of(case, int(seed), NOISE if turn < ROBOTS else LITTLE_NOISE)
        if found := visible_table_errors(case, scene):
            size, effect = found[int(stream(case.seed, 15).integers(len(found)))]
            return simulation(scene, (effect,), (effect,)), size
    raise RuntimeError(f"{case}: shows in no robot")


def make_case(folder, case):
    """Write the case's FILES into the folder and return the truth; its parameters include kind and form."""
    logs, size = simulate(case)
    write_case(folder, logs)
    truth = truth_of(logs, size)
    return replace(truth, parameters=truth.parameters | {"kind": case.kind, "form": case.form})
