"""What results hold entry by entry, in tables, and what a console and a notebook show of them."""

import re
import subprocess
import sys
from dataclasses import asdict, replace

import numpy as np
import pytest
from identified_arm import ROBOT, log_of, sampled

import bayesid
from bayesid.errors import InputError
from bayesid.fit.knowledge import Beliefs
from bayesid.identification.identification import Identification
from bayesid.identification.pipeline import identify
from bayesid.log.log import join_logs
from bayesid.report.verdicts import sure_share


@pytest.fixture(scope="module")
def fit():
    """Least squares, of two logs as one; the friction of joint 2 is stated."""
    beliefs, both = Beliefs(nominal={"Fv2": (0.7, 0.1)}), join_logs([log_of(0), log_of(21)])
    return identify(ROBOT, both, complete="off", posterior=False, beliefs=beliefs)


@pytest.mark.parametrize("which", ["fit", "sampled"])
def test_coefficients_are_those_of_the_arrays(which, fit):
    result = fit if which == "fit" else sampled()
    records = result.coefficients_table()
    assert [one.name for one in records] == list(result.coefficients.names)
    assert records[1:3] == (records[1], records[2])
    assert result.coefficient("Fc2").mean == result.beta[result.coefficients.names.index("Fc2")]
    assert [one.expression for one in records] == list(result.coefficients.expressions)
    assert [one.unit for one in records] == list(result.coefficients.units)
    np.testing.assert_array_equal([one.mean for one in records], result.beta)
    np.testing.assert_array_equal([one.sd for one in records], result.sd)
    if result.posterior is None:
        expected = result.beta - 1.959964 * result.sd, result.beta + 1.959964 * result.sd
        assert all(np.isnan(one.prior_sd) for one in records)
    else:
        expected = result.posterior.interval(0.95)
        assert all(one.prior_sd > 0.0 for one in records)
    np.testing.assert_allclose([(one.lower, one.upper) for one in records], np.transpose(expected), rtol=1e-6)
    assert {type(value) for value in asdict(records[0]).values()} == {str, float}


def test_parameters_are_those_of_the_model():
    result = sampled()
    records = result.parameters_table()
    sd, by_data = result.parameter_sd
    assert [(one.name, one.unit, one.joint) for one in records] == [
        (one.name, one.unit, one.joint) for one in result.model.parameters
    ]
    np.testing.assert_array_equal([one.mean for one in records], result.theta)
    np.testing.assert_array_equal([one.sd for one in records], sd)
    assert [one.decided_by == "data" for one in records] == by_data.tolist()
    assert result.parameter("m2") == records[[one.name for one in records].index("m2")]


def test_segments_count_joints_from_one_and_keep_their_logs_clock(fit):
    records, (segments, signs, confidence) = fit.segments_table(), fit.recorded_segments
    assert len(records) == len(segments)
    assert {one.joint for one in records} == {1, 2, 3}
    first, last = records[0], records[-1]
    assert (first.start, first.joint, first.sign) == (0.0, segments.joint[0] + 1, signs[0])
    assert first.n_samples == segments.end[0] - segments.start[0]
    assert first.end == pytest.approx((first.n_samples - 1) / 100.0)
    assert last.end <= 6.01
    assert len({one.log for one in records}) == 1  # both were simulated alike
    np.testing.assert_array_equal([one.confidence for one in records], confidence)
    assert sum(one.n_samples for one in records) <= 3 * len(fit.log)


def test_an_unknown_name_is_told_near_ones(fit):
    for of, name, says in (
        ("coefficient", "Fc4", "'Fc4'; did you mean Fc"),
        ("coefficient", "m1", r"parameter\('m1'\)"),
        ("coefficient", "qqq", "'qqq'; choose from J"),
        ("parameter", "mass2", "'mass2'; did you mean m"),
        ("parameter", 2, "2; did you mean m2"),
    ):
        with pytest.raises(InputError, match=says) as caught:
            getattr(fit, of)(name)
        assert "\n" not in str(caught.value)


