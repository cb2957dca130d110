"""The papers of the house: citation, journal paper and policies name what is there, and numbers that the docs show."""

import re
from pathlib import Path

import pytest

import bayesid

ROOT = Path(__file__).parents[2]
PAPER = (ROOT / "docs" / "paper" / "paper.md").read_text(encoding="utf-8")
REFERENCES = (ROOT / "docs" / "paper" / "paper.bib").read_text(encoding="utf-8")
PLAN = {"bayesid", "studies", "tests", "docs", "pyproject.toml", "README.md"}
CONVENTION = {"CHANGELOG.md", "CITATION.cff", "CODE_OF_CONDUCT.md", "CONTRIBUTING.md", "LICENSE", "SECURITY.md"}
"""Where those who look for them look first."""
BUILD = {"MANIFEST.in", "setup.py"}


def test_the_top_level_holds_what_is_planned_and_what_convention_puts_there():
    made_there = {"build", "dist", "site", "PKG-INFO", "setup.cfg"}  # the last two in an unpacked source distribution
    entries = {path.name for path in ROOT.iterdir() if path.name[0] != "." and path.suffix != ".egg-info"}
    extra = {name for name in entries - made_there if not name.startswith(("results", "bayesid-demo"))}
    assert extra == PLAN | CONVENTION | BUILD


# ---------------------------------------------------------------------------------------------------------------
# Citation
# ---------------------------------------------------------------------------------------------------------------
def test_the_citation_is_of_this_version():
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.+)$", text, re.M)[1] == bayesid.__version__
    assert {"cff-version", "message", "title", "authors"} <= set(re.findall(r"^([\w-]+):", text, re.M))


@pytest.mark.long
def test_the_citation_is_valid():
    cffconvert = pytest.importorskip("cffconvert", reason="pip install 'bayesid[release]'")
    cffconvert.Citation((ROOT / "CITATION.cff").read_text(encoding="utf-8")).validate()


# ---------------------------------------------------------------------------------------------------------------
# Paper
# ---------------------------------------------------------------------------------------------------------------
def test_the_paper_cites_all_references_and_no_others():
    cited = set(re.findall(r"(?<![\w`])@(\w+)", PAPER))
    assert cited == set(re.findall(r"^@\w+\{(\w+),", REFERENCES, re.M))


def test_every_reference_can_be_found():
    entries = re.split(r"^(?=@)", REFERENCES, flags=re.M)[1:]
    without = [entry.partition(",")[0] for entry in entries if not re.search(r"doi|\\url|volume|note", entry)]
    assert without == []
    dois = re.findall(r"doi = \{(.*)\}", REFERENCES)
    assert len(dois) == len(set(dois))
    assert all(re.fullmatch(r"10\.\d{4,5}/\S+", doi) for doi in dois)


def test_the_paper_has_the_sections_and_the_length_of_its_journal():
    assert {"Summary", "Statement of need", "References"} <= set(re.findall(r"^# (.+)$", PAPER, re.M))
    assert 250 <= len(PAPER.split("---", 2)[2].split()) <= 1750


def test_numbers_of_the_paper_are_those_of_the_documentation():
    shown = " ".join(path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md"))
    section = PAPER.partition("# What it reaches")[2]
    numbers = set(re.findall(r"\d+\.\d+", section)) | set(re.findall(r"\d+ of \d+", section))
    assert len(numbers) >= 8
    assert [number for number in sorted(numbers) if number not in shown] == []


def test_the_policy_names_the_list_that_a_test_keeps():
    policy = (ROOT / "docs" / "versions.md").read_text(encoding="utf-8")
    for name in re.findall(r"`(tests/[\w.]+|bayesid/[\w.]+|CITATION.cff)`", policy):
        assert (ROOT / name).exists(), name
    assert "tests/public_api.txt" in policy
