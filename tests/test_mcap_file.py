"""MCAP files that lie about themselves: what they lost is told, and no size is believed before it was checked."""

import re
import struct
import tracemalloc
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import lz4.frame
import pytest
import yaml
import zstandard
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType

from sequences.datasets.frames import posed_frames
from sequences.datasets.listing import list_images
from sequences.errors import SequenceError
from sequences.images.streams import Stills
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.reading.counts import OUTSIDE
from sequences.recordings.bag import Bag
from tests.sequence_files import BEGIN_NS, Walk, as_file_without_index, as_split_folder, rewrite, write_listing

IMAGES = "/camera/image/compressed"
CHUNK_HEAD = 9 + 8 + 8  # up to the uncompressed size: opcode, length and two times


@pytest.fixture(scope="module")
def walk_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Walk().write(tmp_path_factory.mktemp("walk") / "walk.mcap")


def records(data: bytes | bytearray, start: int = 8, end: int | None = None) -> Iterator[tuple[int, int, int]]:
    """Opcode, place and length of each record, its head left out."""
    while start < (len(data) - 8 if end is None else end):
        opcode, length = struct.unpack_from("<BQ", data, start)
        yield opcode, start + 9, length
        start += 9 + length


def chunks(data: bytes | bytearray) -> list[tuple[int, int, int]]:
    """Place of each chunk, and of the records in it where they are not compressed, from and to."""
    places = [(place, length) for opcode, place, length in records(data) if opcode == Opcode.CHUNK]
    return [
        (place, place + length - struct.unpack_from("<Q", data, place + 32)[0], place + length)
        for place, length in places
    ]


def id_of(data: bytes, topic: str) -> int:
    return next(
        struct.unpack_from("<H", data, place)[0]
        for opcode, place, length in records(data)
        if opcode == Opcode.CHANNEL and topic.encode() in data[place : place + length]
    )


def damaged(source: Path, target: Path, change: Callable[[bytearray], None], **options: object) -> Path:
    """A copy without checksums of its index, with uncompressed chunks, changed in place."""
    data = bytearray(rewrite(source, target, enable_crcs=False, enable_data_crcs=False, **options).read_bytes())
    change(data)
    target.write_bytes(data)
    return target


def without_ten_images(data: bytearray) -> None:
    """Ten of the records of images become ones of a kind that nobody knows."""
    lose_ten(data, chunks(data))


def lose_ten(data: bytearray, stretches: Iterable[tuple[int, int, int]]) -> None:
    images, left = id_of(data, IMAGES), 10
    for _, begin, end in stretches:
        for opcode, place, _ in records(data, begin, end):
            if opcode == Opcode.MESSAGE and struct.unpack_from("<H", data, place)[0] == images and left:
                data[place - 9], left = 0x90, left - 1
    assert left == 0


def with_forged_checksums(data: bytearray) -> None:
    without_ten_images(data)
    for place, begin, end in chunks(data):
        data[place + 24 : place + 28] = struct.pack("<I", zlib.crc32(data[begin:end]))


def with_ten_images_of_another_channel(data: bytearray) -> None:
    images, others, left = id_of(data, IMAGES), id_of(data, "/camera/camera_info"), 10
    for _, begin, end in chunks(data):
        for opcode, place, _ in records(data, begin, end):
            if opcode == Opcode.MESSAGE and struct.unpack_from("<H", data, place)[0] == images and left:
                data[place : place + 2], left = struct.pack("<H", others), left - 1


def with_chunks_indexed_as_of_others(data: bytearray) -> None:
    """The index says of most chunks that they have no images."""
    images, others = id_of(data, IMAGES), id_of(data, "/camera/camera_info")
    indexes = [place for opcode, place, _ in records(data) if opcode == Opcode.CHUNK_INDEX]
    for place in indexes[1:]:
        (length,) = struct.unpack_from("<I", data, place + 32)
        for at in range(place + 36, place + 36 + length, 10):
            if struct.unpack_from("<H", data, at)[0] == images:
                data[at : at + 2] = struct.pack("<H", others)


