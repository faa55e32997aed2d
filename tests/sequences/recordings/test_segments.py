"""Where reading ends early: what is missed, and what is counted."""

from dataclasses import replace
from pathlib import Path

import pytest
from mcap.writer import IndexType

from sequences.datasets.frames import posed_frames
from sequences.errors import SequenceError
from sequences.images.video import ImageStream
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.reading.counts import OUTSIDE
from tests.helpers.lossy_mcap import chunks, lose_ten, without_ten_images
from tests.helpers.sequence_files import BEGIN_NS, IMAGES, Walk, rewrite, write_listing


@pytest.fixture(scope="module")
def long_walk_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Walk(180).write(tmp_path_factory.mktemp("long") / "walk.mcap")


def long_walk(source: Path, folder: Path, **options: object) -> Path:
    """A third of a minute, in chunks of a few images, without checksums."""
    settings = {"chunk_size": 3000, "enable_crcs": False, "enable_data_crcs": False, **options}
    return rewrite(source, folder / "long.mcap", **settings)


FORMS_OF_FILES = [{}, {"index_types": IndexType.NONE, "repeat_channels": True}, {"use_chunking": False}]


@pytest.mark.parametrize("options", FORMS_OF_FILES)
def test_images_lost_within_the_segment_are_missed_where_reading_ends_behind_it(
    options: dict[str, object], long_walk_file: Path, tmp_path: Path
) -> None:
    """The lost ones are not taken for images behind the segment."""
    path = long_walk(long_walk_file, tmp_path, **options)
    for segment in (SequenceOptions(duration_s=1.0), SequenceOptions(start_s=2.0, duration_s=1.0)):
        reader = SequenceReader(path, replace(segment, ground_truth_topic=""), odometry="unread")
        assert len(list(reader)) == 11
        assert reader.counts.skipped == {OUTSIDE: 180 - 11}
        assert reader.counts.read < 180
    lost, data = tmp_path / "lost.mcap", bytearray(path.read_bytes())
    if options.get("use_chunking", True):
        without_ten_images(data)
    else:
        lose_ten(data, [(0, 8, len(data) - 8)])
    lost.write_bytes(data)
    said = rf"lost\.mcap: {IMAGES}: 170 messages found where the file states 180"
    with pytest.raises(SequenceError, match=said):
        list(SequenceReader(lost, SequenceOptions(duration_s=1.0, ground_truth_topic=""), odometry="unread"))
    frames = posed_frames(lost, frames=slice(2, 25))
    with pytest.raises(SequenceError, match=said):
        list(frames)


def test_what_lies_behind_the_segment_is_counted_without_being_opened(long_walk_file: Path, tmp_path: Path) -> None:
    path = long_walk(long_walk_file, tmp_path)
    data = bytearray(path.read_bytes())
    for _, begin, end in chunks(data)[-5:]:
        data[begin:end] = bytes(end - begin)  # no records at all
    path.write_bytes(data)
    reader = SequenceReader(path, SequenceOptions(duration_s=1.0, ground_truth_topic=""), odometry="unread")
    assert len(list(reader)) == 11
    assert reader.counts.are_complete
    with pytest.raises(SequenceError):
        list(SequenceReader(path, SequenceOptions(ground_truth_topic=""), odometry="unread"))


def test_each_file_of_a_folder_is_read_up_to_the_end_of_the_segment(long_walk_file: Path, tmp_path: Path) -> None:
    """Files that run side by side: that the first is over says nothing of the second."""
    source = long_walk_file
    bag = tmp_path / "bag"
    bag.mkdir()
    rewrite(source, bag / "a.mcap", keep=lambda topic, _: topic != IMAGES)
    rewrite(source, bag / "b.mcap", keep=lambda topic, time_ns: topic == IMAGES and time_ns < BEGIN_NS + 15 * 10**9)
    rewrite(source, bag / "c.mcap", keep=lambda topic, time_ns: topic == IMAGES and time_ns >= BEGIN_NS + 15 * 10**9)
    write_listing(bag)
    reader = SequenceReader(bag, SequenceOptions(duration_s=1.0, ground_truth_topic=""), odometry="unread")
    assert len(list(reader)) == 11
    assert reader.counts.skipped == {OUTSIDE: 180 - 11}
    assert reader.counts.are_complete


def test_who_stops_gets_no_more_frames_and_whole_counts(walk_of_25: Path) -> None:
    reader = SequenceReader(walk_of_25)
    frames = iter(reader)
    taken = [next(frames) for _ in range(7)]
    reader.stop()
    assert list(frames) == []
    assert len(taken) == reader.counts.used == 7
    assert reader.counts.skipped == {OUTSIDE: 18}
    assert reader.counts.warning is None
    assert len(list(reader)) == 25  # another iteration


def test_an_image_that_is_neither_used_nor_skipped_is_an_error(
    walk_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take, times = ImageStream.take, iter(range(100))
    monkeypatch.setattr(ImageStream, "take", lambda *given: [] if next(times) == 5 else take(*given))
    said = rf"walk\.mcap: {IMAGES}: 11 images used and 0 skipped, expected the 12 that are stated"
    with pytest.raises(SequenceError, match=said):
        list(SequenceReader(walk_file))
