"""Keyframes of a run: a few images in full, where the belief changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from filtering.estimate import Estimate, Mode, Status
from filtering.se3 import Poses
from sequences.frame import Frame

_CLOUD_SIZE = 300
_THUMBNAIL_SIDE = 320  # pixels


@dataclass(frozen=True)
class Keyframe:
    """One image of the run in full: what the camera saw and what the filter believed.

    Attributes:
        time_ns: Header stamp of the image.
        thumbnail: The image, its longer side at most 320 pixels, RGB; empty where there is none.
        cloud: 300 poses that stand for the belief, equally weighted, world_from_camera.
        modes: The hypotheses, the reported one first.
        status: The filter's own status.
        world_from_camera: True pose, one pose, or None.
        spread_m: Root mean square distance of the particles from their mean, metres.
    """

    time_ns: int
    thumbnail: UInt8[np.ndarray, "height width 3"]
    cloud: Poses
    modes: tuple[Mode, ...]
    status: Status
    world_from_camera: Poses | None
    spread_m: float


def make_keyframe(frame: Frame, estimate: Estimate) -> Keyframe:
    """One image in full."""
    cloud = estimate.cloud(_CLOUD_SIZE)
    return Keyframe(
        time_ns=frame.time_ns,
        thumbnail=shrunk(frame.image, _THUMBNAIL_SIDE).copy(),  # the decoder's buffer may be used again
        cloud=cloud,
        modes=estimate.modes,
        status=estimate.status,
        world_from_camera=frame.world_from_camera,
        spread_m=float(np.sqrt(cloud.translation.var(axis=0).sum())),
    )


def choose_keyframes(keyframes: list[Keyframe], count: int) -> list[Keyframe]:
    """At most `count` keyframes that tell the story best: the first, the last, and those where the belief changes.

    The curve of doubt over time (the fraction of the belief outside the best hypothesis, and the log of the spread) is
    simplified: as long as there are too many, the keyframe goes that lies nearest to the line between its neighbours.
    How much time a keyframe stands for counts too, so that calm segments stay present and neighbours do not crowd.
    """
    keyframes = list(keyframes)
    start_ns, duration_ns = keyframes[0].time_ns, max(keyframes[-1].time_ns - keyframes[0].time_ns, 1)
    time = np.array([(keyframe.time_ns - start_ns) / duration_ns for keyframe in keyframes])
    doubt = np.array(
        [[1.0 - keyframe.modes[0].weight, 0.3 * np.log10(keyframe.spread_m + 0.1)] for keyframe in keyframes]
    )
    while len(keyframes) > max(count, 2):
        gap = time[2:] - time[:-2]
        fraction = (time[1:-1] - time[:-2]) / np.maximum(gap, 1e-12)
        line = doubt[:-2] + (doubt[2:] - doubt[:-2]) * fraction[:, None]
        nearer = np.minimum(time[1:-1] - time[:-2], time[2:] - time[1:-1])
        loss = np.linalg.norm(doubt[1:-1] - line, axis=1) * np.sqrt(nearer) + 0.2 * gap
        leaving = 1 + int(np.argmin(loss))
        del keyframes[leaving]
        time, doubt = np.delete(time, leaving), np.delete(doubt, leaving, axis=0)
    return keyframes


def shrunk(image: UInt8[np.ndarray, "height width 3"], side: int) -> UInt8[np.ndarray, "h w 3"]:
    """An image whose longer side has at most `side` pixels; an empty one stays empty."""
    import cv2

    height, width = image.shape[:2]
    if image.size == 0 or max(height, width) <= side:
        return image
    scale = side / max(height, width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
