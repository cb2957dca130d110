"""A link whose twist is not the table's."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from bayesid.effects.displaced import along_normal, is_distal
from bayesid.effects.displacement import Displacement
from bayesid.effects.effect import Phrase, ReadableUnit
from bayesid.robot import Robot


@dataclass(frozen=True, kw_only=True)
class LinkTwist(Displacement):
    """The number alpha of a joint's row is off."""

    name: ClassVar[str] = "link_twist"
    physics: ClassVar[str] = "An angle alpha of the Denavit-Hartenberg table is off: two axes stand askew."
    shown_by: ClassVar[str] = "moving the joints on both sides of the link slowly through their ranges"
    phrase: ClassVar[Phrase] = Phrase(
        "{whose} link is twisted by {alpha} more than the table's alpha, by the model's masses.",
        "an error of an angle alpha of the table",
        size="alpha",
        opposite="{whose} link is twisted by {alpha} less than the table's alpha, by the model's masses.",
        units={"alpha": ReadableUnit("degrees", 180.0 / math.pi)},
    )
    typical: ClassVar[tuple[float, ...]] = (math.radians(1.0),)
    symbol: ClassVar[str] = "alpha"
    of_angle: ClassVar[bool] = True

    @classmethod
    def stands_alone(cls, robot: Robot, joint: int) -> bool:
        """The first row of a modified table says how the base is mounted: `base_tilt`."""
        return joint > 0 or is_distal(robot)

    def displaced(self, robot: Robot, joint: int, step: float) -> Robot:
        """About the common normal of two axes."""
        return along_normal(robot, joint, step, turning=True)
