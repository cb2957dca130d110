"""What the method bears, and whether its claims are true: studies by simulation and on real logs.

Each module named in `STUDIES` holds one `Study`; `bayesid study NAME` runs it, and so does, from Python,

    from bayesid.studies import load, run_study

    finished = run_study(load("noise"), trials=64, workers=2, out="noise")
    print(finished.report)

Workers are processes that import the module that says so: guard it with `if __name__ == "__main__":`. The
modules of `benchmarks` are scripts by themselves.
"""

from __future__ import annotations

from importlib import import_module

from bayesid.errors import InputError
from bayesid.studies.study import Finished, Study, run_study
from bayesid.study import STUDIES

WITH_FLOOR = ("real",)

__all__ = ["STUDIES", "WITH_FLOOR", "Finished", "Study", "load", "run_study"]


def load(name: str, *, floor: bool = False) -> Study:
    """The study of a name; or the one that holds its figures to a floor.

    Raises:
        InputError: there is none.
    """
    if name not in STUDIES:
        raise InputError(f"{name!r} is no study", "study", f"choose from {', '.join(STUDIES)}")
    if floor and name not in WITH_FLOOR:
        remedy = f"leave it out, or choose from {', '.join(WITH_FLOOR)}"
        raise InputError(f"the study {name!r} has no floors", field="floor", remedy=remedy)
    study: Study = import_module(f"bayesid.studies.{name}{'_floor' * floor}").STUDY
    return study
