"""The figure of a stream: signed efforts over the model's, external torques with their thresholds, alarms marked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesid.arrays import Array, Integers
from bayesid.identification.prediction import NORMAL_95
from bayesid.monitor.alarms import Alarm
from bayesid.monitor.kinds import CONTACT, PAYLOAD
from bayesid.monitor.replay import Replay
from bayesid.report.plot.drawing import SIZE, dress, new_figure
from bayesid.report.plot.figure import BLUE, INK, MAGENTA, ORANGE
from bayesid.report.thinning import envelope

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDE = 10.0
"""in, of the figure."""
_EFFORT, _EXTERNAL = 1.9, 1.2
"""in, of a joint's two panels."""
_MOST = 3000
"""Points of a curve: some two a pixel."""
_GAP = 5.0
"""Steps from which on no line is drawn from one instant to the next."""
_SHORTEST = 0.004
"""Share of the figure's width that a contact takes at least, so that it is seen."""
_COLUMNS = 4
"""Of the legend: as many as fit beside each other."""
_CLEAR = 1.15
"""Share of the largest external torque or threshold up to which its panel goes."""


def stream_figure(streamed: Replay) -> Figure:
    """Two panels a joint, one below the other.

    The first has the signed effort over the model's with the band of its 95 %, the second the external torque with its
    threshold. Contacts are blue, a change is an orange line from which on the model is another robot's.
    """
    n = streamed.effort.shape[1]
    figure = new_figure(n * (_EFFORT + _EXTERNAL) + 0.6, _WIDE)
    axes = figure.subplots(2 * n, 1, sharex=True, squeeze=False, height_ratios=[_EFFORT, _EXTERNAL] * n)[:, 0]
    for j in range(n):
        _efforts(axes[2 * j], streamed, j)
        _external(axes[2 * j + 1], streamed, j)
        for ax in axes[2 * j : 2 * j + 2]:
            _mark(ax, streamed, j + 1)
            dress(ax)
    if len(streamed.t) > 1:
        axes[0].set_xlim(float(streamed.t[0]), float(streamed.t[-1]))
    axes[-1].set_xlabel("time, s", fontsize=SIZE, color=INK)
    figure.align_ylabels(axes)
    _key(figure, axes)
    return figure


def _key(figure: Figure, axes: Any) -> None:
    """One legend of what any panel shows, above all."""
    named: dict[str, Any] = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    look: dict[str, Any] = {"fontsize": SIZE - 1.0, "labelcolor": INK, "frameon": False, "ncols": _COLUMNS}
    figure.legend(named.values(), named.keys(), loc="outside upper center", **look)


def _efforts(ax: Axes, streamed: Replay, j: int) -> None:
    predicted, half = streamed.predicted[:, j], NORMAL_95 * streamed.predicted_sd[:, j]
    rows = np.union1d(envelope(predicted + half, _MOST // 2), envelope(predicted - half, _MOST // 2))
    t, low, high = _broken(streamed.t, rows, (predicted - half)[rows], (predicted + half)[rows])
    band: dict[str, Any] = {"color": MAGENTA, "alpha": 0.25, "linewidth": 0.0}
    ax.fill_between(t, low, high, label="95 % band of the model", **band)
    _curve(ax, streamed.t, np.nan_to_num(streamed.effort[:, j]), "effort with the stream's signs", INK, 1.4)
    _curve(ax, streamed.t, predicted, "model", MAGENTA, 0.9)
    ax.set_ylabel(f"joint {j + 1}:\neffort, N m", fontsize=SIZE - 1.0, color=INK)


def _external(ax: Axes, streamed: Replay, j: int) -> None:
    external, threshold = streamed.external[:, j], streamed.threshold[:, j]
    for sign, label in ((1.0, "threshold of a contact"), (-1.0, "")):
        _curve(ax, streamed.t, sign * threshold, label, ORANGE, 0.8, "dashed")
    _curve(ax, streamed.t, external, "external torque", BLUE, 1.1)
    finite = threshold[np.isfinite(threshold)]
    largest = float(np.abs(external).max(initial=0.0, where=np.isfinite(external)))
    most = max(largest, float(np.median(finite)) if finite.size else 0.0)
    if most > 0.0:
        ax.set_ylim(-_CLEAR * most, _CLEAR * most)
    ax.set_ylabel("external\ntorque, N m", fontsize=SIZE - 1.0, color=INK)


def _mark(ax: Axes, streamed: Replay, joint: int) -> None:
    """The alarms of a joint."""
    if not len(streamed.t):
        return
    least = _SHORTEST * float(streamed.t[-1] - streamed.t[0])
    for alarm in streamed.alarms:
        if joint not in alarm.joints and alarm.kind != PAYLOAD:  # which changes the model of all
            continue
        if alarm.kind == CONTACT:
            end = alarm.time + max(alarm.duration or 0.0, least)
            ax.axvspan(alarm.time, end, color=BLUE, alpha=0.3, linewidth=0.0, label="contact")
        else:
            ax.axvline(alarm.raised, color=ORANGE, linewidth=1.6, label="change, when it was said")
            ax.axvspan(alarm.time, alarm.raised, color=ORANGE, alpha=0.2, linewidth=0.0, label="change, not yet said")
            _name(ax, alarm)


def _name(ax: Axes, alarm: Alarm) -> None:
    """The kind of a change beside its line, at the upper edge."""
    text = "unknown change" if alarm.kind == "unknown" else alarm.kind
    look: dict[str, Any] = {"ha": "left", "va": "top", "color": ORANGE, "fontsize": SIZE - 1.0}
    ax.annotate(text, (alarm.raised, 0.98), (3.0, 0.0), ax.get_xaxis_transform(), "offset points", **look)


def _curve(ax: Axes, t: Array, values: Array, label: str, colour: str, width: float, style: str = "solid") -> None:
    rows = envelope(values, _MOST)
    at, drawn = _broken(t, rows, values[rows])
    ax.plot(at, drawn, color=colour, linewidth=width, linestyle=style, label=label or None)


def _broken(t: Array, rows: Integers, *curves: Array) -> list[Array]:
    """The instants of rows, and curves over them, with a nan in each pause, so that no line crosses it."""
    kept = t[rows]
    if len(t) < 3:
        return [kept, *curves]
    pause = np.flatnonzero(np.diff(t) > _GAP * np.median(np.diff(t)))
    places = np.searchsorted(rows, pause, side="right")
    middle = 0.5 * (t[pause] + t[pause + 1])
    return [np.insert(kept, places, middle), *(np.insert(curve, places, np.nan) for curve in curves)]
