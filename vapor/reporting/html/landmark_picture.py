"""The landmarks in one image of a run, as a picture."""

from __future__ import annotations

import numpy as np

from vapor.landmarks.verify import ShownLandmarks
from vapor.reporting.drawing import as_jpeg

_LONGER = 5  # distances are drawn so many times too long, as one of a pixel would hardly be seen
_WIDTH = 960  # of the picture
_GREY, _RIM, _GREEN, _LINE, _RED = (200, 200, 200), (70, 70, 70), (60, 230, 80), (255, 150, 40), (255, 60, 60)
_QUALITY = 85
_BITS = 4  # of a fraction of a pixel


def landmark_picture(shown: ShownLandmarks) -> bytes:
    """The image as JPEG: features as grey dots, landmarks as green circles, lines to where the pose predicts these.

    Features that match a landmark and do not agree with the pose are red crosses.
    """
    import cv2

    height, width = shown.image.shape[:2]
    zoom = _WIDTH / width
    size = _WIDTH, round(zoom * height)
    picture = np.ascontiguousarray(cv2.resize(shown.image, size, interpolation=cv2.INTER_CUBIC))
    ends = shown.seen + _LONGER * (shown.predicted - shown.seen)

    def drawn(at: np.ndarray) -> list[tuple[int, int]]:
        points = np.rint(((at + 0.5) * zoom - 0.5) * 2**_BITS).astype(int)
        return [(int(x), int(y)) for x, y in points]

    for at in drawn(shown.features):
        cv2.circle(picture, at, 4 << _BITS, _RIM, -1, cv2.LINE_AA, _BITS)
        cv2.circle(picture, at, 3 << _BITS, _GREY, -1, cv2.LINE_AA, _BITS)
    arm = 5 << _BITS
    for x, y in drawn(shown.disagreeing):
        cv2.line(picture, (x - arm, y - arm), (x + arm, y + arm), _RED, 2, cv2.LINE_AA, _BITS)
        cv2.line(picture, (x - arm, y + arm), (x + arm, y - arm), _RED, 2, cv2.LINE_AA, _BITS)
    for at, end in zip(drawn(shown.seen), drawn(ends), strict=True):
        cv2.line(picture, at, end, _LINE, 2, cv2.LINE_AA, _BITS)
        cv2.circle(picture, at, 5 << _BITS, _GREEN, 2, cv2.LINE_AA, _BITS)
    return as_jpeg(picture, _QUALITY)


def landmark_caption(shown: ShownLandmarks, seconds: float) -> str:
    """The picture in numbers; `seconds` count since the first image."""
    off = float(np.median(np.linalg.norm(shown.predicted - shown.seen, axis=1)))
    matches = len(shown.seen) + len(shown.disagreeing)
    caption = (
        f"Image {shown.number}, at {seconds:.1f} s: of {len(shown.features)} features (grey) {matches} match landmarks."
        f" {len(shown.seen)} of these are inliers, which agree with the pose (green), and {len(shown.disagreeing)} are"
        f" elsewhere (red crosses). Orange lines, {_LONGER} times too long, lead to where the pose predicts the"
        f" inliers, {off:.1f} of {shown.image.shape[1]} pixels off in the median."
    )
    if shown.others:
        places = "Another place is verified, by" if len(shown.others) == 1 else "Other places are verified, by"
        caption += f" {places} {', '.join(map(str, shown.others))} landmarks."
    return caption
