"""The fuzzer itself: what it must notice, that its cases can be repeated, and that checksums are made to fit."""

import os
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from mcap.opcode import Opcode

from filtering.errors import MAX_MESSAGE
from sequences.errors import SequenceError
from tests.fuzz import __main__ as command
from tests.fuzz import cases
from tests.fuzz.cases import Sample
from tests.fuzz.damage import with_checksum
from tests.fuzz.mcap_damage import put_together, stated_images, take_apart
from tests.fuzz.readers import READERS
from tests.fuzz.reading import Reader, Reading, UnsoundError
from tests.helpers import exported

pytestmark = pytest.mark.usefixtures("unchecked")


def misbehave(path: Path) -> Reading:
    """Read a file that says how it is to be read."""
    word = path.read_text()
    if word == "key":
        raise KeyError(word)
    if word == "long":
        raise type("Long", (SequenceError,), {"__str__": lambda self: "x" * (MAX_MESSAGE + 1)})()
    if word == "refused":
        raise SequenceError("x" * MAX_MESSAGE)
    if word == "unsound":
        raise UnsoundError("camera of negative focal length")
    if word == "hang":
        time.sleep(60)
    if word == "crash":
        os._exit(3)
    if word == "memory":
        np.empty(5 * 2**29, np.uint8)
    if word == "hidden":
        try:
            bytearray(2**50)
        except MemoryError as error:
            raise SequenceError("damaged") from error
    if word == "warning":
        warnings.warn("of something", RuntimeWarning, stacklevel=1)
    items = {"lost": 2, "reported": 2}.get(word, 3)
    return Reading(word.encode() if word != "same" else b"whole", items, {"no image": 1} if word == "reported" else {})


WORDS = {
    "same": ("same", ""),
    "silent": ("silent", ""),
    "reported": ("reported", ""),
    "refused": ("refused", ""),
    "key": ("failure", "traceback: KeyError at"),
    "long": ("failure", "long message at"),
    "unsound": ("failure", "unsound camera"),
    "hang": ("failure", "hang over"),
    "crash": ("failure", "crash with exit status 3"),
    "memory": ("failure", "memory: over 2 GB"),
    "hidden": ("failure", "memory: over the limit"),
    "warning": ("failure", "warning: RuntimeWarning at"),
    "lost": ("failure", "images lost uncounted"),
}


def test_all_that_must_not_be_is_survived_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def make(folder: Path) -> Path:
        (folder / "a.txt").write_text("whole")
        return folder / "a.txt"

    monkeypatch.setattr(cases, "READERS", {word: Reader(make, misbehave, counts_images=True) for word in WORDS})
    monkeypatch.setattr(Sample, "changes", lambda self, seed, number: ({"a.txt": self.name.encode()}, "a word"))
    monkeypatch.setattr(command, "HANG_S", 2.0)
    times = {word: 1 if word == "hang" else 2 for word in WORDS}
    tallies = command.fuzz([(word, range(times[word])) for word in WORDS], seed=0, workers=4)
    for word, (outcome, cause) in WORDS.items():
        tally = tallies[word]
        assert tally.outcomes == {outcome: times[word]}, word
        if outcome == "failure":
            ((found, failure),) = tally.failures.items()
            assert found.startswith(cause)
            assert (failure.count, failure.number) == (times[word], 0)
        else:
            assert not tally.failures


def test_a_case_is_the_same_whenever_it_is_asked_for_and_leaves_the_sample_whole(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    one, two = Sample("estimates", tmp_path / "one"), Sample("estimates", tmp_path / "two")
    made = [one.changes(7, number) for number in range(20)]
    assert made == [two.changes(7, number) for number in range(20)]
    assert len({damage for _, damage in made}) > 15
    assert made != [one.changes(8, number) for number in range(20)]
    for changes, damage in made:
        one.judge(changes, damage)
    assert one.judge({}).outcome == "same"
    assert {str(f.relative_to(one.folder)): f.read_bytes() for f in one.folder.rglob("*") if f.is_file()} == one.files


@pytest.mark.parametrize(
    "name", ["mcap", "mcap-lz4", "mcap-zstd", "mcap-without-checksums", "mcap-without-chunks", "mcap-without-index"]
)
def test_an_mcap_file_put_together_again_is_whole_and_damage_is_under_checksums_that_fit(
    name: str, tmp_path: Path
) -> None:
    sample = Sample(name, tmp_path)
    ((file, data),) = sample.files.items()
    assert stated_images(data, "/camera/image/compressed") == 6
    for repair in (False, True):
        assert sample.judge({file: put_together(take_apart(data), repair=repair)}).outcome == "same"
    assert sample.judge({file: put_together(take_apart(data), repair=True, compression="zstd")}).outcome == "same"
    found = take_apart(data)
    of_odometry = [record for record in _messages(found) if 600 < len(record.body) < 800]
    odometry = of_odometry[len(of_odometry) // 2]
    odometry.body = odometry.body[:-8] + np.float64(0.5).tobytes()  # the last number of its covariance
    assert sample.judge({file: put_together(found, repair=True)}).outcome == "silent"
    if name in ("mcap", "mcap-lz4", "mcap-zstd"):
        assert sample.judge({file: put_together(found, repair=False)}).outcome == "refused"


def _messages(found: list) -> list:
    flat = [each for record in found for each in (record, *record.held)]
    return [record for record in flat if record.opcode == Opcode.MESSAGE]


@pytest.mark.parametrize("name", ["model", "model-retrieval", "training-state"])
def test_models_are_damaged_under_checksums_that_fit(name: str, tmp_path: Path) -> None:
    sample = Sample(name, tmp_path)
    ((file, data),) = sample.files.items()
    assert with_checksum(data) is not None
    altered = data[:-1] + bytes([data[-1] ^ 1])
    assert sample.judge({file: altered}).outcome == "refused"
    assert sample.judge({file: with_checksum(altered)}).outcome == "silent"


def test_exported_models_are_damaged_under_digests_and_checksums_that_fit(tmp_path: Path) -> None:
    sample = Sample("model-exported", tmp_path)
    ((file, data),) = sample.files.items()

    def altered(arrays: bytes) -> bytes:
        return arrays[:-1] + bytes([arrays[-1] ^ 1])

    def altered_and_fitting(arrays: bytes) -> bytes:
        fitting = with_checksum(altered(arrays))
        assert fitting is not None
        return fitting

    assert sample.judge({file: exported.with_arrays(data, altered)}).outcome == "refused"
    assert sample.judge({file: exported.with_arrays(data, altered_and_fitting)}).outcome == "silent"
    graph, entries = exported.take_apart(data)
    other = graph[:-1] + bytes([graph[-1] ^ 1])
    assert sample.judge({file: exported.put_together(other, entries)}).outcome == "refused"
    assert sample.judge({file: exported.with_digest(other, entries)}).outcome == "same"  # it is not looked into


def test_what_once_failed_fails_no_more() -> None:
    replayed = [*cases.replay()]
    assert replayed
    for name, verdict in replayed:
        assert verdict.outcome != "failure", f"{name}: {verdict.cause}: {verdict.details}: {verdict.damage}"


@pytest.mark.parametrize("name", READERS)
def test_a_few_damaged_files_are_refused_or_read_and_what_is_lost_is_counted(name: str, tmp_path: Path) -> None:
    sample = Sample(name, tmp_path)
    for number in range(5):  # `make fuzz` tries more
        verdict = sample.judge(*sample.changes(0, number))
        assert verdict.outcome != "failure", f"case {number}: {verdict.cause}: {verdict.details}: {verdict.damage}"
