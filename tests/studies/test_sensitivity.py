import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bayesid.studies import load
from bayesid.studies.sensitivity import conclusion

SENSITIVITY = (
    "noise",
    "duration",
    "excitation",
    "cutoff",
    "threshold",
    "beam_width",
    "initial_segments",
    "prior",
    "scaling",
)


def made_up(name, trials):
    """Rows of a study as its trials might give them."""
    rng = np.random.default_rng(0)
    rows = []
    for scenario, seed in load(name).plan(trials, 0):
        numbers = {
            "segments": 100,
            "searched": 90,
            "right": 1.0 - 0.05 * rng.random(),
            "joints_flipped": 0,
            "confidence": 0.99,
            "certified": True,
            "nodes": 1000,
            "solves": 20,
            "condition": 12.0,
            "residual": 0.05,
            "torque_error": 0.01 + 0.05 * rng.random(),
            "torque_error_worst": 0.1,
            "coefficients": 58,
            "known": 30,
            "inside": 55,
            "parameters_inside": 0.9,
            "converged": True,
            "warnings": 0,
        }
        timings = {"seconds": 2.0, "search": 1.0, "prepare": 0.1, "second opinion": 0.0}
        rows.append({"seed": seed, **vars(scenario), **numbers, "timings": timings})
    return rows


@pytest.mark.parametrize("trials", [1, 2, 5, 60])
@pytest.mark.parametrize("name", SENSITIVITY)
def test_report_and_figure_of_however_few_trials(name, trials):
    study, rows = load(name), made_up(name, trials)
    figure = Figure()
    FigureCanvasAgg(figure)
    study.draw(rows, figure)
    figure.canvas.draw()
    assert f"{trials} logs" in study.report(rows)


def test_the_conclusion_names_the_levels_that_are_good():
    from bayesid.studies.noise import LEVELS
    from bayesid.studies.sensitivity import Varied, of_field

    varied = Varied("noise", of_field("noise", LEVELS, "{:.0%}"), robots=("kr5", "tx40"))
    rows = made_up("noise", 48)
    for row in rows:
        row["right"] = 0.98 if row["robot"] == "kr5" and row["noise"] > 0.1 else 0.999
        row["torque_error"] = 0.01 if row["noise"] < 0.05 else 0.03
    lines = conclusion(varied, rows).splitlines()
    assert lines[1:3] == ["  kr5: 2%, 5%, 10%", "  tx40: all"]
    assert lines[4:6] == ["  kr5: 2%", "  tx40: 2%"]


def test_the_conclusion_says_what_was_not_tried():
    from bayesid.studies.noise import LEVELS
    from bayesid.studies.sensitivity import Varied, of_field

    varied = Varied("noise", of_field("noise", LEVELS, "{:.0%}"), robots=("kr5", "tx40"))
    rows = [row for row in made_up("noise", 48) if row["robot"] == "kr5" and row["noise"] < 0.1]
    for row in rows:
        row["right"], row["torque_error"] = 0.999, 0.03
    lines = conclusion(varied, rows).splitlines()
    assert lines[1:3] == ["  kr5: 2%, 5% (4 not tried)", "  tx40: not tried"]
    assert lines[4:6] == ["  kr5: none (4 not tried)", "  tx40: not tried"]
