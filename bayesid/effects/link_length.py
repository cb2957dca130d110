"""A link whose length is not the table's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayesid.effects.displaced import along_normal, is_distal
from bayesid.effects.displacement import Displacement
from bayesid.effects.effect import Phrase, ReadableUnit
from bayesid.robot import Robot


@dataclass(frozen=True, kw_only=True)
class LinkLength(Displacement):
    """The number a of a joint's row is off."""

    name: ClassVar[str] = "link_length"
    physics: ClassVar[str] = "A length a of the Denavit-Hartenberg table is off: a link is longer or shorter."
    shown_by: ClassVar[str] = "moving the joints behind the link through their ranges, fast, in several postures"
    phrase: ClassVar[Phrase] = Phrase(
        "{whose} link is {a} longer than the table's a, by the model's masses.",
        "an error of a length a of the table",
        size="a",
        opposite="{whose} link is {a} shorter than the table's a, by the model's masses.",
        units={"a": ReadableUnit("mm", 1e3)},
    )
    typical: ClassVar[tuple[float, ...]] = (0.01,)
    symbol: ClassVar[str] = "a"
    of_angle: ClassVar[bool] = False

    @classmethod
    def stands_alone(cls, robot: Robot, joint: int) -> bool:
        """Where the first row of a modified table leads, the base is mounted."""
        return joint > 0 or is_distal(robot)

    def displaced(self, robot: Robot, joint: int, step: float) -> Robot:
        """Along the common normal of two axes."""
        return along_normal(robot, joint, step, turning=False)
