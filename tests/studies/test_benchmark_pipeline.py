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
