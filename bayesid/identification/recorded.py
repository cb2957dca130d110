"""Signs of segments, from those of their samples; and the segments without the pauses between logs that were joined."""

from __future__ import annotations

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.log.log import Log
from bayesid.log.segments import Segments

_SILENT_EFFORT = 1e-24
"""(N m)^2 by which a sample counts at least, far below any sensor: a segment of exact zeros has a confidence too."""


def segment_signs(segments: Segments, probability: Array, effort: Array) -> tuple[Integers, Array]:
    """(S,) signs and (S,) confidences: each segment's mean probability, weighted with the squared effort.

    Args:
        segments: S over N samples.
        probability: (N, n) P(sign = +).
        effort: (N, n) N m.
    """
    share = np.empty(len(segments))
    for k, (j, a, b) in enumerate(zip(segments.joint, segments.start, segments.end, strict=True)):
        share[k] = np.average(probability[a:b, j], weights=effort[a:b, j] ** 2 + _SILENT_EFFORT)
    return np.where(share >= 0.5, 1, -1), np.maximum(share, 1.0 - share)


def recorded_segments(
    log: Log, t: Array, segments: Segments, probability: Array, effort: Array
) -> tuple[Segments, Integers, Array]:
    """The segments of what was recorded, their signs (S,) and confidences (S,).

    The segments of a log that was joined from several also cover the pauses between these, in which there are
    interpolated values only. They are cut where a recording begins and ends, what lies in a pause is left out, and sign
    and confidence follow from the samples that remain, as an identification's do (:eq:`confidence`).

    Args:
        log: joined from several.
        t: (N,) instants, s.
        segments: of all of them.
        probability: (N, n) P(sign = +).
        effort: (N, n) N m.
    """
    place, _ = log.clock(t)
    edges = np.flatnonzero(place[1:] != place[:-1]) + 1
    cut = segments.split([(j, int(at)) for j in range(log.n_joints) for at in edges])
    cut = cut[place[cut.start] >= 0]
    return cut, *segment_signs(cut, probability, effort)
