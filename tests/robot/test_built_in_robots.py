"""Built-in robots against their makers' data sheets and published models."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from oracles import built_in_table, dh_chain, parameters_of, random_clouds, random_motion

from bayesid.effects import RigidBody
from bayesid.effects.coefficients import base_coefficients
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.robot import load_robot, robot_from_table
from bayesid.robot.kinematics import pose, reach
from bayesid.robot.load import BUILT_IN

ASYMMETRIC = np.radians([30.0, -50.0, 70.0, -25.0, 40.0, 100.0])
HOMES = {"kr": (0.0, -90.0, 90.0, 0.0, 0.0, 0.0)}
"""Degrees, where a data sheet's side view is not the controller's zero."""
KNOWN = {
    "kr3r540": ((355, 0, 625), (423.57, -221.02, 413.33), 541),
    "kr5r650": ((450, 0, 695), (528.92, -280.28, 460.75), 653),
    "kr5r850": ((560, 0, 790), (671.32, -362.49, 495.91), 854),
    "kr6r700": ((470, 0, 750), (551.34, -293.22, 484.6), 706.7),
    "kr6r900": ((525, 0, 890), (674.03, -364.06, 573.04), 901.5),
    "kr10r1100": ((620, 0, 995), (809.79, -442.44, 620.98), 1101),
    "kr10r1420": ((890, 0, 1080), (1059.44, -586.57, 645.59), 1420),
    "kr6r700_2": ((480, 0, 760), (565.38, -298.19, 482.43), 726),
    "kr6r900_2": ((535, 0, 880), (676.94, -362.6, 555.55), 901),
    "kr10r1100_2": ((630, 0, 985), (812.7, -440.98, 603.49), 1101),
    "vs050": ((-10, 0, 920), (-39.88, -44.98, 785.18), 505),
    "vs060": ((-10, 0, 1020), (-63.04, -58.36, 862.82), 605),
    "vs068": ((10, 0, 1155), (-48.2, -52.92, 981.53), 710),
    "vs087": ((10, 0, 1350), (-91.2, -77.75, 1133.6), 905),
    "vs6556": ((-15, 0, 980), (-33.09, -44.2, 858.19), 653),
    "vs6577": ((-15, 0, 1185), (-63.53, -61.77, 1022.62), 854),
    "vm6083": ((80, 0, 1395), (26.21, -13.1, 1221.69), 1021),
    "vm60b1": ((80, 0, 1675), (-20.4, -40.01, 1444.72), 1298),
    "lrmate200ic": ((475, 0, 705), (-379.51, -244.2, 792.23), 704),
    "lrmate200ic5l": ((565, 0, 805), (-484.82, -305.01, 934.46), 892),
    "lrmate200id": ((465, 0, 695), (-397.56, -254.62, 844.51), 717),
    "lrmate200id4s": ((360, 0, 610), (-357.36, -228.28, 764.32), 550),
    "lrmate200id7l": ((550, 0, 805), (-507.34, -318.01, 988.83), 911),
    "gp4": ((362, 0, 605), (-354.87, -227.47, 767.57), 550),
    "gp7": ((560, 0, 815), (-531.73, -332.09, 1006.86), 927),
    "gp8": ((460, 0, 715), (-422.09, -268.79, 855.98), 727),
    "gp12": ((895, 0, 1264), (-763.51, -472.18, 1336.14), 1440),
    "gp25": ((1045, 0, 1465), (-931.82, -569.35, 1619.22), 1730),
    "tx60": ((0, 20, 1045), (-51.99, -28.88, 889.15), 670),
    "tx60l": ((0, 20, 1295), (-83.5, -47.07, 1091.42), 920),
    "tx90": ((50, 50, 1428), (-54.08, -4.86, 1202.61), 1000),
    "tx90l": ((50, 50, 1628), (-66.82, -12.21, 1368.28), 1200),
    "tx90xl": ((50, 50, 1878), (-136.71, -52.56, 1558.67), 1450),
    "rx160": ((150, 0, 2110), (-140.24, -115.47, 1724.87), 1710),
    "rx160l": ((150, 0, 2410), (-51.38, -64.17, 2006.78), 2010),
    "ur3e": ((-456.75, -223.15, 66.5), (-265.79, -386.25, 185.64), None),
    "ur5e": ((-817.2, -232.9, 62.8), (-513.72, -538.62, 260.19), None),
    "ur10e": ((-1184.25, -290.7, 60.85), (-748.16, -736.14, 341.71), None),
    "ur16e": ((-838.4, -290.7, 60.85), (-501.24, -593.58, 311.18), None),
    "ur20": ((-1590.7, -355.3, 77.0), (-1010.86, -952.2, 497.35), None),
    "ur30": ((-1140.7, -355.3, 77.0), (-702.5, -774.17, 401.95), None),
}
"""The flange (x, y, z), mm from the mounting face, and the reach, mm:

