"""The figure of a stream: signed efforts, the model's efforts, external torques with their thresholds, and alarms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.arrays import Array
from bayesid.identification.prediction import NORMAL_95
from bayesid.monitor.changes import CONTACT, PAYLOAD, Alarm
from bayesid.monitor.replay import Replay
from bayesid.report.plot import figure as fig
from bayesid.report.plot.drawing import draw
from bayesid.report.tuning import TUNING

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MatplotlibFigure


def stream_figure(streamed: Replay) -> MatplotlibFigure:
    """Two panels per joint: signed effort with the model's and its 95 % band; external torque with its threshold.

    Contacts are blue; an orange line marks a change.
    """
    n, start = streamed.effort.shape[1], float(streamed.t[0]) if len(streamed.t) else 0.0
    moved = (replace(alarm, time=alarm.time - start, raised=alarm.raised - start) for alarm in streamed.alarms)
    streamed = replace(streamed, t=streamed.t - start, alarms=tuple(moved))
    panels = [_with_alarms(panel(streamed, j), streamed, j + 1) for j in range(n) for panel in (_efforts, _external)]
    panels[-1] = replace(panels[-1], x_name="time since the first sample, s")
    axes = draw(fig.Figure(fig.rows_of(panels, 1), 3.1 * n + 0.6, fig.WIDE, key=True, heights=(1.9, 1.2) * n))
    figure: Any = axes[0].figure
    figure.align_ylabels(axes)
    return figure


def _efforts(streamed: Replay, j: int) -> fig.Panel:
    predicted, half = streamed.predicted[:, j], NORMAL_95 * streamed.predicted_sd[:, j]
    curves = (
        fig.Band(streamed.t, predicted - half, predicted + half, fig.MAGENTA, "95 % band of the model"),
        fig.Line(streamed.t, np.nan_to_num(streamed.effort[:, j]), fig.INK, "effort with tracked signs"),
        fig.Line(streamed.t, predicted, fig.MAGENTA, "model", 0.9),
    )
    return fig.Panel(_paused(streamed.t, curves), y_name=f"joint {j + 1}:\neffort, N m")


def _external(streamed: Replay, j: int) -> fig.Panel:
    external, threshold = streamed.external[:, j], streamed.threshold[:, j]
    curves = (
        fig.Line(streamed.t, threshold, fig.ORANGE, "threshold of a contact", 0.8, style="dashed"),
        fig.Line(streamed.t, -threshold, fig.ORANGE, "", 0.8, style="dashed"),
        fig.Line(streamed.t, external, fig.BLUE, "external torque", 1.1),
    )
    finite = threshold[np.isfinite(threshold)]
    largest = float(np.abs(external).max(initial=0.0, where=np.isfinite(external)))
    most = 1.15 * max(largest, float(np.median(finite)) if finite.size else 0.0)
    limits = (-most, most) if most > 0.0 else None
    return fig.Panel(_paused(streamed.t, curves), y_name="external\ntorque, N m", y_limits=limits)


def _with_alarms(panel: fig.Panel, streamed: Replay, joint: int) -> fig.Panel:
    """The panel with the alarms of its joint; short contacts are drawn wider, so that they are visible."""
    if len(streamed.t) < 2:
        return panel
    first, last = float(streamed.t[0]), float(streamed.t[-1])
    (_, top), marks = panel.limits[1], list(panel.marks)
    for alarm in streamed.alarms:
        if alarm.kind == CONTACT and joint in alarm.joints:
            end = alarm.time + max(alarm.duration or 0.0, 0.004 * (last - first))
            marks.append(fig.Boxes(([alarm.time], [end]), None, fig.BLUE, "contact", 0.3))
        elif alarm.kind == PAYLOAD or (joint in alarm.joints and alarm.kind != CONTACT):  # a payload changes all joints
            marks += _change(alarm, top)
    return replace(panel, marks=marks, x_limits=(first, last), y_limits=panel.limits[1])


def _change(alarm: Alarm, top: float) -> list[fig.Mark]:
    kind = "unknown change" if alarm.kind == "unknown" else alarm.kind
    return [
        fig.upright(alarm.raised, fig.ORANGE, 1.6, label="change detected"),
        fig.Boxes(([alarm.time], [alarm.raised]), None, fig.ORANGE, "change, before detection", 0.2),
        fig.Words([alarm.raised], [0.85 * top], [kind]),
    ]


def _paused(t: Array, curves: Sequence[fig.Line | fig.Band]) -> list[fig.Mark]:
    """Thinned curves, interrupted at pauses of more than five steps."""
    shown = fig.thinned(curves, TUNING.curve)
    if len(t) < 3:
        return list(shown)
    pause = np.flatnonzero(np.diff(t) > 5.0 * np.median(np.diff(t)))
    places = np.searchsorted(shown[0].x, t[pause], side="right")
    x = np.insert(shown[0].x, places, 0.5 * (t[pause] + t[pause + 1]))

    def broken(values: Array) -> Array:
        return np.insert(values, places, np.nan)

    return [
        replace(curve, x=x, low=broken(curve.low), high=broken(curve.high))
        if isinstance(curve, fig.Band)
        else replace(curve, x=x, y=broken(curve.y))
        for curve in shown
    ]
