"""Processes that are killed and disks that are full: old results or new ones stay, whole."""

import errno
import fcntl
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress

import pytest

from sequences.atomic import NEW, clear_leftovers, move_in, workspace
from sequences.errors import SequenceError
from sequences.outputs import MANIFEST, read_manifest, verify
from tests.helpers.full_disk import ENOUGH, filling
from tests.helpers.results import WRITES, whole, write

# --- processes that are killed --------------------------------------------------------------------


def test_leftovers_of_the_dead_go_and_those_of_the_living_stay(tmp_path):
    dead = tmp_path / ".out.0123abcd.partial"
    (dead / NEW).mkdir(parents=True)
    (tmp_path / ".mine.partial").write_text("mine")
    with workspace(tmp_path, "other") as living:
        (living / "file").write_text("half")
        write(tmp_path / "out", "first")
        assert (living / "file").exists()
        assert set(os.listdir(tmp_path)) == {"out", living.name, ".mine.partial"}


@pytest.mark.parametrize("after", range(8))
def test_files_that_were_half_replaced_are_put_back(after, tmp_path):
    """The process dies between two renames; of what it leaves the next one makes the results that were there."""
    write(tmp_path, "first", sometimes=True)
    work = tmp_path / ".out.0123abcd.partial"
    write(tmp_path / "made", "second")
    (tmp_path / "made").rename(work)
    (work / NEW).mkdir()
    for name in ("a.tum", "b.json", MANIFEST):
        (work / name).rename(work / NEW / name)
    (work / NEW / "added").write_text("second")
    rename, left = os.rename, iter(range(after))

    def dying(*paths: object) -> None:
        if next(left, None) is None:
            raise InterruptedError
        rename(*paths)

    moving = pytest.MonkeyPatch()
    moving.setattr(os, "rename", dying)
    with pytest.raises(InterruptedError):
        move_in(work, ["a.tum", "b.json", "added", MANIFEST], instead_of=[MANIFEST, "sometimes.png"])
    moving.undo()
    verify(tmp_path, WRITES)
    assert whole(tmp_path) == "first"
    assert set(os.listdir(tmp_path)) == {*WRITES, MANIFEST}


def test_results_that_are_being_replaced_are_not_read(tmp_path):
    write(tmp_path, "first")
    with workspace(tmp_path, "out"):
        (tmp_path / MANIFEST).unlink()
        with pytest.raises(SequenceError, match="being replaced"):
            verify(tmp_path, WRITES)


WRITER = """
import sys
sys.path[:] = eval(sys.argv.pop(1))
from pathlib import Path
from sequences.atomic import atomic_output
from sequences.outputs import results_folder
for number in range(10**6):
    with results_folder(Path(sys.argv[1]), "run", writes=("a.tum", "b.json", "sometimes.png")) as new:
        for name in ("a.tum", "b.json") + ("sometimes.png",) * (number % 2):
            with atomic_output(new / name) as partial:
                partial.write_text(f"{number}\\n" * 500)
    print(number, flush=True)
"""


def test_kills_at_random_moments_leave_whole_results(tmp_path):
    kills = int(os.environ.get("KILLS", "15"))
    rng = random.Random(0)
    out = tmp_path / "out"
    for _ in range(kills):
        process = subprocess.Popen(
            [sys.executable, "-S", "-c", WRITER, repr(sys.path), str(out)],
            stdout=subprocess.PIPE,
        )
        assert process.stdout is not None
        assert process.stdout.readline()
        time.sleep(0.05 * rng.random())
        process.send_signal(signal.SIGKILL)
        process.communicate()
        if (out / MANIFEST).exists():
            assert all(listed.is_of(out / name) for name, listed in read_manifest(out)["files"].items())
        clear_leftovers(tmp_path)
        verify(out, WRITES)
        whole(out)
        assert os.listdir(tmp_path) == ["out"]


@pytest.mark.parametrize("removed", ["new", "added", "replaced"])
def test_a_process_that_was_killed_while_it_removed_its_workspace_leaves_complete_results(removed, tmp_path):
    write(tmp_path, "second")
    work = tmp_path / ".out.0123abcd.partial"
    for folder, file in (("new", "c.txt"), ("added", "b.json"), ("replaced", "000000.a.tum")):
        if folder != removed:
            (work / folder).mkdir(parents=True)
            (work / folder / file).write_text("first")
    verify(tmp_path, WRITES)
    assert whole(tmp_path) == "second"
    assert not work.exists()


# --- full disks -----------------------------------------------------------------------------------


def test_a_disk_that_is_full_at_any_call_leaves_the_old_results(tmp_path):
    write(tmp_path / "out", "first", sometimes=True)
    with filling(ENOUGH):
        write(tmp_path / "other", "second")
        write(tmp_path / "other", "third", sometimes=True)
    calls = 0
    while True:
        with filling(calls), suppress(SequenceError):
            write(tmp_path / "out", "second")
            break
        if calls % 5 == 0:
            with filling(calls), pytest.raises(SequenceError, match=r"^[^\n]*No space left[^\n]*$"):
                write(tmp_path / "out", "second")
        clear_leftovers(tmp_path / "out")
        clear_leftovers(tmp_path)
        assert whole(tmp_path / "out") == "first"
        assert set(os.listdir(tmp_path)) == {"out", "other"}
        calls += 1
    assert calls > 10
    assert whole(tmp_path / "out") == "second"


def test_a_file_system_without_locks_can_be_written_to(tmp_path, monkeypatch):
    def fails(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", fails)
    (tmp_path / ".out.0123abcd.partial").mkdir()
    write(tmp_path / "out", "first")
    assert whole(tmp_path / "out") == "first"
    assert (tmp_path / ".out.0123abcd.partial").exists()  # who knows whose it is
