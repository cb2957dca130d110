"""Bad input of every command: exit code 2, one line that names it and says what helps, and nothing written."""

import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from command_line import ARM, assert_refused, identify, run
from oracles import urdf_text


@pytest.fixture
def refused(arm_place, capfd):
    return lambda *arguments, says: assert_refused(capfd, arguments, says, arm_place)


def shorter():
    """new.csv, which is not the log of the result: a row less."""
    Path("new.csv").write_text("".join(Path("log.csv").read_text().splitlines(keepends=True)[:-1]))


BAD_CELLS = [
    (1, "q2", "x", ["row 1", "column q2 is missing"]),
    (18, "q2", "hello", ["row 18", "q2", "'hello'"]),
    (602, "tau1", "1e400", ["row 602", "tau1", "inf"]),
    (102, "t", "0.5", ["row 102", "backwards", "0.5"]),
]


def test_bad_logs(arm_place, refused):
    good = [line.split(",") for line in (arm_place / "log.csv").read_text().splitlines()]
    bad = [(good[:31], ["30 rows"]), ([], ["header"]), ([*good[:-1], good[-1][:3]], ["row 602", "3 values"])]
    for row, column, value, says in BAD_CELLS:
        table = [list(one) for one in good]
        table[row - 1][good[0].index(column)] = value
        bad.append((table, says))
    for amplitude, says in ((0.0, "positions"), (1e-7, "no joint moves")):
        still = [[row[0], *[f"{0.5 + amplitude * (i % 2)}"] * 3, *row[4:]] for i, row in enumerate(good[1:])]
        bad.append(([good[0], *still], [says]))
    for table, says in bad:
        (arm_place / "bad.csv").write_text("".join(",".join(row) + "\n" for row in table))
        refused(*identify("bad.csv"), says=["bad.csv", *says])


def test_logs_and_robots_that_are_none(arm_result, arm_place, refused):
    (arm_place / "binary.csv").write_bytes(np.random.default_rng(0).bytes(4000))
    (arm_place / "picture.csv").write_bytes((arm_place / "log.csv").read_bytes()[:2000] + b"\xff\xd8\x00" * 100)
    (arm_place / "binary.toml").write_bytes(b"\xff\xfe\x00")
    (arm_place / "binary.urdf").write_bytes(b"\xff\xfe\x00")
    for log in ("nowhere.csv", "no/where.csv", "result", "binary.csv", "picture.csv"):
        for command in (identify(log), ("validate", "result", log), ("payload", "result", log)):
            refused(*command, says=[log])
    for robot in ("r2d2", "nowhere.toml", str(arm_place), "binary.toml", "binary.urdf"):
        for command in (identify(robot=robot), ("simulate", "--robot", robot, "--out", "s.csv")):
            refused(*command, says=[robot])
    refused(*identify(robot="kr5"), says=["log.csv", "3 joints", "has 6"])
    (arm_place / "runs").mkdir()
    shutil.copy("log.csv", "runs/log.csv")
    (arm_place / "runs" / "summary.json").touch()
    refused(*identify("runs/*.txt"), says=["runs/*.txt", "matches no file"])
    refused("identify", "runs/l*", "runs/log.csv", "--robot", "arm.toml", says=["runs/log.csv", "twice"])
    refused(*identify("runs/l*", out="runs"), says=["runs", "holds the log"])


BAD_ROBOTS = [
    ("arm.toml", ARM.replace("\n  {a = 0.4, alpha = 0.5, d = 0.2, theta = -0.4},", ""), ["3 joints", "arm has 2"]),
    ("x.toml", ARM.replace("a = 0.15, ", ""), ["x.toml", "joint 2", "'a'", "missing"]),
    ("x.toml", ARM.replace("modified", "odd"), ["x.toml", "convention 'odd'"]),
    ("x.toml", ARM.replace("0.15", '"far"'), ["x.toml", "joint 2", "'a'"]),
    ("x.toml", ARM.replace("{a = 0.4", '{type = "screw", a = 0.4'), ["x.toml", "joint 3", "'screw'"]),
    ("x.toml", f"transmission = {[[1, 0, 0]] * 3}\n" + ARM, ["x.toml", "'transmission'"]),
    ("x.toml", "a = = b", ["x.toml", "not valid TOML"]),
    ("x.urdf", "<robot><link>", ["x.urdf", "URDF"]),
    ("x.urdf", '<robot name="x"/>', ["x.urdf", "0 links"]),
    ("x.urdf", urdf_text().replace('child link="part7"', 'child link="part2"'), ["x.urdf", "two joints"]),
    ("x.urdf", urdf_text().replace("continuous", "planar"), ["odd has 2", "joint j1 is planar"]),
    ("x.urdf", urdf_text().replace("0.0 3.0 4.0", "0 0 0"), ["x.urdf", "j1", "axis"]),
]


