"""The benchmark of whole commands, on the shortest of its parts."""

import pytest

from bayesid.studies.benchmarks import pipeline


@pytest.mark.long
def test_many_logs_are_timed(capsys, tmp_path):
    pipeline.main(["--parts", "many", "--short", "--data", str(tmp_path)])
    shown = capsys.readouterr().out
    assert "4 logs: one worker" in shown
    assert "target >= 1.9 x" in shown


@pytest.mark.long
def test_memory_is_that_of_the_whole_command(capsys, tmp_path):
    pipeline.main(["--parts", "memory", "--short", "--data", str(tmp_path)])
    shown = capsys.readouterr().out
    assert "a minute at 1 kHz" in shown
    assert "target <= 1.5 GB" in shown
    assert "MISSED" not in shown


def test_a_command_that_fails_is_named(tmp_path):
    place = pipeline.Place(tmp_path, tmp_path, short=True)
    with pytest.raises(RuntimeError, match=r"bayesid identify missing\.csv .* ended with 2"):
        place.run("identify", "missing.csv", "--robot", "kr5")


def test_other_parts_are_refused(capsys):
    with pytest.raises(SystemExit):
        pipeline.main(["--parts", "identify,speed"])
    assert "no part speed" in capsys.readouterr().err


def test_a_log_in_parts_holds_every_row_once(tmp_path):
    place = pipeline.Place(tmp_path, tmp_path, short=True)
    rows = [f"{i},0.5\n" for i in range(place.samples + 7)]
    (tmp_path / "log.csv").write_text("t,q1\n" + "".join(rows))
    first, second = (part.read_text().splitlines(keepends=True) for part in place.parts(tmp_path / "log.csv"))
    assert first[0] == second[0] == "t,q1\n"
    assert len(first) == place.samples + 1
    assert first[1:] + second[1:] == rows
