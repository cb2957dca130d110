"""Motions without efforts, in every format of logs; and that logs are motions too."""

import numpy as np
import pytest
from log_files import Bag, flat, kuka, save, save_hdf5, save_matlab, save_parquet

import bayesid
from bayesid.errors import InputError
from bayesid.log.log import Log, RecordedMotion
from bayesid.log.reading import read_log
from bayesid.log.signals import filtered_motion, prepare

ROWS, N = 64, 3


@pytest.fixture(scope="module")
def columns():
    """Of a log of three joints; two of them would make no log, for one stands still and one has no effort."""
    rng = np.random.default_rng(5)
    q, dq, tau = rng.normal(size=(3, ROWS, N)) * np.array([1.0, 2.0, 30.0])[:, None, None]
    q[:, 1], tau[:, 2] = 0.25, 0.0
    return {"t": 3.0 + np.arange(ROWS) * 4e-3, "q": q, "dq": dq, "tau": tau}


def test_a_motion_needs_no_efforts(tmp_path, columns):
    given = {name: values for name, values in columns.items() if name != "tau"}
    for path in (
        save(tmp_path / "motion.csv", flat(given)),
        save_parquet(tmp_path / "motion.parquet", flat(given)),
        save_matlab(tmp_path / "5.mat", given),
        save_hdf5(tmp_path / "73.mat", given),
        save(tmp_path / "kuka.csv", kuka(given)),
    ):
        motion = bayesid.read_log(path, effort=False)
        for name in ("t", "q", "dq"):
            np.testing.assert_allclose(getattr(motion, name), columns[name], atol=1e-12)
        with pytest.raises(InputError):
            read_log(path, gains=[1.0, 1.0, 1.0])
    np.testing.assert_array_equal(
        bayesid.read_log(save(tmp_path / "log.csv", flat(columns)), effort=False).q, columns["q"]
    )
    bag = Bag()
    states = bag.states({name: columns[name] for name in ("t", "q")}, ["j1", "j2", "j3"])
    path = bag.write(tmp_path / "bag", {"/a": states, "/talk": []})
    motion = bayesid.read_log(path, effort=False, topic="/a", joints=["j3", "j1"])
    np.testing.assert_allclose(motion.q, columns["q"][:, [2, 0]], atol=1e-15)
    assert motion.dq is None
    with pytest.raises(InputError, match="`gains`: applies to efforts, but a motion has none"):
        bayesid.read_log(path, gains="12,16,10", effort=False)


def test_a_motion_at_its_own_rows_is_that_of_the_even_grid():
    """Jittering rows: each has the values of a curve through the filtered grid."""
    rng = np.random.default_rng(3)
    t = np.arange(800) / 200.0 + rng.uniform(-1e-3, 1e-3, 800)
    q = np.column_stack([np.sin(3.0 * t), 0.4 * np.cos(5.0 * t)])
    motion = filtered_motion(RecordedMotion(t, q))
    grid = prepare(Log(t, q, q, np.ones(2, dtype=bool))).motion
    inner = slice(60, -60)
    np.testing.assert_array_equal(motion.t, t)
    np.testing.assert_allclose(motion.dq[inner, 0], 3.0 * np.cos(3.0 * t)[inner], atol=2e-3)
    np.testing.assert_allclose(motion.ddq[inner, 1], -10.0 * np.cos(5.0 * t)[inner], atol=0.1)
    at = np.interp(grid.t[inner], motion.t, motion.q[:, 0])
    np.testing.assert_allclose(at, grid.q[inner, 0], atol=1e-4)