def test_bad_robots(arm_place, refused):
    for file, text, says in BAD_ROBOTS:
        (arm_place / file).write_text(text)
        refused(*identify(robot=file), says=says)


SIMULATE = "simulate", "--robot", "arm.toml", "--out", "s.csv"
TOLERANCES = ("", "1mm", "1,0.1", "1mm,0.1deg,3", "0.1deg,1mm", "1inch,1deg", "-1mm,1deg", "nanmm,1deg", "1e400mm,1deg")
EFFECTS = ("", "magic:1:0.1", "viscous_friction:0:0.1", "viscous_friction:4:0.1", "viscous_friction:one:0.1")
EFFECTS += ("viscous_friction:1:-0.1", "viscous_friction:1:inf", "rigid_body:1:0.1", "viscous_friction:1")
BAD_VALUES = [
    (identify(), "--search", ("guess",)),
    (identify(), "--terms", ("rigid_body,magic", "rigid_body,rigid_body", "rigid_body,", "", "viscous_friction")),
    (identify(), "--gains", ("1,two,3", "")),
    (identify(), "--unsigned", ("", "0", "4", "some", "1,,2", "-1", "1.5")),
    (identify(), "--cutoff", ("0", "-3", "50.5", "nan", "inf", "high")),
    (identify(), "--beam-width", ("0", "-2", "1.5", "wide")),
    (identify(), "--initial-segments", ("0", "13", "1.5", "few")),
    (identify(), "--seed", ("-1", "1.5", "lucky")),
    (identify(), "--posterior-budget", ("-1", "nan", "inf", "long")),
    (identify(), "--search-budget", ("-1", "nan")),
    (identify(), "--kinematic-tolerance", TOLERANCES),
    (identify(), "--complete", ("nonsense",)),
    (identify(), "--columns", ("x=1", "nowhere.toml")),
    (SIMULATE, "--effect", EFFECTS),
    (SIMULATE, "--duration", ("0", "0.5", "nan", "inf", "long")),
    (SIMULATE, "--rate", ("0", "-1", "5", "nan", "fast")),
    (SIMULATE, "--noise", ("-0.1", "nan", "loud")),
    (SIMULATE, "--seed", ("-1", "lucky")),
    (("demo",), "--seed", ("-1",)),
    (("validate", "result", "log.csv"), "--cutoff", ("900", "x")),
    (("payload", "result", "new.csv"), "--known-mass", ("heavy", "2~x", "0", "2~2")),
    (("payload", "result", "new.csv"), "--posterior-budget", ("-1",)),
    (("payload", "result", "new.csv"), "--cutoff", ("80",)),
    (("predict", "result", "log.csv", "--out", "x.csv"), "--cutoff", ("80",)),
]


def test_an_option_that_is_none_is_named(arm_result, refused):
    shorter()
    for command, option, values in BAD_VALUES:
        for value in values:
            refused(*command, f"{option}={value}", says=[option])


BAD_COMMANDS = [
    ("identify", ["log"]),
    ("identify log.csv", ["--robot"]),
    ("validate result", ["log"]),
    ("simulate --robot kr5", ["--out"]),
    ("demo more", ["more"]),
    ("completion abacus", ["abacus"]),
    ("identify log.csv --robot arm.toml --gains=1,2,3", ["log.csv", "gains"]),
    ("identify log.csv --robt kr5", ["did you mean --robot?"]),
    ("excite --no-degress --robot kr5", ["did you mean --no-degrees?"]),
    ("identify log.csv --robot kr5 --search certifed", ["did you mean certified?"]),
    ("robot show kr5 --qq 0", ["no option --qq"]),
    ("identify log.csv --robot UR-5e", ["ur5e"]),
    ("excite --robot kr5 --about Fc2", ["--about", "--for"]),
]


def test_bad_commands_lead_to_the_right_one(refused):
    for command, says in BAD_COMMANDS:
        refused(*command.split(), says=says)


def test_nominal_values_that_cannot_be_used(arm_place, refused):
    refused(*identify(), "--nominal", "cad.csv", says=["cad.csv", "read"])
    for text, says in (
        ("name,mean,sd\nm9,1.0,0.1\n", ["'m9'"]),
        ("name,mean,sd\nm2,1.0,-0.1\n", ["m2"]),
        ("name,mean,sd\nm2,heavy,0.1\n", ["cad.csv, line 2", "'heavy'"]),
        ("name,value\nm2,1.0\n", ["cad.csv", "sd"]),
        ("", ["cad.csv", "columns"]),
    ):
        (arm_place / "cad.csv").write_text(text)
        refused(*identify(), "--nominal", "cad.csv", says=says)


