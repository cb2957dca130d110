"""Studies of the method's limits and accuracy, by simulation and on real logs.

Each module named in `STUDIES` holds one `Study`. `bayesid study NAME` runs it; from Python:

    from bayesid.studies import load, run_study

    finished = run_study(load("noise"), trials=64, workers=2, out="noise")
    print(finished.report)

Workers are processes that import the calling module: guard the call with `if __name__ == "__main__":`. Modules of
`benchmarks` are scripts.
"""

from __future__ import annotations

from importlib import import_module

from bayesid.errors import InputError
from bayesid.studies.study import Finished, Study, run_study
from bayesid.study import STUDIES

WITH_FLOOR = ("real",)

__all__ = ["STUDIES", "WITH_FLOOR", "Finished", "Study", "load", "run_study"]


def load(name: str, *, floor: bool = False) -> Study:
    """The study of a name, or with `floor` the one that compares its figures with required minima.

    Raises:
        InputError: unknown name, or a study without floors.
    """
    if name not in STUDIES:
        raise InputError(f"unknown study {name!r}", "study", f"choose from {', '.join(STUDIES)}")
    if floor and name not in WITH_FLOOR:
        remedy = f"leave it out, or choose from {', '.join(WITH_FLOOR)}"
        raise InputError(f"the study {name!r} has no floors", field="floor", remedy=remedy)
    study: Study = import_module(f"bayesid.studies.{name}{'_floor' * floor}").STUDY
    return study
