"""What a stranger does next: units in the names that they give, empty rows, the next command."""

import numpy as np
import pytest
from command_line import TWO_JOINTS

import bayesid
from bayesid.cli import main
from bayesid.errors import InputError
from bayesid.log.log import read_log

T = np.arange(300) / 100.0
Q = np.column_stack([np.sin(T), 0.5 * np.cos(3.0 * T)])
EFFORT = np.abs(np.column_stack([40.0 * np.cos(T), 7.0 + 9.0 * np.sin(2.0 * T)]))


def table(path, header, *columns, tail=""):
    rows = [",".join(f"{value:.9g}" for value in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([header, *rows, tail]))
    return str(path)


def test_empty_rows_at_the_end_of_a_spreadsheet(tmp_path):
    path = table(tmp_path / "log.csv", "t,q1,q2,tau1,tau2", T, Q, EFFORT, tail=",,,,\n,,,,\n")
    assert len(read_log(path)) == len(T)
    half = table(tmp_path / "half.csv", "t,q1,q2,tau1,tau2", T, Q, EFFORT, tail="3.0,,,,\n")
    with pytest.raises(InputError, match="row 302"):
        read_log(half)


def test_the_next_commands_read_as_the_first_did(tmp_path, monkeypatch, any_motion, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.toml").write_text(TWO_JOINTS)
    assert main(["simulate", "--robot", "arm.toml", "--out", "plain.csv", "--duration", "6", "--quiet"]) == 0
    values = np.loadtxt("plain.csv", delimiter=",", skiprows=1)
    header = "zeit,lage1,lage2,amp1_mA,amp2_mA"
    table(tmp_path / "log.csv", header, values[:, 0], np.rad2deg(values[:, 1:3]), values[:, 3:] * 1e3)
    columns = 't=zeit,q="lage{} [deg]",i=amp{}_mA'
    options = ["--columns", columns, "--gains", "1,1", "--no-posterior", "--complete", "off", "--no-report"]
    command = ["bayesid", "identify", "log.csv", "--robot", "arm.toml", *options, "--out", "result"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", command)
        assert main(command[1:]) == 0
    findings = bayesid.read_findings("result")
    (check,) = [check for check in bayesid.check_findings(findings) if check.name == "Validation"]
    assert f"--validation ANOTHER_LOG.csv --columns '{columns}' --gains 1,1`" in check.remedy
    again = eval(findings.summary.provenance.call, {"bayesid": bayesid})
    assert again.log.effort.max() == pytest.approx(read_log("plain.csv").effort.max(), rel=1e-6)
    assert "no validation: the model was identified from this log" in repr(again.validate(again.log))
    capsys.readouterr()
    assert main(command[1:]) == 0
    assert "written to result/, in place of an earlier result" in capsys.readouterr().out
