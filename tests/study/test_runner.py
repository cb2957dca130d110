import os
import signal
import sys
import threading
import time
from collections import Counter
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import closing
from importlib.metadata import version
from types import SimpleNamespace

import pytest
from threadpoolctl import threadpool_info, threadpool_limits
from toy_study import alive, dask_client, dask_cluster, leave_mark, marks_in, wait_until

from bayesid.errors import InputError
from bayesid.study import runner
from bayesid.study.runner import Cluster, LostSchedulerError, attempt, connect, flow, run

ON_CLUSTER = "BAYESID_TEST_CLUSTER"
"""Variable that stands in the environment of a cluster's workers, and of no other process."""
TWO_THREADS = {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2", "MKL_NUM_THREADS": "2"}
"""What a worker must not take over."""


class Poison:
    """Can be pickled, but not back."""

    def __reduce__(self):
        return int, ("poison",)


def do(task):
    """What a worker can meet with."""
    kind, *given = task
    match kind:
        case "square":
            return given[0] ** 2
        case "fail":
            raise KeyError(*given)
        case "leave":
            sys.exit(3)
        case "lock":
            return threading.Lock()
        case "poison":
            return Poison()
        case "blas":
            return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]
        case "environment":
            return {key: os.environ.get(key) for key in TWO_THREADS}
        case "die once" if not marks_in(given[0]):
            leave_mark(given[0])
            os.kill(os.getpid(), signal.SIGKILL)
        case "die":
            os.kill(os.getpid(), signal.SIGKILL)
        case "nap":
            leave_mark(given[0])
            time.sleep(given[1])
    return kind


