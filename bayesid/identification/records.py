"""Records of identified coefficients, parameters and segments, by name or as a DataFrame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.errors import InputError, near_names
from bayesid.log.log import Log
from bayesid.log.segments import Segments

if TYPE_CHECKING:
    from pandas import DataFrame  # pandas takes half a second to import


@dataclass(frozen=True)
class Coefficient:
    """A base coefficient."""

    name: str  #: its leading parameter
    expression: str  #: sum of parameters
    unit: str
    mean: float  #: posterior mean, or least-squares estimate
    sd: float  #: standard deviation; inf if not identifiable
    lower: float  #: lower end of the 95 % interval
    upper: float  #: upper end
    #: "data", "constraints" or "prior"; for a `RecursiveEstimator` also "earlier log"; "unknown" for hand-written
    #: models
    decided_by: str
    prior_sd: float  #: sd of the prior, or for a `RecursiveEstimator` of the earlier log; NaN without one
    nominal: float  #: value from stated parameters; NaN without one

    @property
    def rsd(self) -> float:
        """Relative standard deviation; inf if the mean is zero."""
        return self.sd / abs(self.mean) if self.mean else np.inf


@dataclass(frozen=True)
class ParameterValue:
    """A parameter of the model."""

    name: str
    unit: str
    joint: int  #: joint or link, from 1
    mean: float  #: posterior mean, or least-squares estimate
    sd: float  #: standard deviation; NaN without draws if the parameter is not identifiable
    decided_by: str  #: "data", "constraints" or "prior"; "unknown" for a model without its log


@dataclass(frozen=True)
class SegmentSign:
    """A segment of constant sign."""

    joint: int  #: from 1
    start: float  #: first sample, s, on the clock of its log
    end: float  #: last sample, s
    n_samples: int
    sign: int  #: +1 or -1
    confidence: float  #: probability that the sign is right
    log: str  #: source of the log


Record = TypeVar("Record", bound=Coefficient | ParameterValue | SegmentSign, covariant=True)


class Records(tuple[Record, ...]):
    """Records of one kind, in order."""

    kind: type[Record]

    def __new__(cls, kind: type[Record], rows: Iterable[Record]) -> Records[Record]:
        """Records of one kind."""
        made = super().__new__(cls, tuple(rows))
        made.kind = kind
        return made

    def __getnewargs__(self) -> tuple[object, ...]:
        return self.kind, tuple(self)

    def __repr__(self) -> str:
        names = ", ".join(field.name for field in fields(self.kind))
        return f"{len(self)} records of {self.kind.__name__} ({names}); .to_dataframe() makes a table"

    def to_dataframe(self) -> DataFrame:
        """A `pandas.DataFrame` with one row per record and one column per field."""
        from pandas import DataFrame

        return DataFrame({field.name: [getattr(row, field.name) for row in self] for field in fields(self.kind)})


Entry = TypeVar("Entry", Coefficient, ParameterValue)


def named(entries: Sequence[Entry], name: str, what: str, elsewhere: str = "") -> Entry:
    """The entry of this name; `elsewhere` is the remedy if there is none.

    Raises:
        InputError: there is none; similar names are suggested.
    """
    names = [entry.name for entry in entries]
    if name in names:
        return entries[names.index(name)]
    remedy = elsewhere or near_names(str(name), names) or f"choose from {', '.join(names)}"
    raise InputError(f"there is no {what} {name!r}", f"{what}(name)", remedy)


# Segments of joined logs
def segment_signs(segments: Segments, probability: Array, effort: Array) -> tuple[Integers, Array]:
    """(S,) signs and confidences from P(sign = +) (N, n), weighted with the squared efforts (N, n), N m."""
    share = np.empty(len(segments))
    for k, (j, a, b) in enumerate(zip(segments.joint, segments.start, segments.end, strict=True)):
        weights = effort[a:b, j] ** 2 + 1e-24  # segments of exact zeros need weights too
        share[k] = np.average(probability[a:b, j], weights=weights)
    return np.where(share >= 0.5, 1, -1), np.maximum(share, 1.0 - share)


def recorded_segments(
    log: Log, t: Array, segments: Segments, probability: Array, effort: Array
) -> tuple[Segments, Integers, Array]:
    """Segments of recorded samples, their signs (S,) and confidences (S,); times t (N,) are in s.

    Segments are cut at pauses and between joined logs, whose interpolated samples are left out. Signs and confidences
    follow from the remaining samples (:eq:`confidence`).
    """
    place, _ = log.clock(t)
    edges = np.flatnonzero(place[1:] != place[:-1]) + 1
    cut = segments.split([(j, int(at)) for j in range(log.n_joints) for at in edges])
    cut = cut[place[cut.start] >= 0]
    return cut, *segment_signs(cut, probability, effort)
