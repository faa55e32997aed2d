"""Whole commands on a disk that is full from some call on: one line, and earlier results are whole.

With `FULL=1` it is full at every call in turn; in the suite at one of each command.
"""

import random
import shutil

import numpy as np
import pytest

from filtering.errors import MAX_MESSAGE
from filtering.se3 import Poses
from sequences.frame import Trajectory
from sequences.trajectories.tum import write_tum
from tests.helpers.command_line import main
from tests.helpers.full import FULL, some
from tests.helpers.full_disk import ENOUGH, filling
from tests.helpers.killed_commands import CALLS, Call, Killing, write_inputs
from tests.helpers.sequence_files import Walk
from tests.helpers.tiny_model import SMALL

MORE = {
    "synthesize": Call(
        ("synthesize", "ceiling", "out/result.mcap", "--frames", "6", "--width", "32", "--height", "24")
    ),
    "posterior": Call(
        ("posterior", "walk.mcap", "--model", "tiny.safetensors", "--output", "out/result.png", *SMALL[:4])
    ),
    "evaluate": Call(("evaluate", "trajectories", "--output", "out/result.json")),
}
ALL = CALLS | MORE

pytestmark = pytest.mark.usefixtures("unchecked", "rough_light")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working directory, with all that the calls read."""
    monkeypatch.chdir(tmp_path)
    write_inputs(tmp_path)
    (tmp_path / "trajectories").mkdir()
    times_ns, poses = zip(*Walk(12).truth, strict=True)
    for name in ("trajectory.tum", "ground_truth.tum"):
        write_tum(tmp_path / "trajectories" / name, Trajectory(np.array(times_ns), Poses.stack(poses)))
    return tmp_path


@pytest.mark.parametrize("name", some(5, sorted(ALL, key=["train", "benchmark", "regressors"].__contains__)))
def test_a_command_whose_disk_is_full_says_so_in_a_line_and_leaves_what_was_there(name, folder, capfd):
    call, old = ALL[name], folder / "old"
    found = Killing(call, folder, None)
    with filling(ENOUGH) as disk:
        assert main([*call.words]) == 0
    before = found.found()
    shutil.copytree(found.out, old)
    if call.grows:  # it replaces its tables, and keeps what it finds, one by one
        with filling(ENOUGH) as disk:
            assert main([*call.words, *call.again]) == 0
    calls, known = ENOUGH - disk.room, before + found.found()
    names = {each for each, _ in known}

    rooms, full = range(calls) if FULL else [random.Random(name).randrange(calls * 3 // 4)], 0
    for room in rooms:
        found.put_back(old)
        capfd.readouterr()
        with filling(room) as disk:
            status = main([*call.words, *call.again])
        last = capfd.readouterr().err.splitlines()[-1:]
        if disk.room >= 0:  # the number of writes to a recording varies
            assert status == 0
            continue
        full += 1
        assert status == 1
        assert last[0].startswith(f"{call.command}: ")
        assert "No space left on device" in last[0]
        assert len(last[0]) <= MAX_MESSAGE
        assert found.leftovers == []
        now = found.found()
        assert [each for each, what in now if each in names and (each, what) not in known] == []
        assert {each for each, _ in before} <= {each for each, _ in now}
        if not call.grows:
            assert [each for each in before if each not in now] == []
    assert full > 0, "the disk was never full"
    print(f"{name}: full at {full} of {calls} calls: one line each, the old results whole, nothing left over")
