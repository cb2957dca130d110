import numpy as np
import pytest
from reported import reported

from bayesid.studies import load
from bayesid.studies.noise import LEVELS
from bayesid.studies.sensitivity import Varied, conclusion, of_field

SENSITIVITY = ("noise", "duration", "excitation", "cutoff", "threshold", "beam_width", "initial_segments", "scaling")


def made_up(name, trials):
    """Rows of a study as its trials might give them."""
    rng, rows = np.random.default_rng(0), []
    numbers = {
        **{"segments": 100, "searched": 90, "joints_flipped": 0, "confidence": 0.99, "certified": True, "nodes": 1000},
        **{"solves": 20, "condition": 12.0, "residual": 0.05, "torque_error_worst": 0.1, "coefficients": 58},
        **{"known": 30, "inside": 55, "parameters_inside": 0.9, "converged": True, "warnings": 0},
        "timings": {"seconds": 2.0, "search": 1.0, "prepare": 0.1, "second opinion": 0.0},
    }
    for scenario, seed in load(name).plan(trials, 0):
        drawn = {"right": 1.0 - 0.05 * rng.random(), "torque_error": 0.01 + 0.05 * rng.random()}
        rows.append({"seed": seed, **vars(scenario), **numbers, **drawn})
    return rows


@pytest.mark.parametrize("trials", [1, 60])
def test_report_and_figure_of_however_few_trials(trials):
    for name in SENSITIVITY:
        assert f"{trials} logs" in reported(load(name), made_up(name, trials))


def test_the_conclusion_names_the_levels_that_are_good_and_those_that_were_not_tried():
    varied = Varied("noise", of_field("noise", LEVELS, "{:.0%}"), robots=("kr5", "tx40"))
    rows = made_up("noise", 48)
    for row in rows:
        row["right"] = 0.98 if row["robot"] == "kr5" and row["noise"] > 0.1 else 0.999
        row["torque_error"] = 0.01 if row["noise"] < 0.05 else 0.03
    lines = conclusion(varied, rows).splitlines()
    assert lines[1:3] == ["  kr5: 2%, 5%, 10%", "  tx40: all"]
    assert lines[4:6] == ["  kr5: 2%", "  tx40: 2%"]
    some = [row | {"torque_error": 0.03} for row in rows if row["robot"] == "kr5" and row["noise"] < 0.1]
    lines = conclusion(varied, some).splitlines()
    assert lines[1:3] == ["  kr5: 2%, 5% (4 not run)", "  tx40: not run"]
    assert lines[4:6] == ["  kr5: none (4 not run)", "  tx40: not run"]
