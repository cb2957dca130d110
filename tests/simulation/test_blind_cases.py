"""Folders of the blind studies, which hold no hint of what is hidden, and the plans of these studies."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from bayesid.studies import blind

ALL = (*blind.EFFECTS, blind.OUTSIDE)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """One robot's folders and truths, by effect."""
    root, made = tmp_path_factory.mktemp("cases"), {}
    for i, effect in enumerate((None, *ALL)):
        folder = root / str(i)
        made[effect] = folder, blind.make_case(folder, 21, effect, 4.0, "kr5", "standard", True)
    return made


def test_folder_holds_no_hint(folders):
    whole = {path.name: path.read_bytes() for path in folders[None][0].iterdir()}
    assert sorted(whole) == sorted(blind.FILES)
    for effect, (folder, _) in folders.items():
        found = {path.name: path.read_bytes() for path in folder.iterdir()}
        assert found.keys() == whole.keys()
        for name in ("baseline.csv", "robot.toml", "terms.txt"):
            assert found[name] == whole[name]
        for name in ("log.csv", "holdout.csv"):
            assert len(found[name]) == len(whole[name])
            assert (found[name] == whole[name]) == (effect is None)
            assert found[name].splitlines()[0] == b"t,q1,q2,q3,q4,q5,q6,tau1,tau2,tau3,tau4,tau5,tau6"


def test_logs_are_the_three_motions_with_efforts_without_sign(folders):
    for folder, truth in folders.values():
        motions = []
        for name in ("baseline", "log", "holdout"):
            values = np.loadtxt(folder / f"{name}.csv", delimiter=",", skiprows=1)
            assert values.shape == (blind.SAMPLES, 13)
            np.testing.assert_allclose(values[:, 0], np.arange(blind.SAMPLES) / 100)
            assert values[:, 7:].min() >= 0
            motions.append(values[:, 1:7])
            if name != "baseline":
                efforts = getattr(truth, f"{name}_efforts")
                np.testing.assert_allclose(values[:, 7:], np.abs(efforts), rtol=1e-9)
                assert (efforts < 0).any()
        np.testing.assert_array_equal(np.sign(truth.log_efforts), truth.log_signs)
        assert all(np.abs(a - b).max() > 0.5 for a, b in zip(motions, motions[1:] + motions[:1], strict=True))


def test_generator_imports_nothing_of_bayesid():
    """It is the oracle of the blind studies."""
    text = Path(blind.__file__).read_text()
    assert "import bayesid" not in text
    assert "from bayesid" not in text


def test_plan_is_balanced():
    cases = blind.plan(300, 7)
    single = [case for case in cases if isinstance(case.effect, str) and case.effect != blind.OUTSIDE]
    pairs = [case for case in cases if isinstance(case.effect, tuple)]
    beyond = [case for case in cases if case.effect == blind.OUTSIDE]
    assert [len(single), len(pairs), sum(c.effect is None for c in cases), len(beyond)] == [220, 25, 30, 25]
    assert set(Counter(case.effect for case in single).values()) == {11}
    assert {case.effect for case in single} == set(blind.EFFECTS)
    assert all(len(set(case.effect)) == 2 for case in pairs)
    for name in blind.EFFECTS:
        sizes = np.log([case.size for case in single if case.effect == name])
        assert np.log(0.5) <= sizes.min() < np.log(0.8)
        assert np.log(6) < sizes.max() <= np.log(10)
    assert all(3 <= case.size <= 10 for case in pairs + beyond)
    assert len({case.seed for case in cases}) == 300
    few = blind.plan(8, 3)
    assert few == blind.plan(8, 3) != blind.plan(8, 4)
    assert {"pair" if isinstance(c.effect, tuple) else c.effect for c in few} >= {"pair", None, blind.OUTSIDE}