@pytest.mark.parametrize(
    ("change", "index_types"),
    [
        (without_ten_images, IndexType.ALL),
        (without_ten_images, IndexType.MESSAGE),
        (with_forged_checksums, IndexType.ALL),
        (with_ten_images_of_another_channel, IndexType.ALL),
        (with_chunks_indexed_as_of_others, IndexType.ALL),
    ],
)
def test_images_that_a_file_states_and_has_not_are_an_error(
    change: Callable[[bytearray], None], index_types: IndexType, walk_file: Path, tmp_path: Path
) -> None:
    path = damaged(walk_file, tmp_path / "lost.mcap", change, index_types=index_types, chunk_size=1000)
    reader = SequenceReader(path, SequenceOptions(ground_truth_topic=""), odometry="unread")
    with pytest.raises(SequenceError, match=rf"lost\.mcap: {IMAGES}: \d messages found where the file states 12"):
        list(reader)


def test_a_file_without_statistics_is_counted_by_the_indexes_beside_its_chunks(walk_file: Path, tmp_path: Path) -> None:
    options = {"index_types": IndexType.MESSAGE, "use_statistics": False, "chunk_size": 1000}
    path = damaged(walk_file, tmp_path / "lost.mcap", without_ten_images, **options)
    with pytest.raises(SequenceError, match=r"2 messages found where the file states 12"):
        list(SequenceReader(path, odometry="unread"))


def test_a_file_that_states_no_numbers_says_that_lost_images_cannot_be_told(walk_file: Path, tmp_path: Path) -> None:
    reader = SequenceReader(as_file_without_index(walk_file, tmp_path))
    assert len(list(reader)) == 12
    assert any("states no number of messages" in notice for notice in reader.notices)
    reader = SequenceReader(walk_file)
    assert len(list(reader)) == 12
    assert reader.notices == []


def bomb(source: Path, target: Path, compression: str, content: bytes, stated: int) -> Path:
    """A copy whose last chunk is another: of some compressed content that is said to be so large."""
    kind = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "": CompressionType.NONE}[compression]
    data = rewrite(source, target, compression=kind, index_types=IndexType.NONE, enable_data_crcs=False).read_bytes()
    place, length = [(place, length) for opcode, place, length in records(data) if opcode == Opcode.CHUNK][-1]
    name = compression.encode()
    chunk = data[place : place + 16] + struct.pack("<QII", stated, 0, len(name)) + name
    chunk += struct.pack("<Q", len(content)) + content
    body = data[: place - 9] + struct.pack("<BQ", Opcode.CHUNK, len(chunk)) + chunk + data[place + length :]
    at = next(place for opcode, place, _ in records(body) if opcode == Opcode.FOOTER)
    target.write_bytes(body[:at] + bytes(20) + body[at + 20 :])  # no index
    return target


ZEROS = bytes(1 << 27)
STREAMED = zstandard.ZstdCompressor().compressobj()


@pytest.mark.parametrize(
    ("compression", "content", "stated", "said"),
    [
        ("zstd", zstandard.compress(ZEROS), 1000, r"states 1000 bytes uncompressed, its zstd frame 134217728"),
        ("zstd", STREAMED.compress(ZEROS) + STREAMED.flush(), 1000, r"damaged MCAP"),  # of unknown size
        ("lz4", lz4.frame.compress(ZEROS), 1000, r"states 1000 bytes uncompressed, .* 1001 at least"),
        ("zstd", zstandard.compress(ZEROS), 1 << 40, r"states 1099511627776 bytes uncompressed, expected at most"),
        ("lz4", lz4.frame.compress(b""), 1 << 40, r"states 1099511627776 bytes uncompressed, expected at most"),
        ("", b"", 1 << 40, r"states 1099511627776 bytes uncompressed, expected at most"),
    ],
)
def test_a_chunk_that_unpacks_to_more_than_it_says_is_refused_before_it_does(
    compression: str, content: bytes, stated: int, said: str, walk_file: Path, tmp_path: Path
) -> None:
    path = bomb(walk_file, tmp_path / "bomb.mcap", compression, content, stated)
    tracemalloc.start()
    try:
        with pytest.raises(SequenceError, match=said):
            list(Bag(path).messages([IMAGES]))
        assert tracemalloc.get_traced_memory()[1] < 3e6
    finally:
        tracemalloc.stop()


def test_a_record_that_is_said_to_be_longer_than_the_file_is_refused(walk_file: Path, tmp_path: Path) -> None:
    def stretch(data: bytearray) -> None:
        place = next(place for opcode, place, _ in records(data) if opcode == Opcode.CHUNK)
        data[place - 8 : place] = struct.pack("<Q", 1 << 40)

    path = damaged(walk_file, tmp_path / "long.mcap", stretch)
    with pytest.raises(SequenceError, match=r"record of 1099511627776 bytes, which is beyond the end of the file"):
        list(Bag(path).messages([IMAGES]))


