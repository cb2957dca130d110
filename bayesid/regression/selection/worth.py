"""What an added effect is worth to an engineer: how large its effort is, and what leaving it out costs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

RATED, LARGEST_READING = "rated effort", "largest effort in this log"
"""What an effect's largest effort is held against: the first where the robot's file tells it, else the second."""


@dataclass(frozen=True)
class EffortSize:
    """How large an effect's own effort is on held-back data, in the joint where that is largest.

    Attributes:
        joint: from 1.
        rms: N m.
        largest: absolute value, N m.
        reference: effort that the largest is held against, N m.
        of: what that is, `RATED` or `LARGEST_READING`.

    Example:
        >>> EffortSize(2, 1.2, 3.0, 60.0, RATED).share
        0.05
    """

    joint: int
    rms: float
    largest: float
    reference: float
    of: str

    @property
    def share(self) -> float:
        """Of the reference that the largest effort is; NaN where the reference is zero."""
        return _ratio(self.largest, self.reference)


@dataclass(frozen=True)
class Cost:
    """What the error of the efforts on held-back data is without an effect, in the joint where that matters most.

    Attributes:
        joint: from 1, of those that the effect acts in: where the mean squared error rises most, as a share of the mean
            squared effort, for neither N m and N nor a shoulder's N m and a wrist's are alike.
        before: RMS error without the effect, all others kept and their numbers found anew, N m.
        after: RMS error with it, N m.
        effort: RMS effort of the joint there, N m.

    Example:
        >>> cost = Cost(2, 3.0, 0.5, 50.0)
        >>> cost.share_before, cost.share_after
        (0.06, 0.01)
    """

    joint: int
    before: float
    after: float
    effort: float

    @property
    def share_before(self) -> float:
        """Error without the effect over the joint's effort; NaN where that is zero."""
        return _ratio(self.before, self.effort)

    @property
    def share_after(self) -> float:
        """Error with it over the joint's effort; NaN where that is zero."""
        return _ratio(self.after, self.effort)


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else np.nan
