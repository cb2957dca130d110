"""What the method bears, and whether it tells the truth: studies by simulation and on real logs.

Each module named in `NAMES` holds one `Study`; `bayesid study NAME` runs it, and so does, from Python,

    from studies import load, run_study

    finished = run_study(load("noise"), trials=64, workers=2, out="noise")
    print(finished.report)

Workers are processes that import the module that says so: guard it with `if __name__ == "__main__":`. Modules named
`benchmark_...` and `throughput` are scripts by themselves.
"""

from __future__ import annotations

from importlib import import_module

from bayesid.errors import InputError
from studies.study import Finished, Study, run_study

__all__ = ["NAMES", "Finished", "Study", "load", "run_study"]

NAMES = (
    "noise", "duration", "excitation", "cutoff", "threshold", "beam_width", "initial_segments", "prior", "scaling",
    "paper", "real", "calibration", "misfit", "sbc", "discrepancy", "real_discrepancy",
)  # fmt: skip


def load(name: str) -> Study:
    """The study of a name.

    Raises:
        InputError: there is none.
    """
    if name not in NAMES:
        raise InputError(f"{name!r} is no study", "study", f"choose from {', '.join(NAMES)}")
    study: Study = import_module(f"studies.{name}").STUDY
    return study
