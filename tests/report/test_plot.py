"""Figures: what is drawn is what was found, in the Axes given, and nothing is left behind."""

import subprocess
import sys
from dataclasses import replace

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from conftest import small_robot
from made_findings import make_findings, with_alternatives, with_summary
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure

import bayesid
from bayesid.errors import InputError
from bayesid.report import plot
from bayesid.report.plot.ink import BLUE, MAGENTA, ORANGE
from bayesid.report.thinning import binned, envelope
from bayesid.results.folders import save_identification
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


def test_given_axes_are_used_and_no_others():
    for draw in OF_JOINTS.values():
        axes = Figure().subplots(2)
        assert draw(FOUND, joints=[3, 1], axes=list(axes)) == axes.tolist()
        assert ["3" in axes[0].get_ylabel(), "1" in axes[1].get_ylabel()] == [True, True]
        assert len(axes[0].figure.axes) == 2
        alone = Figure().subplots()
        assert draw(FOUND, joints=[2], axes=alone) == [alone]
    for draw in (*SINGLE.values(), plot.forest):
        ax = Figure().subplots()
        assert draw(FOUND, ax=ax) is ax
        assert ax.figure.axes == [ax]
    for draw, shape in ((plot.pair, (2, 2)), (plot.trace, (3, 2)), (plot.rank, (3,))):
        grid = Figure().subplots(*shape)
        drawn = draw(FOUND, 3, grid)
        assert set(drawn) <= set(grid.ravel().tolist())
        assert set(grid.ravel()[0].figure.axes) <= set(grid.ravel().tolist())
        assert all(ax.has_data() for ax in drawn)


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


# --- What is drawn ---------------------------------------------------------------------------------------------------
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


def test_many_samples_are_drawn_by_their_extremes():
    """And signs that have no room, at 300 segments in 10 in, are left out."""
    many = make_findings(n=1, count=9000, per_joint=300, draws=False, signed_joints=())
    (ax,) = plot.torques(many, axes=[Figure(figsize=(6.0, 2.0)).subplots()])
    values = many.samples.predicted[:, 0]
    rows = envelope(values, 1800)
    np.testing.assert_array_equal(curves(ax)["model"], np.column_stack([many.samples.t[rows], values[rows]]))
    assert len(rows) < 2000
    assert not ax.texts
    assert len(intervals(gid(ax, "x-plus"))) + len(intervals(gid(ax, "x-minus"))) == 300
    (known,) = plot.torques(make_findings(n=3, signed_joints=(2,)), [2])
    assert list(curves(known)) == ["recorded", "model"]


def test_bands_are_segments():
    """Blue is plus; opacity from 0.05 at confidence 0.5 to 0.34 at 1, a straight line."""
    for j, ax in enumerate(plot.torques(FOUND)):
        for sign, name, colour in ((1, "x-plus", BLUE), (-1, "x-minus", ORANGE)):
            mine = np.flatnonzero((SEGMENTS.joint == j) & (SEGMENTS.sign == sign))
            bands = gid(ax, name)
            np.testing.assert_allclose(intervals(bands), np.column_stack([SEGMENTS.start[mine], SEGMENTS.end[mine]]))
            alpha = np.interp(SEGMENTS.confidence[mine], [0.5, 1.0], [0.05, 0.34])
            np.testing.assert_allclose(bands.get_facecolors(), [to_rgba(colour, one) for one in alpha], atol=1e-12)
            height = bands.get_paths()[0].vertices[:, 1]
            assert (height.min(), height.max()) == (0.0, 1.0)  # of the axes, however large the efforts


def test_a_validation_is_drawn_with_its_band():
    seen = FOUND.prediction
    for j, ax in enumerate(plot.validation(FOUND)):
        drawn = curves(ax)
        np.testing.assert_array_equal(drawn["measured"], np.column_stack([seen.t, seen.measured[:, j]]))
        np.testing.assert_array_equal(drawn["predicted"], np.column_stack([seen.t, seen.predicted[:, j]]))
        (path,) = gid(ax, "x-band").get_paths()
        corners = {tuple(np.round(one, 9)) for one in path.vertices}
        for edge in (seen.lower, seen.upper):
            assert {tuple(np.round(one, 9)) for one in zip(seen.t, edge[:, j], strict=True)} <= corners


@pytest.mark.parametrize("variable", ["t", "velocity", "position"])
def test_residuals_are_drawn_over_a_variable(variable):
    for j, ax in enumerate(plot.residuals(FOUND, variable)):
        used = SAMPLES.used[:, j]
        value = SAMPLES.t[used] if variable == "t" else getattr(SAMPLES, variable)[used, j]
        points = np.asarray(ax.collections[0].get_offsets())
        np.testing.assert_array_equal(points, np.column_stack([value, SAMPLES.residual[used, j]]))
        centre, mean, error = binned(value, SAMPLES.residual[used, j])
        (line, caps, (bars,)) = ax.containers[0]
        np.testing.assert_array_equal(line.get_xydata(), np.column_stack([centre, mean]))
        ends = np.array([segment[:, 1] for segment in bars.get_segments()])
        np.testing.assert_allclose(ends, np.column_stack([mean - 2.0 * error, mean + 2.0 * error]))
        unit = {"t": "s", "velocity": "m/s" if j == 2 else "rad/s", "position": "m" if j == 2 else "rad"}[variable]
        assert ax.get_xlabel().endswith(f", {unit}")
        assert len(caps) == 2


