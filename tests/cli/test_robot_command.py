"""`bayesid robot`: files made from data sheets, robots shown and listed."""

import io
import re
import tomllib

import numpy as np
import pytest
from command_line import assert_refused, run, unfolded

from bayesid.errors import InputError
from bayesid.export.robot_file import robot_file, robot_template
from bayesid.robot import load_robot
from bayesid.robot.kinematics import pose
from bayesid.robot.load import BUILT_IN, built_in_table

KR5 = """Achse;a [mm];alpha [deg];d [mm];theta [deg]
1;75;-90;335;0
2;270;0;0;q2 - 90
3;90;90;0;0
4;0;-90;-295,5;0
5;0;90;0;0
6;0;180;-80;0
"""
"""A table as a German spreadsheet writes it; half a millimetre is added to see the decimal comma."""


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "table.csv").write_text(KR5)
    return tmp_path


@pytest.fixture
def refused(place, capfd):
    return lambda *arguments, says: assert_refused(capfd, arguments, says, place)


def rows_of(path):
    return tomllib.loads(path.read_text(encoding="utf-8"))


def test_a_table_becomes_a_robot_file(place, capfd):
    assert run("robot", "new", "table.csv", "--convention", "standard", "--name", 'my "KR"', "--out", "kr.toml") == 0
    assert capfd.readouterr() == ("written to kr.toml; check it: bayesid robot show kr.toml\n", "")
    table = rows_of(place / "kr.toml")
    rows = [(0.075, -90, 0.335, 0), (0.27, 0, 0, -90), (0.09, 90, 0, 0), (0, -90, -0.2955, 0), (0, 90, 0, 0)]
    expected = [(a, np.deg2rad(alpha), d, np.deg2rad(theta)) for a, alpha, d, theta in [*rows, (0, 180, -0.08, 0)]]
    assert [tuple(row[key] for key in ("a", "alpha", "d", "theta")) for row in table["joints"]] == expected
    assert (table["name"], table["convention"], table["gravity"]) == ('my "KR"', "standard", [0.0, 0.0, -9.81])
    assert load_robot(place / "kr.toml").n_joints == 6


def test_tables_in_many_ways_of_writing():
    for text, row in (
        ("a,alpha,d,theta\n0.5,pi/2,-0.25,0", (0.5, np.pi / 2, -0.25, 0.0)),
        ("a_{i-1} (mm)\tα_{i-1}\td_i (mm)\tθ_i\n75\t-π/2\t10\tθ2-π/2", (0.075, -np.pi / 2, 0.01, -np.pi / 2)),  # noqa: RUF001
        ("r [cm] | alpha [deg] | d [m] | offset [rad]\n7.5 | 30 | 0.4 | -1.25", (0.075, np.pi / 6, 0.4, -1.25)),
        ("i,theta(i),d(i)[mm],a(i-1)[mm],alpha(i-1)[deg]\n1,q1+90°,d1,2,-2*pi/3", (2e-3, -2 * np.pi / 3, 0, np.pi / 2)),
        ('a[mm],alpha[deg],d[mm],theta[deg]\n"12,5",45,0,0', (0.0125, np.pi / 4, 0.0, 0.0)),
        ("A;Alpha;D;Theta\nmm;deg;mm;deg\n287;-90;-3;0", (0.287, -np.pi / 2, -0.003, 0.0)),
        ("type,a[mm],alpha[deg],d[mm],theta[deg]\nP,0,90,d1+200,0", (0.0, np.pi / 2, 0.2, 0.0)),
    ):
        written = robot_file(text, "arm", "standard", "here")
        (joint,) = tomllib.loads(written)["joints"]
        np.testing.assert_allclose([joint[key] for key in ("a", "alpha", "d", "theta")], row, rtol=1e-14)
        assert (joint.get("type") == "prismatic") == text.startswith("type")
        assert "000000" not in written


TABLES = {
    "a,alpha,d,theta\n25,0,0.4,0": ", joint 1: column a holds 25, too much for m; name the column with its unit: a[mm]",
    "a,alpha,d\n0,0,0": ": column theta is missing (a, alpha, d)",
    "a[deg],alpha,d,theta\n0,0,0,0": ": column a[deg] is in 'deg'; give it in mm, cm or m",
    "a,alpha,d,theta\n0,0,0,0\n0,x,0,0": ", joint 2: column alpha holds 'x', not a number",
    "a,alpha,d,theta\n0,0,0,0\n0,0,0": ", joint 2: holds 3 values, but the header has 4",
    "a,alpha,d,theta,r\n0,0,0,0,0": ": has two columns for a: a and r",
    "a,alpha,d,theta,type\n0,0,0,0,round": ", joint 1: unknown joint type 'round'",
    "a,alpha,d,theta\n": ": holds no joint",
    "": ": column a is missing (no header)",
    "a\0lpha": ": is not text",
}


def test_tables_that_are_none():
    for text, says in TABLES.items():
        with pytest.raises(InputError, match=re.escape(f"here{says}")):
            robot_file(text, "arm", "standard", "here")


def test_the_template_says_what_to_fill_in_and_is_no_robot_before(place, refused, capfd):
    assert run("robot", "new", "--out", "arm.toml") == 0
    assert "fill it in, then check it: bayesid robot show arm.toml" in capfd.readouterr().out
    refused("robot", "new", "--out", "arm.toml", says=["arm.toml: exists already", "--force"])
    refused("robot", "show", "arm.toml", says=["arm.toml: not filled in yet: a, alpha, d of joints 1, 2, 3, 4, 5, 6"])
    text = (place / "arm.toml").read_text()
    filled = re.sub(r"\{ a = nan, alpha = nan, d = nan", "{ a = 0.3, alpha = 0.5, d = 0.1", text)
    filled = filled.replace("# transmission", "transmission")
    (place / "arm.toml").write_text(filled)
    robot = load_robot(place / "arm.toml")
    assert (robot.n_joints, robot.name) == (6, "arm")
    assert robot.transmission is not None, "what is commented out would be read"
    assert all(len(line) <= 120 for line in robot_template("arm", "arm.toml").splitlines())


