"""Maps a study's function over its scenarios, on all cores or in this process."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

from tqdm import tqdm

Scenario = Any
Row = dict[str, Any]


def run(study: Callable[[Scenario], Row], scenarios: Sequence[Scenario], workers: int | None = None) -> list[Row]:
    """The study's rows, in the order of its scenarios.

    Args:
        study: a module-level function.
        scenarios: what to give it, one by one.
        workers: processes, each with one BLAS thread; the number of cores by default, 1 for this process.
    """
    workers = workers or os.cpu_count() or 1
    if workers == 1:
        return list(_with_bar(map(study, scenarios), len(scenarios)))
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(_with_bar(pool.map(study, scenarios), len(scenarios)))


def _with_bar(rows: Iterable[Row], total: int) -> Iterable[Row]:
    return tqdm(rows, total=total, disable=None, unit=" trials")
