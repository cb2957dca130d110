from types import SimpleNamespace

import numpy as np
import pytest

from bayesid.discrepancy import selection
from bayesid.discrepancy.selection import _Sets


@pytest.fixture
def counted(monkeypatch):
    """A case whose data name what they were settled under, and how often effects were explained and ranked."""
    counts = {"explained": 0, "ranked": 0}

    def explain_with(data, effects, start=None):
        counts["explained"] += 1
        return SimpleNamespace(data=data), SimpleNamespace(by=tuple(effects), errors=("errors", data))

    def best_forms(screening, library):
        counts["ranked"] += 1
        return [(SimpleNamespace(hypothesis=group[0]), 0.0) for group in library if group]

    monkeypatch.setattr(selection, "explain_with", explain_with)
    monkeypatch.setattr(selection, "best_forms", best_forms)
    monkeypatch.setattr(selection, "Screening", lambda regression, errors: None)
    case = SimpleNamespace(settled=lambda effects, explanation: f"under {[e.key for e in effects]}")
    return case, counts


def effect(name, joint, standard=False):
    return SimpleNamespace(key=(name, (joint + 1,)), standard=standard, columns=SimpleNamespace(joints={joint}))


def test_a_set_of_effects_is_settled_once(counted):
    case, counts = counted
    one, other = effect("payload", 0), effect("delay", 1)
    sets = _Sets(case, [[one], [other]])
    first = sets.settled([one, other], "data")
    assert first.data == f"under {[one.key, other.key]}"
    assert sets.settled((one, other), "other data") is first
    assert counts["explained"] == 2
    assert sets.settled([one], first.data) is not first
    assert sets.settled([effect("payload", 0), other], "data") is not first  # another form of the same effect
    assert counts["explained"] == 6


def test_a_set_is_ranked_once_for_the_same_closed_joints(counted):
    case, counts = counted
    taken, plain, odd, elsewhere = (
        effect("payload", 0),
        effect("viscous_friction", 1, standard=True),
        effect("cable_drag", 1),
        effect("cable_drag", 0),
    )
    sets = _Sets(case, [[taken], [plain], [odd], [elsewhere]])
    chosen = sets.settled([taken], "data")
    ranking = sets.ranked(chosen, np.array([False, False]))
    assert ranking.effects == [plain, odd, elsewhere]
    assert sets.ranked(chosen, np.array([False, False])) is ranking
    assert sets.ranked(chosen, np.array([False, True])).effects == [plain, elsewhere]
    assert counts["ranked"] == 2