def test_new_files_that_cannot_be(place, refused):
    (place / "folder.toml").mkdir()
    (place / "picture.csv").write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\x81")
    new = "robot", "new"
    refused(*new, "table.csv", "--out", "a.toml", says=["--convention: is needed with a table", "standard or modified"])
    refused(*new, "picture.csv", "--convention", "standard", "--out", "a.toml", says=["picture.csv"])
    refused(*new, "no.csv", "--convention", "standard", "--out", "a.toml", says=["no.csv: cannot be read"])
    refused(*new, "--out", "a.csv", says=["a.csv: does not end in .toml"])
    refused(*new, "--out", "folder.toml", says=["folder.toml: is a folder"])
    refused(*new, says=["--out"])
    refused(*new, "--convention", "craig", "--out", "a.toml", says=["craig"])


def test_list_has_all_built_in_robots(capfd):
    assert run("robot", "list") == 0
    out, err = capfd.readouterr()
    assert err == ""
    assert all(len(line) <= 100 for line in out.splitlines())
    assert out.splitlines()[-1].endswith("bayesid robot show NAME"), "which says where its table is from"
    for name, line in zip(BUILT_IN, out.splitlines()[1:-1], strict=True):
        table = built_in_table(name)
        assert line.split()[:2] == [name, str(len(table["joints"]))]
        assert table["description"] in line
    assert run("robot", "show", "kr6r900") == 0
    assert built_in_table("kr6r900")["source"] in unfolded(capfd.readouterr().out)


def test_a_controllers_log_read_with_the_papers_zeros_is_told_the_robot(tmp_path, capfd):
    log = str(tmp_path / "log.csv")
    assert run("simulate", "--robot", "kr5r650", "--duration", "5", "--rate", "50", "--seed", "3", "--out", log) == 0
    assert run("identify", log, "--robot", "kr5", "--out", str(tmp_path / "out")) == 2
    alias, refused = capfd.readouterr().err.splitlines()
    assert "kr5-paper" in alias
    assert "--robot kr5r650" in refused
    assert not (tmp_path / "out").exists()


def test_show_says_where_the_flange_is(capfd):
    """KR 6 R900 in the side view of its data sheet: 525 mm forwards, 890 mm up; reach 901.5 mm."""
    assert run("robot", "show", "kr6r900", "--q", "0,-90,90,0,0,0", "--degrees") == 0
    out, err = capfd.readouterr()
    assert err == ""
    lines = {line.split()[0]: line.split() for line in out.splitlines()}
    assert lines["flange"] == ["flange", "525.0", "0.0", "890.0"]
    assert "KUKA KR 6 R900 sixx" in out
    assert "gravity in the base frame: 0, 0, -9.81 m/s^2" in out
    assert "to the origin of joint 5 901.5 mm" in out
    assert "note: q1 to q6 are A1 to A6 of the controller" in out
    assert "source: ros-industrial/kuka_experimental" in out
    q = np.array([-30.0, -60.0, 45.0, -20.0, 70.0, 10.0])  # may begin with a minus
    assert run("robot", "show", "ur5e", "--q", ",".join(map(str, np.radians(q)))) == 0
    (line,) = [line.split() for line in capfd.readouterr().out.splitlines() if line.startswith("flange")]
    expected = 1e3 * pose(load_robot("ur5e"), np.radians(q)).flange[:3, 3]
    np.testing.assert_allclose(np.array(line[1:], dtype=float), expected, rtol=0, atol=0.051)


def test_what_cannot_be_shown(place, refused):
    show = "robot", "show"
    refused(*show, "kr6r90", says=["kr6r90: no such robot", "kr6r900"])
    refused(*show, "kr5", "--q", "1,2", says=["--q: holds 2 positions, kuka_kr5_sixx_r650 has 6 joints"])
    refused(*show, "kr5", "--q", "0,-90,90,0,0,0", says=["looks like degrees", "--degrees"])
    refused(*show, "kr5", "--q", "0,0,0,0,0,x", says=["is not a list of numbers"])
    refused(*show, "kr5", "--out", "arm.gif", says=["arm.gif: is not a picture", ".png"])
    refused(*show, "kr5", "--out", ".", says=["is a folder"])
    refused(*show, says=["robot"])
    assert run(*show, "kr5", "--q", "0,-90,90,0,0,0", "--no-degrees", "--quiet") == 0


def test_a_table_from_the_standard_input_is_shown_as_a_picture(place, monkeypatch):
    table = b"a[mm] alpha[deg] d[mm] theta[deg]\n25 -90 400 0\n315 0 0 0\n"
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(table), encoding="utf-8"))
    assert run("robot", "new", "-", "--convention", "standard", "--out", "arm.toml", "--quiet") == 0
    assert run("robot", "show", "arm.toml", "--out", "arm.svg", "--quiet") == 0
    assert b"<svg" in (place / "arm.svg").read_bytes()
    assert run("robot", "new", r"a,alpha,d,theta\n1,0,0,0", "--convention", "standard", "--out", "one.toml") == 0
    assert load_robot(place / "one.toml").n_joints == 1
