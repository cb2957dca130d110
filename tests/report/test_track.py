"""Text and figure of a tracked stream."""

import re
from dataclasses import replace

import numpy as np

from bayesid.monitor.changes import Alarm, ChangeTest, Sums
from bayesid.monitor.replay import Agreement, Replay, StreamFigures, UpdateTimes
from bayesid.monitor.tracker import Counts, TrackedSample
from bayesid.report.plot.stream import stream_figure
from bayesid.report.stream import alarm_line, count_line, stream_conclusion, track_lines, track_rows

PAYLOAD = Alarm(2.31, 3, "payload", (2, 3), 3.2, None, 2.81, 0.9)
CONTACT = Alarm(1.0, 2, "contact", (1, 2), 1.0, 0.25, 31.7)
LINES = (
    (PAYLOAD, "2.31 s", "payload", "joints 2 and 3", "+2.8 kg", "0.9 s"),
    (CONTACT, "1.00 s", "contact", "joints 1 and 2", "31.7 N m", "0.25 s"),
    (Alarm(4.0, 1, "friction", (1,), 6.0, None, -0.512, 0.7), "4.00 s", "friction", "joint 1", "-0.51 N m", "2.0 s"),
    (Alarm(4.0, 1, "gain", (1,), 6.0, None, 0.12, 0.7), "4.00 s", "gain", "joint 1", "+12 %", "2.0 s"),
    (Alarm(4.0, 1, "unknown", (1,), 6.0, None, None, 0.1), "4.00 s", "unknown", "joint 1", "2.0 s"),
)


def figures():
    return StreamFigures(
        np.array([4, 0]), np.array([4.0, 0.0]), np.array([0.5, 0.0]), np.array([60.0, 7.0]), np.array([20.0, 4.0]), 4
    )


def test_an_alarm_is_a_line_with_its_time_kind_joints_and_size():
    for alarm, *parts in LINES:
        assert re.search(".*".join(map(re.escape, parts)), alarm_line(alarm))


def test_a_stream_is_good_without_alarms_and_otherwise_has_a_remedy_for_each():
    assert stream_conclusion((), figures(), "result", 9.0).state == "good"
    blind = stream_conclusion((), replace(figures(), effort=np.array([19.0, 7.0])), "result", 9.0)
    assert (blind.state, "in joint 1 contacts cannot be seen" in blind.sentence) == ("look", True)
    assert all(text in blind.actions[0].message for text in ("20.0 N m in joint 1", "19.0"))
    alarms = PAYLOAD, CONTACT, replace(CONTACT, time=2.0)
    found = stream_conclusion(alarms, figures(), "my result", 9.0)
    assert (found.state, len(found.actions)) == ("look", 2), "contacts have one remedy"
    assert all(text in found.sentence for text in ("3 alarms", "payload", "2 times contact"))
    assert all(
        text in found.actions[0].remedy for text in ("`bayesid discrepancy 'my result' ROWS.csv`", "2.31 to 9.00 s")
    )
    assert len(stream_conclusion(alarms, figures(), "my result", 9.0, named={0}).actions) == 1
    invalid = stream_conclusion(alarms, figures(), "my result", 9.0, residual=0.88)
    assert "88 %" in invalid.actions[0].message


def test_signs_of_samples_that_count_are_compared():
    probability = np.array([[0.999, 0.2], [0.6, 0.001], [0.3, 0.5]])
    positive = np.array([[True, True], [False, False], [False, True]])
    found = Agreement.of(probability, positive, np.array([[True, True], [True, True], [True, False]]))
    np.testing.assert_allclose(found.by_joint, [2.0 / 3.0, 0.5])
    np.testing.assert_allclose(found.sure_by_joint, [1.0 / 3.0, 0.5])
    assert (found.share, found.sure_share, found.share_of_sure) == (0.6, 0.4, 1.0)
    assert track_rows(figures(), found) == [
        ("1", "66.7 %", "33.3 %", "1.00", "20.0", "0.50"),
        ("2", "50.0 %", "50.0 %", "-", "4.00", "0.00"),
    ]
    (line,) = track_lines(found, "done", None)
    assert "60.0 %" in line.message


