"""A study of your own: what a model leaves of the efforts, by sampling rate."""

from dataclasses import dataclass

import bayesid
from bayesid.studies import Study, run_study
from bayesid.studies.study import in_turn


@dataclass(frozen=True)
class Rate:
    """Sampling rate, Hz."""

    rate: float


def trial(scenario, seed):
    """What one identification leaves of the worst joint's effort."""
    signed = bayesid.simulate("kr5-paper", duration=5.0, rate=scenario.rate, rng=seed, signed=True)
    result = bayesid.identify("kr5-paper", signed.rectified(), terms=["rigid_body"], posterior=False)
    return {"residual": float(result.validate(signed).relative_residual.max())}


def report(rows):
    """One sentence."""
    return f"worst joint leaves {max(row['residual'] for row in rows):.0%}"


def draw(rows, figure):
    """Residual over rate."""
    figure.subplots().plot([row["rate"] for row in rows], [row["residual"] for row in rows], "o")


if __name__ == "__main__":
    study = Study("rate", 2, in_turn([Rate(40.0), Rate(80.0)]), trial, report, draw)
    print(run_study(study).report)
