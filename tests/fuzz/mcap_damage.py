"""MCAP files taken apart into records, damaged in one of them, and put together again, checksums and all."""

import dataclasses
import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import lz4.frame
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode

from tests.fuzz.damage import NUMBERS, WORDS, Rng, damaged_bytes, damaged_json, damaged_png, pick, short

_MAGIC = b"\x89MCAP0\r\n"
_CLASSES: dict[int, Any] = {each: getattr(records, each.name.title().replace("_", "")) for each in Opcode}


@dataclass
class Record:
    """One record: its opcode and bytes; of a chunk, what it holds."""

    opcode: int
    body: bytes
    held: list["Record"] = field(default_factory=list)

    def parsed(self) -> Any:
        """Its fields, or None where they cannot be read."""
        kind = _CLASSES.get(self.opcode)
        stream = ReadDataStream(io.BytesIO(self.body))
        try:
            if kind is records.Message:
                return kind.read(stream, len(self.body))
            return kind.read(stream) if kind else None
        except Exception:  # whatever the library raises
            return None


def take_apart(data: bytes) -> list[Record]:
    """The records of a file, as far as they can be read."""
    found = []
    for record in _records(data[len(_MAGIC) :]):
        if record.opcode == Opcode.CHUNK and (chunk := record.parsed()) is not None:
            record.held = [*_records(_decompressed(chunk))]
        found.append(record)
    return found


def _records(data: bytes) -> Iterator[Record]:
    at = 0
    while at + 9 <= len(data) and data[at:] != _MAGIC:
        opcode, length = struct.unpack_from("<BQ", data, at)
        if at + 9 + length > len(data):
            return
        yield Record(opcode, data[at + 9 : at + 9 + length])
        at += 9 + length


def _decompressed(chunk: records.Chunk) -> bytes:
    limit = 2**24
    try:
        if chunk.compression == "zstd":
            return zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=limit)
        return lz4.frame.decompress(chunk.data) if chunk.compression == "lz4" else chunk.data
    except Exception:  # whatever the libraries raise
        return b""


def _compressed(data: bytes, compression: str) -> bytes:
    if compression == "zstd":
        return zstandard.compress(data, 1)
    return lz4.frame.compress(data) if compression == "lz4" else data


def put_together(found: list[Record], *, repair: bool, compression: str | None = None) -> bytes:
    """The bytes of a file.

    Args:
        found: Its records.
        repair: Whether what follows from others is made to fit: checksums, sizes, offsets, and message indexes.
        compression: Of all chunks; None for that of each.
    """
    out = io.BytesIO()
    out.write(_MAGIC)
    places: list[tuple[int, int, records.Chunk]] = []  # of chunks and how long they are
    indexes: list[dict[int, int]] = []  # of each, where its message indexes are
    summary_start, in_summary, chunk_number = 0, False, 0
    entries: dict[int, list[tuple[int, int]]] = {}
    for record in found:
        opcode, body = record.opcode, record.body
        if opcode == Opcode.CHUNK and (chunk := record.parsed()) is not None and (repair or record.held):
            plain, entries = _chunk_content(record.held)
            if compression is not None or plain != _decompressed(chunk):
                chunk.compression = chunk.compression if compression is None else compression
                chunk.data = _compressed(plain, chunk.compression)
            if repair:
                chunk.uncompressed_size, chunk.uncompressed_crc = len(plain), zlib.crc32(plain)
            body = _body(chunk)
            places.append((out.tell(), 9 + len(body), chunk))
            indexes.append({})
        elif opcode == Opcode.MESSAGE_INDEX and repair and places and (index := record.parsed()) is not None:
            body = _body(records.MessageIndex(index.channel_id, entries.get(index.channel_id, [])))
            indexes[-1][index.channel_id] = out.tell()
        elif opcode == Opcode.CHUNK_INDEX and repair and (index := record.parsed()) is not None:
            if chunk_number < len(places):
                start, length, chunk = places[chunk_number]
                known = indexes[chunk_number]
                index = dataclasses.replace(
                    index,
                    chunk_start_offset=start,
                    chunk_length=length,
                    message_index_offsets={i: known[i] for i in index.message_index_offsets if i in known},
                    compression=chunk.compression,
                    compressed_size=len(chunk.data),
                    uncompressed_size=chunk.uncompressed_size,
                )
                body = _body(index)
            chunk_number += 1
        elif opcode == Opcode.DATA_END and repair:
            body = struct.pack("<I", zlib.crc32(out.getvalue()))
        elif opcode == Opcode.FOOTER and repair and len(body) == 20:
            head = struct.pack("<BQQQ", opcode, 20, summary_start, 0)
            begin = summary_start or out.tell()
            body = head[9:] + struct.pack("<I", zlib.crc32(out.getvalue()[begin:] + head))
        if in_summary and not summary_start and opcode != Opcode.FOOTER:
            summary_start = out.tell()
        if opcode == Opcode.SUMMARY_OFFSET and repair:
            continue  # they may be left out, and the footer then says so
        in_summary = in_summary or opcode == Opcode.DATA_END
        out.write(struct.pack("<BQ", opcode, len(body)) + body)
    out.write(_MAGIC)
    return out.getvalue()


