"""Copies of the process: what they hand back is what the process itself would have computed."""

import os
import signal
import time
from functools import partial

import numpy as np
import pytest

from bayesid.process import beside, in_parallel


class Thing:
    """Compared by identity, and not to be pickled."""

    def __init__(self, value):
        self.value, self.make = value, lambda: value


THINGS = [Thing(1), Thing(2), Thing(3)]


def failing():
    raise ValueError("as it should")


def no_children():
    try:
        os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return True
    return False


def test_results_are_in_the_order_of_the_tasks():
    found = in_parallel([partial(np.full, 3, k) for k in range(7)])
    np.testing.assert_array_equal(found, np.repeat(np.arange(7), 3).reshape(7, 3))


def test_what_is_known_is_the_same_object_again():
    tasks = [lambda k=k: (THINGS[k], {"twice": [THINGS[k], THINGS[0]]}) for k in (2, 1, 0, 1)]
    found = in_parallel(tasks, known=THINGS)
    for (one, held), k in zip(found, (2, 1, 0, 1), strict=True):
        assert one is THINGS[k]
        assert held["twice"][0] is THINGS[k]
        assert held["twice"][1] is THINGS[0]


def test_a_task_beside_returns_what_it_returns():
    with beside(lambda: (THINGS[1], os.getpid()), known=THINGS) as other:
        thing, process = other()
    assert thing is THINGS[1]
    assert process > 0


def test_a_task_beside_that_is_not_asked_for_is_given_up():
    with beside(lambda: time.sleep(60.0)):
        pass
    assert no_children()


def test_a_task_beside_that_fails_says_so():
    with beside(failing) as other, pytest.raises(ValueError, match="as it should"):
        other()


def test_a_task_is_done_here_if_its_copy_is_ended(monkeypatch):
    here = os.getpid()
    with beside(lambda: here if os.getpid() == here else os.kill(os.getpid(), signal.SIGKILL)) as other:
        assert other() == here
