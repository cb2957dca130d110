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
from bayesid.identification.pipeline import identify
from bayesid.log.log import join_logs
from bayesid.regression.knowledge import ParameterPrior


@pytest.fixture(scope="module")
def fit():
    """Least squares, of two logs as one; the friction of joint 2 is stated."""
    prior, both = ParameterPrior(nominal={"Fv2": (0.7, 0.1)}), join_logs([log_of(0), log_of(21)])
    return identify(ROBOT, both, complete="off", posterior=False, prior=prior)


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


def test_tables_become_frames_whose_joints_count_from_one(fit):
    coefficients, parameters, segments = (
        table().to_dataframe() for table in (fit.coefficients_table, fit.parameters_table, fit.segments_table)
    )
    assert list(coefficients.columns[:7]) == ["name", "expression", "unit", "mean", "sd", "lower", "upper"]
    assert coefficients.set_index("name").loc["Fv2", "nominal"] == fit.coefficient("Fv2").nominal == 0.7
    np.testing.assert_array_equal(parameters["mean"], fit.theta)
    np.testing.assert_array_equal(parameters["sd"], fit.parameter_sd[0])
    np.testing.assert_array_equal(parameters["decided_by"] == "data", fit.parameter_sd[1])
    assert parameters["joint"].min() == 1
    assert list(segments.columns) == ["joint", "start", "end", "n_samples", "sign", "confidence", "log"]
    of, signs, confidence = fit.recorded_segments
    np.testing.assert_array_equal(segments["joint"], of.joint + 1)
    np.testing.assert_array_equal(segments["n_samples"], of.end - of.start)
    np.testing.assert_array_equal(segments["sign"], signs)
    np.testing.assert_array_equal(segments["confidence"], confidence)
    assert (segments["start"].min(), segments["end"].max()) == (0.0, pytest.approx(6.0)), "by their log's own clock"


@pytest.fixture(scope="module")
def result():
    return replace(sampled(), log=replace(sampled().log, source="a.csv"))


def test_a_result_is_told_in_some_ten_lines(result, fit):
    signed = replace(fit, log=replace(fit.log, signed=np.ones(3, dtype=bool)))
    for thing, word in (
        (fit, "not sampled"),
        (signed, "all known"),
        (result, "Identification of arm3 from a.csv: 601 rows"),
        (result.identified, "rigid_body"),
        (result.posterior, "R-hat"),
        (result.fit, "condition number"),
        (result.coefficients, "Fv2"),
        (result.validate(log_of(21, signed=False)), "in 95 % band"),
        (bayesid.find_discrepancy(result, log_of(21, signed=False), posterior=False), "arm3"),
        (result.predict(log_of(21), draws=2), "601 instants of 3 joints, 2 draws"),
        (result.log, "601 rows in 6 s, 3 joints (none signed), no velocities"),
        (result.signals, "100 Hz"),
        (result.signals.motion, "601 instants of 3 joints, 0 to 6 s"),
        (result.report_data(), "validation"),
        (bayesid.assess_excitation(ROBOT, log_of(0)), "condition number"),
        (result.segments_table(), "confidence"),
    ):
        text = repr(thing)
        assert word in text
        assert len(text) < 1200
        assert len(text.splitlines()) <= 16
        assert "array([" not in text


def test_a_notebook_shows_text_checks_and_a_figure(result):
    text = result._repr_html_()
    assert "<svg" in text
    assert not re.search("<script|(src|href)=[\"'][^#]", text), "nothing is run, and nothing fetched from elsewhere"
    assert "Identification of arm3 from a.csv" in text
    checks = result.checks()
    assert all(f"<strong>{check.name}:</strong>" in text for check in checks)
    assert "<b>" not in replace(result, log=replace(result.log, source="<b>.csv"))._repr_html_()


def test_nothing_is_drawn_before_it_is_shown():
    script = "import sys, bayesid; bayesid.identify; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0