def _chunk_content(held: list[Record]) -> tuple[bytes, dict[int, list[tuple[int, int]]]]:
    out, entries = io.BytesIO(), {}
    for record in held:
        if record.opcode == Opcode.MESSAGE and len(record.body) >= 22:
            channel, _, time = struct.unpack_from("<HIQ", record.body)
            entries.setdefault(channel, []).append((time, out.tell()))
        out.write(struct.pack("<BQ", record.opcode, len(record.body)) + record.body)
    return out.getvalue(), entries


def _body(record: Any) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()[9:]


def damaged_mcap(data: bytes, rng: Rng) -> tuple[bytes, str]:
    """A file with one record damaged, and the rest made to fit or not."""
    if rng.random() < 0.15:
        return damaged_bytes(data, rng)
    found = take_apart(data)
    repair = bool(rng.random() < 0.7)
    note = _damage_record(found, rng)
    compression = pick(rng, ("", "lz4", "zstd")) if rng.random() < 0.1 else None
    damaged = put_together(found, repair=repair, compression=compression)
    return damaged, f"{note}{', checksums and offsets made to fit' if repair else ''}"


def _damage_record(found: list[Record], rng: Rng) -> str:
    """Damage one record, or the order of two, in place; kinds of records are as likely as each other."""
    places = [found, *(record.held for record in found if record.held)]
    by_kind: dict[tuple[bool, int], list[tuple[list[Record], int]]] = {}
    for place in places:
        for i, record in enumerate(place):
            by_kind.setdefault((place is found, record.opcode), []).append((place, i))
    kinds = sorted(by_kind)
    messages = [kind for kind in kinds if kind[1] == Opcode.MESSAGE]
    kind = pick(rng, messages) if messages and rng.random() < 0.35 else pick(rng, kinds)
    place, i = pick(rng, by_kind[kind])
    record = place[i]
    name = Opcode(record.opcode).name.lower() if record.opcode in set(Opcode) else f"record {record.opcode}"
    what = int(rng.integers(10))
    if what == 0:
        del place[i]
        return f"{name} left out"
    if what == 1:
        other, j = pick(rng, by_kind[pick(rng, kinds)])
        other.insert(j, record)
        return f"{name} twice"
    if what == 2:
        (other, j), (one, k) = pick(rng, by_kind[kind]), by_kind[kind][0]
        other[j], one[k] = one[k], other[j]
        return f"{name} in another order"
    if what == 3:
        record.opcode = int(rng.integers(256))
        return f"{name} with opcode {record.opcode}"
    if what == 4:
        record.body, note = damaged_bytes(record.body, rng)
        return f"{name}: {note}"
    fields = record.parsed()
    try:
        note = _damage_message(fields, rng) if isinstance(fields, records.Message) else _damage_field(fields, rng)
        record.body = _body(fields)
    except (TypeError, struct.error, UnicodeEncodeError, OverflowError):  # no fields, or more than one can hold
        record.body, note = damaged_bytes(record.body, rng)
    return f"{name}: {note}"


