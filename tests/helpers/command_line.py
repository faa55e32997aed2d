"""Calls of the command, and checks of its output."""

import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.helpers.tiny_model import SMALL
from vapor import track
from vapor.benchmark import PROGRAM
from vapor.benchmark import __main__ as benchmark

EVERY_COMMAND = [*([name] for name in track.COMMANDS), *([PROGRAM, name] for name in benchmark.COMMANDS)]
"""The words that name each command, for `main`."""


def main(words: list[str]) -> int:
    """The exit status of a command: of `vapor-benchmark` where that is the first word, else of `vapor-track`."""
    return benchmark.main(words[1:]) if words[:1] == [PROGRAM] else track.main(words)


def words_of_run(sequence: Path | str, model: Path | str, output: Path, options: Sequence[str] = ()) -> list[str]:
    return ["run", str(sequence), "--model", str(model), "--output", str(output), *SMALL, "--no-recording", *options]


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refuse(words: list[str], capsys: pytest.CaptureFixture[str], *said: object) -> str:
    """Check that the command fails with status 1 and one line that contains all of `said`; the line."""
    capsys.readouterr()
    status = main(words)
    out, err = capsys.readouterr()
    assert status == 1, err
    assert out == ""
    assert err.startswith(f"{PROGRAM} {words[1]}: " if words[0] == PROGRAM else f"vapor-track {words[0]}: ")
    assert err.endswith("\n")
    assert err.count("\n") == 1
    for part in said:
        assert str(part) in err
    return err


def refuse_run(
    sequence: Path,
    model: Path | str,
    earlier: Path,
    capsys: pytest.CaptureFixture[str],
    *said: object,
    options: Sequence[str] = (),
) -> str:
    """`refuse`, into a new directory and into one that holds a result: neither may change; the line."""
    inputs = contents(earlier.parent)
    new = earlier.parent / "new"
    line = refuse(words_of_run(sequence, model, new, options), capsys, *said)
    assert not new.exists()
    assert refuse(words_of_run(sequence, model, earlier, options), capsys) == line
    assert contents(earlier.parent) == inputs
    return line


def skipped_in_run(sequence: Path, model: Path, output: Path) -> tuple[int, dict[str, int]]:
    assert main(words_of_run(sequence, model, output)) == 0
    report = json.loads((output / "report.json").read_text())
    return report["frames"], report["skipped"]


def report_of(directory: Path) -> dict:
    return json.loads((directory / "report.json").read_text())
