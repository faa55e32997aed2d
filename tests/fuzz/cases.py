"""One damaged file: which it is by reader, seed and number, what the reader makes of it, and how to keep it."""

import base64
import json
import resource
import tempfile
import traceback
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from filtering.errors import MAX_MESSAGE, VaporTrackError
from tests.fuzz.damage import damage_of, pick
from tests.fuzz.readers import READERS
from tests.fuzz.reading import Reader, Reading, UnsoundError

Changes = Mapping[str, bytes | None]
"""Content of files that are not as in the sample, by path; None for those that are gone."""

Outcome = Literal["refused", "same", "told", "silent", "failure"]
"""Refused with an error of ours, read as if nothing had happened, read with a difference that was counted or said, or
read with one that was not; or what must not be."""

MOST_CHARACTERS = MAX_MESSAGE
MOST_MEMORY = 2 * 2**30
_CORPUS = Path(__file__).with_name("corpus.jsonl")
_MOST_KEPT = 20480  # bytes of a line


@dataclass(frozen=True)
class Verdict:
    """What came of one damaged file.

    Attributes:
        outcome: See `Outcome`.
        cause: Of a failure: what happened and where; the same for all files that fail alike.
        said: Of a failure, more of it.
        damage: What was done to the file.
        size: How many bytes differ from the sample.
    """

    outcome: Outcome
    cause: str = ""
    said: str = ""
    damage: str = ""
    size: int = 0


class Sample:
    """A reader's sample in a folder, whole between cases."""

    def __init__(self, name: str, folder: Path, reader: Reader | None = None) -> None:
        self.name = name
        self.folder = folder
        self._reader = reader or READERS[name]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._path = self._reader.make(folder)
            self.files = {
                str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()
            }
            self._whole = self._reader.read(self._path)
        if self._reader.image_topic is not None and self._reader.stated(self._path) != self._whole.items:
            raise RuntimeError(f"{name}: {self._whole.items} images read of {self._reader.stated(self._path)} stated")

    def changes(self, seed: int, number: int) -> tuple[Changes, str]:
        """The damage of a case, and what it is in words; the same whenever it is asked for."""
        rng = np.random.default_rng([seed, zlib.crc32(self.name.encode()), number])
        images = (".png", ".jpg")
        described = [name for name in self.files if not name.endswith(images)]
        changed: dict[str, bytes | None] = {}
        told = []
        for _ in range(1 if rng.random() < 0.8 else int(rng.integers(2, 4))):
            name = pick(rng, described if described and rng.random() < 0.8 else [*self.files])
            before = changed.get(name, self.files[name])
            if before is None or rng.random() < 0.03:
                # Not one of its kind: that may be a whole list of other images.
                other = pick(rng, [each for each in self.files if not each.endswith(Path(name).suffix)] or [name])
                changed[name] = pick(rng, (None, b"", self.files[other]))
                told.append(f"{name}: gone, empty, or {other}")
                continue
            try:
                changed[name], words = damage_of(name)(before, rng)
            except Exception as error:  # of what is damaged already, more may not be understood
                if not told:
                    raise RuntimeError(f"damaging {name} of {self.name}, case {number}") from error
                continue
            told.append(f"{name}: {words}")
        return changed, "; ".join(told)

    def judge(self, changes: Changes, damage: str = "") -> Verdict:
        """What the reader makes of the sample with some of its files changed."""
        with self._changed(changes):
            peak = _peak_memory()
            with warnings.catch_warnings(record=True) as warned:
                warnings.simplefilter("always")
                outcome, cause, said = self._read()
            if warned and outcome != "failure":
                first = warned[0]
                where = f"{Path(first.filename).name}:{first.lineno}"
                outcome, cause, said = "failure", f"warning: {first.category.__name__} at {where}", str(first.message)
            if _peak_memory() - peak > MOST_MEMORY:
                outcome, cause = "failure", "memory: over 2 GB"
        size = sum(_difference(self.files[name], data) for name, data in changes.items())
        return Verdict(outcome, cause, said[:400], damage, size)

    def _read(self) -> tuple[Outcome, str, str]:
        try:
            found = self._reader.read(self._path)
            if self._reader.counts_images and (lost := self._lost(found)):
                return "failure", "images lost uncounted", lost
        except VaporTrackError as error:
            if any(isinstance(each, MemoryError) for each in _chain(error)):
                return "failure", "memory: over the limit", str(error)
            if (length := len(str(error).replace(str(self.folder), ""))) > MOST_CHARACTERS:  # wherever it lies
                return "failure", f"long message at {_place(error)}", f"{length} characters: {error}"
            return "refused", "", ""
        except UnsoundError as error:
            return "failure", f"unsound {str(error).split()[0]}", str(error)
        except MemoryError as error:
            return "failure", f"memory: over the limit at {_place(error)}", ""
        except Exception as error:
            return "failure", f"traceback: {type(error).__name__} at {_place(error)}", str(error)
        if found.content == self._whole.content:
            return "same", "", ""
        return ("silent" if found.told == self._whole.told else "told"), "", ""

    def _lost(self, found: Reading) -> str:
        """How images were lost without a word; nothing where none was, or where no reader can know of it."""
        stated = self._reader.stated(self._path)
        counted = found.items + found.images_told
        if any(each.endswith("not read") for each in found.told):  # a file of a folder, by its name
            return ""
        if stated is not None:
            return f"{stated} stated, {found.items} read, {dict(found.told)}" if counted < stated else ""
        silent = self._reader.image_topic is None and found.told == self._whole.told
        return f"{found.items} of {self._whole.items} read" if silent and found.items < self._whole.items else ""

    @contextmanager
    def _changed(self, changes: Changes) -> Iterator[None]:
        try:
            for name, data in changes.items():
                if data is None:
                    (self.folder / name).unlink()
                else:
                    (self.folder / name).write_bytes(data)
            yield
        finally:
            for name in changes:
                (self.folder / name).write_bytes(self.files[name])


