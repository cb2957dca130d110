"""Robots, limits, nominal values and columns, mutated: they are read, or refused in one line."""

import re
import tomllib

import pytest
import tomli_w
from hypothesis import strategies as st
from mutations import BUDGETS, HOSTILE_NUMBERS, check_reader, fuzz, mutated_bytes, mutated_tree

from bayesid.errors import InputError
from bayesid.excitation.limits import read_limits
from bayesid.fit.knowledge import Beliefs, read_nominal
from bayesid.log.formats.stated import parse_columns
from bayesid.model.robot import load_robot, robot_from_table, robot_table
from bayesid.results.robot_file import robot_file

DH = b"""name = "arm"
convention = "standard"
gravity = [0.0, 0.0, -9.81]
transmission = [[1.0, 0.0, 0.0], [0.2, 90.0, 0.0], [0.0, 0.0, 70.0]]
joints = [
  { a = 0.3, alpha = 1.5708, d = 0.2, theta = 0.1 },
  { a = 0.2, alpha = 0.0, d = 0.0, theta = -1.2 },
  { type = "prismatic", a = 0.0, alpha = -1.5, d = 0.1, theta = 0.0 },
]
"""
URDF = b"""<?xml version="1.0" encoding="utf-8"?>
<robot name="arm">
  <link name="base"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="hand"/>
  <joint name="j1" type="revolute"><parent link="base"/><child link="l1"/>
    <origin xyz="0 0 0.3" rpy="0 0.2 0"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="3"/></joint>
  <joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/>
    <origin xyz="0.3 0 0"/><axis xyz="0 1 0"/><limit lower="-1" upper="1.5" velocity="2" effort="9"/></joint>
  <joint name="j3" type="prismatic"><parent link="l2"/><child link="l3"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.5" velocity="1" effort="9"/><mimic joint="j2"/></joint>
  <joint name="weld" type="fixed"><parent link="l3"/><child link="hand"/></joint>
</robot>
"""
SHORT = b"".join(line for line in URDF.splitlines(keepends=True))
LIMITS = b"lower = [-2.0, -1.0, 0.0]\nupper = [2.0, 1.5, 0.5]\nvelocity = 2.5\nacceleration = [8, 8, 2]\n"
NOMINAL = b'name,mean,sd,decided\nm1,2.5,0.3,data\n"Fv2",1.5,,prior\nFc3,0.7,1e-2,data\n'
COLUMNS = b't = "Zeit [ms]"\nq = "Achse{} [Grad]"\ni = "Strom{1-6} [A]"\ndq2 = "v2"\n'
SHEET = b"joint,a[mm],alpha[deg],d[mm],theta[deg]\n1,25,-90,400,0\n2,455,0,0,q2 + pi/2\n3,35,-90,0,180\n"


