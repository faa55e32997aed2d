"""How a command ends: its status, what it says of errors of the machine, and the process itself."""

import os
import re
import subprocess
import sys
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest
import torch

from tests.helpers.checkout import CHECKOUT
from tests.helpers.command_line import refuse, words_of_run
from vapor.track import main


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "not enough memory"),
        (torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20 GiB"), "not enough memory"),
        (
            RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 9 bytes"),
            "not enough memory",
        ),
        (BrokenProcessPool("A child process terminated abruptly"), "a worker process ended unexpectedly"),
    ],
)
def test_a_machine_that_is_too_small_is_told_in_one_line(error, said, tmp_path, monkeypatch, capsys):
    def fail(_: object) -> None:
        raise error

    monkeypatch.setattr("vapor.commands.evaluate.main", fail)
    refuse(["evaluate", str(tmp_path)], capsys, said)


def test_any_other_error_of_the_program_itself_is_not_hidden(tmp_path, monkeypatch):
    def fail(_: object) -> None:
        raise RuntimeError("mat1 and mat2 shapes cannot be multiplied")

    monkeypatch.setattr("vapor.commands.evaluate.main", fail)
    with pytest.raises(RuntimeError, match="mat1"):
        main(["evaluate", str(tmp_path)])


def test_a_missing_gpu_is_told(walk_of_25, tiny_model, tmp_path, capsys):
    if torch.cuda.is_available():
        pytest.skip("this machine has a CUDA device")
    words = [*words_of_run(walk_of_25, tiny_model, tmp_path / "out"), "--device", "cuda"]
    refuse(words, capsys, "no CUDA device", "expected --device cpu or auto")


def process(words: list[str], folder: Path, *python: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(CHECKOUT), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONHASHSEED": "77"}
    command = [sys.executable, *python, *words]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)


def test_help_and_version_load_no_network_library(tmp_path):
    for word in ("--help", "--version"):
        done = process(["-m", "vapor.track", word], tmp_path, "-X", "importtime")
        assert done.returncode == 0
        loaded = {line.rsplit("|")[-1].strip() for line in done.stderr.splitlines()}
        assert "filtering.errors" in loaded  # importtime is read rightly
        assert not {"torch", "rerun", "cv2", "gtsam", "matplotlib"} & loaded


@pytest.mark.usefixtures("unchecked")
def test_a_signal_that_comes_when_the_results_are_complete_takes_nothing_away(
    walk_of_25, tiny_model, tmp_path, monkeypatch, capsys
):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("vapor.commands.run.show_files", interrupted)
    words = [*words_of_run(walk_of_25, tiny_model, tmp_path / "run"), "--duration-s", "0.5"]
    assert main(words) == 0
    assert "interrupted" not in capsys.readouterr().err
    assert (tmp_path / "run" / "manifest.json").exists()
    monkeypatch.setattr("vapor.commands.run.run", interrupted)
    assert main([*words, "--overwrite"]) == 130


@pytest.mark.usefixtures("unchecked")
def test_the_process_ends_with_the_status_of_the_command_and_gives_the_same_bytes(walk_of_25, tiny_model, tmp_path):
    wrong = process(["-m", "vapor.track", "localise"], tmp_path)
    assert (wrong.returncode, wrong.stdout) == (2, "")
    some = ["--duration-s", "0.5"]
    words = [*words_of_run(walk_of_25, tiny_model, tmp_path / "process"), *some]
    done = process(["-m", "vapor.track", *words], tmp_path)
    assert done.returncode == 0
    assert re.fullmatch(r"(localizing: .*\n)+", done.stderr)
    assert "particle filter" in done.stdout
    assert main([*words_of_run(walk_of_25, tiny_model, tmp_path / "here"), *some]) == 0
    for name in ("trajectory.tum", "smoothed.tum", "estimate.mcap"):
        assert (tmp_path / "process" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()