SAFE = [
    ("square", 2),
    ("fail", "no luck"),
    ("square", 3),
    ("leave",),
    ("lock",),
    ("poison",),
    ("blas",),
    ("environment",),
    ("square", 4),
]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Its scheduler gives a task up when one worker died of it: a second round is then ours."""
    place = tmp_path_factory.mktemp("cluster")
    settings = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0", ON_CLUSTER: "yes", **TWO_THREADS}
    with dask_cluster(place, **settings) as running:
        yield running


@pytest.fixture(scope="module", params=["none", "one", "two", "cluster"])
def outcomes(request, tmp_path_factory):
    """Of SAFE, and with more than one worker of two tasks in between that kill workers; these come last here."""
    where = request.param
    mark = tmp_path_factory.mktemp("outcomes") / "mark"
    deadly = [("die",), ("die once", str(mark))] if where in ("two", "cluster") else []
    tasks = [*SAFE[:1], *deadly, *SAFE[1:]]
    scheduler = request.getfixturevalue("cluster").address if where == "cluster" else None
    with pytest.MonkeyPatch.context() as patch, threadpool_limits(2, user_api="blas"):
        for key, value in TWO_THREADS.items():
            patch.setenv(key, value)
        found = everything(run(do, tasks, {"none": 0, "one": 1, "two": 2}.get(where), scheduler))
    assert sorted(found) == list(range(len(tasks)))
    order = [tasks.index(task) for task in [*SAFE, *deadly]]
    return where, [found[index] for index in order]


def everything(batches):
    """Outcomes by task; each comes once."""
    with closing(batches):
        came = [outcome for batch in batches for outcome in batch]
    assert max(Counter(outcome.index for outcome in came).values()) == 1
    return {outcome.index: outcome for outcome in came}


# ---------------------------------------------------------------------------------------------------------------
# What becomes of a task
# ---------------------------------------------------------------------------------------------------------------
def test_values_come_back(outcomes):
    where, (first, _, third, *_, last) = outcomes[0], outcomes[1][: len(SAFE)]
    assert [(one.value, one.error, one.died) for one in (first, third, last)] == [(k**2, "", False) for k in (2, 3, 4)]
    pids = {int(one.worker.rpartition(":")[2]) for one in (first, third, last)}
    assert (pids == {os.getpid()}) == (where == "none")


def test_what_a_task_raises_is_its_outcome(outcomes):
    failed = [one for one in outcomes[1][: len(SAFE)] if one.error]
    assert [(one.value, one.died) for one in failed] == [(None, False)] * 4
    fail, leave, lock, poison = (one.error for one in failed)
    assert fail == "KeyError: 'no luck'"
    assert leave == "SystemExit: 3"
    assert lock.startswith("TypeError: cannot pickle")
    assert poison.startswith("ValueError: invalid literal for int()")


def test_one_blas_thread_a_worker(outcomes):
    where, found = outcomes[0], dict(zip([task[0] for task in SAFE], outcomes[1], strict=False))
    assert found["blas"].value
    assert set(found["blas"].value) == {1}
    if where in ("one", "two"):  # a BLAS that is loaded later reads it; on a cluster Dask sees to that
        assert set(found["environment"].value.values()) == {"1"}


@pytest.mark.parametrize("outcomes", ["two", "cluster"], indirect=True)
def test_a_task_that_kills_its_workers_is_an_outcome(outcomes):
    died, survived = outcomes[1][len(SAFE) :]
    assert (died.value, died.died) == (None, True)
    assert died.error.startswith("WorkerDied: ")
    assert (survived.value, survived.error, survived.died) == ("die once", "", False)


# ---------------------------------------------------------------------------------------------------------------
# When they are handed out
# ---------------------------------------------------------------------------------------------------------------
class FakePool:
    """All tasks that are at hand at a time share one worker, and if one of them kills it, all are lost."""

    attempts, lost, many = 2, "WorkerDied: it did", 3

    def __init__(self, *_):
        self.peak, self.closed, self._at_hand, self._worker = 0, False, [], ThreadPoolExecutor(1)

    def room(self, waiting):
        return self.many

    def submit(self, function, task):
        self._at_hand.append((function, task, Future()))
        self.peak = max(self.peak, len(self._at_hand))
        self._worker.submit(self._work)
        return self._at_hand[-1][-1]

    def _work(self):
        time.sleep(0.01)
        now, self._at_hand = self._at_hand, []
        for function, task, future in now:
            if ("die",) in [task for _, task, _ in now]:
                future.set_exception(ConnectionError())
            else:
                future.set_result(attempt(function, task))

    def died(self, failure):
        return isinstance(failure, ConnectionError)

    def close(self):
        self.closed = True


def test_no_more_tasks_at_hand_than_there_is_room():
    pool = FakePool()
    assert [outcome.value for outcome in everything(flow(pool, do, [("square", k) for k in range(50)])).values()]
    assert pool.peak == pool.many
    assert pool.closed


def test_a_task_does_not_die_of_another_one():
    tasks = [("square", 1), ("die",), ("square", 2), ("die",), *[("square", k) for k in range(3, 7)]]
    found = everything(flow(FakePool(), do, tasks))
    assert [found[k].died for k in range(len(tasks))] == [task == ("die",) for task in tasks]


def test_without_tasks_nothing_is_started(monkeypatch):
    monkeypatch.setattr(runner, "Processes", None)
    monkeypatch.setattr(runner, "connect", None)
    assert list(run(do, [])) == list(run(do, [], scheduler="tcp://127.0.0.1:1")) == []


def test_no_more_processes_than_tasks(monkeypatch):
    asked = []
    monkeypatch.setattr(runner, "Processes", lambda workers: asked.append(workers) or FakePool())
    everything(run(do, [("square", 1)] * 3, workers=8))
    everything(run(do, [("square", 1)] * 3, workers=2))
    assert asked == [3, 2]


def test_the_scheduler_knows_few_tasks_at_a_time(cluster):
    batches = run(do, [("square", k) for k in range(200)], scheduler=cluster.address)
    with dask_client(cluster.address) as client, closing(batches):
        known = [client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)) for _ in batches]
    assert 0 < max(known) < 40  # two threads have two each; those just released may still be there


# ---------------------------------------------------------------------------------------------------------------
# How it ends
# ---------------------------------------------------------------------------------------------------------------
def test_closed_early_local_workers_end_at_once(tmp_path):
    marks = tmp_path / "marks"
    with closing(run(do, [("nap", str(marks), 600.0)] * 5, workers=2)) as batches:
        assert next(batches) == []
        pids = [pid for pid, _ in wait_until(lambda: len(marks_in(marks)) == 2 and marks_in(marks), "both work")]
        assert all(map(alive, pids))
        began = time.monotonic()
    assert time.monotonic() - began < 30.0
    assert not any(map(alive, pids))


def test_closed_early_a_cluster_is_asked_to_stop(cluster, tmp_path):
    marks = tmp_path / "marks"
    with closing(run(do, [("nap", str(marks), 0.5)] * 50, scheduler=cluster.address)) as batches:
        next(batches)
    with dask_client(cluster.address) as client:
        wait_until(lambda: not client.run_on_scheduler(lambda dask_scheduler: dask_scheduler.tasks), "no task is left")
    assert len(marks_in(marks)) < 10


@pytest.mark.parametrize("error", [OSError("connection reset"), AttributeError("ncores"), CancelledError()])
def test_a_scheduler_that_is_gone(error):
    """What its client raises depends on when it is asked; test_kill.py kills one."""

    def gone(*_):
        raise error

    executor = SimpleNamespace(submit=gone)
    client = SimpleNamespace(nthreads=gone, status="closing", get_executor=lambda pure: executor)
    pool = Cluster(client)
    with pytest.raises(LostSchedulerError):
        pool.room(1)
    with pytest.raises(LostSchedulerError):
        pool.submit(do, ("square", 1))
    client.status = "running"
    with pytest.raises(type(error)):
        pool.submit(do, ("square", 1))


# ---------------------------------------------------------------------------------------------------------------
# Where there is nothing to run on
# ---------------------------------------------------------------------------------------------------------------
def refusal(**where):
    with pytest.raises(InputError) as error:
        run(do, SAFE, **where)
    assert "\n" not in str(error.value)
    assert error.value.remedy
    return f"{error.value.where}: {error.value.what}"


def test_fewer_workers_than_none():
    assert refusal(workers=-1) == "--workers: -1 workers"


@pytest.mark.parametrize("address", ["", "cluster", "127.0.0.1:8786", "tcp://127.0.0.1", "http://127.0.0.1:8786"])
def test_what_is_no_address(address):
    assert refusal(scheduler=address) == f"--scheduler: {address!r} is no address of a scheduler"


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "tcp://127.0.0.1:99999", "tcp://nowhere.invalid:8786"])
def test_no_scheduler_there(address):
    with pytest.raises(InputError) as error:
        connect(address, patience=0.5)
    assert f"no scheduler answers at {address}" in str(error.value)
    assert error.value.remedy
    assert "\n" not in str(error.value)


def test_dask_is_not_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError) as error:
        run(do, SAFE, scheduler="tcp://127.0.0.1:8786")
    assert "Dask is not installed" in str(error.value)
    assert error.value.remedy == "pip install 'bayesid[distributed]'"


def other_version(name):
    return "0.0.0" if ON_CLUSTER in os.environ else version(name)


def no_version(name):
    if ON_CLUSTER in os.environ:
        raise ModuleNotFoundError(f"No package metadata was found for {name}")
    return version(name)


def test_workers_of_another_version(cluster, monkeypatch):
    monkeypatch.setattr(runner, "version", other_version)
    message = refusal(scheduler=cluster.address)
    assert "worker tcp://127.0.0.1:" in message
    assert f"has 0.0.0, here is {version('bayesid')}" in message


def test_workers_without_bayesid(cluster, monkeypatch):
    monkeypatch.setattr(runner, "version", no_version)
    assert "a worker has no bayesid" in refusal(scheduler=cluster.address)
