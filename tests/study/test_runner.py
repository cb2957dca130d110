import os
import signal
import sys
import threading
import time
from collections import Counter
from contextlib import closing
from functools import partial
from importlib.metadata import version
from types import SimpleNamespace

import pytest
from threadpoolctl import threadpool_info, threadpool_limits
from toy_study import alive, dask_client, dask_cluster, leave_mark, marks_in, wait_until

from bayesid.cli.terminal import in_options
from bayesid.errors import InputError
from bayesid.study import runner
from bayesid.study.runner import Cluster, LostSchedulerError, connect, run

ON_CLUSTER = "BAYESID_TEST_CLUSTER"
"""Variable that stands in the environment of a cluster's workers, and of no other process."""
TWO_THREADS = {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2", "MKL_NUM_THREADS": "2"}
"""Environment variable that a worker must not inherit."""


class Poison:
    """Can be pickled, but not back."""

    def __reduce__(self):
        return int, ("poison",)


def do(task):
    """Failures of a worker."""
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
        case "die once" if not marks_in(given[0]):
            leave_mark(given[0])
            os.kill(os.getpid(), signal.SIGKILL)
        case "die":
            os.kill(os.getpid(), signal.SIGKILL)
        case "nap":
            leave_mark(given[0])
            time.sleep(given[1])
    return kind


FAILING = [("fail", "no luck"), ("leave",), ("lock",), ("poison",)]
SAFE = [("square", 2), *FAILING, ("blas",), ("square", 4)]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Its scheduler gives a task up when one worker died of it: a second round is then ours."""
    place = tmp_path_factory.mktemp("cluster")
    settings = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0", ON_CLUSTER: "yes", **TWO_THREADS}
    with dask_cluster(place, **settings) as running:
        yield running


def everything(batches):
    """Outcomes by task, one each."""
    with closing(batches):
        came = [outcome for batch in batches for outcome in batch]
    assert max(Counter(outcome.index for outcome in came).values()) == 1
    return {outcome.index: outcome for outcome in came}


@pytest.mark.parametrize("where", ["none", "two", "cluster"])
def test_values_come_back_and_what_fails_or_kills_its_workers_is_an_outcome(where, tmp_path, request, monkeypatch):
    deadly = [] if where == "none" else [("die",), ("die once", str(tmp_path / "mark"))]
    tasks = [*SAFE[:1], *deadly, *SAFE[1:]]
    scheduler = request.getfixturevalue("cluster").address if where == "cluster" else None
    for key, value in TWO_THREADS.items():
        monkeypatch.setenv(key, value)
    with threadpool_limits(2, user_api="blas"):
        outcomes = everything(run(do, tasks, {"none": 0, "two": 2}.get(where), scheduler))
    assert sorted(outcomes) == list(range(len(tasks)))
    found = {task: outcomes[k] for k, task in enumerate(tasks)}
    squares = [found["square", 2], found["square", 4]]
    assert [(one.value, one.error, one.died) for one in squares] == [(4, "", False), (16, "", False)]
    assert ({int(one.worker.rpartition(":")[2]) for one in squares} == {os.getpid()}) == (where == "none")
    failed = [found[task] for task in FAILING]
    assert [(one.value, one.died) for one in failed] == [(None, False)] * 4
    assert [one.error.partition(":")[0] for one in failed] == ["KeyError", "SystemExit", "TypeError", "ValueError"]
    assert set(found["blas",].value) == {1}
    if deadly:
        died, survived = (found[task] for task in deadly)
        assert (died.value, died.died, died.error.partition(":")[0]) == (None, True, "WorkerDied")
        assert (survived.value, survived.error, survived.died) == ("die once", "", False)


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


def test_a_lost_scheduler_is_an_error():
    """The client's exception depends on its state."""

    def gone(*_):
        raise AttributeError("ncores")

    executor = SimpleNamespace(submit=gone)
    client = SimpleNamespace(nthreads=gone, status="closing", get_executor=lambda pure: executor)
    pool = Cluster(client)
    for call in (lambda: pool.capacity(), lambda: pool.submit(do, 0, ("square", 1))):
        with pytest.raises(LostSchedulerError):
            call()
    client.status = "running"
    with pytest.raises(AttributeError):
        pool.submit(do, 0, ("square", 1))


def refusal(call=None, **where):
    with pytest.raises(InputError) as error:
        run(do, SAFE, **where) if call is None else call()
    assert "\n" not in str(error.value)
    return in_options(str(error.value))


def test_unavailable_workers_are_refused(monkeypatch):
    assert list(run(do, [])) == list(run(do, [], scheduler="tcp://127.0.0.1:1")) == []  # without tasks none is needed
    assert refusal(workers=-1).startswith("--workers: is -1")
    for address in ("", "127.0.0.1:8786", "tcp://127.0.0.1", "http://127.0.0.1:8786"):
        assert refusal(scheduler=address).startswith(f"--scheduler: {address!r} is not an address")
    assert "no scheduler answers" in refusal(partial(connect, "tcp://127.0.0.1:1", patience=0.5))
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert "pip install 'bayesid[distributed]'" in refusal(scheduler="tcp://127.0.0.1:8786")


def other_version(name):
    return "0.0.0" if ON_CLUSTER in os.environ else version(name)


def test_workers_of_another_version_are_refused(cluster, monkeypatch):
    monkeypatch.setattr(runner, "version", other_version)
    assert f"has bayesid 0.0.0, this machine has {version('bayesid')}" in refusal(scheduler=cluster.address)
