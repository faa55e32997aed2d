"""The process that writes what a run leaves behind: its errors, its death, and that of the process it writes for."""

import os
import resource
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.reading.counts import ImageCounts
from tests.helpers.full import full, some
from tests.helpers.rerun_files import entities_of
from tests.helpers.simulated_run import simulated_steps
from tests.helpers.simulation import seen_at
from vapor.reporting.beside import outputs_beside
from vapor.reporting.output_process import output_process
from vapor.reporting.run_outputs import RunOutputs
from vapor.tracking.loop import Baselines
from vapor.tracking.methods import start_baselines

SETTINGS = {"recording": True, "view": False, "particles": 50}
FILTER = LocalizerConfig()


@pytest.fixture(scope="module")
def steps():
    return [(frame, replace(step, posterior=seen_at(frame.world_from_camera))) for frame, step in simulated_steps(12)]


def baselines() -> Baselines:
    return Baselines(start_baselines(FILTER, lambda: np.random.default_rng(0)))


def pid_of() -> int:
    with output_process() as process:
        return process.pid


def write(directory: Path, steps, error: Exception | None = None, *, kill: int | None = None) -> None:
    """Write steps; after the first an error may come, or the process be killed."""
    with outputs_beside(directory, FILTER, seed=0, **SETTINGS) as outputs:
        for frame, step in steps:
            outputs.add(frame, step)
            if kill is not None:
                os.kill(kill, signal.SIGKILL)
                kill = None
            if error is not None:
                raise error
        outputs.finish(skipped={}, images=ImageCounts(len(steps)))


@full
def test_the_same_is_written_and_recorded_as_in_this_process(tmp_path, steps):
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    at_end = {"smoothed": Poses.stack([frame.world_from_camera for frame, _ in steps])}
    with RunOutputs(baselines(), here, **SETTINGS) as outputs:
        for frame, step in steps:
            outputs.add(frame, step)
        same = outputs.record(skipped={"odd": 2}, images=ImageCounts(12), at_end=at_end)
    with outputs_beside(there, FILTER, seed=0, **SETTINGS) as outputs:
        for frame, step in steps:
            outputs.add(frame, step)
        record = outputs.finish(skipped={"odd": 2}, images=ImageCounts(12), at_end=at_end)
    assert sorted(path.name for path in there.iterdir()) == ["estimate.mcap", "recording.rrd"]
    assert (here / "estimate.mcap").read_bytes() == (there / "estimate.mcap").read_bytes()
    for name in ("times_ns", "covariance", "num_modes", "best_weight", "step_ms"):
        np.testing.assert_array_equal(getattr(record, name), getattr(same, name))
    assert record.methods.keys() == same.methods.keys() >= {"kalman", "gaussian_sum", "filter", "smoothed"}
    assert {"/world/path/smoothed", "/world/path/dead_reckoning"} <= entities_of(there / "recording.rrd")
    for name, trajectory in same.methods.items():
        np.testing.assert_array_equal(record.methods[name].poses.as_matrix(), trajectory.poses.as_matrix())
    assert record.skipped == {"odd": 2}
    own_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    assert record.peak_rss_mb > own_mb + 50  # that of both


def test_an_error_of_the_loop_leaves_nothing_and_the_process_goes_on(tmp_path, steps):
    pid = pid_of()
    with pytest.raises(OSError, match="camera unplugged"):
        write(tmp_path, steps, OSError("camera unplugged"))
    assert list(tmp_path.iterdir()) == []
    write(tmp_path, steps)
    assert pid_of() == pid


@pytest.mark.usefixtures("unchecked")
def test_an_error_of_what_is_written_comes_with_a_later_image_or_at_the_end_and_leaves_nothing(tmp_path, steps):
    pid = pid_of()
    with pytest.raises(VaporTrackError, match=r"expected the folder .*absent to exist"):
        write(tmp_path / "absent", steps[:1])
    broken = [(steps[0][0], replace(steps[0][1], estimate=None))]
    with pytest.raises(RuntimeError, match=r"in the process that writes the results:\n(.*\n)*AttributeError"):
        write(tmp_path, broken + steps)
    assert list(tmp_path.iterdir()) == []
    assert pid_of() == pid


def test_a_full_disk_is_told_in_the_words_that_it_has_in_this_process(tmp_path, steps):
    with output_process() as process:
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (20_000, 20_000))
    with pytest.raises(
        VaporTrackError, match=r"estimate.mcap: cannot write: File too large|recording\.rrd: .*File too"
    ):
        write(tmp_path, steps * 4)
    assert list(tmp_path.iterdir()) == []
    with output_process() as process:
        process.kill()


def test_a_process_that_is_killed_is_told_of_in_one_line_and_another_takes_its_place(tmp_path, steps):
    pid = pid_of()
    with pytest.raises(VaporTrackError, match="ended unexpectedly, perhaps for lack of memory"):
        write(tmp_path, steps * 20, kill=pid)
    assert pid_of() != pid


SCRIPT = """
import signal, sys, time
from dataclasses import replace
from pathlib import Path
from filtering.config import LocalizerConfig
from tests.helpers.simulated_run import simulated_steps
from tests.helpers.simulation import seen_at
from vapor.reporting.beside import outputs_beside

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
settings = {"seed": 0, "recording": True, "view": False, "particles": 50}
with outputs_beside(Path(sys.argv[1]), LocalizerConfig(), **settings) as outputs:
    for frame, step in simulated_steps(3):
        outputs.add(frame, replace(step, posterior=seen_at(frame.world_from_camera)))
    until = time.monotonic() + 30
    while len(list(Path(sys.argv[1]).iterdir())) < 2 and time.monotonic() < until:
        time.sleep(0.01)
    print(outputs._process.pid, flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize("number", some(1, [signal.SIGKILL, signal.SIGINT]))
def test_when_the_process_that_it_writes_for_dies_it_ends_and_leaves_nothing(number, tmp_path):
    """A script without a guard of `__main__`, in a group of its own as of a terminal, which gets the signal."""
    script, out = tmp_path / "script.py", tmp_path / "out"
    script.write_text(SCRIPT)
    out.mkdir()
    process = subprocess.Popen(
        [sys.executable, script, out],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        start_new_session=True,
    )
    assert process.stdout is not None
    writer = int(process.stdout.readline())
    assert len(list(out.iterdir())) == 2
    os.killpg(process.pid, number)
    process.communicate()
    until = time.monotonic() + 10.0
    while Path(f"/proc/{writer}").exists() and time.monotonic() < until:
        time.sleep(0.02)
    assert not Path(f"/proc/{writer}").exists()
    assert list(out.iterdir()) == []
