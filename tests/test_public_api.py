"""The promise of public_api.txt: nothing of it changes unless the file and CHANGELOG.md say so."""

from pathlib import Path

import public_api
import pytest
from public_api import FILE, read, unmentioned, write

CHANGELOG = Path(__file__).parents[1] / "CHANGELOG.md"
RELEASED = ["Log.t", "bayesid.identify  (robot, log)", "bayesid identify --search  {certified}"]
NOW = ["Log.t", "bayesid.identify  (robot, log, terms=None)", "bayesid identify --cutoff", "result/summary.json: noise"]


@pytest.mark.filterwarnings("ignore")
def test_the_file_lists_what_is_promised(capsys):
    marked, now = read(FILE.read_text(encoding="utf-8")), public_api.listing()
    capsys.readouterr()
    listed = marked["kept"] + marked["added"]
    changed = sorted(set(now) ^ set(listed))
    assert changed == [], "what is promised has changed: `python -m tests.public_api`, and name it in CHANGELOG.md"
    assert not set(marked["removed"]) & set(now)
    assert len(listed) == len(set(listed)) > 800


def test_the_changelog_names_what_has_changed_since_the_release():
    missing = unmentioned(FILE.read_text(encoding="utf-8"), CHANGELOG.read_text(encoding="utf-8"))
    assert missing == [], "name these under the first heading of CHANGELOG.md"


# ---------------------------------------------------------------------------------------------------------------
# The file and the changelog, of other listings
# ---------------------------------------------------------------------------------------------------------------
def test_lines_are_marked_by_what_was_released():
    marked = read(write(NOW, RELEASED))
    assert marked["kept"] == ["Log.t"]
    assert marked["added"] == sorted(set(NOW) - set(RELEASED))
    assert marked["removed"] == sorted(set(RELEASED) - set(NOW))
    assert sorted(marked["kept"] + marked["removed"]) == sorted(RELEASED)  # so that the release is never forgotten


def test_what_is_marked_has_to_be_named_under_the_first_heading():
    changed = {"bayesid.identify", "identify --cutoff", "identify --search", "result/summary.json: noise"}
    old = f"## 0.1.0\n{' '.join(changed)}\n"
    assert set(unmentioned(write(NOW, RELEASED), f"# Changelog\n\n## 0.2.0\n`identify-all`\n\n{old}")) == changed
    assert unmentioned(write(NOW, RELEASED), f"# Changelog\n\n{old}") == []


def test_a_release_forgets_the_marks(tmp_path, monkeypatch):
    monkeypatch.setattr(public_api, "FILE", tmp_path / "api.txt")
    monkeypatch.setattr(public_api, "listing", lambda: sorted(NOW))
    (tmp_path / "api.txt").write_text(write(RELEASED, RELEASED), encoding="utf-8")
    public_api.update()
    assert set(read((tmp_path / "api.txt").read_text("utf-8"))["removed"]) == set(RELEASED) - set(NOW)
    public_api.update()  # again: the same
    assert set(read((tmp_path / "api.txt").read_text("utf-8"))["removed"]) == set(RELEASED) - set(NOW)
    public_api.update(release=True)
    assert read((tmp_path / "api.txt").read_text("utf-8")) == {"kept": sorted(NOW), "added": [], "removed": []}
