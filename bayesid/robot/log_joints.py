"""Whether a log holds the joints of a robot, and which of the robot's chains it may hold."""

from __future__ import annotations

from collections import Counter

from bayesid.errors import InputError
from bayesid.robot.arm import Robot

_NAMED = 4
"""Chains that an error names; a round number."""


def check_joints(robot: Robot, count: int, source: str) -> None:
    """That a log holds as many joints as a robot has.

    Args:
        robot: as it was loaded.
        count: joints of the log.
        source: of the log.

    Raises:
        InputError: the numbers differ; it names the options that choose a chain of so many joints.
    """
    if count == robot.n_joints:
        return
    said = f"the log has {count} joints, robot {robot.name} has {robot.n_joints}"
    remedy = "give the log and the robot that belong together"
    if count > robot.n_joints:
        said += f" ({', '.join(robot.notes)})" if robot.notes else ""
        remedy += " (or, with `columns`, those of the robot's joints alone)"
    elif chains := chains_of(robot, count):
        remedy += f", or choose its chain of {count} joints by {', or by '.join(chains[:_NAMED])}"
    raise InputError(said, source, remedy)


def chains_of(robot: Robot, count: int) -> list[str]:
    """Options that choose a chain of so many joints, from a robot with more.

    A chain begins at the base or after a joint that carries several, a torso's last say, and then the joints before it
    are held; it ends at a joint that carries none or several. Those with the fewest held are named; where there is
    none, a chain may end anywhere.
    """
    names = [joint.name for joint in robot.joints]
    paths: list[list[int]] = []
    for k, joint in enumerate(robot.joints):
        paths.append([*(paths[joint.parent] if joint.parent >= 0 else []), k])
    carried = Counter(joint.parent for joint in robot.joints)
    limbs = [
        (path[:-count], path[-1])
        for path in paths
        if len(path) >= count and carried[path[-1]] != 1 and (len(path) == count or carried[path[-count - 1]] > 1)
    ]
    fewest = min((len(before) for before, _ in limbs), default=0)
    limbs = [limb for limb in limbs if len(limb[0]) == fewest]
    limbs = limbs or [([], path[-1]) for path in paths if len(path) == count]
    held = [",".join(f"{names[k]}=0" for k in before) for before, _ in limbs]
    options = [
        f"`tip` {names[last]}{f' `hold` {joints}' if joints else ''}"
        for (_, last), joints in zip(limbs, held, strict=True)
    ]
    return options if all(names) else []
