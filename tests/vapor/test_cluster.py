"""Jobs on the workers of a Dask scheduler."""

import gc
import json
import sys
from collections.abc import Iterator
from time import perf_counter

import pytest

pytest.importorskip("distributed", reason="distributed is not installed: pip install 'vapor-track[dask]'")
from distributed import LocalCluster

from filtering.errors import VaporTrackError
from tests.helpers import jobs
from vapor import cluster as cluster_module
from vapor.parallel import in_parallel


@pytest.fixture(scope="module")
def processes() -> Iterator[LocalCluster]:
    """Two workers, each a process with one thread."""
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
        yield cluster


@pytest.fixture
def thread() -> Iterator[LocalCluster]:
    """A worker in this process, which starts at once."""
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0") as cluster:
        yield cluster


def on(cluster: LocalCluster, function, arguments: list[tuple], **options) -> list[tuple[int, object]]:
    return sorted(in_parallel(function, arguments, 1, scheduler=cluster.scheduler_address, **options))


def test_jobs_of_a_killed_worker_are_done_by_others(processes, tmp_path):
    assert on(processes, jobs.end_once, [(tmp_path, n) for n in range(6)]) == [(n, n) for n in range(6)]
    assert (tmp_path / "ended").exists()


def test_a_job_whose_workers_die_each_time_stops_no_others(processes, monkeypatch):
    monkeypatch.setattr(processes.scheduler, "allowed_failures", 1)
    arguments = [("kill" if n == 1 else "", n) for n in range(4)]
    done = dict(on(processes, jobs.end_if, arguments, given_up=lambda word, number: "gave up"))
    assert done.pop(1) == "gave up"
    # Dask suspects what was waiting at a worker that died, too.
    assert all(result in (number, "gave up") for number, result in done.items())
    assert list(done) == [0, 2, 3]
    assert sorted(done.values(), key=str)[0] != "gave up"


def test_equal_jobs_are_each_done(thread):
    assert on(thread, jobs.end_if, [("", 7)] * 3) == [(0, 7), (1, 7), (2, 7)]


def test_an_error_of_a_job_is_raised_here(thread):
    with pytest.raises(ZeroDivisionError):
        on(thread, divmod, [(1, 0)])


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch):
    monkeypatch.setattr(cluster_module, "_ANSWER_S", 0.2)
    with pytest.raises(VaporTrackError, match=r"tcp://127.0.0.1:9: no Dask scheduler answers, expected the address"):
        list(in_parallel(abs, [(1,)], 1, scheduler="tcp://127.0.0.1:9"))


@pytest.mark.parametrize("scheduler", ["", "nonsense", "127.0.0.1", "http://127.0.0.1:9", "tcp://127.0.0.1", "file"])
def test_what_is_no_address_is_named_at_once(scheduler, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text('{"address": 7}')
    began_s = perf_counter()
    with pytest.raises(VaporTrackError, match=f"^{scheduler}: no Dask scheduler answers, expected the address"):
        list(in_parallel(abs, [(1,)], 1, scheduler=scheduler))
    gc.collect()  # Dask says much about a client that never connected
    assert perf_counter() - began_s < 5


def test_a_scheduler_is_named_by_its_file(thread, tmp_path):
    (tmp_path / "file").write_text(json.dumps({"address": thread.scheduler_address}))
    assert list(in_parallel(abs, [(-1,)], 1, scheduler=str(tmp_path / "file"))) == [(0, 1)]


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(VaporTrackError, match=r"distributed is not installed, .* pip install 'vapor-track\[dask\]'"):
        list(in_parallel(abs, [(1,)], 1, scheduler="tcp://127.0.0.1:9"))


def test_a_worker_of_another_version_is_refused(thread, monkeypatch):
    monkeypatch.setattr(cluster_module, "version_of", lambda package: "0.0.0")
    with pytest.raises(VaporTrackError, match=r"Dask worker \S+ has vapor-track \S+, expected 0.0.0"):
        on(thread, abs, [(1,)])


def test_a_scheduler_of_another_version_is_refused(monkeypatch):
    monkeypatch.setattr(cluster_module, "version_of", lambda package: "0.0.0")
    with (
        LocalCluster(n_workers=0, processes=False, dashboard_address=":0") as cluster,
        pytest.raises(VaporTrackError, match=r"Dask scheduler has vapor-track \S+, expected 0.0.0"),
    ):
        on(cluster, abs, [(1,)])


def test_a_worker_of_several_threads_is_refused():
    with (
        LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address=":0") as cluster,
        pytest.raises(VaporTrackError, match=r"has 2 threads, expected one: dask worker SCHEDULER --nthreads 1"),
    ):
        on(cluster, abs, [(1,)])


def test_jobs_wait_for_a_worker_and_that_is_said(caplog):
    with LocalCluster(n_workers=0, threads_per_worker=1, processes=False, dashboard_address=":0") as cluster:
        monitor = cluster_module.logging.getLogger("vapor.cluster")
        monitor.addFilter(lambda record: cluster.scale(1) or True)  # as soon as it is said, there is one
        assert on(cluster, abs, [(-3,)]) == [(0, 3)]
        monitor.filters.clear()
    assert "the Dask scheduler has no worker yet" in caplog.text


def test_a_scheduler_that_ends_is_said(thread):
    results = in_parallel(jobs.wait, [(n,) for n in range(50)], 1, scheduler=thread.scheduler_address)
    next(results)
    thread.close()
    with pytest.raises(VaporTrackError, match="the Dask scheduler ended, or cancelled the jobs"):
        list(results)
