"""`bayesid predict`: the file, and what is refused."""

import shutil

import numpy as np
import pytest
from command_line import assert_refused, run
from conftest import small_robot, smooth_motion

import bayesid

COLUMNS = ["t", *(f"{kind}{j}" for kind in ("tau", "sd", "lower", "upper") for j in (1, 2))]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A result, its model, and a motion without efforts."""
    place = tmp_path_factory.mktemp("made")
    robot, motion = small_robot(2), smooth_motion(2, 6.0, 100.0, seed=1)
    model = bayesid.Model.of(robot, ["rigid_body", "viscous_friction"], motion)
    rng = np.random.default_rng(2)
    theta = bayesid.random_parameters(model, rng=rng)
    log = bayesid.simulate(model, theta, motion, rng=rng, noise=0.03, signed=True)
    result = bayesid.identify(robot, log, ["rigid_body", "viscous_friction"], complete="off", posterior=False)
    bayesid.save(result, place / "result", report=False)
    new = smooth_motion(2, 4.0, 125.0, seed=3)
    values = np.column_stack([new.t, new.q])
    np.savetxt(place / "motion.csv", values, delimiter=",", header="t,q1,q2", comments="", fmt="%.17g")
    log.save(place / "log.csv")
    return place, result


@pytest.fixture
def place(made, tmp_path, monkeypatch):
    for path in made[0].iterdir():
        (shutil.copytree if path.is_dir() else shutil.copy)(path, tmp_path / path.name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def table(path):
    return path.read_text().splitlines()[0].split(","), np.loadtxt(path, delimiter=",", skiprows=1)


@pytest.mark.parametrize(("options", "noise"), [((), True), (("--without-noise",), False)])
def test_the_file_holds_what_python_gives(made, place, capfd, options, noise):
    command = "predict", "result", "motion.csv", "--out", "new/torques.csv", *options
    assert_refused(capfd, command, ["no folder new"])
    (place / "new").mkdir()
    assert run(*command) == 0
    header, values = table(place / "new" / "torques.csv")
    predicted = made[1].predict(place / "motion.csv", noise=noise)
    assert header == COLUMNS
    assert values.shape == (500, 9)
    np.testing.assert_array_equal(values[:, 0], predicted.t)
    for block, expected in zip(
        np.split(values[:, 1:], 4, axis=1),
        (predicted.mean, predicted.sd, predicted.lower, predicted.upper),
        strict=True,
    ):
        np.testing.assert_allclose(block, expected, rtol=1e-6, atol=1e-6)
    out, err = capfd.readouterr()
    assert predicted.holds in out
    assert "written to new/torques.csv" in out
    assert err == ""
    assert_refused(capfd, command, ["exists already", "--force", "new/torques-2.csv"])


def test_a_file_where_a_folder_is_written_and_the_reverse(place, capfd):
    (place / "new").mkdir()
    assert run("predict", "result", "motion.csv", "--out", "new") == 0
    assert table(place / "new" / "prediction.csv")[0] == COLUMNS
    assert "written to new/prediction.csv" in capfd.readouterr().out
    (place / "taken").write_text("a file")
    for name in ("stream.csv", "taken"):
        assert_refused(capfd, ("track", "result", "log.csv", "--out", name), [name, "a file", "writes a folder"])
    assert_refused(capfd, ("floor", "log.csv", "log.csv", "--out", "new"), ["new", "is a folder", "writes one file"])


def test_repeated_rows_of_a_file_are_left_out_and_arrays_with_them_are_refused(place, capfd):
    stored = bayesid.load("result")
    _, values = table(place / "motion.csv")
    np.savetxt("twice.csv", np.repeat(values, 2, axis=0), delimiter=",", header="t,q1,q2", comments="", fmt="%.17g")
    for name in ("motion", "twice"):
        assert run("predict", "result", f"{name}.csv", "--out", f"of_{name}.csv") == 0
        assert ("500 rows repeat the time of the row before" in capfd.readouterr().err) == (name == "twice")
    np.testing.assert_array_equal(table(place / "of_twice.csv")[1], table(place / "of_motion.csv")[1])
    t, q = np.repeat(values[:, 0], 2), np.repeat(values[:, 1:], 2, axis=0)
    for given in ((t, q), (t, q, 0.0 * q, 0.0 * q)):
        with pytest.raises(bayesid.InputError, match="does not increase"):
            stored.predict(given)


def test_without_a_name_the_file_is_torques(made, place, capfd):
    """And never takes the place of one."""
    assert run("predict", "result", "motion.csv") == 0
    assert table(place / "torques.csv")[0] == COLUMNS
    assert_refused(capfd, ("predict", "result", "motion.csv"), ["torques.csv", "--out torques-2.csv"])
    stored = bayesid.load("result")
    name = made[1].parameters_table()[3].name
    assert (stored.parameter(name).mean, stored.parameter(name).decided_by) == (made[1].parameter(name).mean, "unknown")
