"""The page of an identification: whole, self-contained, and with the numbers that were found."""

import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from html_page import Page
from made_findings import make_findings, with_alternatives, with_summary
from markupsafe import escape

from bayesid.report.pages.coefficient_table import _caption
from bayesid.report.pages.identification_page import identification_page
from bayesid.report.pages.rendering import typeset
from bayesid.report.verdicts import check_findings

EVIL = "<script>alert('x')</script> \" & <b>"


def everything():
    """Validation, nominal values, other assignments, warnings, and names that could be mistaken for HTML."""
    found = with_alternatives(make_findings(n=2, validated=True))
    found = with_summary(found, robot=f"arm {EVIL}", log=f"log {EVIL}.csv", warnings=(f"beware {EVIL}", "and again"))
    found = with_summary(
        found, "provenance", command=f"bayesid identify {EVIL}", files={EVIL: "ab" * 32}, options={EVIL: EVIL}
    )
    return replace(found, prediction=replace(found.prediction, source=f"new {EVIL}.csv"))


def one_joint():
    """Of two coefficients one is not shown by the log."""
    found = make_findings(n=1, coefficients=2)
    table = found.coefficients
    ends = {"low": np.array([table.low[0], -np.inf]), "high": np.array([table.high[0], np.inf])}
    table = replace(table, sd=np.array([table.sd[0], np.inf]), nominal=np.full(2, np.nan), **ends)
    return replace(found, coefficients=table)


def beam():
    """Nothing is proven, nothing was sampled."""
    found = make_findings(n=1, draws=False, coefficients=3)
    nothing = dict.fromkeys(("lower_bound", "gap", "optimality_gap", "assignments", "persistent_share"))
    return with_summary(with_summary(found, posterior=None), "search", certified=False, method="beam", **nothing)


def signed():
    found = make_findings(n=2, signed_joints=(1, 2), draws=False, coefficients=3)
    return with_summary(found, posterior=None)


def unproven():
    """A bound, but not a proof."""
    return with_summary(beam(), "search", lower_bound=800.25, gap=12.25, method="certified")


MADE = {"everything": everything, "one_joint": one_joint, "beam": beam, "signed": signed, "unproven": unproven}


@pytest.fixture(scope="module")
def pages():
    """Each is made once: findings, page, text."""
    made = {}

    def get(name):
        if name not in made:
            findings = MADE[name]()
            text = identification_page(findings)
            made[name] = findings, Page(text), text
        return made[name]

    return get


@pytest.mark.parametrize("name", MADE)
def test_the_page_is_whole_and_needs_nothing_else(pages, name):
    findings, page, text = pages(name)
    page.whole(text, scripts=1)
    static = text.partition("<script>")[0]
    assert not re.search(r"https?:|url\((?!#)|<link|<iframe|srcset", text)
    assert set(re.findall(r'aria-labelledby="([^"]*)', static)) <= set(page.identifiers)
    assert page.hidden == len(findings.coefficients.mean)
    words = re.sub(r"<svg.*?</svg>|data-figure='[^']*'", "", static, flags=re.DOTALL)
    assert not re.search(r"\bnan\b|\bNone\b|np\.|array\(|\binf\b(?!\")", words)
    assert f"{escape(findings.summary.robot)}, " in text.partition("</title>")[0]


@pytest.mark.parametrize("name", MADE)
def test_contents_and_checks_lead_to_their_sections(pages, name):
    """The list at the top has all sections in their order, and nothing else; every check but those of none leads on."""
    findings, _, text = pages(name)
    sections = re.findall(r'<section id="([\w-]+)" aria-labelledby="[\w-]+"><h2 id="[\w-]+">([^<]+)</h2>', text)
    contents = text.partition('<nav class="contents"')[2].partition("</nav>")[0]
    assert re.findall(r'<a href="#([\w-]+)">([^<]+)</a>', contents) == sections
    checks = text.partition('<ul class="checks">')[2].partition("</ul>")[0]
    linked = {check: place for place, check in re.findall(r'<strong><a href="#([\w-]+)">([^<]+)</a>', checks)}
    told = check_findings(findings)
    assert linked["Fit"] == "residuals"
    assert set(linked.values()) <= {place for place, _ in sections} | {"warnings"}
    for one in told:
        assert typeset(one.message.split("`")[0]) in checks
        assert typeset(one.remedy.split("`")[0]) in checks
    lights = Counter(re.findall(r'<span class="light">([^<]+)</span>', checks))
    assert lights == Counter(one.state for one in told)


