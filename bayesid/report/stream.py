"""The folder of a stream: signed_stream.csv, alarms.json, stream.json, and a figure where one is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from bayesid.arrays import Array
from bayesid.files.tables import numbered, write_columns, write_json
from bayesid.files.writing import save_folder
from bayesid.monitor.changes import Alarm
from bayesid.monitor.replay import Agreement, Replay
from bayesid.monitor.tracked import Counts, StreamFigures, Tracked
from bayesid.report.plot.stream import stream_figure

STREAM = "stream.json"
STREAM_FILES = frozenset({STREAM, "signed_stream.csv", "alarms.json", "stream.png", "stream.svg"})


@dataclass(frozen=True)
class StreamResult:
    """What there is to say of a stream."""

    log: str  # where it came from
    rate: float  # Hz
    lag: float  # s
    counts: Counts  # what became of the rows
    bad: int  # rows that were none
    figures: StreamFigures  # of the stream as a whole
    alarms: tuple[Alarm, ...]  # as they stood at the end
    smoothing: Agreement | None  # agreement with the smoothing of the whole log; None where there is none
    smoothing_status: str  # why not, or "done"
    # agreement of a stream that was fed absolute values with the signs of the log; None where it has none
    known: Agreement | None = None
    named: Mapping[int, Named] | None = None  # by alarm, what `bayesid.find_discrepancy` names; None where nobody asked


@dataclass(frozen=True)
class Named:
    """What a change is by `bayesid.find_discrepancy`."""

    status: str  # its status, or why it could not say anything
    effects: tuple[tuple[str, tuple[int, ...]], ...] = ()  # names with their joints (from 1)


def stream_names(n: int) -> list[str]:
    """The columns of signed_stream.csv."""
    return ["t", *(name for kind in ("tau", "p", "predicted", "external") for name in numbered(kind, n))]


def stream_line(now: Tracked) -> str:
    """A row of signed_stream.csv."""
    values = [now.effort, np.round(now.probability, 6), now.predicted, now.external]
    return ",".join([repr(float(now.t)), *(f"{value:.8g}" for block in values for value in block.tolist())])


def open_stream(folder: Path, n: int) -> TextIO:
    """signed_stream.csv in a folder that is being made, its header written."""
    file = (folder / "signed_stream.csv").open("w", newline="", encoding="utf-8")
    file.write(f"{','.join(stream_names(n))}\n")
    return file


def save_replay(folder: Path, result: StreamResult, streamed: Replay, picture: str | None = None) -> Path:
    """Writes the folder of a recording that was replayed.

    Args:
        folder: where.
        result: what there is to say of it.
        streamed: instant by instant.
        picture: "png" or "svg" for a figure.

    Raises:
        InputError: the folder cannot be written, or holds other files than an earlier stream.
    """

    def rows(some: slice) -> Array:
        p = np.round(streamed.probability[some], 6)
        return np.hstack([streamed.effort[some], p, streamed.predicted[some], streamed.external[some]])

    def write(place: Path) -> None:
        names = stream_names(streamed.effort.shape[1])
        write_columns(place / "signed_stream.csv", names, streamed.t, rows, ".8g")
        write_summaries(place, result)
        if picture is not None:
            figure = stream_figure(streamed)
            figure.savefig(place / f"stream.{picture}", dpi=140.0, facecolor="white")

    return save_folder(folder, STREAM_FILES, STREAM, write)


def write_summaries(place: Path, result: StreamResult) -> None:
    """alarms.json and stream.json, in a folder that is being made."""
    named = result.named or {}
    alarms = [alarm.as_dict() | _named(named.get(k)) for k, alarm in enumerate(result.alarms)]
    write_json(place / "alarms.json", alarms)
    write_json(place / STREAM, stream_summary(result))


def _named(named: Named | None) -> dict[str, Any]:
    if named is None:
        return {}
    effects = [{"effect": effect, "joints": list(joints)} for effect, joints in named.effects]
    return {"named": effects, "named_status": named.status}


def stream_summary(result: StreamResult) -> dict[str, Any]:
    """stream.json: SI units, joints in order; null where there is nothing to say."""
    figures, counts = result.figures, asdict(result.counts)
    quantiles = {name: 1e6 * figures.times.quantile(share) for name, share in (("median", 0.5), ("p99_9", 0.999))}
    return {
        "log": result.log,
        "summary": {
            "rate": result.rate,
            "lag": result.lag,
            "instants": figures.instants,
            "counts": {**counts, "bad": result.bad},
            "update_microseconds": quantiles,
            "rms_residual": figures.rms.tolist(),
            "largest_external_over_threshold": figures.pushed.tolist(),
            "smoothing_status": result.smoothing_status,
            "smoothing": _agreement(result.smoothing),
            "known_signs": _agreement(result.known),
        },
        "n_alarms": len(result.alarms),
    }


def _agreement(one: Agreement | None) -> dict[str, Any] | None:
    if one is None:
        return None
    return {
        "share": one.share,
        "by_joint": one.by_joint.tolist(),
        "sure": one.sure_share,
        "sure_by_joint": one.sure_by_joint.tolist(),
        "share_of_sure": one.share_of_sure,
    }