def test_the_largest_external_torque_is_that_of_the_test_of_a_contact():
    """The lesser of two successive samples: one alone above the threshold does not count."""
    ratios = np.array([[np.nan, 0.2], [0.5, 9.0], [1.64, 0.3], [0.9, 0.4], [0.3, 1.2], [0.2, -1.1], [0.1, np.nan]])
    limit = np.array([20.0, 4.0])
    zero, unknown = np.zeros(2), np.full(2, np.nan)
    now = TrackedSample(0.0, *[zero] * 6, unknown, limit, ("moving",) * 2, (), (), *[zero] * 3)
    of_stream = StreamFigures.of_joints(2)
    assert [row[-1] for row in track_rows(of_stream, None)] == ["-", "-"]
    for ratio in ratios:
        of_stream.add(replace(now, external=ratio * limit))
    np.testing.assert_allclose(of_stream.pushed, [0.9, 1.1])
    np.testing.assert_array_equal(of_stream.threshold, limit)
    of_stream.add(replace(now, external=50.0 * limit, threshold=np.full(2, np.inf)))
    of_stream.add(replace(now, external=50.0 * limit))
    np.testing.assert_allclose(of_stream.pushed, [0.9, 1.1])
    test, sums = ChangeTest(None, 50.0, 0.01), Sums.begin(2)
    sparsity = np.array([test.push(sums, ratio * limit, limit) for ratio in ratios])
    np.testing.assert_array_equal(sparsity.any(axis=0), of_stream.pushed > 1.0)


def test_missing_comparisons_and_counts_of_rows_are_reported():
    none = Agreement.of(np.ones((3, 2)), np.ones((3, 2), dtype=bool), np.zeros((3, 2), dtype=bool))
    arguments = (None, "the log is too short", None), (none, "done", None)
    assert [track_lines(*each)[0].state for each in arguments] == ["look", "look"]
    assert "known in the log" in track_lines(none, "done", None, signed=True)[0].message
    assert re.findall(r"\d+", count_line(Counts(), figures(), 0.0, 100.0)) == ["0"]
    slow = figures()
    slow.times.extend([3e-4] * 98 + [0.025] * 2)
    assert "25 ms (99.9 % quantile), longer than the period of 10 ms" in count_line(Counts(100), slow, 0.0, 100.0)
    assert "longer than" not in count_line(Counts(100), slow, 0.0, 30.0)


def test_quantiles_of_update_times(rng):
    times, taken = UpdateTimes(), 1e-3 * np.exp(0.5 * rng.standard_normal(2000))
    for seconds in taken:
        times.append(seconds)
    for share in (0.5, 0.999):
        assert abs(times.quantile(share) / np.quantile(taken, share, method="inverted_cdf") - 1.0) < 0.011
    assert np.isnan(UpdateTimes().quantile(0.5))


def made_stream(n=2, alarms=(PAYLOAD, CONTACT)):
    t = np.concatenate([np.arange(200) / 50.0, 8.0 + np.arange(50) / 50.0])
    wave = np.sin(3.0 * t)[:, None] * np.arange(1.0, n + 1.0)
    parts = {
        "probability": np.ones_like(wave),
        "effort": wave,
        "predicted": 0.9 * wave,
        "predicted_sd": 0.1 + 0.0 * wave,
    }
    known = (t > 0.12)[:, None]  # without torques of the first samples
    parts |= {"external": np.where(known, 0.1 * wave, np.nan), "threshold": np.where(wave > 0.9, np.inf, 1.0)}
    return Replay(t, **parts, alarms=alarms, counts=Counts(), figures=figures(), lag=0.0, rate=50.0)


def test_every_joint_has_panels_of_effort_and_external_torque():
    figure = stream_figure(made_stream())
    assert len(figure.axes) == 4
    effort, external = figure.axes[2:]
    drawn = {line.get_label(): line for line in effort.get_lines()}
    at, values = drawn["effort with tracked signs"].get_data()
    np.testing.assert_allclose(values[~np.isnan(values)], 2.0 * np.sin(3.0 * at[~np.isnan(values)]))
    assert 3.98 < at[np.isnan(values)][0] < 8.0  # no line across the pause
    (change,) = [one for one in effort.collections if one.get_gid() == "change detected"]
    assert change.get_segments()[0][0, 0] == PAYLOAD.raised
    assert "payload" in [text.get_text() for text in effort.texts]
    assert external.get_ylabel() == "external\ntorque, N m"
    assert 1.0 < external.get_ylim()[1] < 2.0
    (key,) = figure.legends
    assert {"model", "threshold of a contact", "contact", "change detected"} <= {
        text.get_text() for text in key.get_texts()
    }


def test_streams_of_no_and_of_two_samples_are_drawn():
    whole = made_stream()
    for count in (0, 2):
        parts = "t", "effort", "predicted", "predicted_sd", "external", "threshold"
        axes = stream_figure(replace(whole, **{name: getattr(whole, name)[:count] for name in parts})).axes
        assert [len(line.get_xdata()) for line in axes[0].get_lines()][:2] == [count, count]
        assert np.isfinite([ax.get_ylim() for ax in axes]).all()
