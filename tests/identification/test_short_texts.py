"""What a console and a notebook show of results."""

import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from conftest import small_robot, smooth_motion

import bayesid
from bayesid.identification.identification import Identification
from bayesid.report.verdicts import sure_share

TERMS = ("rigid_body", "viscous_friction")


@pytest.fixture(scope="module")
def logs():
    robot, motions = small_robot(2), [smooth_motion(2, 6.0, 100.0, seed=seed) for seed in (0, 5)]
    model = bayesid.Model(robot, bayesid.make_terms(TERMS, robot, motions[0]))
    theta = bayesid.random_parameters(model, np.random.default_rng(4))
    return [bayesid.simulate(model, theta, motion, rng=np.random.default_rng(1), noise=0.05) for motion in motions]


@pytest.fixture(scope="module")
def result(logs):
    few = bayesid.Sampling(budget=0.0)
    return bayesid.identify(small_robot(2), replace(logs[0], source="a.csv"), TERMS, complete="off", posterior=few)


@pytest.fixture(scope="module")
def things(result, logs):
    """One of each of the big results, and a word that its text must say."""
    discrepancy = bayesid.find_discrepancy(result, logs[1], posterior=False)
    return {
        "identification": (result, "Identification of arm2 from a.csv: 600 rows"),
        "model": (result.identified, "rigid_body, viscous_friction"),
        "posterior": (result.posterior, "R-hat"),
        "fit": (result.fit, "condition number"),
        "coefficients": (result.coefficients, "Fv2"),
        "validation": (result.validate(logs[1]), "in 95 % band"),
        "discrepancy": (discrepancy, discrepancy.holdout),
        "log": (result.log, "600 rows in 5.99 s, 2 joints (none signed), no velocities"),
        "signals": (result.signals, "100 Hz"),
        "motion": (result.signals.motion, "600 instants of 2 joints, 0 to 5.99 s"),
        "findings": (bayesid.find_findings(result), "validation"),
        "judgement": (bayesid.judge_log(small_robot(2), logs[0], TERMS), "condition number"),
        "table": (result.segments_table(), "confidence"),
    }


KINDS = ("identification", "model", "posterior", "fit", "coefficients", "validation", "discrepancy")
PARTS = ("log", "signals", "motion", "findings", "judgement", "table")


@pytest.mark.parametrize("kind", KINDS + PARTS)
def test_a_result_is_told_in_some_ten_lines(things, kind):
    thing, word = things[kind]
    text = repr(thing)
    assert word in text
    assert len(text) < 1200
    assert len(text.splitlines()) <= 16
    assert max(map(len, text.splitlines())) < 200
    assert "array(" not in text


def test_the_text_of_an_identification_says_how_it_stands(result):
    lines = repr(result).splitlines()
    assert f"{len(result.segments)} segments" in lines[1]
    assert ("not certified" if not result.search.certified else "certified: no other") in lines[1]
    assert f"{sure_share(bayesid.find_findings(result)):.1%} of |effort|" in lines[1]
    assert f"{len(result.coefficients)}, {result.n_known} known to 10%" in lines[2]
    warned = replace(result, warnings=("say --unsigned 2", *"bcde"))
    assert "- say unsigned 2" in repr(warned)
    assert ".warnings has all" in repr(warned)
    assert "warnings      none" in repr(replace(result, warnings=()))


def test_all_signs_known_and_nothing_sampled(result):
    signed = replace(result.log, signed=np.ones(2, dtype=bool))
    text = repr(replace(result, log=signed, posterior=None))
    assert "signs         all known" in text
    assert "posterior     not sampled" in text
    assert "(all signed)" in repr(signed)


class Tags(HTMLParser):
    """Open and closed tags, and what is loaded from elsewhere."""

    def __init__(self, text):
        super().__init__()
        self.open, self.seen, self.fetched = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.open.append(tag)
        self.fetched += [value for name, value in attrs if name in ("src", "href") and not value.startswith("#")]

    def handle_startendtag(self, tag, attrs):
        self.seen.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_a_notebook_shows_text_checks_and_a_figure(result):
    text = result._repr_html_()
    tags = Tags(text)
    assert (tags.open, tags.fetched) == ([], [])
    assert "svg" in tags.seen
    assert "script" not in tags.seen
    assert "Identification of arm2 from a.csv" in text
    checks = bayesid.check_findings(bayesid.find_findings(result))
    assert all(f"<strong>{check.name}:</strong>" in text for check in checks)
    assert "<b>" not in replace(result, log=replace(result.log, source="<b>.csv"))._repr_html_()
    assert "leave out posterior=False" in replace(result, posterior=None)._repr_html_()
    worst = int(result.fit.relative_residual.argmax()) + 1
    assert f"joint {worst}: effort" in text


def test_without_the_public_names_a_notebook_shows_the_text(result, monkeypatch):
    monkeypatch.setattr(Identification, "notebook_view", None)
    assert result._repr_html_() is None


@pytest.mark.parametrize("name", ["identify", "find_discrepancy", "Identification"])
def test_the_view_comes_with_the_public_names(name, monkeypatch):
    monkeypatch.setattr(Identification, "notebook_view", None)
    monkeypatch.delitem(vars(bayesid), name, raising=False)  # as if it had not been asked for
    assert getattr(bayesid, name) is not None
    assert Identification.notebook_view is not None


def test_nothing_is_drawn_before_it_is_shown():
    script = "import sys, bayesid; bayesid.identify; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0