def _damage_message(message: records.Message, rng: Rng) -> str:
    """What a message holds, in most cases; else its time or channel."""
    if rng.random() < 0.3:
        return _damage_field(message, rng)
    content = message.data
    if content[:1] == b"{":
        message.data, note = damaged_json(content, rng)
        return note
    picture = content.find(b"\x89PNG")
    if picture >= 0 and rng.random() < 0.4:
        image, note = damaged_png(content[picture:], rng)
        message.data = content[:picture] + image
        return f"image: {note}"
    if picture > 0 and rng.random() < 0.6:  # the fields before the image
        head, note = damaged_bytes(content[:picture], rng)
        message.data = head + content[picture:]
        return note
    if len(content) >= 16 and rng.random() < 0.4:  # one of the numbers of eight bytes, which are aligned after four
        at = 4 + 8 * int(rng.integers((len(content) - 4) // 8))
        value = pick(rng, (float("nan"), float("inf"), -1.0, 0.0, 1e300, 1e12, 1e-300, 1e5))
        message.data = content[:at] + struct.pack("<d", value) + content[at + 8 :]
        return f"{value} at byte {at}"
    message.data, note = damaged_bytes(content, rng)
    return note


def _damage_field(fields: Any, rng: Rng) -> str:
    name = pick(rng, [f.name for f in dataclasses.fields(fields)])
    before = getattr(fields, name)
    value = _other(before, rng)
    setattr(fields, name, value)
    return f"{name} {short(str(before))} became {short(str(value))}"


def _other(value: Any, rng: Rng) -> Any:
    if isinstance(value, int):
        choices = (*NUMBERS, max(value - 1, 0), value + 1, value * 2, value ^ 1 << int(rng.integers(48)))
        return pick(rng, choices)
    if isinstance(value, str):
        known = ("", "zstd", "lz4", "cdr", "json", "protobuf", "jsonschema", "ros2msg", "nav_msgs/msg/Odometry", "/tf")
        return pick(rng, known) if rng.random() < 0.6 else pick(rng, [w for w in WORDS if "\ud800" not in w])
    if isinstance(value, bytes):
        return damaged_bytes(value, rng)[0]
    if isinstance(value, dict) and value:
        key = pick(rng, [*value])
        changed = dict(value)
        other = changed.pop(key)
        return changed if rng.random() < 0.3 else {**changed, key: _other(other, rng)}
    if isinstance(value, list) and value:
        i = int(rng.integers(len(value)))
        return value[:i] + value[i + 1 :] if rng.random() < 0.5 else [*value, tuple(_other(v, rng) for v in value[i])]
    return value


def stated_images(data: bytes, topic: str) -> int | None:
    """How many messages of a topic a file's statistics state, or its records; None where they state none.

    Read without the library, as a second opinion.
    """
    found = take_apart(data)
    flat = [each for record in found for each in (record, *record.held)]
    ends = [i for i, record in enumerate(found) if record.opcode == Opcode.DATA_END]
    summary = found[ends[0] :] if ends else []
    channels = _parsed(summary, Opcode.CHANNEL) or _parsed(flat, Opcode.CHANNEL)
    wanted = {channel.id for channel in channels if channel.topic == topic}
    for statistics in _parsed(summary, Opcode.STATISTICS):
        return sum(n for i, n in statistics.channel_message_counts.items() if i in wanted) or None
    messages = [record.body for record in flat if record.opcode == Opcode.MESSAGE and len(record.body) > 22]
    return sum(struct.unpack_from("<H", body)[0] in wanted for body in messages) or None


def _parsed(found: list[Record], opcode: int) -> list[Any]:
    fields = [record.parsed() for record in found if record.opcode == opcode]
    return [each for each in fields if each is not None]
