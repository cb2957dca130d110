"""How commands end: sentences folded, a verdict, what to do, and the next command in one line."""

import numpy as np
from command_line import ARM, run, unfolded

import bayesid
from bayesid.cli.arguments import parse
from bayesid.cli.options import finish
from bayesid.identification.checks import Check
from bayesid.report.conclusion import conclude


def test_sentences_are_folded_and_commands_stay_whole(capfd):
    """A text of several lines is laid out already; the last line is to be copied."""
    command = "`bayesid discrepancy some/folder ANOTHER_LOG.csv --unsigned all --degrees`"
    conclusion = conclude([Check("Fit", "look", "word " * 30 + "end", f"{command} finds what the model lacks")])
    table = "a" * 60 + "  " + "b" * 60 + "\nsecond"
    last = f"written to {'x' * 90}; next: bayesid show"
    finish(parse(["demo"]), "  first " + "line " * 30, table, conclusion=conclusion, last=last)
    lines = capfd.readouterr().out.splitlines()
    assert all(line in lines for line in (*table.splitlines(), last))
    rest = [line for line in lines if line not in (*table.splitlines(), last)]
    assert all(len(line) <= 78 or command in line for line in rest)
    assert any(command in line for line in rest)
    assert rest[1].startswith("    line"), "what is folded is indented"
    assert unfolded("\n".join(rest)).count("line") == 30


def test_a_number_stays_with_its_unit_where_a_line_folds(capfd):
    finish(parse(["demo"]), *(f"{'x' * width} 12 %, 3 N m, end" for width in range(50, 80)))
    lines = [line.strip() for line in capfd.readouterr().out.splitlines()]
    assert any(line.startswith("3 N m") for line in lines)
    assert not any(line.startswith(("%", "N m", "m,")) for line in lines)


def test_a_motion_is_judged_with_a_verdict_and_the_next_command(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.toml").write_text(ARM)
    log = bayesid.simulate("arm.toml", rate=50.0, noise=0.02, rng=1)
    log.save(tmp_path / "log.csv")
    assert run("excite", "--robot", "arm.toml", "--log", "log.csv", "--strict") == 0
    out = capfd.readouterr().out
    assert "Verdict: " in out
    assert out.splitlines()[-1] == "next: bayesid identify log.csv --robot arm.toml"
    q = np.array(log.q)
    q[:, 1] = 0.3
    bayesid.Log(log.t, q, log.effort, log.signed).save(tmp_path / "still.csv")
    for options, code in (((), 0), (("--strict",), 3)):
        assert run("excite", "--robot", "arm.toml", "--log", "still.csv", *options) == code
        out = capfd.readouterr().out
        assert "Verdict: bad." in out
        assert "`bayesid excite --robot arm.toml --limits LIMITS.toml`" in out
