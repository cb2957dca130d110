"""How long a comparison of a model with a log takes: blind cases of 2,400 samples with a holdout, and a real payload.

    python -m bayesid.studies.benchmarks.discrepancy [--cases 10]

Seconds of wall time and of processors, without posteriors and reports. Of the real pair, UR10e without and with a
payload (5,000 rows each), identification is shown by itself. Processor seconds compare on a busy machine too.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bayesid.discrepancy.workflow import explain_log
from bayesid.identification.pipeline import QUICK, identify
from bayesid.log.reading import read_log
from bayesid.parallel import Result
from bayesid.studies.discrepancy import compared, generator
from bayesid.studies.real import DATA

_PLANNED = 20
"""Cases of the plan that the golden results are of."""


def blind_cases(count: int) -> None:
    """A line for each case, and the median and the most."""
    blind, seconds = generator("benchmarks.discrepancy"), []
    for number, case in enumerate(blind.plan(_PLANNED, 0)[:count]):
        with tempfile.TemporaryDirectory() as place:
            blind.make_case(place, *case)
            found, timings = compared(Path(place))
        seconds.append(timings["discrepancy"])
        print(
            f"blind/{number:02d}  {timings['discrepancy']:6.1f} s, {timings['cpu']:6.1f} of processors  {found.status}"
        )
    if seconds:
        print(f"median {np.median(seconds):.1f} s, most {np.max(seconds):.1f} s")


def real_payload() -> None:
    """A line for the identification, and one for the comparison."""
    healthy, loaded = (read_log(DATA / "ur10e" / f"{name}.csv").rectified() for name in ("c_unloaded", "c_loaded"))
    earlier = _timed("identify", lambda: identify("ur10e", healthy, posterior=False))
    _timed("discrepancy", lambda: explain_log(earlier, loaded, search=QUICK, posterior=False))


def _timed(name: str, work: Callable[[], Result]) -> Result:
    began, cpu = time.perf_counter(), sum(os.times()[:4])
    result = work()
    wall, cpu = time.perf_counter() - began, sum(os.times()[:4]) - cpu
    print(f"ur10e, {name:<12} {wall:6.1f} s, {cpu:6.1f} of processors")
    return result


def main() -> None:
    """Blind cases first."""
    parser = argparse.ArgumentParser(description="Seconds of a discrepancy.")
    parser.add_argument("--cases", type=int, default=10, help="blind cases (20 at most)")
    blind_cases(parser.parse_args().cases)
    if DATA.is_dir():
        real_payload()
    else:
        print(f"the real pair is left out: {DATA} is not here; set BAYESID_DATA to its folder")


if __name__ == "__main__":
    main()