def test_the_numbers_of_the_tables_are_those_found(pages):
    findings, page, _ = pages("everything")
    found = findings.coefficients
    rows = page.table("Base coefficients")[1:]
    assert len(rows) == len(found.mean)
    for k, row in enumerate(rows):
        assert row[1] == [found.mean[k]]
        assert row[2] == [found.relative_sd[k]]
        assert row[3] == [found.low[k], found.high[k]]
        assert row[4] == ([] if np.isnan(found.nominal[k]) else [found.nominal[k]])
    seen = findings.prediction
    for j, row in enumerate(page.table("new ")[1:]):
        assert row[1:4] == [[seen.rms_error[j]], [seen.relative_residual[j]], [seen.coverage[j]]]
    others = page.table("2 alternatives")[1:]
    assert [row[1:3] for row in others] == [[[2.75], [0.27]], [[6.5], [0.02]]]


def test_ambiguous_segments_are_listed_by_their_size(pages):
    """A link leads to the figure of the joint and names the segment's ends; what stands still is not listed."""
    findings, page, _ = pages("everything")
    table, samples = findings.segments, findings.samples
    rows = page.table("Segments in motion")[1:]
    doubtful = [int(k) for k in np.flatnonzero(table.ambiguous & table.moving)]

    def size(k):
        inside = (samples.t >= table.start[k]) & (samples.t <= table.end[k])
        of_joint = np.abs(samples.recorded[:, table.joint[k]])
        return of_joint[inside].max() / of_joint.max()

    ordered = sorted(doubtful, key=size, reverse=True)
    assert [row[3:5] for row in rows] == [[[table.confidence[k]], [size(k)]] for k in ordered]
    links = [(one["href"], float(one["data-from"]), float(one["data-to"])) for one in page.links if "data-from" in one]
    assert links[: len(ordered)] == [
        (f"#torque{table.joint[k] + 1}", *(pytest.approx(one[k], abs=1e-4) for one in (table.start, table.end)))
        for k in ordered
    ]


def test_text_from_outside_is_escaped(pages):
    _, page, text = pages("everything")
    assert "<script>alert" not in text
    assert text.count("&lt;script&gt;alert") >= 8
    assert "b" not in page.tags
    for start in ("arm", "log", "beware", "new", "bayesid identify"):
        assert f"{start} &lt;script&gt;alert(&#39;x&#39;)&lt;/script&gt; &#34; &amp; &lt;b&gt;" in text


@pytest.mark.parametrize(
    ("name", "there", "not_there"),
    [
        ("everything", ["Nominal</th>", 'id="pair"', 'id="rank"', 'id="validation2"'], ["No other assignment"]),
        ("one_joint", ["No other assignment", 'id="pair"', 'id="torque1"'], ["Nominal</th>", 'id="validation1']),
        ("beam", ['id="proof"'], ['id="alternatives"', 'id="pair"', "No other assignment"]),
        ("unproven", ["800.25", 'id="alternatives"'], ["No other assignment"]),
        ("signed", ['"label":"recorded"'], ['id="proof"', "Hatched", 'id="pair"']),
    ],
)
def test_what_is_there_is_shown_and_what_is_not_is_not(pages, name, there, not_there):
    """Only a proof says that nothing else remains."""
    _, _, text = pages(name)
    assert [one for one in there if one not in text] == []
    assert [one for one in not_there if one in text] == []


def test_a_minute_of_seven_joints_fits_into_a_mail():
    """60 s at 1 kHz, thinned as findings are; 900 segments, 68 coefficients' worth of draws, and a validation."""
    found = make_findings(n=7, count=20_000, per_joint=129, validated=True)
    assert len(identification_page(found).encode()) < 3_000_000


def test_lengths_are_named_if_an_expression_has_them():
    assert "lengths of the robot file" in _caption(False, False, ["mc2x + a2 M2"])
    assert "robot file" not in _caption(False, False, ["J1yy + 0.656 mc3y", "Ia1 + 0.107584 M3"])  # of a URDF
