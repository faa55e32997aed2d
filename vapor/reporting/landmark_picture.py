"""A picture of one image's landmarks: the features that were looked at, and those that agree with a verified pose."""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt8

from vapor.landmarks.verify import ShownLandmarks

_LONGER = 5  # times as long as it is each distance is drawn: of a pixel little would be seen
_WIDTH = 960  # of the picture
_GREY, _RIM, _GREEN, _LINE = (200, 200, 200), (70, 70, 70), (60, 230, 80), (255, 150, 40)
_QUALITY = 85


def landmark_picture(shown: ShownLandmarks) -> bytes:
    """The image as JPEG: features as grey dots, landmarks as green circles, lines to where the pose predicts these."""
    import cv2

    height, width = shown.image.shape[:2]
    zoom = _WIDTH / width
    size = _WIDTH, round(zoom * height)
    picture = np.ascontiguousarray(cv2.resize(shown.image, size, interpolation=cv2.INTER_CUBIC))
    fraction = 4  # bits of a pixel
    ends = shown.seen + _LONGER * (shown.predicted - shown.seen)

    def drawn(at: np.ndarray) -> list[tuple[int, int]]:
        points = np.rint(((at + 0.5) * zoom - 0.5) * 2**fraction).astype(int)
        return [(int(x), int(y)) for x, y in points]

    for at in drawn(shown.features):
        cv2.circle(picture, at, 4 << fraction, _RIM, -1, cv2.LINE_AA, fraction)
        cv2.circle(picture, at, 3 << fraction, _GREY, -1, cv2.LINE_AA, fraction)
    for at, end in zip(drawn(shown.seen), drawn(ends), strict=True):
        cv2.line(picture, at, end, _LINE, 2, cv2.LINE_AA, fraction)
        cv2.circle(picture, at, 5 << fraction, _GREEN, 2, cv2.LINE_AA, fraction)
    return _encoded(picture)


def _encoded(picture: UInt8[np.ndarray, "h w 3"]) -> bytes:
    import cv2

    _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return jpeg.tobytes()


def landmark_caption(shown: ShownLandmarks, seconds: float) -> str:
    """What the picture shows, in numbers.

    Args:
        shown: What is drawn.
        seconds: Since the first image.
    """
    off = float(np.median(np.linalg.norm(shown.predicted - shown.seen, axis=1)))
    said = (
        f"Image {shown.number}, at {seconds:.1f} s: of {len(shown.features)} features (grey) {len(shown.seen)} are"
        f" landmarks that agree with the pose (green). Orange lines, {_LONGER} times too long, lead to where these"
        f" must be seen from it, {off:.1f} of {shown.image.shape[1]} pixels off in the median."
    )
    if shown.others:
        places = "Another place is verified, by" if len(shown.others) == 1 else "Other places are verified, by"
        said += f" {places} {', '.join(map(str, shown.others))} landmarks."
    return said
