"""Video as recordings have it, of images that are each unlike the next."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction

import av
import cv2
import numpy as np

from tests.helpers.foxglove_files import Told
from tests.helpers.sequence_files import BEGIN_NS
from tests.helpers.tf_files import MS, Event, header

NUM, GROUP, TOPIC = 14, 6, "/camera/image"  # images, and how many there are from one key frame to the next
Packet = tuple[int, bytes]  # which image, and its bytes, in the order in which a decoder needs them


def stamp(index: int) -> int:
    return BEGIN_NS + 100 * MS * index


def pictures(num: int = NUM, width: int = 96, height: int = 64) -> np.ndarray:
    """Images of a camera that pans along a soft pattern, each unlike the next."""
    rng = np.random.default_rng(0)
    wall = cv2.GaussianBlur(rng.integers(0, 256, (height, width + 6 * num, 3), dtype=np.uint8), (0, 0), 3.0)
    wall = cv2.normalize(wall, None, 0, 255, cv2.NORM_MINMAX)  # pyright: ignore[reportCallIssue, reportArgumentType]
    return np.stack([wall[:, 6 * i : 6 * i + width] for i in range(num)])


def encode(
    images: np.ndarray, encoder: str = "libx264", *, b_frames: int = 0, pixels: str = "yuv420p", **options: str
) -> list[Packet]:
    """Packets of images of one size, a key frame every six."""
    codec = av.CodecContext.create(encoder, "w")
    assert isinstance(codec, av.VideoCodecContext)
    codec.height, codec.width = images.shape[1:3]
    codec.pix_fmt, codec.time_base, codec.framerate = pixels, Fraction(1, 10), Fraction(10)
    codec.gop_size, codec.max_b_frames = GROUP, b_frames
    quiet = {"libx264": {"sc_threshold": "0"}, "libx265": {"x265-params": "log-level=none:scenecut=0"}}
    codec.options = {"crf": "16", **quiet.get(encoder, {}), **options}
    packets = []
    with scheduled_as_before():
        for i, image in enumerate(images):
            pixel_format = "rgb24" if image.ndim == 3 else "gray"
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format=pixel_format)
            frame.pts = i
            packets += codec.encode(frame)
        packets += codec.encode(None)
    assert [p.pts for p in packets if p.is_keyframe] == list(range(0, len(images), GROUP))
    return [(int(p.pts or 0), bytes(p)) for p in packets]


@contextmanager
def scheduled_as_before() -> Iterator[None]:
    """SVT-AV1 makes a thread of root's that encodes a real-time one: no other process would get its share any more."""
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, parameters)


def video(packets: list[Packet], video_format: str = "h264") -> list[Told]:
    """As recorded: in the order of the packets, a little after their images were taken."""
    return [
        Told(
            stamp(n) + 20 * MS,
            TOPIC,
            "CompressedVideo",
            {"timestamp": stamp(i), "frame_id": "camera", "data": data, "format": video_format},
        )
        for n, (i, data) in enumerate(packets)
    ]


def ffmpeg_packets(packets: list[Packet], encoding: str) -> list[Event]:
    return [
        Event(
            stamp(n) + 20 * MS,
            "/camera/image/ffmpeg",
            "ffmpeg_image_transport_msgs/FFMPEGPacket",
            {"header": header(stamp(i), "camera"), "encoding": encoding, "pts": i, "data": data},
        )
        for n, (i, data) in enumerate(packets)
    ]
