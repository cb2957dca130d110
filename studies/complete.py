"""What does model selection improve? Logs identified without it (`off`) and with it (`auto`).

Parts, mixed in the plan so that a short run has some of each:

- classes: simulated logs without a hidden effect, with one effect in one joint, or with wrong kinematics. Coverage of
  95 % intervals, errors and standard deviations of the coefficients of the standard terms.
- noise: no hidden effect, several kinds of noise. How often is an effect added falsely?
- blind: one or two hidden effects that are not among the standard terms. Signs in both modes.
- pairs and poor: real logs. Torque error on another log; signs where the standard model is poor. The logs are in
  $BAYESID_DATA, on workers of a cluster as well; without them the plan has no such part.

Errors and standard deviations of coefficients are relative to the coefficient that alone would give efforts as large as
the log's (RMS over all joints, each relative to its effort), the same in both modes. Signs count in motion, where
|effort| is at least 5 % of its joint's maximum.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.arrays import Array
from bayesid.effects import STANDARD
from bayesid.identification.identification import Identification
from bayesid.identification.options import Completeness
from bayesid.identification.pipeline import identify
from bayesid.identification.prediction import NORMAL_95
from bayesid.log.log import Log
from bayesid.log.reading import read_log
from bayesid.posterior.sampler import Sampling
from bayesid.regression.knowledge import ParameterPrior
from bayesid.robot import Robot, load_robot
from bayesid.signs.search.certified import Certified
from bayesid.studies.complete_report import MODES, draw, report
from bayesid.studies.discrepancy import generator
from bayesid.studies.hidden import Case, Simulated, make_case
from bayesid.studies.readings import NOISES
from bayesid.studies.real import DATA, right_signs
from bayesid.studies.record import Row
from bayesid.studies.study import Study, mixed

PAIRS = (
    *permutations(("ur10e/a_50s", "ur10e/b_20s", "ur10e/c_unloaded"), 2),
    *(halves for log in ("panda/a", "tx40/a") for halves in permutations((f"{log}:1", f"{log}:2"))),
)
POOR = ("lwr4/a", "kr300/a", "dualarm/a")
_LOGS = 20
"""Of each class, and of each kind of noise."""
_BLIND_LOGS = 60
_ARMS = ("kr5", "random")
_LAG = (0.02, 0.04)
"""s"""
_SHORT = 2.0
"""s"""
_MILLIMETRE, _DEGREE = 1e-3, float(np.pi / 180.0)
_TURN = 1000
"""Added to the seeds when the plan begins again."""


@dataclass(frozen=True)
class Recorded:
    """A real log.

    Attributes:
        part: of the study.
        name: of the log or the pair of logs.
        data: folder of the robots' folders.
        log: robot/log, with :1 or :2 for half of it.
        target: another log, to be predicted; empty for none.
        posterior: whether it is sampled.
    """

    part: str
    name: str
    data: str
    log: str
    target: str = ""
    posterior: bool = False


def plan(trials: int, seed: int) -> Sequence[tuple[Simulated | Recorded, int]]:
    """All parts, mixed evenly; then all again with other seeds.

    Raises:
        InputError: MuJoCo is not installed.
    """
    order = mixed([_classes(), _noise(), _blind(lacked()), *_real()])
    return [
        (order[k % len(order)][0], seed + order[k % len(order)][1] + _TURN * (k // len(order))) for k in range(trials)
    ]


def lacked() -> tuple[str, ...]:
    """The generator's effects that standard terms do not include: all but friction, offset, rotor, payload.

    Raises:
        InputError: MuJoCo is not installed.
    """
    return tuple(effect for effect in generator("complete").EFFECTS if effect not in (*STANDARD, "payload"))


def _classes() -> list[tuple[Simulated, int]]:
    """Each class with the same seed, then again with the next; KR5 and random robots in turn."""

    def of(name: str, **options: Any) -> Simulated:
        return Simulated("classes", name, "", **options)

    kinds = [
        of("right"),
        of("exact", exact=True),
        of("stribeck", effects=("stribeck_friction",)),
        of("load_dependent", effects=("load_dependent_friction",)),
        of("dh", length=_MILLIMETRE, angle=0.1 * _DEGREE),
        of("dh_wide", length=5.0 * _MILLIMETRE, angle=0.5 * _DEGREE),
        of("delay", effects=("delay",), lag=_LAG),
        of("warming", effects=("thermal_drift",)),
        of("short", duration=_SHORT),
    ]
    return [(replace(kind, robot=_ARMS[k % 2]), k) for k in range(_LOGS) for kind in kinds]


def _noise() -> list[tuple[Simulated, int]]:
    return [(Simulated("noise", name, _ARMS[k % 2], reading=name), k + _LOGS) for k in range(_LOGS) for name in NOISES]


def _blind(lacked: Sequence[str]) -> list[tuple[Simulated, int]]:
    """Every effect in turn, alone and with another one."""
    logs, count = [], len(lacked)
    for k in range(_BLIND_LOGS):
        turn = k // count
        both = lacked[k % count], lacked[(k + 4 + turn) % count]
        scenario = Simulated("blind", "blind", _ARMS[(k // 2 + turn) % 2], both[: 1 + k % 2])
        logs.append((scenario, k + 2 * _LOGS))
    return logs


def _real() -> list[list[tuple[Recorded, int]]]:
    """Parts with real logs; none where the logs are missing."""
    if not DATA.is_dir():
        return []
    data = str(DATA)
    pairs = [(Recorded("pairs", f"{log} -> {target}", data, log, target), 0) for log, target in PAIRS]
    return [pairs, [(Recorded("poor", log, data, log), 0) for log in POOR]]


# ---------------------------------------------------------------------------------------------------------------
# Trials
# ---------------------------------------------------------------------------------------------------------------
def trial(scenario: Simulated | Recorded, seed: int) -> Row:
    """Identifies one log in each mode, without its signs, and scores both."""
    return _of_simulated(scenario, seed) if isinstance(scenario, Simulated) else _of_recorded(scenario, seed)


def _of_simulated(scenario: Simulated, seed: int) -> Row:
    case = make_case(scenario, seed)
    modes = MODES[1:] if scenario.part == "noise" else MODES
    results: dict[str, Identification] = {
        mode: _identified(case.robot, case.log, mode, scenario.prior, scenario.posterior, seed) for mode in modes
    }
    of_coefficients = _of_coefficients(case, results) if scenario.part == "classes" else {}
    hidden = [named(effect, joints) for effect, joints in case.hidden]
    return {"hidden": hidden, **of_coefficients, **_of_signs(case.log, results)}


def _of_recorded(scenario: Recorded, seed: int) -> Row:
    data = Path(scenario.data)
    log, robot = read_part(data, scenario.log), robot_of(data, scenario.log)
    results: dict[str, Identification] = {
        mode: _identified(robot, log, mode, ParameterPrior(), scenario.posterior, seed) for mode in MODES
    }
    errors = {}
    if scenario.target:
        target = read_part(data, scenario.target)
        errors = {
            f"torque_error_{mode}": result.validate(target).rms_error.tolist() for mode, result in results.items()
        }
    return {**_of_signs(log, results), **errors}


def robot_of(data: Path, log: str) -> Robot:
    """The robot of a log, robot/log."""
    return load_robot(next((data / log).parent.glob("robot.*")))


def read_part(data: Path, name: str) -> Log:
    """A log, robot/log, or half of it, robot/log:1."""
    place, _, half = name.partition(":")
    log = read_log(data / f"{place}.csv")
    return half_of(log, int(half)) if half else log


def half_of(log: Log, which: int) -> Log:
    """The first (1) or the second (2) half of a log."""
    middle = len(log) // 2
    rows = slice(0, middle) if which == 1 else slice(middle, len(log))
    dq = None if log.dq is None else log.dq[rows]
    return replace(log, t=log.t[rows], q=log.q[rows], effort=log.effort[rows], dq=dq, pieces=())


def _identified(
    robot: Robot, log: Log, mode: Completeness, prior: ParameterPrior, posterior: bool, seed: int
) -> Identification:
    """Identifies the log without its signs."""
    sampling = Sampling(rng=seed) if posterior else False
    return identify(robot, log.rectified(), complete=mode, search=Certified(), posterior=sampling, prior=prior)


def named(effect: str, joints: tuple[int, ...]) -> str:
    """An effect with its joints, as text."""
    return f"{effect} {','.join(map(str, joints)) or 'all'}"


def _entered(result: Identification) -> list[str]:
    return [] if result.model_selection is None else [named(e.effect, e.joints) for e in result.model_selection.effects]


# ---------------------------------------------------------------------------------------------------------------
# Scores
# ---------------------------------------------------------------------------------------------------------------
def _of_signs(log: Log, results: Mapping[str, Identification]) -> Row:
    """Right signs, certificate and added effects in each mode."""
    row: Row = {}
    for mode, result in results.items():
        right, counted = right_signs(result, log)
        row |= {
            f"right_{mode}": _share(right[counted]),
            f"joints_{mode}": [_share(right[counted[:, j], j]) for j in range(log.n_joints)],
            f"certified_{mode}": bool(result.search.certified),
            f"entered_{mode}": _entered(result),
        }
    return {**row, "timings": {mode: sum(result.timings.values()) for mode, result in results.items()}}


def _share(right: Any) -> float:
    return float(right.mean()) if right.size else float("nan")


def _of_coefficients(case: Case, results: Mapping[str, Identification]) -> Row:
    """Errors, standard deviations and coverage of the coefficients of the standard terms."""
    units = _units(case, results[MODES[0]])
    scored = {mode: _errors(case, result, list(units)) for mode, result in results.items()}
    in_all = np.all([np.isfinite(error) for error, _ in scored.values()], axis=0)
    unit = np.array(list(units.values()))
    row: Row = {"compared": int(in_all.sum())}
    for mode, (error, sd) in scored.items():
        finite = np.isfinite(error)
        relative, relative_sd = (values[in_all] / unit[in_all] for values in (error, sd))
        row |= {
            f"coefficients_{mode}": int(finite.sum()),
            f"inside_{mode}": int(np.sum(np.abs(error[finite]) <= NORMAL_95 * sd[finite])),
            f"error_{mode}": float(np.sqrt(np.mean(relative**2))),
            f"sd_{mode}": float(relative_sd.mean()),
        }
    return row


def _units(case: Case, result: Identification) -> dict[str, float]:
    """For each coefficient of the standard terms the value that alone gives efforts of the log's size.

    Size: mean over the log of the sum over joints of (effort over the joint's RMS effort)^2.
    """
    motion = result.signals.motion
    model, standard = case.standard(motion)
    columns = model.columns(motion)[:, :, standard.selected] / np.sqrt(np.mean(case.log.effort**2, axis=0))[:, None]
    size = np.sqrt(np.mean(np.sum(columns**2, axis=1), axis=0))
    return dict(zip(standard.names, (np.sqrt(case.log.n_joints) / size).tolist(), strict=True))


def _errors(case: Case, result: Identification, names: Sequence[str]) -> tuple[Array, Array]:
    """(k,) errors of the named coefficients and their standard deviations; NaN where one of them is unknown."""
    places = {name: k for k, name in enumerate(result.coefficients.names)}
    error, sd = result.beta - case.truth(result.model, result.coefficients), result.sd
    known = np.array([name in places for name in names])
    chosen = np.array([places.get(name, 0) for name in names])
    good = known & np.isfinite(error[chosen]) & np.isfinite(sd[chosen])
    return np.where(good, error[chosen], np.nan), np.where(good, sd[chosen], np.nan)


STUDY = Study(
    "complete", 9 * _LOGS + len(NOISES) * _LOGS + _BLIND_LOGS + len(PAIRS) + len(POOR), plan, trial, report, draw
)
