"""What was identified, entry by entry: plain records to iterate over, to look up by name, or to make a DataFrame of."""

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

    name: str  #: of the parameter that it is built on
    expression: str  #: the sum of parameters that it is
    unit: str  #: of it
    mean: float  #: of the posterior, or the least-squares estimate
    sd: float  #: its standard deviation; inf where the log shows nothing of it
    lower: float  #: lower end of its 95 % interval
    upper: float  #: upper end
    #: "data", "constraints" or "prior"; of a `RecursiveEstimator` also "earlier log"; "unknown" of a model made by hand
    decided_by: str
    prior_sd: float  #: what the prior alone knows, or of an `RecursiveEstimator` the earlier log; NaN without one
    nominal: float  #: what the nominal parameters give; NaN where they do not give one

    @property
    def rsd(self) -> float:
        """Relative standard deviation; inf of a coefficient that is zero."""
        return self.sd / abs(self.mean) if self.mean else np.inf


@dataclass(frozen=True)
class ParameterValue:
    """A parameter of the model."""

    name: str  #: of it
    unit: str  #: of it
    joint: int  #: or link, from 1
    mean: float  #: of the posterior, or the least-squares estimate
    sd: float  #: its standard deviation; NaN where none is known: efforts show it in sums alone, without samples
    decided_by: str  #: "data", "constraints" or "prior"; "unknown" of a model without its log


@dataclass(frozen=True)
class SegmentSign:
    """A segment of constant sign."""

    joint: int  #: from 1
    start: float  #: its first sample, s, on the clock of its log
    end: float  #: its last sample, s
    n_samples: int  #: in it
    sign: int  #: +1 or -1
    confidence: float  #: that it is right
    log: str  #: that it is of


Record = TypeVar("Record", bound=Coefficient | ParameterValue | SegmentSign, covariant=True)


class Records(tuple[Record, ...]):
    """Records of one kind, in order."""

    kind: type[Record]

    def __new__(cls, kind: type[Record], rows: Iterable[Record]) -> Records[Record]:
        """Of a kind."""
        made = super().__new__(cls, tuple(rows))
        made.kind = kind
        return made

    def __getnewargs__(self) -> tuple[object, ...]:
        return self.kind, tuple(self)

    def __repr__(self) -> str:
        names = ", ".join(field.name for field in fields(self.kind))
        return f"{len(self)} records of {self.kind.__name__} ({names}); .to_dataframe() makes a table"

    def to_dataframe(self) -> DataFrame:
        """A `pandas.DataFrame` with a row a record, and a column a field."""
        from pandas import DataFrame

        return DataFrame({field.name: [getattr(row, field.name) for row in self] for field in fields(self.kind)})


Entry = TypeVar("Entry", Coefficient, ParameterValue)


def named(entries: Sequence[Entry], name: str, what: str, elsewhere: str = "") -> Entry:
    """The entry of a name; `elsewhere` says where an entry of that name is instead.

    Raises:
        InputError: there is none; near names are told.
    """
    names = [entry.name for entry in entries]
    if name in names:
        return entries[names.index(name)]
    remedy = elsewhere or near_names(str(name), names) or f"choose from {', '.join(names)}"
    raise InputError(f"there is no {what} {name!r}", f"{what}(name)", remedy)


# Segments of joined logs
def segment_signs(segments: Segments, probability: Array, effort: Array) -> tuple[Integers, Array]:
    """(S,) signs and (S,) confidences: each segment's mean probability, weighted with the squared effort.

    Of the S segments over N samples, P(sign = +) (N, n) and efforts (N, n), N m.
    """
    share = np.empty(len(segments))
    for k, (j, a, b) in enumerate(zip(segments.joint, segments.start, segments.end, strict=True)):
        weights = effort[a:b, j] ** 2 + 1e-24  # far below any sensor: a segment of exact zeros has a confidence too
        share[k] = np.average(probability[a:b, j], weights=weights)
    return np.where(share >= 0.5, 1, -1), np.maximum(share, 1.0 - share)


def recorded_segments(
    log: Log, t: Array, segments: Segments, probability: Array, effort: Array
) -> tuple[Segments, Integers, Array]:
    """The segments of what was recorded, their signs (S,) and confidences (S,); instants t (N,) are in s.

    Segments also cover pauses of a log, and between logs that were joined, in which there are interpolated values only.
    They are cut where a recording begins and ends, what lies in a pause is left out, and sign and confidence follow
    from the samples that remain, as an identification's do (:eq:`confidence`).
    """
    place, _ = log.clock(t)
    edges = np.flatnonzero(place[1:] != place[:-1]) + 1
    cut = segments.split([(j, int(at)) for j in range(log.n_joints) for at in edges])
    cut = cut[place[cut.start] >= 0]
    return cut, *segment_signs(cut, probability, effort)
