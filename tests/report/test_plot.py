"""Figures: what is drawn is what was found, in the Axes given, and nothing is left behind."""

import subprocess
import sys
from dataclasses import replace

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from conftest import small_robot
from made_findings import make_findings, with_summary
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure

import bayesid
from bayesid.errors import InputError
from bayesid.report import plot
from bayesid.report.folders import save_identification
from bayesid.report.plot.figure import BLUE, MAGENTA, ORANGE
from bayesid.report.report_data import binned
from bayesid.simulation.logs import simulate_log

FOUND = make_findings(n=3, validated=True)
BARE = replace(FOUND, draws=None, prediction=None)
SAMPLES, SEGMENTS = FOUND.samples, FOUND.segments
OF_JOINTS = {
    "torques": plot.torques,
    "validation": plot.validation,
    "residuals": plot.residuals,
    "autocorrelation": plot.autocorrelation,
}
OF_DRAWS = {"forest": plot.forest, "pair": plot.pair, "trace": plot.trace, "rank": plot.rank}
SINGLE = {"coefficients": plot.coefficients, "alternatives": plot.alternatives}
ALL = {**OF_JOINTS, **OF_DRAWS, **SINGLE}


@pytest.fixture(scope="module", autouse=True)
def no_windows():
    """Figures belong to nobody: pyplot keeps none of them."""
    before = plt.get_fignums()
    yield
    assert plt.get_fignums() == before


def axes_of(drawn):
    return [drawn] if isinstance(drawn, Axes) else drawn


def curves(ax):
    """Label to (N, 2) data."""
    return {line.get_label(): line.get_xydata() for line in ax.lines}


def gid(ax, name):
    (one,) = [artist for artist in ax.get_children() if artist.get_gid() == name]
    return one


def intervals(bands):
    """(K, 2) left and right ends of bands."""
    return np.array([[p.vertices[:, 0].min(), p.vertices[:, 0].max()] for p in bands.get_paths()])


def test_axes_come_back_in_a_figure_of_their_own():
    """Drawing changes neither what was found nor how the user's own figures look."""
    style = dict(mpl.rcParams)
    before = {key: value.copy() for key, value in vars(SAMPLES).items() if isinstance(value, np.ndarray)}
    for draw in ALL.values():
        drawn = axes_of(draw(FOUND))
        assert all(isinstance(ax, Axes) for ax in drawn)
        assert len({id(ax.figure) for ax in drawn}) == 1
        assert isinstance(drawn[0].figure, Figure)
    assert dict(mpl.rcParams) == style
    assert plt.get_fignums() == []
    for key, value in before.items():
        np.testing.assert_array_equal(getattr(SAMPLES, key), value)


def test_what_cannot_be_drawn_is_told():
    for draw in OF_JOINTS.values():
        for joints in ([0], [4], [1, -1], []):
            with pytest.raises(ValueError, match="1 to 3"):
                draw(FOUND, joints=joints)
        with pytest.raises(ValueError, match=r"2 axes.*3"):
            draw(FOUND, axes=Figure().subplots(2).tolist())
    for draw in (plot.pair, plot.trace, plot.rank):
        with pytest.raises(ValueError, match=r"1 axes.*\d"):
            draw(FOUND, 3, [Figure().subplots()])
    for draw in OF_DRAWS.values():
        with pytest.raises(ValueError, match="posterior"):
            draw(BARE)
    with pytest.raises(ValueError, match="validated"):
        plot.validation(BARE)
    with pytest.raises(ValueError, match="proven"):
        plot.alternatives(with_summary(FOUND, "search", lower_bound=None, certified=False))
    with pytest.raises(ValueError, match=r"'acceleration'.*t, velocity, position"):
        plot.residuals(FOUND, "acceleration")
    with pytest.raises(ValueError, match="two coefficients"):
        plot.pair(make_findings(coefficients=1))


def test_identifications_and_folders_can_be_drawn(tmp_path):
    robot = small_robot(2)
    log = simulate_log(robot, 3.0, 50.0, 0.05, [], 0)[1]
    result = bayesid.identify(robot, log, terms=["rigid_body"], posterior=False, complete="off")
    folder = save_identification(result, tmp_path / "result", report=False)
    (by_result,), (by_folder,) = plot.torques(result, [2]), plot.torques(str(folder), [2])
    for one, other in zip(by_result.lines, by_folder.lines, strict=True):
        np.testing.assert_allclose(other.get_ydata(), one.get_ydata(), rtol=1e-6, atol=1e-30)
    for wrong in (tmp_path, str(tmp_path / "nowhere")):
        with pytest.raises(InputError, match=r"summary\.json"):
            plot.torques(wrong)


