"""MCAP files that lie about themselves: what they lost is told, and no size is believed before it was checked."""

import heapq
import struct
import tracemalloc
import zlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from sequences.errors import SequenceError
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.recordings import mcap_file
from sequences.recordings.bag import Bag
from sequences.recordings.mcap_file import unpack_chunk
from tests.helpers.sequence_files import (
    BEGIN_NS,
    IMAGES,
    as_file_without_index,
    chunks,
    damaged,
    id_of,
    records,
    rewrite,
    without_ten_images,
)


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


def topic_after_topic(source: Path, target: Path, **options: object) -> Path:
    """A file as of one writer for each topic, whose clock is set back halfway."""
    half_ns = BEGIN_NS + 500_000_000
    with open(target, "wb") as stream, open(source, "rb") as whole:
        writer = Writer(stream, chunk_size=1000, **options)  # pyright: ignore[reportArgumentType]
        writer.start()
        for topic in ("/odom", IMAGES):
            whole.seek(0)
            messages = [*make_reader(whole).iter_messages(topics=[topic])]
            schema, channel, _ = messages[0]
            assert schema is not None
            schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
            channel_id = writer.register_channel(topic, channel.message_encoding, schema_id)
            for _, _, message in messages:
                time_ns = message.log_time - (10**12 if message.log_time > half_ns else 0)
                writer.add_message(channel_id, time_ns, message.data, time_ns)
        writer.finish()
    return target


FORMS_OF_FILES = [{}, {"use_chunking": False}, {"index_types": IndexType.NONE}]


@pytest.mark.parametrize("options", FORMS_OF_FILES)
def test_messages_come_as_they_lie_in_the_file_whatever_clocks_said(
    options: dict[str, object], walk_file: Path, tmp_path: Path
) -> None:
    whole = [(raw.topic, raw.data) for raw in Bag(walk_file).messages(["/odom", IMAGES])]
    bag = Bag(topic_after_topic(walk_file, tmp_path / "a.mcap", **options))
    found = [(raw.topic, raw.data) for raw in bag.messages(["/odom", IMAGES])]
    assert found == sorted(whole, key=lambda each: each[0] != "/odom")


@pytest.mark.parametrize("options", FORMS_OF_FILES)
def test_that_one_topic_is_over_is_uninformative_of_another(
    options: dict[str, object], walk_file: Path, tmp_path: Path
) -> None:
    bag = Bag(topic_after_topic(walk_file, tmp_path / "a.mcap", **options))
    raws = [*bag.messages(["/odom", IMAGES], until=lambda time_ns: time_ns >= BEGIN_NS + 200_000_000)]
    assert [raw.topic for raw in raws] == ["/odom"] * 12 + [IMAGES] * 2


def test_iterators_side_by_side_unpack_each_chunk_once(
    walk_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = Bag(rewrite(walk_file, tmp_path / "a.mcap", chunk_size=1000, compression=CompressionType.ZSTD))
    unpacked = []
    monkeypatch.setattr(mcap_file, "unpack_chunk", lambda data: unpacked.append(data) or unpack_chunk(data))
    names = [*bag.topics]
    alone = {name: [*bag.messages([name])] for name in names}
    bag = Bag(tmp_path / "a.mcap")
    unpacked.clear()
    side_by_side = heapq.merge(*(bag.messages([name]) for name in names), key=lambda raw: raw.log_time_ns)
    assert Counter(raw.topic for raw in side_by_side) == {name: len(raws) for name, raws in alone.items()}
    assert len(unpacked) == len(set(unpacked)) > 5
    unpacked.clear()
    monkeypatch.setattr(mcap_file, "_MAX_KEPT_BYTES", 3000)
    assert [*bag.messages(names)] == [*Bag(tmp_path / "a.mcap").messages(names)]
    assert sum(map(len, bag._latest._kept.values())) <= 3000