def test_a_footer_that_hides_what_the_file_states_is_refused(walk_file: Path, tmp_path: Path) -> None:
    def with_a_second_footer(data: bytearray) -> None:
        place = next(place for opcode, place, _ in records(data) if opcode == Opcode.STATISTICS)
        data[place - 9 : place - 9] = data[-37:-8]

    path = damaged(walk_file, tmp_path / "a.mcap", with_a_second_footer, use_chunking=False)
    with pytest.raises(SequenceError, match=r"footer with \d+ bytes behind it, expected it at the end"):
        Bag(path)


def test_chunks_that_all_claim_the_same_time_are_not_held_without_limit(
    walk_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def at_once(data: bytearray) -> None:
        for opcode, place, _ in records(data):
            if opcode == Opcode.CHUNK_INDEX:
                data[place : place + 8] = bytes(8)

    path = damaged(walk_file, tmp_path / "heap.mcap", at_once, chunk_size=1000)
    assert len(list(Bag(path).messages([IMAGES]))) == 12
    monkeypatch.setattr("sequences.recordings.mcap_file._MAX_HELD_BYTES", 3000)
    with pytest.raises(SequenceError, match=r"chunks overlap in time by more than 3000 bytes"):
        list(Bag(path).messages([IMAGES]))


# --- rosbag2 folders -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["{outside}", "../outside.mcap", "inner/../../outside.mcap", "link.mcap", "a/link.mcap"]
)
def test_a_listing_that_leads_out_of_its_folder_is_refused(name: str, walk_file: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside.mcap"
    outside.write_bytes(walk_file.read_bytes())
    bag = tmp_path / "bag"
    (bag / "inner").mkdir(parents=True)
    (bag / "link.mcap").symlink_to(outside)
    (bag / "a").symlink_to(bag)
    (bag / "metadata.yaml").write_text(f"relative_file_paths:\n- {name.format(outside=outside)}\n")
    with pytest.raises(SequenceError, match="leads out of the folder"):
        Bag(bag)


def test_links_within_the_folder_and_to_it_are_followed(walk_file: Path, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "a.mcap").write_bytes(walk_file.read_bytes())
    (bag / "b.mcap").symlink_to("a.mcap")
    (bag / "metadata.yaml").write_text("relative_file_paths:\n- b.mcap\n")
    (tmp_path / "elsewhere").symlink_to(bag)
    assert len(list(Bag(tmp_path / "elsewhere").messages([IMAGES]))) == 12


# --- what the metadata.yaml of a folder states --------------------------------------------------------


def images_of(bag: Path) -> tuple[int, list[str]]:
    """How many images are read of a folder, and the notices."""
    reader = SequenceReader(bag, SequenceOptions(ground_truth_topic=""), odometry="unread")
    return len(list(reader)), reader.notices


def test_a_folder_that_has_what_its_listing_states_is_read_without_a_word(walk_file: Path, tmp_path: Path) -> None:
    bag = as_split_folder(walk_file, tmp_path)
    assert images_of(bag) == (12, [])
    # As other tools write it: names sorted, messages of single files counted twice, as converting did.
    listing = bag / "metadata.yaml"
    content = yaml.safe_load(listing.read_text())
    for file in content["rosbag2_bagfile_information"]["files"]:
        file["message_count"] *= 2
    listing.write_text(yaml.safe_dump(content))
    assert images_of(bag) == (12, [])


def without(text: str, *lines: str) -> str:
    """A listing without some lines, which are all there."""
    left = text.splitlines()
    for line in lines:
        left.remove(line)
    return "".join(f"{line}\n" for line in left)


LISTED, IN_FILES = "    - bag_1.mcap", "    - path: bag_1.mcap"


def test_a_file_that_is_gone_from_the_listing_is_missed(walk_file: Path, tmp_path: Path) -> None:
    bag = as_split_folder(walk_file, tmp_path)
    listing = bag / "metadata.yaml"
    whole = listing.read_text()
    listing.write_text(without(whole, LISTED))
    with pytest.raises(SequenceError, match=r"`files` has 'bag_1\.mcap' and `relative_file_paths` has not"):
        images_of(bag)
    gone = without(whole.split("  files:")[0], LISTED)
    listing.write_text(gone)
    said = rf"metadata\.yaml: '{IMAGES}': the files that it lists have 6 messages, expected the 12 that it states"
    with pytest.raises(SequenceError, match=rf"{said}; beside them lies 'bag_1\.mcap'"):
        images_of(bag)
    listing.write_text(gone.replace(IMAGES, "/another"))  # the numbers of all topics remain
    with pytest.raises(SequenceError, match=r"all topics: the files that it lists have \d+ messages, expected the \d+"):
        images_of(bag)
    (bag / "bag_1.mcap").unlink()
    listing.write_text(gone)
    with pytest.raises(SequenceError, match=rf"{said} \(`ros2 bag reindex`"):
        images_of(bag)
    listing.write_text(whole)
    with pytest.raises(SequenceError, match=r"names 'bag_1\.mcap', which is not in the folder"):
        images_of(bag)


def test_more_images_than_the_listing_states_are_an_error_too(walk_file: Path, tmp_path: Path) -> None:
    bag = as_split_folder(walk_file, tmp_path)
    (bag / "bag_1.mcap").write_bytes(walk_file.read_bytes())
    with pytest.raises(SequenceError, match="have 18 messages, expected the 12 that it states"):
        images_of(bag)


def test_a_listing_that_states_no_numbers_is_read_with_a_notice(walk_file: Path, tmp_path: Path) -> None:
    bag = as_split_folder(walk_file, tmp_path)
    listing = bag / "metadata.yaml"
    whole = listing.read_text()
    told = "metadata.yaml states no number of messages: images of files that it lost cannot be told"
    zeros = re.sub(r"message_count: \d+", "message_count: 0", whole)  # as of a recorder that was killed
    for text in (zeros, "relative_file_paths: [bag_0.mcap, bag_1.mcap]\n"):
        listing.write_text(text)
        assert images_of(bag) == (12, [told])
    listing.write_text("relative_file_paths:\n- bag_0.mcap\n")
    assert images_of(bag) == (6, [told, "metadata.yaml does not list 'bag_1.mcap': not read"])


def test_a_file_beside_is_named_where_nothing_is_missing(walk_file: Path, tmp_path: Path) -> None:
    bag = as_split_folder(walk_file, tmp_path)
    for name in ("copy.mcap", "d.mcap", "e.mcap", "f.mcap"):
        (bag / name).write_bytes(walk_file.read_bytes())
    said = "metadata.yaml does not list 'copy.mcap', 'd.mcap', 'e.mcap' and 1 more: not read"
    assert images_of(bag) == (12, [said])


def test_numbers_of_the_listing_speak_for_files_that_state_none(walk_file: Path, tmp_path: Path) -> None:
    bag = as_split_folder(walk_file, tmp_path)
    as_file_without_index(bag / "bag_1.mcap", tmp_path).replace(bag / "bag_1.mcap")
    assert images_of(bag) == (12, [])


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("message_count: 12", "message_count: many", "message_count: 'many', expected a whole number"),
        ("message_count: 12", "message_count: -1", "message_count: '-1', expected a whole number"),
        (
            "  relative_file_paths:\n",
            "  relative_file_paths: 7\n  others:\n",
            "`relative_file_paths` is 7, expected a list",
        ),
        ("  version: 5", "  version: [5", "expected YAML"),
    ],
)
def test_a_damaged_listing_is_named(before: str, after: str, said: str, walk_file: Path, tmp_path: Path) -> None:
    listing = as_split_folder(walk_file, tmp_path) / "metadata.yaml"
    listing.write_text(listing.read_text().replace(before, after))
    with pytest.raises(SequenceError, match=rf"metadata\.yaml: .*{re.escape(said)}"):
        Bag(listing.parent)


def test_the_folder_of_a_recorder_that_was_killed_says_how_it_is_read(walk_file: Path, tmp_path: Path) -> None:
    bag = as_split_folder(walk_file, tmp_path)
    (bag / "metadata.yaml").unlink()
    for read in (Bag, list_images):
        with pytest.raises(SequenceError, match=r"no metadata\.yaml, .*one by one \(`ros2 bag reindex` writes one\)"):
            read(bag)
    assert sum(images_of(file)[0] for file in bag.glob("*.mcap")) == 12


# --- where reading ends early -------------------------------------------------------------------------


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
    take, times = Stills.take, iter(range(100))
    monkeypatch.setattr(Stills, "take", lambda *given: [] if next(times) == 5 else take(*given))
    said = rf"walk\.mcap: {IMAGES}: 11 images used and 0 skipped, expected the 12 that are stated"
    with pytest.raises(SequenceError, match=said):
        list(SequenceReader(walk_file))