# --- what is kept ----------------------------------------------------------------------------------


def replay() -> Iterator[tuple[str, Verdict]]:
    """Readers and verdicts of the cases that once failed.

    Damaged files are kept whole: what else is made by numpy, OpenCV and compressors may have other last bits elsewhere.
    """
    entries = [json.loads(line) for line in _CORPUS.read_text(encoding="ascii").splitlines()]
    for name in dict.fromkeys(entry["reader"] for entry in entries):
        with tempfile.TemporaryDirectory() as folder:
            sample = Sample(name, Path(folder))
            for entry in entries:
                if entry["reader"] == name:
                    changes = {file: _unpacked(text) for file, text in entry["files"].items()}
                    yield name, sample.judge(changes, entry["damage"])


def keep(sample: Sample, changes: Changes, verdict: Verdict) -> bool:
    """Add a case to those that are kept; False where it is too large or there already."""
    files = {name: _packed(data) for name, data in changes.items()}
    line = json.dumps({"reader": sample.name, "cause": verdict.cause, "damage": verdict.damage[:200], "files": files})
    known = _CORPUS.read_text(encoding="ascii").splitlines() if _CORPUS.exists() else []
    if len(line) > _MOST_KEPT or any(json.loads(each)["files"] == files for each in known):
        return False
    _CORPUS.write_text("".join(f"{each}\n" for each in [*known, line]), encoding="ascii")
    return True


def _packed(data: bytes | None) -> str | None:
    return None if data is None else base64.b85encode(zlib.compress(data, 9)).decode()


def _unpacked(text: str | None) -> bytes | None:
    return None if text is None else zlib.decompress(base64.b85decode(text))


def _same(one: bytes, other: bytes) -> tuple[int, int]:
    """How many bytes are the same at the beginning, and of the rest at the end."""
    shortest = min(len(one), len(other))
    a, b = np.frombuffer(one[:shortest], np.uint8), np.frombuffer(other[:shortest], np.uint8)
    differs = np.flatnonzero(a != b)
    begin = int(differs[0]) if len(differs) else shortest
    a, b = (np.frombuffer(each[len(each) - shortest + begin :], np.uint8)[::-1] for each in (one, other))
    differs = np.flatnonzero(a != b)
    return begin, int(differs[0]) if len(differs) else shortest - begin


def _difference(whole: bytes, data: bytes | None) -> int:
    if data is None:
        return len(whole)
    begin, end = _same(whole, data)
    return max(len(whole), len(data)) - begin - end


# --- what happened ---------------------------------------------------------------------------------


def limit_memory() -> None:
    """Let this process take no more than three times the limit beside what it has, for want of which it would swap."""
    held = _status_bytes("VmSize")
    resource.setrlimit(resource.RLIMIT_AS, (held + 3 * MOST_MEMORY, held + 3 * MOST_MEMORY))


def _peak_memory() -> int:
    return _status_bytes("VmPeak")


def _status_bytes(name: str) -> int:
    status = Path("/proc/self/status")
    if not status.exists():  # elsewhere than on Linux memory is not watched
        return 0
    line = next(line for line in status.read_text().splitlines() if line.startswith(name))
    return 1024 * int(line.split()[1])


def _chain(error: BaseException) -> Iterator[BaseException]:
    """The error, and what it was raised from or while handling."""
    seen: set[int] = set()
    each: BaseException | None = error
    while each is not None and id(each) not in seen:
        seen.add(id(each))
        yield each
        each = each.__cause__ or each.__context__


def _place(error: BaseException) -> str:
    """The innermost line of ours."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        file = Path(frame.filename)
        if {"filtering", "sequences", "vapor"} & {file.parent.name, file.parent.parent.name}:
            return f"{file.name}:{frame.lineno} in {frame.name}"
    return "a place unknown"
