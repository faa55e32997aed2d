"""How large an image says it is, before it is decoded."""

from __future__ import annotations

from sequences.errors import SequenceError

MAX_PIXELS = 100_000_000
"""Of an image: decoded, it takes twice three bytes for each."""
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
_NO_SIZE = (0xC4, 0xC8, 0xCC)  # of the markers from C0 to CF, those that are no start of a frame


def stated_size(data: bytes) -> tuple[int, int] | None:
    """Width and height by the header of a PNG or JPEG; None of anything else, and where the header is damaged."""
    if data.startswith(_PNG):
        return (_number(data, 16, 4), _number(data, 20, 4)) if len(data) >= 24 else None
    return _jpeg_size(data) if data.startswith(_JPEG) else None


def require_size(data: bytes) -> None:
    """Raise SequenceError where an image says that it is too large to be decoded."""
    size = stated_size(data)
    if size is not None:
        require_pixels(*size, f"image of {len(data):,} bytes")


def require_pixels(width: int, height: int, where: str) -> None:
    """Raise SequenceError where images are too large to be decoded; `where` begins the message."""
    if width * height > MAX_PIXELS:
        raise SequenceError(f"{where}: {width} x {height} pixels, expected at most {MAX_PIXELS:,} in all")


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """From the start of the frame, which follows segments of known lengths."""
    at = len(_JPEG)
    while 0 <= (at := data.find(b"\xff", at)) < len(data) - 9:
        marker = data[at + 1]
        if 0xC0 <= marker <= 0xCF and marker not in _NO_SIZE:
            return _number(data, at + 7, 2), _number(data, at + 5, 2)
        if marker in (0x00, 0x01, 0xFF) or 0xD0 <= marker <= 0xD9:  # these have no length
            at += 1 if marker == 0xFF else 2
        else:
            at += 2 + _number(data, at + 2, 2)
    return None


def _number(data: bytes, at: int, size: int) -> int:
    return int.from_bytes(data[at : at + size], "big")
