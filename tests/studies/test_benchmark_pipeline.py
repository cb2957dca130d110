"""The benchmark of whole commands, on the shortest of its parts."""

import re

import pytest

from bayesid.studies.benchmarks import pipeline


@pytest.mark.long
@pytest.mark.parametrize(
    ("part", "line", "target"),
    [("many", "4 logs: one worker", "target >= 1.9 x"), ("memory", "a minute at 1 kHz", "target <= 1.5 GB +met")],
)
def test_a_part_prints_its_line_and_its_target(capsys, tmp_path, part, line, target):
    """Of memory the target is met in the short form too; a few logs are mostly beginnings."""
    pipeline.main(["--parts", part, "--short", "--data", str(tmp_path)])
    shown = capsys.readouterr().out
    assert line in shown
    assert re.search(target, shown)


def test_a_command_that_fails_is_named(tmp_path):
    place = pipeline.Place(tmp_path, tmp_path, short=True)
    with pytest.raises(RuntimeError, match=r"bayesid identify missing\.csv .* ended with 2"):
        place.run("identify", "missing.csv", "--robot", "kr5")


def test_a_log_in_parts_holds_every_row_once(tmp_path):
    place = pipeline.Place(tmp_path, tmp_path, short=True)
    rows = [f"{i},0.5\n" for i in range(place.samples + 7)]
    (tmp_path / "log.csv").write_text("t,q1\n" + "".join(rows))
    first, second = (part.read_text().splitlines(keepends=True) for part in place.parts(tmp_path / "log.csv"))
    assert first[0] == second[0] == "t,q1\n"
    assert len(first) == place.samples + 1
    assert first[1:] + second[1:] == rows
