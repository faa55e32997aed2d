"""The sequences that paths stand for, and short names to tell their results apart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from sequences.recordings.recording_file import SUFFIXES
from vapor.storage import listed, url_of

SUMMARY = "summary.json"
"""Name of the file that says what came of many sequences, beside their results."""


def is_fleet(paths: Sequence[Path]) -> bool:
    """Whether these paths stand for several sequences: they are more than one, or a folder to search."""
    return len(paths) > 1 or (len(paths) == 1 and _found_in(paths[0]) not in ([], list(paths)))


def find_sequences(paths: Sequence[Path], output: Path) -> dict[str, Path]:
    """The sequences that are meant, by the names of their results, in order.

    A file or a rosbag2 folder is a sequence. Any other folder stands for all recordings in it and deeper, but for
    results of earlier runs; where it holds none it stands for itself, and fails when it is opened. What is found twice
    is localized once. A name is that of the file or folder, with those of folders above it where others have it too.
    Copies of what is in storage are found there, and not made.
    """
    found: dict[Path, Path] = {}
    for path in paths:
        for sequence in _found_in(path, leave_out=output.absolute()) or [path]:
            found.setdefault(sequence.resolve(), sequence)
    return dict(zip(unique_names(list(found)), found.values(), strict=True))


def _found_in(path: Path, leave_out: Path | None = None) -> list[Path]:
    """Sequences that a path stands for, in order of their names."""
    if url_of(path) is not None:
        return _found_in_storage(path)
    if not path.is_dir() or (path / "metadata.yaml").is_file():
        return [path]
    sequences: list[Path] = []
    for entry in sorted(path.iterdir()):
        if entry.name.startswith(".") or entry.absolute() == leave_out:
            continue
        if entry.is_dir() and (
            not entry.is_symlink() or (entry / "metadata.yaml").is_file()
        ):  # links may run in circles
            sequences += _found_in(entry, leave_out)
        elif entry.suffix in SUFFIXES and entry.is_file() and not _is_result(entry):
            sequences.append(entry)
    return sequences


def _found_in_storage(path: Path) -> list[Path]:
    files = listed(path)
    bags = {file.parent for file in files if file.name == "metadata.yaml"}
    if path in bags or path in files or not files:
        return [path]
    reports = {file.parent for file in files if file.name == "report.json"}
    single = (
        file
        for file in files
        if file.suffix in SUFFIXES
        and bags.isdisjoint(file.parents)
        and not (file.name == "estimate.mcap" and file.parent in reports)
    )
    return sorted([*bags, *single])


def _is_result(file: Path) -> bool:
    return file.name == "estimate.mcap" and (file.parent / "report.json").is_file()


def unique_names(sequences: Sequence[Path]) -> list[str]:
    """The shortest names that tell sequences apart; numbered where whole paths do not, as with `a.mcap` and `a/`."""
    parts = [(*path.parent.parts[1:], path.stem if path.suffix in SUFFIXES else path.name) for path in sequences]
    lengths = [1] * len(parts)
    while True:
        names = ["-".join(part[-length:]) for part, length in zip(parts, lengths, strict=True)]
        counts = Counter(name.casefold() for name in [*names, SUMMARY])
        longer = [
            min(length + (counts[name.casefold()] > 1), len(part))
            for name, length, part in zip(names, lengths, parts, strict=True)
        ]
        if longer == lengths:
            break
        lengths = longer
    taken: Counter[str] = Counter()
    for i, name in enumerate(names):
        taken[name.casefold()] += 1
        if counts[name.casefold()] > 1:
            names[i] = f"{name}-{taken[name.casefold()]}"
    return names