BAD_PAYLOADS = [
    ("--payload=new.csv", "does not name a payload and a log"),
    ("--payload=@new.csv", "has no mass in kg"),
    ("--payload=-2.8@new.csv", "both above 0"),
    ("--payload=2.8~0@new.csv", "both above 0"),
    ("--payload=tool 1:2.8@new.csv", "'tool 1' is not a valid label"),
    ("--payload=tool:heavy@new.csv", "has no mass in kg"),
    ("--payload=2.8@missing.csv", "missing.csv"),
    ("--payload=2.8@log.csv", "is given twice"),
    ("--payload=a-b@new.csv", "'a-b' is not a valid label"),
    ("--payload=2.8@new.csv --payload=b@new.csv", "is given twice"),
    ("--payload=2.8@new.csv --payload=2.9@more.csv", "2.8 +- 0.0028 kg"),
    ("--payload=2.8@new.csv --each", "--each"),
    ("--payload=2.8@new.csv --nominal=nominal.csv", "m_payload is stated by --payload too"),
]
BAD_LISTS = [
    ("[[logs", "setup.toml"),
    ('logs = "log.csv"', "lists no logs"),
    ('[[log]]\nfile = "log.csv"', "unknown key 'log'"),
    ('[[logs]]\nfile = "log.csv"\npaylod = "a"', "unknown key 'paylod'; did you mean payload"),
    ('[[logs]]\npayload = "a"', "log 1: names no file"),
    ('[[logs]]\nfile = "log.csv"\nmass = "2.8"', "log 1: mass = '2.8' is not a mass"),
    ('[[logs]]\nfile = "log.csv"\nmass = 0', "both above 0"),
    ('[[logs]]\nfile = "log.csv"\npayload = "a b"', "'a b' is not a valid label"),
    ('[[logs]]\nfile = "missing.csv"', "missing.csv"),
    ('[[logs]]\nfile = "log.csv"\npayload = "tool1"', "no log without a payload"),
]


def test_payloads_and_lists_of_logs_that_cannot_be(arm_place, refused):
    for name in ("new.csv", "more.csv"):
        shutil.copy("log.csv", name)
    (arm_place / "nominal.csv").write_text("name,mean,sd\nm_payload,2.8,0.1\n")
    for options, said in BAD_PAYLOADS:
        words = [f"--{one}" for one in options.removeprefix("--").split(" --")]
        refused(*identify(), *words, says=[said])
    refused(*identify("setup.toml"), says=["setup.toml"])
    for text, said in BAD_LISTS:
        (arm_place / "setup.toml").write_text(text)
        refused(*identify("setup.toml"), says=[said])


WRITERS = (
    identify()[:-1],
    ("validate", "result", "log.csv", "--out"),
    ("demo", "--out"),
    ("payload", "result", "new.csv", "--out"),
)


def test_out_must_be_new_or_an_earlier_result(arm_result, arm_place, refused):
    (arm_place / "full").mkdir()
    (arm_place / "full" / "thesis.tex").touch()
    shorter()
    (arm_result / "notes.txt").touch()
    for command in WRITERS:
        refused(*command, "full", says=["full", "other files", "thesis.tex"])
        refused(*command, "log.csv/out", says=["log.csv/out", "not a folder"])
        refused(*command, ".", says=["."])
        refused(*command, "result", says=["result", "other files"])


def test_results_and_files_never_replace_what_they_came_from(arm_result, arm_place, refused):
    """As in `bayesid identify bayesid-demo/log.csv --out bayesid-demo`."""
    refused("validate", "result", "log.csv", "--out", "result", says=["result", "other files"])
    refused("payload", "result", "log.csv", "--out", "new", says=["log.csv", "identified from"])
    refused("predict", "result", "log.csv", "--out", "./log.csv", says=["is the motion itself"])
    refused("predict", "result", "log.csv", "--out", "result", says=["holds a result"])
    refused("report", "result", "--out", ".", says=["is a folder"])
    for out, says in (("result", "folder"), ("log.csv/s.csv", "not a folder"), ("", "folder")):
        refused("simulate", "--robot", "arm.toml", "--duration", 2, "--out", out, says=[says])
    shutil.copy("log.csv", "result")
    refused(*identify("result/log.csv", out="result"), says=["result", "holds the log"])


