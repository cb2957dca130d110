"""A link whose offset along its joint's axis is not the table's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayesid.effects.displaced import along_axis
from bayesid.effects.displacement import Displacement
from bayesid.effects.effect import Phrase, ReadableUnit
from bayesid.robot import Robot


@dataclass(frozen=True, kw_only=True)
class LinkOffset(Displacement):
    """The number d of a joint's row is off."""

    name: ClassVar[str] = "link_offset"
    physics: ClassVar[str] = "A length d of the Denavit-Hartenberg table is off: a link sits further along its axis."
    shown_by: ClassVar[str] = "moving the joints before the link through their ranges, fast, in several postures"
    phrase: ClassVar[Phrase] = Phrase(
        "{whose} link sits {d} further along its axis than the table's d, by the model's masses.",
        "an error of a length d of the table",
        size="d",
        opposite="{whose} link sits {d} less far along its axis than the table's d, by the model's masses.",
        units={"d": ReadableUnit("mm", 1e3)},
    )
    typical: ClassVar[tuple[float, ...]] = (0.01,)
    symbol: ClassVar[str] = "d"
    of_angle: ClassVar[bool] = False

    def displaced(self, robot: Robot, joint: int, step: float) -> Robot:
        """Along the joint's axis."""
        return along_axis(robot, joint, step, turning=False)
