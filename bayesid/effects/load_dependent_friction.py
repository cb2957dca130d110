"""Dry friction in proportion to the load."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from bayesid.arrays import Array
from bayesid.effects.coulomb_friction import DryTerm
from bayesid.effects.effect import Phrase, ReadableUnit, Scene
from bayesid.motion import Motion
from bayesid.robot import Robot


@dataclass(frozen=True, kw_only=True)
class LoadDependentFriction(DryTerm):
    """Fl |load| tanh(u' / v), Fl >= 0; the load is the rigid bodies' effort.

    Args:
        links: (10 n,) parameters of the rigid bodies that make the load, as identified earlier.
    """

    links: tuple[float, ...]

    name = "load_dependent_friction"
    physics = "Dry friction in gears and bearings that grows with the torque they carry."
    reference = "Hamon, Gautier, Garrec, Dry friction depending on load and velocity, IROS 2010"
    variable = "load"
    shown_by = "moving both ways, loaded and unloaded, at equal speeds"
    phrase = Phrase(
        "{who} needs dry friction that grows with the load, by {Fl} of it.",
        "load-dependent friction",
        units={"Fl": ReadableUnit("%", 100.0)},
    )
    symbols = ("Fl",)
    units = (("1", "1"),)
    nonnegative = True
    given = ("smoothing", "links")

    @classmethod
    def variants(cls, scene: Scene) -> Iterator[Self]:
        """In each actuator by itself."""
        links = tuple(scene.links.tolist())
        for j, speed in enumerate(scene.actuators.standstill_speed.tolist(), start=1):
            yield cls(joints=(j,), smoothing=(speed,), links=links)

    def check(self, n_joints: int) -> None:
        """Ten numbers a link, one smoothing speed an actuator."""
        if len(self.links) != 10 * n_joints:
            raise ValueError(f"links has {len(self.links)} numbers for {n_joints} joints")
        DryTerm(joints=self.joints, smoothing=self.smoothing).check(n_joints)

    def own_columns(self, robot: Robot, motion: Motion) -> Array:
        """The size of the load times the direction of motion."""
        acting = self.acting(robot.n_joints)
        load = np.abs(robot.inverse_dynamics(motion, self._links)[:, acting])
        return (load * self.direction(robot.actuators(motion).joints(acting)))[:, :, None]

    @cached_property
    def _links(self) -> Array:
        return np.array(self.links)

    def own_columns_in(self, scene: Scene, joint: int) -> Array:
        """The load comes from all joints."""
        return self.own_columns(scene.robot, scene.motion)[:, 0]
