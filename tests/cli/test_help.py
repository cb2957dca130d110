"""The help of every command: short at first, all of it on demand, readable in 80 columns."""

import re

import pytest
from command_line import run

from bayesid.cli.arguments import BAYESID

COMMANDS = [
    "",
    *(f"{one.name}" for one in BAYESID.commands),
    *(f"{one.name} {below.name}" for one in BAYESID.commands for below in one.commands),
]
OPTION = re.compile(r"^  (-[-\w]+)")


def options_of(text):
    """Lines that name an option."""
    return [line for line in text.splitlines() if OPTION.match(line)]


@pytest.mark.parametrize("command", COMMANDS)
def test_the_first_help_is_short_and_names_the_other(command, capfd):
    assert run(*command.split(), "--help") == 0
    short = capfd.readouterr().out
    assert run(*command.split(), "--help-all") == 0
    whole = capfd.readouterr().out
    assert all(len(line) <= 80 for line in (*short.splitlines(), *whole.splitlines()))
    assert len(options_of(short)) <= 12
    names, every = ({OPTION.match(line)[1] for line in options_of(text)} for text in (short, whole))
    assert names <= every
    if names < every:
        assert short.splitlines()[-1] == f"all options: bayesid {command} --help-all"
    for line in options_of(whole):
        assert re.search(r"\S  +\S", line[2:]), "an option has its help on its line"
        assert not whole.partition(f"{line}\n")[2].startswith(" " * 10), "and on one line"


@pytest.mark.parametrize(
    "name", ["identify", "validate", "predict", "discrepancy", "payload", "track", "excite", "floor"]
)
def test_the_first_help_shows_how_a_log_is_read(name, capfd):
    run(name, "--help")
    shown = {OPTION.match(line)[1] for line in options_of(capfd.readouterr().out)}
    assert {"--columns", "--degrees", "--correct", *(["--gains"] if name != "predict" else [])} <= shown


def test_every_option_is_in_the_whole_help(capfd):
    for command in BAYESID.commands:
        run(command.name, "--help-all")
        shown = capfd.readouterr().out
        listed = {name for part in (command.options, *command.sections.values()) for name, _ in part if name[0] == "-"}
        assert all(re.search(rf"^  .*{re.escape(name)}\b", shown, re.M) for name in listed)