def test_tables_become_frames(fit):
    coefficients, parameters, segments = (
        table().to_dataframe() for table in (fit.coefficients_table, fit.parameters_table, fit.segments_table)
    )
    assert list(coefficients.columns[:7]) == ["name", "expression", "unit", "mean", "sd", "lower", "upper"]
    np.testing.assert_array_equal(coefficients["mean"], fit.beta)
    assert coefficients.set_index("name").loc["Fv2", "nominal"] == fit.coefficient("Fv2").nominal == 0.7
    assert parameters["joint"].min() == 1
    assert list(segments.columns) == ["joint", "start", "end", "n_samples", "sign", "confidence", "log"]
    assert segments.groupby("joint").n_samples.sum().tolist() == [
        sum(one.n_samples for one in fit.segments_table() if one.joint == joint) for joint in (1, 2, 3)
    ]


@pytest.fixture(scope="module")
def result():
    return replace(sampled(), log=replace(sampled().log, source="a.csv"))


@pytest.fixture(scope="module")
def things(result):
    """One of each of the big results, and a word that its text must say."""
    discrepancy = bayesid.find_discrepancy(result, log_of(21, signed=False), posterior=False)
    return {
        "identification": (result, "Identification of arm3 from a.csv: 601 rows"),
        "model": (result.identified, "rigid_body"),
        "posterior": (result.posterior, "R-hat"),
        "fit": (result.fit, "condition number"),
        "coefficients": (result.coefficients, "Fv2"),
        "validation": (result.validate(log_of(21, signed=False)), "in 95 % band"),
        "discrepancy": (discrepancy, discrepancy.holdout),
        "prediction": (result.predict(log_of(21), draws=2), "601 instants of 3 joints, 2 draws"),
        "log": (result.log, "601 rows in 6 s, 3 joints (none signed), no velocities"),
        "signals": (result.signals, "100 Hz"),
        "motion": (result.signals.motion, "601 instants of 3 joints, 0 to 6 s"),
        "findings": (bayesid.find_findings(result), "validation"),
        "judgement": (bayesid.judge_log(ROBOT, log_of(0)), "condition number"),
        "table": (result.segments_table(), "confidence"),
    }


def test_a_result_is_told_in_some_ten_lines(things):
    for thing, word in things.values():
        text = repr(thing)
        assert word in text
        assert len(text) < 1200
        assert len(text.splitlines()) <= 16
        assert max(map(len, text.splitlines())) < 250
        assert "array([" not in text


def test_the_text_of_an_identification_says_how_it_stands(result):
    text = repr(result)
    assert f"{len(result.segments)} segments" in text
    assert f"{sure_share(bayesid.find_findings(result)):.1%} of |effort|" in text
    assert f"{len(result.coefficients)}, {result.n_known} known to 10%" in text
    assert "- say unsigned 2" in repr(replace(result, warnings=("say --unsigned 2", *"bcde")))
    signed = replace(result, log=replace(result.log, signed=np.ones(3, dtype=bool)), posterior=None)
    assert "all known" in repr(signed)
    assert "not sampled" in repr(signed)


def test_a_notebook_shows_text_checks_and_a_figure(result):
    text = result._repr_html_()
    assert "<svg" in text
    assert not re.search("<script|(src|href)=[\"'][^#]", text), "nothing is run, and nothing fetched from elsewhere"
    assert "Identification of arm3 from a.csv" in text
    checks = bayesid.check_findings(bayesid.find_findings(result))
    assert all(f"<strong>{check.name}:</strong>" in text for check in checks)
    assert "<b>" not in replace(result, log=replace(result.log, source="<b>.csv"))._repr_html_()
    assert "leave out posterior=False" in replace(result, posterior=None)._repr_html_()
    worst = int(result.fit.relative_residual.argmax()) + 1
    assert f"joint {worst}: effort" in text


def test_the_notebook_view_comes_with_the_public_names(result, monkeypatch):
    for name in ("identify", "find_discrepancy", "Identification"):
        monkeypatch.setattr(Identification, "notebook_view", None)
        assert result._repr_html_() is None
        monkeypatch.delitem(vars(bayesid), name, raising=False)  # as if it had not been asked for
        assert getattr(bayesid, name) is not None
        assert Identification.notebook_view is not None


def test_nothing_is_drawn_before_it_is_shown():
    script = "import sys, bayesid; bayesid.identify; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0
