"""Features of an image: where they are, how exactly, and where they are in the next one."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

_QUALITY = 0.01  # of the best corner: weaker ones are not features
_BLOCK, _WINDOW, _LEVELS = 7, (21, 21), 3  # pixels, pixels, halvings
_GRADIENT_WINDOW = 15  # pixels, over which gradients say how exactly a feature is tracked
_NOISE, _LEAST_PX = 6.0, 0.2  # of grey values; standard deviation of the best feature
_SCHARR = 32.0  # sum of its weights
_NOISE_GRADIENT = 0.23  # variance of the gradient of noise of variance 1
_ABOVE_NOISE = 3.0  # times the gradients of noise: a corner
_SECOND_DIFFERENCE = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]], np.float32)
_MEDIAN_OF_NORMAL = 0.6745
_THERE_AND_BACK_PX = 1.0
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.03)

Grey = UInt8[np.ndarray, "height width"]
Points = Float32[np.ndarray, "n 2"]


@dataclass(frozen=True)
class Tracked:
    """Features in the next image.

    Attributes:
        points: Where they are, pixels (x, y), (n, 2).
        found: Whether each was found, (n,): back in the image before it is where it was.
    """

    points: Points
    found: Bool[np.ndarray, " n"]


def detect(image: Grey, known: Points, most: int) -> Float32[np.ndarray, "m 2"]:
    """New corners away from known ones, up to `most` in all; none that may be noise.

    Source: Shi and Tomasi, "Good features to track", CVPR 1994.
    """
    room = most - len(known)
    if room <= 0:
        return np.zeros((0, 2), np.float32)
    apart = max(4, round(0.6 * float(np.sqrt(image.size / most))))
    free = np.full(image.shape, 255, np.uint8)
    for x, y in known.astype(int).tolist():
        cv2.circle(free, (x, y), apart, 0, -1)
    found = cv2.goodFeaturesToTrack(image, room, _QUALITY, apart, mask=free, blockSize=_BLOCK)
    if found is None:
        return np.zeros((0, 2), np.float32)
    corners = np.asarray(found, np.float32).reshape(-1, 2)
    of_noise = _NOISE_GRADIENT * noise_of(image) ** 2 * _GRADIENT_WINDOW**2
    return corners[np.linalg.eigvalsh(structure_tensor(image, corners))[:, 0] > _ABOVE_NOISE * of_noise]


def track(before: Grey, after: Grey, points: Points, predicted: Points) -> Tracked:
    """Find features of one image in the next, near where they are predicted (n, 2).

    Source: Bouguet, "Pyramidal implementation of the affine Lucas Kanade feature tracker", 2001.
    """
    if len(points) == 0:
        return Tracked(points, np.zeros(0, bool))
    there, seen = _flow(before, after, points, predicted)
    back, seen_back = _flow(after, before, there, points)
    height, width = after.shape
    inside = ((there > 2.0) & (there < np.array([width - 3.0, height - 3.0]))).all(axis=1)
    same = np.linalg.norm(back - points, axis=1) < _THERE_AND_BACK_PX
    return Tracked(there, seen & seen_back & inside & same)


def _flow(before: Grey, after: Grey, points: Points, start: Points) -> tuple[Points, Bool[np.ndarray, " n"]]:
    there, seen, _ = cv2.calcOpticalFlowPyrLK(
        before,
        after,
        points,
        start.copy(),
        winSize=_WINDOW,
        maxLevel=_LEVELS,
        criteria=_CRITERIA,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(there, np.float32), seen[:, 0] > 0


def noise_of(image: Grey) -> float:
    """Standard deviation of the noise of grey values, as in the plainer half of the image.

    Source: Immerkær, "Fast noise variance estimation", 1996, by the median.
    """
    second = cv2.filter2D(image, cv2.CV_32F, _SECOND_DIFFERENCE)
    return float(np.median(np.abs(second))) / (_MEDIAN_OF_NORMAL * float(np.linalg.norm(_SECOND_DIFFERENCE)))


def structure_tensor(image: Grey, points: Points) -> Float64[np.ndarray, "n 2 2"]:
    """Sums of the products of the gradients about points, grey values² / pixel²."""
    x = cv2.Scharr(image, cv2.CV_32F, 1, 0) / _SCHARR
    y = cv2.Scharr(image, cv2.CV_32F, 0, 1) / _SCHARR
    at = np.clip(np.round(points).astype(int), 0, np.array(image.shape[::-1]) - 1)
    window = (_GRADIENT_WINDOW, _GRADIENT_WINDOW)
    xx, xy, yy = (
        cv2.boxFilter(np.asarray(product, np.float32), cv2.CV_32F, window, normalize=False)[at[:, 1], at[:, 0]]
        for product in (x * x, x * y, y * y)
    )
    return np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-2).astype(np.float64)


def pixel_covariance(image: Grey, points: Points) -> Float64[np.ndarray, "n 2 2"]:
    """How exactly features are tracked, pixels²: along an edge hardly, across it well.

    It is the inverse of the structure tensor, times the variance of grey values.
    """
    return _NOISE**2 * np.linalg.inv(structure_tensor(image, points) + 1e-3 * np.eye(2)) + _LEAST_PX**2 * np.eye(2)
