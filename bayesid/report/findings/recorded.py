"""The segments of what was recorded, without the pauses between logs that were joined."""

from __future__ import annotations

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import segment_signs
from bayesid.log.segments import Segments


def recorded_segments(identification: Identification) -> tuple[Segments, Integers, Array]:
    """The segments of what was recorded, their signs (S,) and confidences (S,).

    The segments of a log that was joined from several also cover the pauses between these, in which there are
    interpolated values only. They are cut where a recording begins and ends, what lies in a pause is left out, and sign
    and confidence follow from the samples that remain, as an identification's do (:eq:`confidence`).
    """
    log, t = identification.log, identification.signals.motion.t
    if not log.pooled:
        return identification.segments, identification.signs, identification.confidence
    place, _ = log.clock(t)
    edges = np.flatnonzero(place[1:] != place[:-1]) + 1
    segments = identification.segments.split([(j, int(at)) for j in range(log.n_joints) for at in edges])
    segments = segments[place[segments.start] >= 0]
    signs, confidence = segment_signs(segments, identification.probability, identification.signals.raw_effort)
    return segments, signs, confidence