def fuzz_file(path, samples, read, examples):
    """Mutations of the bytes of a file."""
    path.write_bytes(samples[0])
    assert check_reader(lambda: read(path))

    def check(content):
        path.write_bytes(content)
        check_reader(lambda: read(path))

    for sample in samples:
        fuzz(mutated_bytes(sample), check, examples // len(samples))


READERS = {
    "robot.toml": ([DH], load_robot),
    "robot.urdf": ([URDF], load_robot),
    "limits.toml": ([LIMITS], read_limits),
    "limits.urdf": ([URDF], read_limits),
    "nominal.csv": ([NOMINAL], lambda path: [Beliefs(nominal=read_nominal(path))]),
    "columns.toml": ([COLUMNS], lambda path: parse_columns(str(path))),
    "sheet.csv": (
        [SHEET],
        lambda path: robot_file(path.read_bytes().decode("latin-1"), "arm", "standard", "sheet.csv"),
    ),
}


@BUDGETS
@pytest.mark.parametrize("name", READERS)
def test_bytes(tmp_path, name, examples):
    samples, read = READERS[name]
    fuzz_file(tmp_path / name, samples, read, examples)


@BUDGETS
@pytest.mark.parametrize("form", ["table", "chain"])
def test_tables(form, examples):
    table = tomllib.loads(DH.decode())
    table = table if form == "table" else robot_table(robot_from_table(table, "arm"))
    fuzz(mutated_tree(table), lambda one: check_reader(lambda: robot_from_table(one, "arm")), examples)


@BUDGETS
def test_tables_of_limits(tmp_path, examples):
    path = tmp_path / "limits.toml"

    def check(table):
        try:
            path.write_bytes(tomli_w.dumps(table).encode())
        except (TypeError, UnicodeEncodeError, ValueError):  # what TOML cannot hold
            return
        check_reader(lambda: read_limits(path))
        check_reader(lambda: load_robot(path))

    fuzz(mutated_tree(tomllib.loads(LIMITS.decode())), check, examples)


@st.composite
def changed_attributes(draw):
    """The URDF with attributes of others, hostile numbers and elements moved."""
    text = URDF.decode()
    for _ in range(draw(st.integers(1, 3))):
        values = list(re.finditer(r'"([^"]*)"', text))
        one = draw(st.sampled_from(values))
        other = draw(
            st.sampled_from([value[1] for value in values] + list(HOSTILE_NUMBERS) + ["1e308 0 0", "0 0 1e-200"])
        )
        text = text[: one.start(1)] + other + text[one.end(1) :]
    return text


@BUDGETS
def test_attributes(tmp_path, examples):
    path = tmp_path / "robot.urdf"

    def check(text):
        path.write_text(text, encoding="utf-8")
        check_reader(lambda: load_robot(path))
        check_reader(lambda: load_robot(path, tip="l2", hold={"j1": 0.5}))
        check_reader(lambda: read_limits(path))

    fuzz(changed_attributes(), check, examples)


# ---------------------------------------------------------------------------------------------------------------
# What was found
# ---------------------------------------------------------------------------------------------------------------
def chain(n, kind):
    """Links one after the other."""
    links = "".join(f'<link name="l{k}"/>' for k in range(n + 1))
    joints = "".join(
        f'<joint name="j{k}" type="{kind}"><parent link="l{k}"/><child link="l{k + 1}"/><axis xyz="0 0 1"/></joint>'
        for k in range(n)
    )
    return f'<robot name="snake">{links}{joints}</robot>'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (chain(5000, "fixed"), "has 5001 links"),
        (chain(5000, "revolute"), "has 5001 links"),
        (f'<robot name="deep">{"<a>" * 100_000}{"</a>" * 100_000}</robot>', "elements in more than 32 others"),
        (f'<robot name="{"x" * (9 << 20)}"/>', "is longer than 8 MiB"),
    ],
)
def test_a_urdf_beyond_all_robots(tmp_path, text, said):
    path = tmp_path / "robot.urdf"
    path.write_text(text, encoding="utf-8")
    for read in (load_robot, read_limits):
        with pytest.raises(InputError, match=said):
            read(path)


def test_a_chain_of_more_joints_than_any_robot(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(chain(500, "revolute"), encoding="utf-8")
    with pytest.raises(InputError, match="has 500 moving joints"):
        load_robot(path)


def test_a_long_chain_that_a_robot_may_have(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(chain(100, "revolute").replace('"revolute"', '"fixed"', 60), encoding="utf-8")
    assert load_robot(path).n_joints == 40


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("robot.toml", f"joints = {'[' * 5000}{']' * 5000}", "tables or lists in more than 32 others"),
        ("robot.toml", f"gravity = {'9' * 5001}", "is not valid TOML"),
        ("robot.toml", DH.decode().replace("0.3", "1" + "0" * 400), "key 'a' cannot be used"),
        ("robot.toml", DH.decode().replace("0.3", "1e308"), "key 'a' holds 1e\\+308"),
        ("robot.toml", f"{'a.' * 20_000}b = 1", "tables or lists in more than 32 others"),
        ("robot.urdf", URDF.decode().replace("0 0 0.3", "0 0 1e308"), "key 'origin xyz' holds 1e\\+308"),
    ],
)
def test_numbers_and_depths_beyond_all_robots(tmp_path, name, text, said):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        load_robot(path)


def test_limits_in_a_circle(tmp_path):
    path = tmp_path / "limits.urdf"
    ends = (("base", "a"), ("a", "b"), ("b", "a"))
    joints = "".join(
        f'<joint name="{p}{c}" type="revolute"><parent link="{p}"/><child link="{c}"/></joint>' for p, c in ends
    )
    path.write_text(f"<robot name='ring'>{joints}</robot>", encoding="utf-8")
    with pytest.raises(InputError, match="link a: is the child of two joints"):
        read_limits(path)
