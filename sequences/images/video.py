"""Image messages of one topic, in order -> images: stills, or video by PyAV.

A packet of video has one image, mostly built on those before it. So after a damaged packet there is no image up to the
next key frame, as before the first one: a decoder's guess looks like an image, but the camera never saw it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple, NoReturn

import numpy as np
from jaxtyping import UInt8

from sequences.errors import SequenceError
from sequences.images.decoding import decode_image
from sequences.images.headers import MAX_PIXELS

Image = UInt8[np.ndarray, "height width 3"]
BEFORE_KEY_FRAME = "video before its first key frame"
DAMAGED = "damaged video, up to the next key frame"

# What a format contains -> the decoder. ffmpeg_image_transport names encoders: libx264, hevc_nvenc, libsvtav1.
_DECODERS = {
    "h264": "h264",
    "x264": "h264",
    "hevc": "hevc",
    "h265": "hevc",
    "x265": "hevc",
    "vp9": "vp9",
    "av1": "libdav1d",
}


class Picture(NamedTuple):
    """One image of a topic, by its stamp.

    `decode` returns it, RGB, or raises SequenceError. `skipped` is the reason to count where there is none, else ''.
    """

    time_ns: int
    decode: Callable[[], Image]
    skipped: str = ""


class ImageStream:
    """A stream whose every message is an image.

    Attributes:
        remembers: Whether an image may need messages before its own, so that none may be left out.
    """

    remembers = False

    def __init__(self, decode: Callable[[Any], Image]) -> None:
        self._decode = decode

    def take(self, time_ns: int, message: Any) -> Iterable[Picture]:
        """The images of a message, none later than the messages so far; None for a lost message."""
        return [] if message is None else [Picture(time_ns, lambda: self._decode(message))]

    def finish(self) -> Iterable[Picture]:
        """The images that remain after the last message."""
        return ()


class Video(ImageStream):
    """A stream of video packets. Their stamps are those of their images, also where these come in another order."""

    remembers = True

    def __init__(self, format_field: str) -> None:
        """Set up a stream by the name of the field with its format. Raises SequenceError where PyAV is missing."""
        try:
            import av
            import av.error
        except ImportError as error:
            raise SequenceError(
                f"video is decoded by PyAV, which is not installed ({error}); expected it from"
                " pip install 'vapor-track[video]'"
            ) from error
        self._av, self._errors = av, av.error.FFmpegError
        self._format_field = format_field
        self._format: str | None = None
        self._codec: Any = None  # PyAV's
        self._waiting: list[int] = []  # stamps of packets whose images have not come out
        self._begun = False

    def take(self, time_ns: int, message: Any) -> Iterator[Picture]:
        """See `ImageStream`."""
        if message is None:
            yield from self._break_off()
            return
        video_format = getattr(message, self._format_field)
        if video_format != self._format:
            yield from self.finish()
            self._format, self._codec, self._begun = video_format, self._open(video_format), False
        if self._codec is None:
            yield Picture(time_ns, partial(_refuse, video_format))
            return
        self._waiting.append(time_ns)
        packet = self._av.Packet(bytes(message.data))
        packet.pts = time_ns
        try:
            frames = self._codec.decode(packet) if packet.size else None  # an empty one would end the stream
        except self._errors:
            frames = None
        if frames is None:
            yield from self._break_off(damaged_ns=time_ns)
            return
        yield from self._pictures(frames)
        if any(frame.is_corrupt for frame in frames):
            yield from self._break_off()

    def finish(self) -> Iterator[Picture]:
        """See `ImageStream`."""
        yield from self._break_off()

    def _open(self, video_format: str) -> Any:
        name = next((name for part, name in _DECODERS.items() if part in video_format.lower()), None)
        if name is None or name not in self._av.codecs_available:
            return None
        codec = self._av.CodecContext.create(name, "r")
        codec.thread_count = 1  # several would hold images back
        codec.options = {"err_detect": "explode", "max_pixels": str(MAX_PIXELS)}
        return codec

    def _break_off(self, damaged_ns: int | None = None) -> Iterator[Picture]:
        """The images that were held back, and no more before a key frame comes."""
        if self._codec is None:
            return
        try:
            frames = self._codec.decode(None)
        except self._errors:
            frames = []
        self._codec.flush_buffers()
        yield from self._pictures([frame for frame in frames if frame.pts != damaged_ns])
        for time_ns in self._waiting:
            yield self._skip(time_ns)
        self._waiting.clear()

    def _pictures(self, frames: list[Any]) -> Iterator[Picture]:
        for frame in frames:
            if frame.is_corrupt or frame.pts not in self._waiting:
                continue
            for time_ns in [t for t in self._waiting if t < frame.pts]:  # images come out in their order
                yield self._skip(time_ns)
                self._waiting.remove(time_ns)
            self._waiting.remove(frame.pts)
            self._begun = True
            yield Picture(frame.pts, partial(_image, frame, self._format or ""))

    def _skip(self, time_ns: int) -> Picture:
        reason = DAMAGED if self._begun else BEFORE_KEY_FRAME
        return Picture(time_ns, partial(_refuse, self._format or ""), skipped=reason)


def _refuse(video_format: str) -> NoReturn:
    raise SequenceError(f"video of format {video_format!r} cannot be decoded, expected H.264, H.265, VP9 or AV1")


def _image(frame: Any, video_format: str) -> Image:
    """A frame as RGB. Of one channel (mono, or a Bayer mosaic), ffmpeg_image_transport puts the pixels into luma."""
    _, _, ros_encoding, *_ = [*video_format.split(";"), "", "", ""]
    if ros_encoding == "mono8" or ros_encoding.startswith("bayer_"):
        luma = frame.planes[0]
        size = {"height": frame.height, "width": frame.width, "step": luma.line_size}
        return decode_image(SimpleNamespace(encoding=ros_encoding, is_bigendian=0, data=bytes(luma), **size))
    return frame.to_ndarray(format="rgb24")