def test_results_that_are_none_or_damaged(arm_result, arm_place, refused):
    (arm_place / "empty").mkdir()
    for command in ("validate", "payload", "track"):
        for folder in ("nowhere", "empty", "log.csv"):
            refused(command, folder, "log.csv", says=[folder, "model.toml"])
    refused("report", "nowhere", says=["nowhere", "no summary.json"])
    (arm_place / "empty" / "payload.json").write_text("{}")
    refused("report", "empty", says=["empty", "`bayesid payload`", "open empty/payload.json"])
    whole = {path.name: path.read_bytes() for path in arm_result.iterdir()}
    content = whole["model.toml"]
    bad = [b"gar = = bage", b"\xff\xfe\x00", b"", content[: len(content) // 2], content[:-30]]
    for key in ("robot", "terms", "values", "noise"):
        bad.append(tomli_w.dumps({k: v for k, v in tomllib.loads(content.decode()).items() if k != key}).encode())
    for value in ("heavy", float("nan")):
        table = tomllib.loads(content.decode())
        table["values"]["J2xy"] = value
        bad.append(tomli_w.dumps(table).encode())
    bad.append(content.replace(b"viscous_friction", b"magic"))
    for one in bad:
        (arm_result / "model.toml").write_bytes(one)
        refused("validate", "result", "log.csv", "--out", "out", says=["model.toml"])
    (arm_result / "model.toml").write_bytes(content)
    (arm_result / "posterior.nc").write_bytes(whole["posterior.nc"][:5000])
    refused("validate", "result", "log.csv", "--out", "out", says=["posterior.nc", "damaged"])
    (arm_result / "posterior.nc").write_bytes(whole["posterior.nc"])
    columns = [line.split(",") for line in (arm_place / "log.csv").read_text().splitlines()]
    (arm_place / "two.csv").write_text("".join(",".join(row[:3] + row[4:6]) + "\n" for row in columns))
    refused("validate", "result", "two.csv", says=["two.csv", "2 joints", "arm has 3"])
    refused("predict", "result", "two.csv", "--out", "x.csv", says=["two.csv", "2 joints"])
    refused("validate", "result", "no.csv", says=["no.csv"])
    refused("validate", "result", "log.csv", "--cutoff", "900", says=["--cutoff"])
    refused("report", "result", "--validation", "log.csv", says=["`bayesid validate RESULT LOG`"])
    (arm_result / "findings.npz").write_bytes(whole["findings.npz"][:-100])
    refused("report", "result", says=["result", "findings.npz is damaged"])
    (arm_result / "findings.npz").unlink()
    refused("report", "result", says=["result", "no findings.npz"])


BAD_MOTIONS = [
    (("--about", "Fc9"), ("--about", "'Fc9'")),
    (("--between", "torque_offset:1"), ("--between", "two different")),
    (("--about", "Fc2", "--between", "torque_offset:1,joint_spring:1"), ("--between", "--about")),
    (("--start", "0,1"), ("--start", "2 numbers")),
    (("--effort-limits", "5,5,5"), ("--effort-limits", "--limits FILE", "effort")),
    (("--capsules", "0.03,x"), ("--capsules", "not a list of numbers")),
    (("--margin=-1", "--capsules", "0.03"), ("--margin", "-1 m", "touch")),
    (("--capsules", "0.03", "--floor", "low"), ("--floor", "'low'", "none")),
    (("--capsules", "0.03", "--meshes", "."), ("--meshes", "--capsules")),
    (("--floor", "0.1"), ("--floor", "--capsules")),
    (("--tool", "0,0,0.1"), ("--tool", "--capsules")),
    (("--about", ""), ("--about",)),
    (("--between", "grease:1,torque_offset:1"), ("--between", "'grease'")),
    (("--log", "log.csv"), ("--log", "--for")),
    (("--robot", "kr5"), ("kr5", "another robot")),
    (("--duration", "0.1"), ("--duration",)),
    (("--changes", "0"), ("--changes",)),
    (("--payload", "box"), ("payload", "box")),
    (("--noise", "0.05"), ("--noise", "result")),
]


def test_motions_after_a_result_that_cannot_be(arm_result, refused):
    for options, says in BAD_MOTIONS:
        quick = ("--duration", "4", "--rate", "50", "--changes", "60")
        refused("excite", "--for", "result", *quick, *options, "--out", "next", says=says)
    (arm_result / "discrepancy.json").write_text('{"found": [{"effect": 3}]}')
    refused("excite", "--for", "result", "--out", "next", says=["discrepancy.json"])
    assert run("excite") == 2
    refused("excite", "--robot", "kr5", "--changes", "0", "--out", "motion", says=["changes", "0"])