def test_efforts_are_those_found():
    for j, ax in enumerate(plot.torques(FOUND)):
        drawn = curves(ax)
        for label, values in (
            ("recorded, without sign", SAMPLES.recorded),
            ("with signs", SAMPLES.signed),
            ("model", SAMPLES.predicted),
        ):
            np.testing.assert_array_equal(drawn[label], np.column_stack([SAMPLES.t, values[:, j]]))
        assert to_hex(ax.lines[2].get_color()) == MAGENTA
        assert ax.get_xlim() == (SAMPLES.t[0], SAMPLES.t[-1])
        assert ax.get_ylabel() == f"joint {j + 1}: effort, {'N' if j == 2 else 'N m'}"


def test_bands_are_segments():
    """Blue is plus; opacity from 0.05 at confidence 0.5 to 0.34 at 1, a straight line."""
    for j, ax in enumerate(plot.torques(FOUND)):
        for sign, name, colour in ((1, "sign +", BLUE), (-1, "sign \N{MINUS SIGN}", ORANGE)):
            mine = np.flatnonzero((SEGMENTS.joint == j) & (SEGMENTS.sign == sign))
            bands = gid(ax, name)
            np.testing.assert_allclose(intervals(bands), np.column_stack([SEGMENTS.start[mine], SEGMENTS.end[mine]]))
            alpha = np.interp(SEGMENTS.confidence[mine], [0.5, 1.0], [0.05, 0.34])
            np.testing.assert_allclose(bands.get_facecolors(), [to_rgba(colour, one) for one in alpha], atol=1e-12)
            height = bands.get_paths()[0].vertices[:, 1]
            assert (height.min(), height.max()) == (0.0, 1.0)  # of the axes, however large the efforts


def test_residuals_are_drawn_over_a_variable():
    for j, ax in enumerate(plot.residuals(FOUND, "velocity")):
        used = SAMPLES.used[:, j]
        value = SAMPLES.velocity[used, j]
        points = np.asarray(ax.collections[0].get_offsets())
        np.testing.assert_array_equal(points, np.column_stack([value, SAMPLES.residual[used, j]]))
        centre, mean, error = binned(value, SAMPLES.residual[used, j])
        np.testing.assert_array_equal(curves(ax)["means"], np.column_stack([centre, mean]))
        bars = ax.collections[-1]
        ends = np.array([segment[:, 1] for segment in bars.get_segments()])
        np.testing.assert_allclose(ends, np.column_stack([mean - 2.0 * error, mean + 2.0 * error]))
        assert ax.get_xlabel().endswith(", m/s" if j == 2 else ", rad/s")


def test_intervals_of_draws_are_those_of_each_ensemble():
    """A thin line holds 95 % of an ensemble's draws, as many beyond each end; the worst-decided coefficient on top."""
    ax = plot.forest(FOUND, 3)
    chosen = FOUND.worst(3)
    names = {text.get_position()[1]: text.get_text() for text in ax.get_yticklabels()}
    assert [names[row] for row in sorted(names)] == [FOUND.coefficients.name[k] for k in chosen]
    assert ax.yaxis_inverted()
    scaled, rows = FOUND.standardised(chosen), []
    intervals_of = [one for one in ax.collections[1:] if isinstance(one, LineCollection)]  # after the line at zero
    for lines, ensemble in zip(intervals_of[::2], scaled, strict=True):  # each is followed by its quartiles
        for k, ((low, row), (high, _)) in enumerate(lines.get_segments()):
            rows.append((round(row), row))
            below, above = np.sum(ensemble[:, k] < low), np.sum(ensemble[:, k] > high)
            assert below == above == pytest.approx(0.025 * len(ensemble), abs=1.0)
            assert round(row) == k
    assert len(set(rows)) == 6
    for name in ("forest", "trace", "rank"):  # as few as there can be
        assert axes_of(OF_DRAWS[name](make_findings(n=1, coefficients=1)))


def test_nothing_heavy_is_imported_before_it_is_needed():
    code = """
import sys, bayesid
print(*[name for name in ("matplotlib", "arviz", "xarray") if name in sys.modules])
print(bayesid.plot.torques.__name__)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "\ntorques\n"


def test_in_axes_of_others_the_legend_is_inside_and_names_what_is_there():
    sure = replace(FOUND.coefficients, by_data=np.ones(8, dtype=bool), nominal=np.full(8, np.nan))
    for found, labels in ((FOUND, 3), (replace(FOUND, coefficients=sure), 1)):
        ax = Figure().subplots()
        assert plot.coefficients(found, ax) is ax
        assert len(ax.get_legend().get_texts()) == labels
        assert not ax.figure.legends
    given = Figure().subplots(2).tolist()
    assert plot.rank(FOUND, 2, given) == given
    assert set(dir(plot)) == set(plot.__all__)
