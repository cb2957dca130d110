"""Share of certain signs after a recording, against segments that are flipped one by one, by least squares."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from conftest import smooth_motion
from open_results import open_known
from scipy.stats import norm

from bayesid.excitation.gaussian_posterior import certain_share

PERIOD = 0.05


def turned_cost(known, motion, rows_of, joint, chosen):
    """Residual of the best fit with signs flipped in some samples of a joint, with the prior as rows."""
    prior = np.linalg.cholesky(known.precision).T
    rows, effort = rows_of
    target = effort.copy()
    target[chosen, joint] *= -1.0
    moving = known.weights(motion) > 0.0
    stacked = np.vstack([prior, rows[moving]])
    wanted = np.concatenate([prior @ known.mean, target[moving]])
    return float(np.sum((wanted - stacked @ np.linalg.lstsq(stacked, wanted, rcond=None)[0]) ** 2))


def brute_force(known, motion):
    """Share of |effort| in motion, mean over joints, in segments whose sign is wrong with at most 1 %."""
    columns, weights = known.columns(motion), known.weights(motion)
    rows = columns * np.sqrt(weights)[:, :, None]
    effort = rows @ known.mean
    size, shares = np.abs(columns @ known.mean) * (weights > 0.0), []
    for j in range(3):
        state = list(zip(effort[:, j] > 0.0, motion.dq[:, j] > 0.0, weights[:, j] > 0.0, strict=True))
        cuts = [0, *(k for k in range(1, len(state)) if state[k] != state[k - 1]), len(state)]
        sure = 0.0
        for a, b in pairwise(cuts):
            cost = turned_cost(known, motion, (rows, effort), j, slice(a, b))
            sure += size[a:b, j].sum() * (norm.sf(np.sqrt(cost) / 2.0) <= 0.01)
        shares.append(sure / size[:, j].sum())
    return float(np.mean(shares))


@pytest.mark.parametrize("quiet", [0.003, 0.3])
def test_certain_share_agrees_with_flipped_segments(quiet):
    known = open_known(share=0.002)
    known = replace(known, density=quiet * known.density)
    motion = smooth_motion(3, 4.0, 1.0 / PERIOD, seed=12)
    found = certain_share(known, motion)
    assert found == pytest.approx(brute_force(known, motion), abs=1e-9)
    assert 0.05 < found < 1.0