def test_the_autocorrelation_is_drawn_with_what_noise_would_do():
    table = FOUND.correlation
    for j, ax in enumerate(plot.autocorrelation(FOUND)):
        np.testing.assert_array_equal(ax.lines[0].get_xydata(), np.column_stack([table.lag, table.value[j]]))
        box = ax.patches[0].get_extents().transformed(ax.transData.inverted())
        np.testing.assert_allclose([box.y0, box.y1], [-table.bound[j], table.bound[j]], rtol=1e-9)


def test_coefficients_are_drawn_in_units_of_their_size():
    bar, by_data = FOUND.coefficients.bar, FOUND.coefficients.by_data
    ax = plot.coefficients(FOUND)
    for container, chosen, colour in zip(ax.containers, (by_data, ~by_data), (BLUE, ORANGE), strict=True):
        np.testing.assert_allclose([one.get_width() for one in container], bar.mean[chosen])
        np.testing.assert_allclose([one.get_y() + 0.3 for one in container], np.flatnonzero(chosen))
        assert {to_hex(one.get_facecolor()) for one in container} == {colour}
    for lines, chosen in zip(ax.collections, (by_data, ~by_data), strict=True):
        ends = np.array([segment[:, 0] for segment in lines.get_segments()])
        clipped = np.column_stack([bar.low[chosen], bar.high[chosen]]).clip(-2.5, 2.5)
        np.testing.assert_allclose(ends, clipped)
    known = np.isfinite(bar.nominal)
    np.testing.assert_allclose(ax.lines[0].get_xdata(), bar.nominal[known].clip(-2.5, 2.5))
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), np.flatnonzero(known))
    assert [text.get_text() for text in ax.get_yticklabels()] == list(FOUND.coefficients.name)
    assert ax.get_ylim()[0] > ax.get_ylim()[1]  # the first one on top
    shown = replace(FOUND.coefficients, sd=np.where(np.arange(8) == 1, np.inf, FOUND.coefficients.sd))
    ends = plot.coefficients(replace(FOUND, coefficients=shown)).collections[0].get_segments()[1][:, 0]
    assert ends.tolist() == [-2.5, 2.5]  # of what the log does not show


def test_alternatives_are_drawn_by_what_they_cost_more():
    ax = plot.alternatives(with_alternatives(FOUND))
    others, best = ax.collections[:2]
    np.testing.assert_allclose(others.get_offsets(), [[2.75, 1.0], [6.5, 2.0]])
    np.testing.assert_allclose(best.get_offsets(), [[0.0, 0.0]])
    (shade,) = ax.patches
    assert shade.get_x() == pytest.approx(13.8)
    open_end = {"certified": False, "lower_bound": 800.25, "gap": 12.25, "within": None, "assignments": None}
    (shade,) = plot.alternatives(with_summary(FOUND, "search", **open_end)).patches
    assert (shade.get_x(), shade.get_width()) == pytest.approx((-12.25, 12.25))


def test_intervals_of_draws_are_those_of_each_ensemble():
    """A thin line holds 95 % of an ensemble's draws, as many beyond each end; the worst-decided coefficient on top."""
    ax = plot.forest(FOUND, 3)
    chosen = FOUND.worst(3)
    names = {text.get_position()[1]: text.get_text() for text in ax.get_yticklabels()}
    assert [names[row] for row in sorted(names)] == [FOUND.coefficients.name[k] for k in chosen]
    assert ax.yaxis_inverted()
    scaled, rows = FOUND.standardised(chosen), []
    for lines, ensemble in zip(ax.collections[::2], scaled, strict=True):  # each is followed by its quartiles
        for k, ((low, row), (high, _)) in enumerate(lines.get_segments()):
            rows.append((round(row), row))
            below, above = np.sum(ensemble[:, k] < low), np.sum(ensemble[:, k] > high)
            assert below == above == pytest.approx(0.025 * len(ensemble), abs=1.0)
            assert round(row) == k
    assert len(set(rows)) == 6


def test_pairs_and_traces_show_the_draws():
    chosen = FOUND.worst(2)
    scaled = FOUND.standardised(chosen)
    (ax,) = plot.pair(FOUND, 2)
    drawn = np.asarray(ax.collections[0].get_offsets())
    np.testing.assert_allclose(np.sort(drawn, axis=0), np.sort(scaled.reshape(-1, 2), axis=0))
    np.testing.assert_allclose(drawn[:3], scaled[0, :3])
    names = [FOUND.coefficients.name[k] for k in chosen]
    assert [ax.get_xlabel(), ax.get_ylabel()] == names
    grid = plot.trace(FOUND, 2)
    for row, k in enumerate(chosen):
        lines = grid[2 * row + 1].lines
        for line, ensemble in zip(lines, FOUND.standardised(np.array([k]))[:, :, 0], strict=False):
            np.testing.assert_allclose(line.get_ydata(), ensemble)
        assert grid[2 * row].get_ylabel() == names[row]


def test_ranks_are_counted():
    """Of two ensembles each bar's height above its base is in proportion to how many of its draws have such a rank."""
    ax = plot.rank(FOUND, 1)[0]
    scaled = FOUND.standardised(FOUND.worst(1))[:, :, 0]
    ranks = scaled.ravel().argsort().argsort().reshape(scaled.shape)
    assert len(ax.patches) == 2
    for of_ensemble, bars in zip(ranks, ax.patches, strict=True):
        tops, _, base = bars.get_data()
        counts, _ = np.histogram(of_ensemble, bins=len(tops), range=(0, scaled.size))
        assert np.corrcoef(tops - base, counts)[0, 1] > 0.95
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
