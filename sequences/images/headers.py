"""Headers of compressed images: their sizes, and whether they are whole, before they are decoded."""

from __future__ import annotations

import struct

import numpy as np
from jaxtyping import UInt8

from sequences.errors import SequenceError

MAX_PIXELS = 100_000_000
_MAX_SCANS = 100  # of a progressive JPEG, which has about ten: each is a pass over all pixels
_END = b"\xff\xd9"
_SCAN = 0xDA
_SIZES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # markers of frames
# What may follow 0xff in or between scans: a stuffed zero, restarts, fill, tables, comments, and further scans.
_IN_SCANS = np.isin(
    np.arange(256), [0x00, *range(0xD0, 0xD8), 0xC4, 0xDA, 0xDB, 0xDC, 0xDD, *range(0xE0, 0xF0), 0xFE, 0xFF]
)


class DamagedImageError(SequenceError):
    """An image that lacks a part of itself, though it may decode."""


def why_skipped(error: SequenceError) -> str:
    """The reason by which an image that could not be decoded is counted."""
    return "damaged image" if isinstance(error, DamagedImageError) else "undecodable image"


def check_before_decoding(data: bytes) -> None:
    """Check a compressed image without decoding it.

    Raises DamagedImageError for a JPEG that is cut off or has an impossible marker, and for a PNG without an end.
    Raises SequenceError for other formats, and above 100 megapixels.
    """
    size = stated_size(data)
    if size is None:
        raise SequenceError(f"{len(data)} bytes are no image, expected JPEG, PNG, WebP or BMP")
    require_pixels(*size, "image")
    if is_png(data) and not _png_ends(data):  # the decoder would allocate as much as a chunk states
        raise DamagedImageError(f"PNG of {len(data)} bytes is cut off or broken, expected chunks up to an end")
    if not is_jpeg(data):
        return
    _, markers = _markers_of_scans(data)
    if _END not in data[-256:] or not _IN_SCANS[markers].all():
        raise DamagedImageError(f"JPEG of {len(data)} bytes is cut off or broken, expected pixels up to an end marker")
    if np.count_nonzero(markers == _SCAN) > _MAX_SCANS:
        raise SequenceError(f"JPEG has more than {_MAX_SCANS} scans, expected about ten at most")


def stated_size(data: bytes) -> tuple[int, int] | None:
    """Width and height by the header of a JPEG, PNG, WebP or BMP; None for other bytes and a damaged header."""
    try:
        width, height = _size(data)
    except (struct.error, IndexError):
        return None
    return (width, height) if width and height else None


def require_pixels(width: int, height: int, where: str) -> None:
    """Raise SequenceError where images have more than 100 megapixels; `where` begins the message."""
    if width * height > MAX_PIXELS:
        raise SequenceError(f"{where}: {width} x {height} pixels, expected at most {MAX_PIXELS // 10**6} megapixels")


def is_jpeg(data: bytes) -> bool:
    """Whether bytes begin as a JPEG does."""
    return data[:2] == b"\xff\xd8"


def is_png(data: bytes) -> bool:
    """Whether bytes begin as a PNG does."""
    return data[:8] == b"\x89PNG\r\n\x1a\n"


def lengthened(data: bytes) -> bytes:
    """A JPEG with more coded pixels at its end: it decodes differently only where some were missing."""
    end, _ = _markers_of_scans(data)
    return data[:end] + bytes([0x55]) * 64 + data[end:]


def _markers_of_scans(data: bytes) -> tuple[int, UInt8[np.ndarray, " n"]]:
    """Where the coded pixels of a JPEG end, and all markers from the first scan up to there."""
    *_, begin = _jpeg(data)
    coded = np.frombuffer(data, np.uint8)[begin:]
    places = np.flatnonzero(coded[:-1] == 0xFF)
    markers = coded[places + 1]
    ends = np.flatnonzero(markers == _END[1])
    last = ends[0] if len(ends) else len(places)
    return begin + int(places[last]) if len(ends) else len(data), markers[:last]


def _size(data: bytes) -> tuple[int, int]:
    """Width and height, pixels; zeros for other formats."""
    if is_jpeg(data):
        return _jpeg(data)[:2]
    if is_png(data) and data[12:16] == b"IHDR":
        width, height = struct.unpack_from(">II", data, 16)
        return width, height
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return _webp(data)
    if data[:2] == b"BM":
        if struct.unpack_from("<I", data, 14)[0] == 12:  # as of OS/2
            width, height = struct.unpack_from("<HH", data, 18)
        else:
            width, height = struct.unpack_from("<ii", data, 18)
        return abs(width), abs(height)
    return 0, 0


def _png_ends(data: bytes) -> bool:
    """Whether the chunks of a PNG follow each other up to its last."""
    at = 8
    while at + 12 <= len(data):
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at += 12 + int.from_bytes(data[at : at + 4], "big")
    return False


def _jpeg(data: bytes) -> tuple[int, int, int]:
    """Width, height, and where the first scan begins; size zero where there is none."""
    width = height = 0
    at = 2
    while data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # fill
            at += 1
        elif marker == _SCAN:
            return width, height, at
        else:
            if marker in _SIZES and not width:
                height, width = struct.unpack_from(">HH", data, at + 5)
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]
    return 0, 0, at


def _webp(data: bytes) -> tuple[int, int]:
    if data[12:16] == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if data[12:16] == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, height = struct.unpack_from("<HH", data, 26)
    return width & 0x3FFF, height & 0x3FFF
