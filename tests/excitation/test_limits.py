import re

import numpy as np
import pytest
from conftest import small_robot
from open_results import open_known

from bayesid.cli.terminal import in_options
from bayesid.errors import InputError
from bayesid.excitation.limits import check_limits, read_limits
from bayesid.excitation.splines import Feasibility
from bayesid.simulation.trajectories import MotionLimits


def table(tmp_path, text):
    path = tmp_path / "limits.toml"
    path.write_text(text)
    return path


def joint(name, kind, parent, child, limit=""):
    links = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{links}{limit}</joint>'


def urdf(tmp_path, *joints):
    path, text = tmp_path / "arm.urdf", "".join(joints)
    links = dict.fromkeys(re.findall(r'link="(\w+)"', text))
    path.write_text(f"<robot name='arm'>{''.join(f'<link name={link!r}/>' for link in links)}{text}</robot>")
    return path


def test_limits_from_a_table(tmp_path):
    path = table(tmp_path, "lower = [-1, -2.5]\nupper = 2\nvelocity = 2.5\njerk = [200, 150.5]\neffort = 80\n")
    limits = read_limits(path)
    assert limits == MotionLimits((-1.0, -2.5), 2.0, 2.5, jerk=(200.0, 150.5), effort=80.0)
    each = check_limits(limits, small_robot(2))
    assert (each.jerk, each.effort, each.acceleration) == ((200.0, 150.5), (80.0, 80.0), (15.0, 15.0))
    with pytest.raises(InputError, match="2 numbers for 'lower'"):
        check_limits(limits, small_robot(3))
    few = check_limits(read_limits(table(tmp_path, "upper = [1, 2, 3]\n")), small_robot(3))
    feasibility = Feasibility.of(open_known(), few, None)
    assert np.isinf(feasibility.effort).all()
    assert np.isinf(feasibility.rates[2]).all()
    np.testing.assert_array_equal(feasibility.upper, [1.0, 2.0, 3.0])


def test_values_that_cannot_be_used_are_refused_in_one_line(tmp_path):
    for text in (
        "lower = ",
        "lower = 'low'",
        "lower = [1, true]",
        "speed = 2",
        "velocity = 0.0",
        "upper = nan",
        "lower = [3, 3]",
        "lower = [-1, -2]\nupper = [1, 2, 3]",
        "jerk = [10, -1]",
        "effort = []",
        "effort = inf",
        "effort = [[1, 2], [3, 4]]",
        "jerk = [1, 2]\neffort = [1, 2, 3]",
    ):
        with pytest.raises(InputError) as caught:
            read_limits(table(tmp_path, text))
        said = in_options(str(caught.value))
        assert "limits.toml" in said
        assert "\n" not in said
    with pytest.raises(InputError, match=r"none\.toml"):
        read_limits(tmp_path / "none.toml")
    for wrong in ({"jerk": 0.0}, {"effort": (3.0, -1.0)}, {"effort": float("nan")}):
        with pytest.raises(ValueError, match="must be positive"):
            MotionLimits(**wrong)


def test_limits_of_a_urdf_are_read_through_fixed_joints_and_refused_where_it_branches(tmp_path):
    joints = [
        joint("c", "continuous", "l2", "l3", '<limit velocity="0.9" effort="7"/>'),
        joint("b", "prismatic", "flange", "l2", '<limit lower="-0.1" upper="0.4" velocity="0.2" effort="5"/>'),
        joint("fixed", "fixed", "l1", "flange"),
        joint("a", "revolute", "base", "l1", '<limit lower="-2.9" upper="1.7" velocity="2.1" effort="9"/>'),
    ]
    assert read_limits(urdf(tmp_path, *joints)) == MotionLimits(
        (-2.9, -0.1, -2.0), (1.7, 0.4, 2.0), (2.1, 0.2, 0.9), effort=(9.0, 5.0, 7.0)
    )
    with pytest.raises(InputError, match="branches"):
        read_limits(urdf(tmp_path, *joints, joint("d", "revolute", "l1", "l9")))
    joints[1] = joint("b", "prismatic", "flange", "l2", '<limit velocity="0.2" effort="5"/>')
    stated = table(tmp_path, "lower = [-2.5, -0.2, -1]\nupper = [1, 0.3, 1]\nacceleration = 8\n")
    assert read_limits(stated, urdf=urdf(tmp_path, *joints)) == MotionLimits(
        (-2.5, -0.2, -1.0), (1.0, 0.3, 1.0), (2.1, 0.2, 0.9), 8.0, effort=(9.0, 5.0, 7.0)
    )
    with pytest.raises(InputError, match="prismatic without limits"):
        read_limits(table(tmp_path, "effort = 80\n"), urdf=urdf(tmp_path, *joints))
    unknown = '<limit lower="-1" upper="1" velocity="2" effort="{}"/>'  # as exporters write
    pair = [
        joint(f"j{k}", "revolute", f"l{k}", f"l{k + 1}", unknown.format(one)) for k, one in enumerate((0, "1e30", 12.5))
    ]
    assert read_limits(urdf(tmp_path, *pair)).effort == (np.inf, np.inf, 12.5)
    assert read_limits(urdf(tmp_path, pair[0])).effort is None
    for bad, says in (
        (joint("a", "prismatic", "base", "l1"), "prismatic without limits"),
        ("<joint", "is not valid XML"),
    ):
        with pytest.raises(InputError, match=rf"arm\.urdf.*{says}"):
            read_limits(urdf(tmp_path, bad))
