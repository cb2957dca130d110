"""A joint whose zero is not where the table has it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from bayesid.effects.displaced import along_axis
from bayesid.effects.displacement import Displacement
from bayesid.effects.effect import Phrase, ReadableUnit
from bayesid.robot import Robot


@dataclass(frozen=True, kw_only=True)
class JointZero(Displacement):
    """The number theta of a joint's row is off."""

    name: ClassVar[str] = "joint_zero"
    physics: ClassVar[str] = "A joint's zero is off: it was mastered elsewhere, or its encoder has slipped."
    reference: ClassVar[str] = "Mooring, Roth, Driels, Fundamentals of Manipulator Calibration, 1991"
    shown_by: ClassVar[str] = "moving the joints behind it slowly through their ranges, the arm stretched"
    phrase: ClassVar[Phrase] = Phrase(
        "{whose} zero is off: it stands {zero} further than its position says.",
        "a joint's zero that is off",
        size="zero",
        opposite="{whose} zero is off: it stands {zero} less far than its position says.",
        units={"zero": ReadableUnit("degrees", 180.0 / math.pi)},
    )
    typical: ClassVar[tuple[float, ...]] = (math.radians(1.0),)
    symbol: ClassVar[str] = "zero"
    of_angle: ClassVar[bool] = True

    @classmethod
    def stands_alone(cls, robot: Robot, joint: int) -> bool:
        """The zero of a joint that slides is its d: `link_offset`."""
        return not robot.joints[joint].prismatic

    def displaced(self, robot: Robot, joint: int, step: float) -> Robot:
        """About the joint's axis."""
        return along_axis(robot, joint, step, turning=True)
