"""The skeleton of a robot: what is drawn is where its links are, seen from the side and from above."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation

import bayesid
from bayesid.errors import InputError
from bayesid.report.plot.robots import skeleton, skeleton_figure
from bayesid.robot.kinematics import pose

POSES = {
    "kr6r900": np.radians([0.0, -90.0, 90.0, 0.0, 0.0, 0.0]),
    "ur10e": np.radians([0.0, -60.0, 50.0, -30.0, 70.0, 0.0]),
    "panda": np.radians([0.0, -30.0, 0.0, -90.0, 0.0, 60.0, 0.0]),
}
VIEWS = [0, 2], [0, 1]


def words(ax):
    """Labels, by their text."""
    return [artist for artist in ax.texts if isinstance(artist, Annotation) and artist.get_text()]


@pytest.mark.parametrize("name", POSES)
def test_links_are_drawn_where_they_are(name):
    before = plt.get_fignums()
    axes = skeleton(name, POSES[name])
    assert plt.get_fignums() == before
    here = pose(bayesid.load_robot(name), POSES[name])
    for ax, seen in zip(axes, VIEWS, strict=True):
        links = {line.get_gid(): line.get_xydata() for line in ax.lines if line.get_gid()}
        for i, line in enumerate(here.lines, start=1):
            np.testing.assert_allclose(links[f"link {i}"], line[:, seen], rtol=0, atol=1e-15)
        np.testing.assert_allclose(links["flange"][0], here.flange[:3, 3][seen], rtol=0, atol=1e-15)
        assert ax.get_aspect() == 1.0
        FigureCanvasAgg(ax.figure).draw()
        boxes = [word.get_window_extent(ax.figure.canvas.get_renderer()).padded(-1.5) for word in words(ax)]
        assert not [(a, b) for i, a in enumerate(boxes) for b in boxes[:i] if a.overlaps(b)], "labels on each other"
    assert np.ptp(axes[0].get_xlim()) == pytest.approx(np.ptp(axes[1].get_ylim())), "one scale"


def test_what_cannot_be_drawn():
    for robot, q, says in (("kr55", None, "no such robot"), ("kr5", [0.0], "`q`: are not joint positions")):
        with pytest.raises(InputError, match=says):
            skeleton(robot, q)


def test_it_is_drawn_into_given_axes_or_a_figure_of_its_own():
    robot = bayesid.load_robot("kr6r900")
    given = Figure().subplots(1, 2).tolist()
    assert skeleton(robot, axes=given) == given
    assert "q = " in skeleton_figure(robot).get_supxlabel()
    assert not given[0].figure.get_supxlabel()
    with pytest.raises(ValueError, match=r"1 axes.*2"):
        skeleton(robot, axes=given[:1])
