"""Mutated inputs for the readers: whatever comes, a reader reads it or says in one line why not."""

from __future__ import annotations

import copy
import re
import resource
import signal
import warnings
from collections.abc import Callable, Mapping
from contextlib import contextmanager

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from bayesid.cli.terminal import in_options
from bayesid.errors import InputError

BUDGETS = pytest.mark.parametrize(
    "examples", [pytest.param(60, id="short"), pytest.param(10_000, id="long", marks=pytest.mark.long)]
)
LONGEST = 30
"""s of CPU that one input may take."""
MOST_MEMORY = 2 << 20
"""KiB that reading may add to the process."""
HOSTILE_NUMBERS = (
    *("1e308", "-1e308", "1e-320", "nan", "inf", "-inf", "1e999", "0", "-1", "1e18", "9" * 5001, "1" + "0" * 400),
    *("0x10", "1_0", "\u0661", "1,5", "", "-", "--1", "1e", "true", "4294967296", "2147483648"),
)
HOSTILE_WORDS = (
    *(bytes([letter]) for letter in b"\0\xff\r\x85\x1a#%\"'=,;\t]}"),
    *(b"\xff\xfe", b"\xef\xbb\xbf", b"\x1b[31m", b"\n\n", b"[deg]", b"&lt;", b"<a>", b"</link>", b"-->"),
    *(word * 3000 for word in (b"[", b"{", b"a.", b" ", b"_")),
    *(b"nan", b"1e308", b"(" * 300, b"9" * 5001, "\u0661".encode(), b"q" + b"9" * 5000),
)
HOSTILE_VALUES = (
    *(None, True, -1, 0, 2**31, 2**70, 10**400, 1e308, -1e308, 1e-320, float("nan"), float("inf"), -5, 3.5),
    *("", "a\x01b", "x" * 3000, "1e308", "\u0661"),
    *([], {}, [[]], [1, "a"], [1e308] * 3, {"a": {"b": []}}, [None], [[1.0] * 4] * 4),
)
_CHANGES = ("flip", "insert", "renumber", "renumber", "cut", "truncate", "repeat")
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


class Hang(BaseException):
    """No reader's `except Exception` takes it for damage."""


@contextmanager
def limited_time():
    """Ends what takes longer than `LONGEST` s of CPU."""

    def stop(_signal, _frame):
        raise Hang

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def check_reader(read: Callable[[], object]) -> bool:
    """Whether it reads; if not, it has said why in one line of letters, without warnings of others or much memory."""
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with warnings.catch_warnings(record=True) as caught, limited_time():
        warnings.simplefilter("always")
        try:
            read()
            refusal = None
        except InputError as error:
            refusal = error
    if refusal is not None:
        assert refusal.what
        assert refusal.remedy
        assert "\n" not in in_options(str(refusal))
    foreign = [f"{one.filename}:{one.lineno}: {one.message}" for one in caught if not _is_note(one)]
    assert not foreign, foreign
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory < MOST_MEMORY
    return refusal is None


def _is_note(warning: warnings.WarningMessage) -> bool:
    """Whether a warning is a note of ours, or of what a library will change."""
    ours = warning.category is UserWarning and "site-packages" not in warning.filename
    return ours or issubclass(warning.category, DeprecationWarning)


def fuzz(inputs: st.SearchStrategy, check: Callable[[object], object], examples: int) -> None:
    """Has a check look at so many inputs, the same ones every time."""

    @settings(
        **{"max_examples": examples, "derandomize": True, "database": None, "deadline": None},
        **{"phases": [Phase.generate], "suppress_health_check": list(HealthCheck), "report_multiple_bugs": False},
    )
    @given(inputs)
    def one(content):
        check(content)

    one()


def mutated_files(samples: Mapping[str, tuple[str, bytes]]) -> st.SearchStrategy:
    """(name, content) with the bytes of one of some files changed."""
    each = [st.tuples(st.just(name), mutated_bytes(content)) for name, (_, content) in samples.items()]
    return st.one_of(each)


@st.composite
def mutated_bytes(draw, sample: bytes) -> bytes:
    """A sample with one to four changes: bytes, words, numbers, cuts and repetitions."""
    content = sample
    for _ in range(draw(st.integers(1, 4))):
        content = _changed(draw, content)
    return content


def _changed(draw, content: bytes) -> bytes:
    how = draw(st.sampled_from(_CHANGES))
    if how == "renumber":
        found = list(_NUMBER.finditer(content))
        if not found:
            return content
        one = found[min(draw(st.one_of(st.integers(0, 40), st.integers(0, len(found) - 1))), len(found) - 1)]
        return content[: one.start()] + draw(st.sampled_from(HOSTILE_NUMBERS)).encode() + content[one.end() :]
    # anywhere, but in the first part, where headers are, as often as in all the rest
    at = draw(st.one_of(st.integers(0, min(len(content), 300)), st.integers(0, len(content))))
    if how == "flip":
        return content[:at] + draw(st.binary(min_size=1, max_size=8)) + content[at + draw(st.integers(0, 8)) :]
    if how == "insert":
        return content[:at] + draw(st.sampled_from(HOSTILE_WORDS)) + content[at:]
    if how == "cut":
        return content[:at] + content[at + draw(st.integers(1, 400)) :]
    if how == "truncate":
        return content[:at]
    length = draw(st.integers(1, 200))
    return content[:at] + content[at : at + length] * draw(st.integers(2, 60)) + content[at:]


@st.composite
def mutated_tree(draw, sample: object) -> object:
    """Tables and lists with one to three entries changed, lost, renamed or doubled."""
    tree = copy.deepcopy(sample)
    for _ in range(draw(st.integers(1, 3))):
        holders = list(_holders(tree))
        holder = holders[draw(st.integers(0, len(holders) - 1))]
        keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
        key = draw(st.sampled_from(keys))
        how = draw(st.integers(0, 5))
        if how == 0:
            del holder[key]
        elif how == 1 and isinstance(holder, list):
            holder.append(copy.deepcopy(holder[key]))
        elif how == 1:
            holder[draw(st.sampled_from(["name", "joints", "x" * 500, "", "shape", str(key) + "1"]))] = holder[key]
        else:
            holder[key] = copy.deepcopy(draw(st.sampled_from(HOSTILE_VALUES)))
        if not tree:
            return tree
    return tree


def _holders(tree: object):
    """All tables and lists that hold something."""
    waiting = [tree]
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict | list) and one:
            yield one
            waiting += one.values() if isinstance(one, dict) else one
