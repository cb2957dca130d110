"""Lower bounds of random nodes of a real log with 44 half spaces, against the costs of precise solutions."""

import numpy as np
from conftest import real_log

from bayesid.log.reading import read_log
from bayesid.studies.constraints import gaps


def test_bounds_of_random_nodes_are_near_the_least_cost_and_never_above():
    """With the solver's usual tolerance nearly all of some nodes' costs was left."""
    path = real_log("ur10e/b_20s.csv")
    row = gaps(path.parent, read_log(path), seed=1, nodes=40)
    cost, usual, finer = (np.array(row[key]) for key in ("cost", "usual", "finer"))
    assert np.max(usual / cost) > 0.5, "or no node is hard"
    assert np.min(finer) > -1e-9 * cost.max()
    assert np.max(finer / cost) < 0.05
    assert np.quantile(finer / cost, 0.9) < 0.001
    several = np.array(row["decided"]) > 1
    assert np.max((finer / cost)[several]) < 0.001
