"""Jobs in processes of this machine."""

import pytest
from joblib.externals.loky.process_executor import TerminatedWorkerError

from tests.helpers import jobs
from vapor import parallel
from vapor.parallel import in_parallel


def test_what_a_process_that_dies_had_begun_is_begun_again(tmp_path, caplog):
    results = in_parallel(jobs.end_once, [(tmp_path, number) for number in range(4)], 2)
    assert sorted(results) == [(number, number) for number in range(4)]
    assert (tmp_path / "ended").exists()
    (line,) = caplog.messages
    assert "a worker process ended unexpectedly" in line
    assert "of 4 jobs are begun again" in line


def test_a_job_that_ends_its_process_each_time_is_given_up(monkeypatch, caplog):
    monkeypatch.setattr(parallel, "_TRIES", 2)
    with pytest.raises(TerminatedWorkerError):
        list(in_parallel(jobs.end, [(0,), (1,)], 2))
    assert len(caplog.messages) == 1


def test_one_process_is_this_one_and_does_a_job_when_its_result_is_asked_for():
    done = []
    results = in_parallel(done.append, [(0,), (1,)], 1)
    next(results)
    assert done == [0]
