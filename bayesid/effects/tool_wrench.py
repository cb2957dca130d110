"""A constant force on the tool, and a couple: what the actuators supply against it is -J' F (virtual work)."""

from __future__ import annotations

from typing import ClassVar

from bayesid.arrays import Array
from bayesid.effects.effect import Phrase
from bayesid.effects.parameters import Parameter
from bayesid.effects.term import WholeRobotTerm
from bayesid.motion import Motion
from bayesid.robot import Robot

_FORCE = (("x", "N"), ("y", "N"), ("z", "N"))
_COUPLE = (("rx", "N m"), ("ry", "N m"), ("rz", "N m"))


class ToolWrench(WholeRobotTerm):
    """A force from outside on the last link's frame, such as a hose that pulls, constant along the base's axes."""

    name = "tool_wrench"
    shown_by = "moving the tool slowly through space, and turning it in place"
    phrase = Phrase("A force of {wbx}, {wby} and {wbz} along the base's axes acts on the tool.", "a force on the tool")
    in_base: ClassVar[bool] = True
    parts: ClassVar[tuple[tuple[str, str], ...]] = _FORCE
    symbol: ClassVar[str] = "wb"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Force, and couple if there is one, on the last link."""
        n = robot.n_joints
        return tuple(Parameter(f"{self.symbol}{axis}{n}", unit, n) for axis, unit in self.parts)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(N, n, 3 or 6) what the actuators supply against it."""
        return -robot.tool_jacobian(motion, self.in_base).swapaxes(1, 2)[:, :, : len(self.parts)]


class BaseWrench(ToolWrench):
    """A force and a couple along the base's axes."""

    name = "tool_wrench.couple"
    phrase = Phrase(
        "A force of {wcx}, {wcy} and {wcz} and a couple of {wcrx}, {wcry} and {wcrz} along the base's axes "
        "act on the tool."
    )
    parts = (*_FORCE, *_COUPLE)
    symbol = "wc"


class FollowingForce(ToolWrench):
    """A force that turns with the tool, such as a jet or a preloaded contact."""

    name = "tool_wrench.following"
    phrase = Phrase("A force of {wtx}, {wty} and {wtz} acts on the tool and turns with it.")
    in_base = False
    symbol = "wt"


class FollowingWrench(FollowingForce):
    """A force and a couple that turn with the tool."""

    name = "tool_wrench.following_couple"
    phrase = Phrase(
        "A force of {wfx}, {wfy} and {wfz} and a couple of {wfrx}, {wfry} and {wfrz} act on the tool and turn with it."
    )
    parts = (*_FORCE, *_COUPLE)
    symbol = "wf"
