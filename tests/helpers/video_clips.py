"""Video files, as phones write them."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

_TURNED = [0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30]  # a quarter turn: the matrix of a track in MP4


def write_clip(path: Path, images: np.ndarray, times_ms: Sequence[int]) -> Path:
    """A video of images (n, h, w, 3) of even size, with their time stamps."""
    path.parent.mkdir(exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        assert isinstance(stream, av.VideoStream)
        stream.height, stream.width = images.shape[1:3]
        stream.pix_fmt, stream.options = "yuv420p", {"crf": "12"}
        stream.codec_context.time_base = Fraction(1, 1000)
        for image, time_ms in zip(images, times_ms, strict=True):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
            frame.pts, frame.time_base = time_ms, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def held_upright(path: Path) -> Path:
    """The same video with the metadata of a phone that was held upright: a player turns its frames by 90°."""
    content = bytearray(path.read_bytes())
    begin = content.index(b"tkhd") + 4 + 40  # after version, flags, times, numbers, layer, group and volume
    content[begin : begin + 36] = b"".join(number.to_bytes(4, "big", signed=True) for number in _TURNED)
    path.write_bytes(content)
    return path
