"""Discrepancies made by hand, with different numbers everywhere: nothing is compared."""

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
from conftest import smooth_motion

from bayesid.discrepancy.case import Excess, NoiseFloor, Trial
from bayesid.discrepancy.workflow import Discrepancy
from bayesid.effects.bodies import Payload
from bayesid.effects.drive import TorqueOffset
from bayesid.effects.friction import CoulombFriction
from bayesid.log.signals import Signals
from bayesid.regression.selection.added_effect import AddedEffect
from bayesid.regression.selection.columns import Columns
from bayesid.regression.selection.fitted_effects import LN10, Thresholds
from bayesid.regression.selection.hypotheses import Hypothesis
from bayesid.regression.selection.scores import Score

N_JOINTS, COULOMB, NOISE = 3, 1.9, 0.3
EMPTY = Columns({}, {}, np.zeros(0), np.zeros(0, dtype=bool))


def hypothesis(source, changes=()):
    return Hypothesis(source, EMPTY, lambda other: hypothesis(other), changes)


def found(source, parameters=None, changes=(), equivalent=(), probability=0.99, competing=(), **more):
    what, alike = hypothesis(source, changes), tuple(equivalent)
    return AddedEffect(
        what, 40.0 * LN10, probability, 0.004, 0.006, competing, alike, parameters=parameters or {}, **more
    )


def score(source, log10, **more):
    return Score(hypothesis(source), log10 * LN10, 9.0, **more)


def friction(joint=2):
    return CoulombFriction(joints=(joint,), smoothing=(0.05,))


def make_trial():
    """A log without signs; joint 2 has Coulomb friction that its model lacks."""
    motion, rng = smooth_motion(N_JOINTS, 20.0, 100.0, seed=3), np.random.default_rng(4)
    before = 5.0 * np.sin(motion.q) + 8.0
    after = before.copy()
    after[:, 1] += COULOMB * np.tanh(motion.dq[:, 1] / 0.05)
    effort = np.abs(after + NOISE * rng.standard_normal(after.shape))
    everywhere = np.ones(effort.shape, dtype=bool)
    signals = Signals(motion, effort, effort, np.zeros(N_JOINTS, dtype=bool), 100.0, 8.0, {}, everywhere)
    used = everywhere.copy()
    used[:50] = False
    return Trial(signals, motion, used), before, after


def made_of(robot_name="arm <A&B>", n=N_JOINTS, sliding=(), log='log "1" & <2>.csv'):
    """What an identification says of its robot and log."""
    joints = [SimpleNamespace(prismatic=j in sliding) for j in range(1, n + 1)]
    robot = SimpleNamespace(name=robot_name, joints=joints)
    return SimpleNamespace(model=SimpleNamespace(robot=robot), log=SimpleNamespace(source=log))


TRIAL, PREDICTED_BEFORE, PREDICTED_AFTER = make_trial()
FRICTION = {"Fc2": (COULOMB, 0.1, "N m")}
NOTHING = {"added": (), "where": (), "refused": (), "not_testable": (), "warnings": ()}


def floor_of(rms, origin="repeated periods", mostly_coloured=(), white=0.9):
    """Of joints, those of some (0-based) most of which lasts."""
    which = np.isin(np.arange(len(rms)), mostly_coloured)
    limits, every = np.stack([rms, rms], axis=1), np.ones(len(rms), dtype=bool)
    return NoiseFloor(rms, (origin,) * len(rms), limits, every, white * rms, which)


def make(**changes):
    """A result in which joint 2 lacked Coulomb friction."""
    values = {
        "status": "explained",
        "where": (Excess(2, 1.87, "velocity", (-1.25, 0.75)),),
        "added": (found(friction(), FRICTION),),
        "sets": (),
        "preexisting": (),
        "before": np.array([0.292, 2.41, 0.313]),
        "after": np.array([0.291, 0.312, 0.312]),
        "floor": replace(floor_of(np.array([0.29, 0.30, 0.31])), reliable=np.array([True, True, False])),
        "holdout": "later <b>.csv",
        "unexplained": (),
        "scores": (
            score(friction(), 40.25, improvement=30.0, mean_square=np.ones(3)),
            score(TorqueOffset(joints=(2,)), 1.5),
            score(Payload(), -0.75),
        ),
        "refused": (found(TorqueOffset(joints=(3,)), {}),),
        "not_testable": (("hysteresis", (1,)), ("hysteresis", (2,)), ("hysteresis", (3,)), ("payload", ())),
        "identification": made_of(),
        "trial": TRIAL,
        "predicted_before": PREDICTED_BEFORE,
        "predicted_after": PREDICTED_AFTER,
        "warnings": ("beware of <script>alert(1)</script>",),
        "thresholds": Thresholds(),
        "seconds": 1.0,
    }
    values["unexplained_on"] = {joint: ("log",) for joint, _ in changes.get("unexplained", ())}
    return Discrepancy(**{**{one.name: values.get(one.name) for one in fields(Discrepancy)}, **changes})
