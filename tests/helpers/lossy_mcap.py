"""MCAP files that have lost images."""

import struct
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from mcap.opcode import Opcode

from tests.helpers.sequence_files import (
    IMAGES,
    rewrite,
)


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
