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

Outcome = Literal["refused", "same", "reported", "silent", "failure"]
"""Refused with an error of ours; read as the whole file; read with a difference that was counted or reported, or with
one that was not; or a fault of the reader."""

_MOST_MEMORY = 2 * 2**30
_CORPUS = Path(__file__).with_name("corpus.jsonl")
_MOST_KEPT = 20480  # bytes of a line


@dataclass(frozen=True)
class Verdict:
    """The outcome of one damaged file.

    Attributes:
        outcome: See `Outcome`.
        cause: Of a failure: what happened and where; the same for all files that fail alike.
        details: Of a failure.
        damage: What was done to the file.
    """

    outcome: Outcome
    cause: str = ""
    details: str = ""
    damage: str = ""


class Sample:
    """A reader's sample in a folder, whole between cases."""

    def __init__(self, name: str, folder: Path, reader: Reader | None = None) -> None:
        self.name, self.folder = name, folder
        self._reader = reader or READERS[name]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._path = self._reader.make(folder)
            files = [file for file in sorted(folder.rglob("*")) if file.is_file()]
            self.files = {str(file.relative_to(folder)): file.read_bytes() for file in files}
            self._whole = self._reader.read(self._path)
        if self._reader.image_topic is not None and self._reader.stated(self._path) != self._whole.items:
            raise RuntimeError(f"{name}: {self._whole.items} images read of {self._reader.stated(self._path)} stated")

    def changes(self, seed: int, number: int) -> tuple[Changes, str]:
        """The damage of a case, and its description; the same at every call."""
        rng = np.random.default_rng([seed, zlib.crc32(self.name.encode()), number])
        described = [name for name in self.files if not name.endswith((".png", ".jpg"))]
        changed: dict[str, bytes | None] = {}
        damages = []
        for _ in range(1 if rng.random() < 0.8 else int(rng.integers(2, 4))):
            name = pick(rng, described if described and rng.random() < 0.8 else [*self.files])
            before = changed.get(name, self.files[name])
            if before is None or rng.random() < 0.03:
                # A file of another kind: a whole list of other images, perhaps.
                other = pick(rng, [each for each in self.files if not each.endswith(Path(name).suffix)] or [name])
                changed[name] = pick(rng, (None, b"", self.files[other]))
                damages.append(f"{name}: gone, empty, or {other}")
                continue
            try:
                changed[name], words = damage_of(name)(before, rng)
            except Exception as error:  # a file that is damaged already may not be understood
                if not damages:
                    raise RuntimeError(f"damaging {name} of {self.name}, case {number}") from error
                continue
            damages.append(f"{name}: {words}")
        return changed, "; ".join(damages)

    def judge(self, changes: Changes, damage: str = "") -> Verdict:
        """Read the sample with some of its files changed."""
        with self._changed(changes), warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            peak = _status_bytes("VmPeak")
            outcome, cause, details = self._read()
            if warned and outcome != "failure":
                w = warned[0]
                cause = f"warning: {w.category.__name__} at {Path(w.filename).name}:{w.lineno}"
                outcome, details = "failure", str(w.message)
            if _status_bytes("VmPeak") - peak > _MOST_MEMORY:
                outcome, cause = "failure", "memory: over 2 GB"
        return Verdict(outcome, cause, details[:400], damage)

    def _read(self) -> tuple[Outcome, str, str]:
        try:
            found = self._reader.read(self._path)
            if self._reader.counts_images and (lost := self._lost(found)):
                return "failure", "images lost uncounted", lost
        except VaporTrackError as error:
            if any(isinstance(each, MemoryError) for each in _chain(error)):
                return "failure", "memory: over the limit", str(error)
            if (length := len(str(error).replace(str(self.folder), ""))) > MAX_MESSAGE:  # wherever it lies
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
        return ("silent" if found.reported == self._whole.reported else "reported"), "", ""

    def _lost(self, found: Reading) -> str:
        """How images were lost uncounted; empty where none was, or where no reader can know of it."""
        if any(each.endswith("not read") for each in found.reported):  # a file of a folder, by its name
            return ""
        if (stated := self._reader.stated(self._path)) is not None:
            counted = found.items + found.images_skipped
            return f"{stated} stated, {found.items} read, {dict(found.reported)}" if counted < stated else ""
        silent = self._reader.image_topic is None and found.reported == self._whole.reported
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


# --- the corpus ------------------------------------------------------------------------------------


def replay() -> Iterator[tuple[str, Verdict]]:
    """Readers and verdicts of the cases that once failed.

    Damaged files are kept whole: numpy, OpenCV and compressors may give other last bits elsewhere.
    """
    entries = [json.loads(line) for line in _CORPUS.read_text(encoding="ascii").splitlines()]
    for name in dict.fromkeys(entry["reader"] for entry in entries):
        with tempfile.TemporaryDirectory() as folder:
            sample = Sample(name, Path(folder))
            for entry in entries:
                if entry["reader"] == name:
                    packed = entry["files"].items()
                    changes = {file: text and zlib.decompress(base64.b85decode(text)) for file, text in packed}
                    yield name, sample.judge(changes, entry["damage"])


def keep(sample: Sample, changes: Changes, verdict: Verdict) -> bool:
    """Add a case to the corpus; False where it is too large or there already."""
    files = {
        name: None if data is None else base64.b85encode(zlib.compress(data, 9)).decode()
        for name, data in changes.items()
    }
    line = json.dumps({"reader": sample.name, "cause": verdict.cause, "damage": verdict.damage[:200], "files": files})
    known = _CORPUS.read_text(encoding="ascii").splitlines() if _CORPUS.exists() else []
    if len(line) > _MOST_KEPT or any(json.loads(each)["files"] == files for each in known):
        return False
    _CORPUS.write_text("".join(f"{each}\n" for each in [*known, line]), encoding="ascii")
    return True


# --- memory and errors -----------------------------------------------------------------------------


def limit_memory() -> None:
    """Limit this process to three times the allowed memory beside what it has, so that it does not swap."""
    most = _status_bytes("VmSize") + 3 * _MOST_MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _status_bytes(name: str) -> int:
    status = Path("/proc/self/status")
    if not status.exists():  # elsewhere than on Linux memory is not watched
        return 0
    return next(1024 * int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith(name))


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """The error, and the errors from which or while handling which it was raised."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _place(error: BaseException) -> str:
    """The innermost line of ours."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        file = Path(frame.filename)
        if {"filtering", "sequences", "vapor"} & {file.parent.name, file.parent.parent.name}:
            return f"{file.name}:{frame.lineno} in {frame.name}"
    return "a place unknown"
