"""What constraints on the links of a UR10e say and cost: one log with its signs hidden, with them and without.

    python -m bayesid.studies.constraints

The maker publishes masses and centres of mass of the links, in the frames of the Denavit-Hartenberg table. What is
stated is far from exact: each centre of mass to within 0.1 m along each axis, each mass at most 1.3 times the published
one, and all masses together from 27 to 31 kg: 44 half spaces. Errors are against the published numbers.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import numpy as np

from bayesid.arrays import Array
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.log.log import Log
from bayesid.log.reading import read_log
from bayesid.regression.stated import StatedParameters
from bayesid.studies import real

MASSES = np.array([7.369, 13.051, 3.989, 2.1, 1.98, 0.615])
"""kg, of the links."""
CENTRES = np.array(
    [
        [0.021, 0.0, 0.027],
        [0.38, 0.0, 0.158],
        [0.24, 0.0, 0.068],
        [0.0, 0.007, 0.018],
        [0.0, 0.007, 0.018],
        [0, 0, -0.026],
    ]
)
"""m, of the links, in their frames."""
_AROUND, _MOST, _TOTAL = 0.1, 1.3, (27.0, 31.0)


def published(p: StatedParameters) -> Iterator[Any]:
    """The half spaces."""
    yield [p.total_mass >= _TOTAL[0], p.total_mass <= _TOTAL[1]]
    for k, (mass, centre) in enumerate(zip(MASSES, CENTRES, strict=True), start=1):
        yield p.com_in_box(k, centre - _AROUND, centre + _AROUND)
        yield p.mass(k) <= _MOST * mass


def figures(result: Identification, log: Log) -> dict[str, float]:
    """Shares, errors and standard deviations of a result."""
    rows = real.grid_rows(result, log.t)
    moving = result.segments.per_sample(result.segments.moving, *result.probability.shape)[rows] > 0
    counted = real.is_strong(log.effort) & moving
    right = result.sample_signs[rows] == np.sign(log.effort)
    links, sd = (values[:60].reshape(6, 10) for values in (result.theta, result.parameter_sd[0]))
    centres = links[:, 6:9] / links[:, 9:]
    return {
        "signs right, %": 100.0 * float(right[counted].mean()),
        "proven": float(result.search.certified),
        "error of masses, kg": float(np.abs(links[:, 9] - MASSES).mean()),
        "error of centres of mass, m": float(np.abs(centres - CENTRES).mean()),
        "sd of masses, kg": float(sd[:, 9].mean()),
        "sd of first moments, kg m": float(sd[:, 6:9].mean()),
    }


def sd_of_open_parameters(results: list[Identification]) -> list[float]:
    """Geometric means over the links' parameters that the prior decides without constraints."""
    spread: list[Array] = [result.parameter_sd[0][:60] for result in results]
    is_open = ~results[0].parameter_sd[1][:60]
    return [float(np.exp(np.log(sd[is_open]).mean())) for sd in spread]


def main() -> None:
    """Prints a table: without, with, and the ratio."""
    folder = real.DATA / "ur10e"
    log = read_log(folder / "b_20s.csv")
    results, columns = [], []
    for says in (None, published, None, published):  # the first of each loads modules
        began = sum(os.times()[:4])
        results.append(identify(folder / "robot.toml", log.rectified(), constraints=says))
        columns.append({"processor time, s": sum(os.times()[:4]) - began, **figures(results[-1], log)})
    without, with_them = columns[2:]
    open_sd = sd_of_open_parameters(results[2:])
    without["sd of what the prior decided"], with_them["sd of what the prior decided"] = open_sd
    print(f"{'UR10e, b_20s':<32}{'without':>10}{'with 44':>10}{'ratio':>8}")
    for name, value in without.items():
        print(f"{name:<32}{value:10.4g}{with_them[name]:10.4g}{with_them[name] / value:8.2f}")
    dear = max(results[-1].constraints, key=lambda one: one.nats)
    print(f"dearest constraint: {dear.label}, {dear.nats:.1f} nats")


if __name__ == "__main__":
    main()