- in the side view of the data sheet, summed by hand from its lengths; for Universal Robots at zero, from their table;
- at `ASYMMETRIC`, by multiplying the joint origins and axes of a published URDF (ros-industrial, kroshu, DENSORobot,
  UniversalRobots), or, where there is none (kr5r650, kr5r850, DENSO's but the VS-060), translations by the data sheet's
  lengths and rotations about the axes of its drawing, equal to tables of another source (see each robot's file);
- the data sheet's maximum reach: of the flange for Staubli, of the wrist's centre, joint 5, for all others.
"""
COEFFICIENTS = {"panda": 43}
"""Where a robot has not 36 base coefficients of its links."""
EARLIER = {"kr5-paper", "panda", "tx40"}
"""Tables with zeros of their own; tested by their logs and, kr5-paper, by the paper's coefficients."""


def home(name):
    return np.radians(next((q for start, q in HOMES.items() if name.startswith(start)), (0.0,) * 6))


def test_every_built_in_robot_is_known_and_says_where_it_comes_from():
    assert set(KNOWN) | EARLIER == set(BUILT_IN)
    tables = {name: built_in_table(name) for name in BUILT_IN}
    for name, table in tables.items():
        assert all(table[key] for key in ("name", "description", "source"))
        assert table["gravity"] == [0.0, 0.0, -9.81]
        assert ("transmission" in table) == (name == "tx40"), "only published gear ratios"
        assert any("frame" in note for note in table["notes"]), "it says where the last frame sits"
    assert len({table["name"] for table in tables.values()}) == len(tables)
    robots = [load_robot(name) for name in BUILT_IN]
    assert not any(one.same_kinematics(other) for one, other in combinations(robots, 2))


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_robot_loads_and_has_efforts(name):
    robot = load_robot(name)
    model = Model(robot, (RigidBody(),))
    assert len(base_coefficients(model)) == COEFFICIENTS.get(name, 36)
    efforts = model.effort(random_motion(robot.n_joints), parameters_of(random_clouds(robot.n_joints)))
    assert np.isfinite(efforts).all()
    assert efforts.any(axis=0).all()


def test_flanges_and_reaches_are_those_of_the_data_sheets():
    for name, (side_view, asymmetric, known_reach) in KNOWN.items():
        robot = load_robot(name)
        flanges = [1e3 * pose(robot, q).flange[:3, 3] for q in (home(name), ASYMMETRIC)]
        np.testing.assert_allclose(flanges[0], side_view, rtol=0, atol=1e-6, err_msg=name)
        np.testing.assert_allclose(flanges[1], asymmetric, rtol=0, atol=0.0051, err_msg=name)
        if known_reach is not None:
            joint = None if name.startswith(("tx", "rx")) else 5
            assert 1e3 * reach(robot, joint) == pytest.approx(known_reach, abs=1.5), name


def test_zeros_that_are_not_the_controllers():
    """At the controller's zero the TX40 is upright; the Panda, stretched upwards, ends in joint 7."""
    upright = pose(load_robot("tx40"), [0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(upright.flange[:3, 3], [0.0, 0.035, 0.77], rtol=0, atol=1e-12)
    np.testing.assert_allclose(pose(load_robot("panda")).flange[:3, 3], [0.088, 0.0, 1.033], rtol=0, atol=1e-12)


GANTRY = [{"a": 0.1 * k, "alpha": 0.3 + k, "d": 0.2, "theta": -0.4, "type": "prismatic"} for k in range(1, 3)]
GANTRY += [{"a": 0.3, "alpha": -0.7, "d": 0.1, "theta": 0.2}]


@pytest.mark.parametrize("name", ["kr5", "panda", "tx90", "ur20", "gantry"])
def test_frames_and_axes_are_those_of_the_dh_matrices(name):
    table = {"convention": "standard", "joints": GANTRY} if name == "gantry" else built_in_table(name)
    robot = robot_from_table(table, "test")
    q = random_motion(robot.n_joints, 1).q[0]
    here, expected = pose(robot, q), dh_chain(table)(q)[0]
    found = [frame @ joint.link_frame for frame, joint in zip(here.joint_frames, robot.joints, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)
    turning = expected if table["convention"] == "modified" else [np.eye(4), *expected[:-1]]
    np.testing.assert_allclose(here.axes, [frame[:3, 2] for frame in turning], rtol=0, atol=1e-13)


def test_reach_of_a_planar_arm():
    """Two links in a horizontal plane reach as far as they are long, and 0.7 m with the second joint stuck."""
    rows = [{"a": a, "alpha": 0.0, "d": 0.3, "theta": 0.4} for a in (0.7, 0.45)]
    arm = robot_from_table({"convention": "standard", "joints": rows}, "test")
    assert reach(arm) == pytest.approx(1.15, abs=1e-9)
    assert reach(arm, joint=2) == pytest.approx(0.7, abs=1e-12)
    slider = replace(arm, joints=(arm.joints[0], replace(arm.joints[1], prismatic=True)))
    np.testing.assert_allclose(reach(slider), np.linalg.norm(pose(slider).flange[:2, 3]), rtol=1e-12)


def test_positions_that_are_none_are_refused():
    for q in ([0.0] * 5, [0.0] * 5 + [np.nan], "here", [[0.0] * 6]):
        with pytest.raises(InputError, match=r"q`: .*give 6 finite numbers"):
            pose(load_robot("kr6r900"), q)
