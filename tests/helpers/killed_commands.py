"""Small calls of commands, and what is found where one was killed."""

import json
import os
import re
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from signal import SIGKILL
from tempfile import TemporaryDirectory
from typing import Any

from sequences.atomic import clear_leftovers, is_workspace
from sequences.outputs import MANIFEST, read_manifest
from tests.helpers.command_line import main
from tests.helpers.exported import take_apart
from tests.helpers.pages import ReadPage
from tests.helpers.sequence_files import Walk
from tests.helpers.tiny_model import SMALL, write_tiny_model
from vapor.engines.onnx_file import describe_onnx
from vapor.tensor_files import CHECKSUM, read_safetensors

LOADED = [
    *("tests.helpers.killed_commands", "vapor.track", "vapor.commands.terminal", "vapor.reporting.run_outputs"),
    "torch._dynamo",
    *("rerun", "pandas", "pyarrow.compute", "matplotlib.backends.backend_agg", "tyro._backends._argparse_formatter"),
    *("torch.onnx.utils", "onnx", "onnxruntime"),
    *(f"vapor.commands.{name}" for name in ("run", "train", "calibrate", "export")),
    *(f"vapor.benchmark.commands.{name}" for name in ("localization", "regressors")),
]

TINY = [
    *("--network.image-width", "32", "--network.image-height", "32", "--network.shortest-edge", "34"),
    *("--network.feature-dim", "16", "--epochs", "2", "--batch-size", "8"),
]

TIMES = {"step_ms", "peak_rss_mb", "seconds", "data", "test"}  # the last two say when recordings were rendered

NEVER_ALIKE = {".rrd", ".csv", ".md"}  # they contain times, or random numbers


@dataclass(frozen=True)
class Call:
    """A small call of a command that writes `out/result`, with or without a suffix.

    Attributes:
        words: After `vapor-track`, or after and with `vapor-benchmark`, in a folder that holds what is read.
        again: Options without which a call on top of the result would have nothing to do.
        grows: Whether the result is a folder that grows file by file; else it is replaced as one.
    """

    words: tuple[str, ...]
    again: tuple[str, ...] = ()
    grows: bool = False

    @property
    def command(self) -> str:
        """Program and command, as messages begin with them."""
        program, *command = self.words if self.words[0] == "vapor-benchmark" else ("vapor-track", *self.words)
        return f"{program} {command[0]}"


CALLS = {
    "run": Call(("run", "other.mcap", "--model", "tiny.safetensors", "--output", "out/result", *SMALL)),
    "train": Call(
        ("train", "walk.mcap", "other.mcap", "--preset", "demo", "--output", "out/result.safetensors", *TINY)
    ),
    "calibrate": Call(  # the tiny model knows no place, whose errors could be found
        ("calibrate", "tiny.safetensors", "walk.mcap", "--ood-only", "--output", "out/result.safetensors")
    ),
    "export": Call(("export", "tiny.safetensors", "out/result.onnx")),
    "benchmark": Call(
        (
            *("vapor-benchmark", "localization", "ceiling", "--models", "tiny.safetensors", "--output", "out/result"),
            *("--kinds", "no-cue", "--runs", "1", "--frames", "50", "--width", "32", "--height", "24"),
            *("--workers", "1", "--first-seed", "700", "--num-samples", "40", "--localizer.max-hypotheses", "30"),
        ),
        again=("--localizer.switch-ratio", "2"),
        grows=True,
    ),
    "regressors": Call(
        (
            *("vapor-benchmark", "regressors", "dinner-table", "--methods", "variational", "--seeds", "1"),
            *("--workers", "1", "--sequences", "1", "--frames", "32", "--test-sequences", "1", "--test-frames", "6"),
            *("--num-samples", "20", "--output", "out/result", "--train.no-calibrate"),
            *(word.replace("--", "--train.") for word in TINY),
        ),
        again=("--gamma", "0.2"),
        grows=True,
    ),
}


def write_inputs(folder: Path) -> None:
    """The model and recordings that the calls read."""
    write_tiny_model(folder / "tiny.safetensors")
    Walk(24).write(folder / "walk.mcap")
    Walk(12).write(folder / "other.mcap")


def work(folder: Path, words: list[str]) -> None:
    os.chdir(folder)
    with open("log", "w") as log:
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
    sys.exit(main(words))


def content_of(path: Path) -> Any:
    """The content of a result without durations; fails where it is not whole."""
    if path.is_dir():
        with TemporaryDirectory() as place:  # what the next command finds; what is there stays as it is
            seen = Path(shutil.copytree(path, Path(place) / path.name))
            clear_leftovers(seen)
            listed = read_manifest(seen)["files"]
            assert {*listed, MANIFEST} == set(os.listdir(seen))
            assert all(file.is_of(seen / name) for name, file in listed.items())
            return {name: content_of(seen / name) for name in listed}
    if path.suffix == ".safetensors":
        return read_safetensors(path)[0][CHECKSUM]
    if path.suffix == ".onnx":
        return describe_onnx(path).training, take_apart(path.read_bytes())[0]
    if path.suffix == ".json":
        return json.loads(path.read_text(), object_hook=lambda o: {k: v for k, v in o.items() if k not in TIMES})
    if path.suffix == ".html":
        page = ReadPage.of(path.read_text())
        return re.sub(r"[\d.]+ and [\d.]+ ms|[\d.]+ MB", "", page.words), page.data if page.scripts else None
    return None if path.suffix in NEVER_ALIKE else path.read_bytes()


class Killing:
    """A call in its own folder, which can be killed, and the files that it leaves."""

    def __init__(self, call: Call, folder: Path, processes: Any) -> None:
        self._call, self._folder, self.out, self._processes = call, folder, folder / "out", processes
        self.out.mkdir()

    def finish(self, *more: str) -> float:
        """Run to the end; gives how many seconds that took."""
        begin_s = time.monotonic()
        assert self._run(None, *more) == 0, (self._folder / "log").read_text()
        return time.monotonic() - begin_s

    def kill(self, after_s: float) -> bool:
        """Run, and kill what still runs after so many seconds; gives whether it did."""
        status = self._run(after_s, *self._call.again)
        assert status in (0, -SIGKILL), (self._folder / "log").read_text()
        return status != 0

    def _run(self, most_s: float | None, *more: str) -> int | None:
        process = self._processes.Process(target=work, args=(self._folder, [*self._call.words, *more]))
        process.start()
        process.join(most_s)
        process.kill()
        process.join()
        return process.exitcode

    def put_back(self, result: Path | None) -> None:
        """Leave nothing there but a result of before, or nothing."""
        shutil.rmtree(self.out)
        shutil.copytree(result, self.out) if result else self.out.mkdir()

    @property
    def leftovers(self) -> list[Path]:
        return [path for path in self.out.rglob(".*") if is_workspace(path.name)]

    def found(self) -> list[tuple[str, Any]]:
        """Names without digests, and contents, of everything that is replaced as one; None for a folder that grows."""
        paths = [path.relative_to(self.out) for path in sorted(self.out.rglob("*" if self._call.grows else "result*"))]
        return [
            (re.sub(r"-[0-9a-f]{10}\b", "", str(path)), None if self._grows(path) else content_of(self.out / path))
            for path in paths
            if not any(map(is_workspace, path.parts))
        ]

    def _grows(self, path: Path) -> bool:
        return self._call.grows and (self.out / path).is_dir()
