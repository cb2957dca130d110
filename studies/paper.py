"""Does the experiment of the paper succeed? Many seeds, each with its own trajectory and noise.

The paper gives one run: its estimates stand beside our median and spread, its RMS error beside ours of every seed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bayesid.arrays import Array
from bayesid.cli.demo import run_experiment
from bayesid.cli.paper import NOISE
from bayesid.identification.prediction import NORMAL_95
from bayesid.signs.search.certified import Certified
from bayesid.simulation.paper import TABLE_II
from bayesid.studies.record import Row
from bayesid.studies.study import Study, in_turn

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure


@dataclass(frozen=True)
class Scenario:
    """Noise of the efforts, relative to each joint's RMS effort."""

    noise: float = NOISE


def trial(scenario: Scenario, seed: int) -> Row:
    """One run of the experiment."""
    experiment = run_experiment(seed, scenario.noise, search=Certified())
    result = experiment.result
    nominal = np.array([row.nominal for row in TABLE_II])
    return {
        "segments": len(result.segments),
        "strong": int(experiment.strong.sum()),
        "wrong": experiment.wrong,
        "coefficients": len(result.fit.beta),
        "estimates": experiment.estimates.tolist(),
        "sd": experiment.sd.tolist(),
        "rsd": (experiment.sd / np.maximum(np.abs(experiment.estimates), 1e-300)).tolist(),
        "z": ((experiment.estimates - nominal) / experiment.sd).tolist(),
        "torque_error": experiment.torque_error.tolist(),
        "certified": bool(result.search.certified),
        "timings": result.timings,
    }


def report(rows: Sequence[Row]) -> str:
    """Table II with our spread, and figures beside the paper's."""
    estimates = np.array([row["estimates"] for row in rows])
    z = np.array([row["z"] for row in rows])
    nominal, published = (np.array([getattr(row, key) for row in TABLE_II]) for key in ("nominal", "published"))
    rsd = np.median([row["rsd"] for row in rows], axis=0)
    width = max(len(row.expression) for row in TABLE_II)
    lines = [f" # {'coefficient':<{width}}  nominal   paper  median     5 %    95 %  median rsd  95 % interval covers"]
    for i, row in enumerate(TABLE_II):
        low, middle, high = np.percentile(estimates[:, i], [5, 50, 95])
        relative = f"{rsd[i]:9.1%}" if row.nominal else "        -"
        lines.append(
            f"{row.number:>2} {row.expression:<{width}}  {row.nominal:7.4f} {row.published:7.4f} {middle:7.4f} "
            f"{low:7.4f} {high:7.4f}   {relative}  {np.mean(np.abs(z[:, i]) < NORMAL_95):14.0%}"
        )
    decided = nominal != 0.0
    ours, theirs = _rms_error(estimates - nominal), float(_rms_error(published - nominal))
    right = sum(row["wrong"] == 0 for row in rows)
    torque = np.median([row["torque_error"] for row in rows], axis=0)
    figures = [
        ("runs with every strong segment right", f"{right} of {len(rows)}", "1 of 1"),
        ("segments", spread([row["segments"] for row in rows]), "39"),
        ("coefficients", f"{rows[0]['coefficients']}", "36"),
        ("of Table II with rsd < 25 % (median run)", f"{int((rsd[decided] < 0.25).sum())}", "27"),
        ("of Table II with rsd < 10 % (median run, of 26)", f"{int((rsd[decided] < 0.1).sum())}", "not given"),
        ("rms error over Table II", spread(ours, "{:.4f}"), f"{theirs:.4f}"),
        ("runs with a smaller error than the paper's", f"{int(np.sum(ours < theirs))} of {len(rows)}", ""),
        ("95 % intervals that hold the nominal value", f"{covered(rows):.1%}", "not given"),
        ("signs certified", f"{sum(row['certified'] for row in rows)} of {len(rows)}", "no proof"),
    ]
    for j in range(len(torque)):
        error = spread([row["torque_error"][j] for row in rows], "{:.2%}")
        figures.append((f"torque error on a new trajectory, joint {j + 1}", error, "" if j else "almost overlapping"))
    lines += ["", f"{'':<52}{'ours: median (5 % to 95 %)':>30}   paper"]
    lines += [f"{name:<52}{ours:>30}   {theirs}".rstrip() for name, ours, theirs in figures]
    failed = [row["seed"] for row in rows if row["wrong"]]
    lines += [f"seeds with a wrong strong segment: {failed}"] if failed else []
    torques = f"median torque error of the worst joint: {100 * torque.max():.1f} %"
    return "\n".join([*lines, "", f"all signs right in {right} of {len(rows)} runs; {torques}"])


def covered(rows: Sequence[Row]) -> float:
    """Share of the 95 % intervals that hold the nominal value."""
    return float(np.mean(np.abs([row["z"] for row in rows]) < NORMAL_95))


def _rms_error(error: Array) -> Array:
    """Over the coefficients, the last axis."""
    size: Array = np.sqrt(np.mean(error**2, axis=-1))
    return size


def spread(values: Sequence[float] | Array, form: str = "{:.0f}") -> str:
    """Median, and 5 and 95 % quantile."""
    low, middle, high = np.percentile(values, [5, 50, 95])
    return f"{form.format(middle)} ({form.format(low)} to {form.format(high)})"


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Errors of the coefficients of Table II: ours with their spread over the seeds, and the paper's."""
    from bayesid.studies.figures import COLOURS

    nominal = np.array([row.nominal for row in TABLE_II])
    error = np.array([row["estimates"] for row in rows]) - nominal
    low, middle, high = np.percentile(error, [5, 50, 95], axis=0)
    at = np.arange(1, len(TABLE_II) + 1)
    ax = figure.subplots()
    ax.axhline(0.0, color="#999999", lw=0.8)
    published = np.array([row.published for row in TABLE_II])
    ax.plot(at, published - nominal, "x", color=COLOURS[1], ms=6, label="paper, one run")
    label = f"ours, median and 5 to 95 % of {len(rows)} runs"
    ax.errorbar(at, middle, [middle - low, high - middle], fmt="o", ms=4, color=COLOURS[0], capsize=2, label=label)
    ax.set_yscale("symlog", linthresh=0.01)
    ax.set_xticks(at)
    ax.tick_params("x", labelsize=7)
    ax.set_xlabel("coefficient of Table II")
    ax.set_ylabel("estimate - nominal value, SI units")
    ax.legend(fontsize=8)


STUDY = Study("paper", 100, in_turn([Scenario()]), trial, report, draw)
