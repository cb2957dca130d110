"""The notebooks of docs/ run, and show what their text says."""

from __future__ import annotations

import json
import re
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from scipy.stats import norm

pytestmark = pytest.mark.long
FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
MAGIC = re.compile(r"^%.*$", re.M)
"""Lines for a notebook's kernel, which is not needed here."""


def cells(name: str) -> list[str]:
    """Sources of a notebook's cells of code."""
    notebook = json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]


def run(name: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    """The names that a notebook leaves behind."""
    monkeypatch.setattr("matplotlib.pyplot.show", lambda: None)
    namespace: dict[str, object] = {"__name__": "__main__"}
    with mpl.rc_context({"backend": "agg"}):
        for k, source in enumerate(cells(name), 1):
            exec(compile(MAGIC.sub("", source), f"{name}.ipynb, code cell {k}", "exec", dont_inherit=True), namespace)
        import matplotlib.pyplot as plt

        plt.close("all")
    return namespace


def test_identify_finds_signs_and_coefficients(monkeypatch):
    left = run("identify", monkeypatch)
    assert np.mean(left["right"]) > 0.995
    assert left["within"] > 0.8
    effort = left["truth"].effort(left["other"], left["theta"])
    louder = np.sqrt(np.mean(effort**2, axis=0) / np.mean(left["effort"] ** 2, axis=0))  # the noise is a share
    expected = 2.0 * norm.cdf(norm.ppf(0.975) / louder) - 1.0
    np.testing.assert_allclose(left["check"].coverage, expected, atol=0.05)  # of 601 samples: three standard errors


def test_a_risk_allows_less_than_the_mean_model(monkeypatch):
    left = run("torque-limit", monkeypatch)
    assert 1.0 < left["by_risk"] < left["by_mean"] < 1.8
    assert np.all(np.diff(left["risk"]) >= 0.0)
    assert left["risk"][left["allowed"]][-1] > 0.05


def test_what_has_changed_is_found(monkeypatch):
    left = run("discrepancy", monkeypatch)
    payload, friction = left["found"].added
    assert (payload.effect, friction.effect, friction.joints) == ("payload", "coulomb_friction", (2,))
    mass, sd, unit = payload.readable["mass"]
    assert unit == "kg"
    assert abs(mass - 1.5) < 4.0 * sd
    change, sd, _ = friction.parameters["change of Fc2"]
    grown = left["worn"] - left["theta"]
    assert abs(change - grown.max()) < 4.0 * sd
