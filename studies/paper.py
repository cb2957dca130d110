"""The paper's experiment over many seeds: new trajectory and new noise each.

python -m studies.paper [--trials 100] [--workers N]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np

from bayesid.demo import run_experiment
from bayesid.paper import TABLE_II
from studies.runner import Row, run


def study(seed: int) -> Row:
    """One run of the experiment."""
    began = time.perf_counter()
    experiment = run_experiment(seed)
    result = experiment.result
    nominal = np.array([row.nominal for row in TABLE_II])
    return {
        "seed": seed,
        "segments": len(result.segments),
        "strong": int(experiment.strong.sum()),
        "wrong": experiment.wrong,
        "coefficients": len(result.fit.beta),
        "estimates": experiment.estimates.tolist(),
        "sd": experiment.sd.tolist(),
        "rsd": (experiment.sd / np.maximum(np.abs(experiment.estimates), 1e-300)).tolist(),
        "z": ((experiment.estimates - nominal) / experiment.sd).tolist(),
        "torque_error": experiment.torque_error.tolist(),
        "seconds": time.perf_counter() - began,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints Table II with its spread, and the figures beside the paper's."""
    parser = argparse.ArgumentParser(description="The paper's experiment over many seeds.")
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--workers", type=int)
    options = parser.parse_args(arguments)
    rows = run(study, range(options.trials), options.workers)
    right = sum(row["wrong"] == 0 for row in rows)
    error = np.median([row["torque_error"] for row in rows], axis=0)
    rsd = np.median([row["rsd"] for row in rows], axis=0)
    z = np.array([row["z"] for row in rows])
    decided = np.array([row.nominal != 0.0 for row in TABLE_II])
    width = max(len(row.expression) for row in TABLE_II)
    print(f" # {'coefficient':<{width}}  nominal   paper  median     5 %    95 %  median rsd  95 % interval covers")
    for i, row in enumerate(TABLE_II):
        found = np.array([trial["estimates"][i] for trial in rows])
        low, middle, high = np.percentile(found, [5, 50, 95])
        covers = np.mean(np.abs(z[:, i]) < 1.96)
        relative = f"{rsd[i]:9.1%}" if row.nominal else "        -"
        print(
            f"{row.number:>2} {row.expression:<{width}}  {row.nominal:7.4f} {row.published:7.4f} {middle:7.4f} "
            f"{low:7.4f} {high:7.4f}   {relative}  {covers:14.0%}"
        )
    print(f"\n{'':<52}{'ours':>10}  paper")
    print(f"{'runs with every strong segment right':<52}{f'{right}/{len(rows)}':>10}  1/1")
    print(f"{'segments (median)':<52}{np.median([r['segments'] for r in rows]):>10.0f}  39")
    print(f"{'coefficients':<52}{rows[0]['coefficients']:>10}  36")
    print(f"{'of Table II with rsd < 10 % (median run, of 26)':<52}{int((rsd[decided] < 0.1).sum()):>10}  -")
    print(f"{'of Table II with rsd < 25 % (median run)':<52}{int((rsd[decided] < 0.25).sum()):>10}  27")
    print("torque error on a new trajectory, median, per joint: " + "  ".join(f"{e:.2%}" for e in error))
    print(f"95 % intervals of all 27 coefficients cover the nominal value in {np.mean(np.abs(z) < 1.96):.1%} of cases")
    print(f"seconds a run, median: {np.median([r['seconds'] for r in rows]):.1f}")
    failed = [row["seed"] for row in rows if row["wrong"]]
    if failed:
        print(f"seeds with a wrong strong segment: {failed}")


if __name__ == "__main__":
    main()
