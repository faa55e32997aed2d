"""Jobs on the workers of a Dask scheduler: two processes with delays in place of work."""

import os
import pickle
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from distributed import LocalCluster

from tests.helpers import cluster_jobs as jobs
from vapor.checkpoints.file_format import SHIPPED
from vapor.commands.workers import hush_dask, workers_for
from vapor.parallel import cluster as cluster_module
from vapor.parallel.cluster import About, ClusterError, connected, packed
from vapor.parallel.jobs import Workers, in_parallel
from vapor.storage import local_path


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    hush_dask()
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
        yield cluster.scheduler_address


def until(condition, seconds: float = 20.0) -> None:
    end_s = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def test_two_workers_do_two_jobs_at_a_time_and_what_a_killed_one_was_doing_is_done_again(address, tmp_path):
    told = []
    with connected(address, told.append) as cluster:
        assert cluster.size == 2
        results = in_parallel(
            jobs.sleep, [(tmp_path, n, 1.0 if n < 2 else 0.01) for n in range(6)], Workers(1, cluster)
        )

        def kill() -> None:
            until(lambda: len(jobs.begun(tmp_path)) >= 2)  # both are at work for a second
            os.kill(jobs.begun(tmp_path)[0][1], signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        assert sorted(results) == [0, 1, 2, 3, 4, 5]
        killer.join()
        first = [pid for number, pid in jobs.begun(tmp_path) if number == 0]
        assert len(first) == 2
        until(lambda: told)
        assert "went away; its job is done again by others" in told[0]
        until(lambda: cluster.size == 2)


def test_a_full_disk_is_told_with_worker_and_path_and_the_others_go_on(address):
    with connected(address, lambda line: None) as cluster:
        results, failed = [], None
        try:
            for result in in_parallel(jobs.fill_disk, [(n,) for n in range(5)], Workers(1, cluster)):
                results.append(result)
        except ClusterError as error:
            failed = str(error)
    assert sorted(results) == [0, 2, 3, 4]
    assert failed is not None
    assert failed.startswith("1 of 5 jobs failed, the others are done; worker tcp://")
    assert failed.endswith(": /scratch/result.json: No space left on device")


def test_what_is_queued_is_cancelled_when_nobody_waits_for_it_any_more(address, tmp_path):
    with connected(address, lambda line: None) as cluster:
        results = in_parallel(jobs.sleep, [(tmp_path, n, 0.2) for n in range(20)], Workers(1, cluster))
        next(results)
        results.close()  # as Ctrl-C does
        time.sleep(0.5)
        begun = len(jobs.begun(tmp_path))
        time.sleep(0.3)
        assert len(jobs.begun(tmp_path)) == begun < 8


def test_workers_of_another_version_are_refused_by_name_also_those_that_come_later(address, monkeypatch):
    with connected(address, lambda line: None) as cluster:
        later = replace(cluster, expected=About("9.9", "abc"))
        with pytest.raises(ClusterError, match=r"worker tcp://\S+ has vapor-track .*, expected vapor-track 9\.9 with"):
            list(in_parallel(jobs.fill_disk, [(0,)], Workers(1, later)))
    monkeypatch.setattr(cluster_module, "code_digest", lambda *_: "changed")
    with (
        pytest.raises(
            ClusterError, match=r"worker tcp://\S+ has .* expected .* code changed .* as here; so have 1 more"
        ),
        connected(address, lambda line: None),
    ):
        pass


def test_an_output_that_a_worker_does_not_see_is_refused(address, tmp_path, monkeypatch):
    with connected(address, lambda line: None) as cluster:
        workers = Workers(1, cluster)
        workers.require_to_see(tmp_path)
        assert not list(tmp_path.iterdir())
        monkeypatch.setattr(Path, "absolute", lambda path: Path("/elsewhere"))
        with pytest.raises(ClusterError, match=r"worker tcp://\S+ does not see .*, expected a disk that all see"):
            workers.require_to_see(tmp_path)


def test_the_dashboard_is_named(address, capsys):
    with workers_for("run", 1, address) as workers:
        assert not workers.are_this_process
    err = capsys.readouterr().err
    assert err.startswith(f"vapor-track run: {address} has 2 workers, dashboard http://")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("scheduler", "message"),
    [
        ("tcp://127.0.0.1:9", r"no answer within 0\.3 s; expected a Dask scheduler"),
        ("127.0.0.1", "missing port"),
        ("foo://127.0.0.1:9", "unknown address scheme"),
    ],
)
def test_a_scheduler_that_is_not_there_is_told(scheduler, message, monkeypatch):
    monkeypatch.setattr(cluster_module, "_PATIENCE_S", 0.3)
    with pytest.raises(ClusterError, match=message), connected(scheduler, lambda line: None):
        pass


def test_a_scheduler_that_goes_away_is_told(monkeypatch):
    monkeypatch.setattr(cluster_module, "_PATIENCE_S", 1.0)
    hush_dask()
    with (
        LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0") as local,
        connected(local.scheduler_address, lambda line: None) as cluster,
    ):
        results = in_parallel(time.sleep, [(0.1,)] * 20, Workers(1, cluster))
        next(results)
        local.close()
        with pytest.raises(ClusterError, match=r"the scheduler went away; finished jobs stay"):
            list(results)


def test_paths_mean_the_same_on_another_machine(tmp_path, monkeypatch):
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
    monkeypatch.setenv("XDG_CACHE_HOME", str(here))
    monkeypatch.chdir(here)
    copy = local_path("s3://bucket/walk.mcap")
    content = packed(Path.joinpath, (Path("walk.mcap"), copy, SHIPPED / "ceiling.safetensors", {"in": [Path("x")]}))
    monkeypatch.chdir(there)
    monkeypatch.setenv("XDG_CACHE_HOME", str(there))
    monkeypatch.setattr(cluster_module, "_PACKAGE", Path("/usr/lib/vapor"))
    _, (relative, other_copy, shipped, nested) = pickle.loads(content)
    assert relative == here / "walk.mcap"
    assert other_copy == local_path("s3://bucket/walk.mcap") != copy
    assert shipped == Path("/usr/lib/vapor/models/ceiling.safetensors")
    assert nested == {"in": [here / "x"]}
