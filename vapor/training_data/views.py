"""Comparison of the motion in images with the motion of poses: orientation, mirroring and focal length."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Literal

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from filtering.se3 import Poses
from sequences.frame import BASE_FROM_CAMERA, Camera, Frame

By = Literal["true poses", "odometry"]

_WIDTH_PX = 320  # at which images are compared
_FEATURES, _RATIO, _LEAST_MATCHES, _MOST_MATCHES = 400, 0.75, 25, 100
_TURNS_RAD, _TURNS_TOO_FAR_RAD, _MOVES_M, _WITHIN_S = 0.12, 0.4, 0.3, 2.0  # from one image of a pair to the other
_MOST_PAIRS, _LEAST_PAIRS = 25, 8
_NEAREST_M = 0.3  # that anything is from the camera, or the length of a long motion between two images if less
_CAP = 0.1  # of a residual, focal lengths
_FOCAL = np.geomspace(0.5, 2.0, 29)
_LOG_FOCAL, _DRAWS = np.log(_FOCAL), 100
_USUAL_FOCAL = 0.8  # of the width, where it is not known
_BETTER, _AS_GOOD, _GOOD = 0.5, 1.25, 0.03  # of the residual as it is; of the best one; and focal lengths
_OTHER_FOCAL, _FOCAL_BETTER, _CERTAIN = 0.08, 0.85, 3.0  # of its logarithm; of the residual; and standard errors

AS_STATED = "as stated"
_IMAGES = {
    AS_STATED: [[1, 0], [0, 1]],
    "the images are upside down": [[-1, 0], [0, -1]],
    "the images are turned by 90° to the right": [[0, 1], [-1, 0]],
    "the images are turned by 90° to the left": [[0, -1], [1, 0]],
    "the images are mirrored or the poses left-handed": [[-1, 0], [0, 1]],
    "the images are mirrored and upside down or the poses left-handed": [[1, 0], [0, -1]],
    "the images are mirrored and turned by 90° to the right or the poses left-handed": [[0, -1], [-1, 0]],
    "the images are mirrored and turned by 90° to the left or the poses left-handed": [[0, 1], [1, 0]],
}
_POSES = {
    "the poses have OpenGL's axes (y up, z back) instead of the camera's": np.diag([1.0, -1.0, -1.0]),
    "the poses are of a body that looks along its x instead of the camera": BASE_FROM_CAMERA.rotation,
    "the camera looks back where the poses look ahead": np.diag([-1.0, 1.0, -1.0]),
}
ORIENTATIONS: Final[Mapping[str, Float64[np.ndarray, "3 3"]]] = {
    **{name: np.block([[np.array(turn, float), np.zeros((2, 1))], [0.0, 0.0, 1.0]]) for name, turn in _IMAGES.items()},
    **_POSES,
}
"""Possible faults, and the matrix that carries directions in an image to the axes of the poses."""


@dataclass(frozen=True)
class ViewCheck:
    """Comparison of the motion that images show with the motion of poses.

    Attributes:
        by: Source of the poses.
        pairs: Pairs of images compared.
        residual: Median distance of image points from their expected places, in focal lengths.
        orientations: Keys of `ORIENTATIONS` with which the images fit the poses about equally well, the best first;
            empty where the images fit with no orientation.
        residual_turned: The same distance with the best orientation.
        focal: The focal length over the stated one where it clearly differs, else None.
    """

    by: By
    pairs: int
    residual: float
    orientations: tuple[str, ...]
    residual_turned: float
    focal: float | None

    @property
    def is_right(self) -> bool:
        """Whether images agree with the poses as stated."""
        return AS_STATED in self.orientations


class Views:
    """Features that pairs of images of one recording share, as its frames come; `pairs` are spread over it."""

    def __init__(self) -> None:
        self.pairs: list[Pair] = []
        self._every_s, self._earliest_s, self._sequence = 0.0, -np.inf, 0
        self._first: _View | None = None
        self._by_odometry = Poses.identity()

    def take(self, frame: Frame) -> None:
        """The next frame."""
        first, step = self._first, frame.odometry
        if first is not None and frame.sequence != self._sequence:
            first, step, self._earliest_s = None, None, -np.inf
        if step is None:  # odometry does not connect this frame with the one before
            self._by_odometry, first = Poses.identity(), None if first is None else replace(first, odometry=None)
        else:
            self._by_odometry = self._by_odometry @ step.previous_from_current
        view = _View(frame.time_ns, frame.image, frame.camera, frame.world_from_camera, self._by_odometry)
        self._first, self._sequence = view, frame.sequence
        if first is not None and first.truth is not None and step is None and view.truth is None:
            self._first = first  # a later image may have a true pose again
            return
        motions = {} if first is None else first.motions_to(view)
        if first is None or not motions or not 0 <= (view.time_ns - first.time_ns) * 1e-9 <= _WITHIN_S:
            return
        moved = next(iter(motions.values()))
        metres, radians = np.linalg.norm(moved.translation[:2]), moved.distance(Poses.identity())[1]
        if max(radians / _TURNS_RAD, metres / _MOVES_M) < 1:
            self._first = first
        elif radians < _TURNS_TOO_FAR_RAD and view.time_ns * 1e-9 >= self._earliest_s:
            self._add(_pair(first, view, motions), view.time_ns * 1e-9)

    def checks(self) -> list[ViewCheck]:
        """By true poses and by odometry, where there are enough pairs of images."""
        found = []
        by: By
        for by in ("true poses", "odometry"):
            pairs = [pair for pair in self.pairs if by in pair.motions]
            if len(pairs) >= _LEAST_PAIRS:
                found.append(_check(by, pairs))
        return found

    def _add(self, pair: Pair | None, second: float) -> None:
        if pair is None:
            return
        self.pairs.append(pair)
        if len(self.pairs) == 2 * _MOST_PAIRS:
            self.pairs, self._every_s = self.pairs[::2], 2 * max(self._every_s, 0.5)
        self._earliest_s = second + self._every_s


@dataclass(frozen=True)
class _View:
    """An image that may become one of a pair, and its poses."""

    time_ns: int
    image: UInt8[np.ndarray, "h w 3"]
    camera: Camera | None
    truth: Poses | None
    odometry: Poses | None

    def motions_to(self, other: _View) -> dict[By, Poses]:
        """second_from_first by each source that gives poses of both."""
        found: dict[By, Poses] = {}
        if self.truth is not None and other.truth is not None:
            found["true poses"] = other.truth.inverse() @ self.truth
        if self.odometry is not None and other.odometry is not None:
            found["odometry"] = other.odometry.inverse() @ self.odometry
        return found

    @cached_property
    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions (n, 2), in focal lengths from the middle, and descriptors (n, 128)."""
        height, width = self.image.shape[:2]
        small = _WIDTH_PX, max(round(height * _WIDTH_PX / width), 1)
        grey = cv2.cvtColor(cv2.resize(self.image, small, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
        focal = _USUAL_FOCAL * small[0]
        camera = self.camera or Camera(*small, focal, focal, (small[0] - 1) / 2, (small[1] - 1) / 2)
        if (camera.width < camera.height) != (width < height):  # it was turned, and its intrinsics were not
            camera = Camera(camera.height, camera.width, camera.fy, camera.fx, camera.cy, camera.cx)
        camera = camera.scaled(*small)
        sift: cv2.SIFT = cv2.SIFT.create(_FEATURES)
        points, descriptors = sift.detectAndCompute(np.asarray(grey), None)  # pyright: ignore[reportCallIssue, reportArgumentType]
        at = np.array([point.pt for point in points]).reshape(-1, 2)
        directions = (at - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        return directions, np.zeros((0, 128), np.float32) if descriptors is None else descriptors


@dataclass(frozen=True)
class Pair:
    """Matches of two images.

    Attributes:
        times_ns: Stamps of both.
        first: Directions in the first image, in focal lengths from the middle, (m, 2).
        second: The same points in the second image.
        motions: second_from_first by source.
        known_focal: Whether the focal length is known.
    """

    times_ns: tuple[int, int]
    first: Float64[np.ndarray, "m 2"]
    second: Float64[np.ndarray, "m 2"]
    motions: Mapping[By, Poses]
    known_focal: bool


def _pair(first: _View, second: _View, motions: Mapping[By, Poses]) -> Pair | None:
    """The matches of two images; None where there are too few."""
    (at_first, one), (at_second, other) = first.features, second.features
    if min(len(one), len(other)) < _LEAST_MATCHES:
        return None
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    there, back = (
        {
            near.queryIdx: near.trainIdx
            for near, *others in matcher.knnMatch(a, b, 2)
            if others and near.distance < _RATIO * others[0].distance
        }
        for a, b in ((one, other), (other, one))
    )
    matches = np.array([(i, j) for i, j in there.items() if back.get(j) == i]).reshape(-1, 2)
    if len(matches) < _LEAST_MATCHES:
        return None
    stamps = first.time_ns, second.time_ns
    return Pair(stamps, at_first[matches[:, 0]], at_second[matches[:, 1]], motions, first.camera is not None)


class Residuals:
    """Distances of the points that pairs of images share from their expected places, for all pairs at once."""

    def __init__(self, pairs: Sequence[Pair]) -> None:
        """Take up to 100 directions of each of p pairs."""
        counts = np.array([min(len(pair.first), _MOST_MATCHES) for pair in pairs])
        self._seen = np.full((2, len(pairs), counts.max(initial=1), 2), np.nan)
        for i, (pair, count) in enumerate(zip(pairs, counts, strict=True)):
            self._seen[0, i, :count], self._seen[1, i, :count] = pair.first[:count], pair.second[:count]
        self._middle = (counts - 1) // 2  # of those in order

    def of(
        self, motions: Poses, turn: Float64[np.ndarray, "3 3"] | None = None, focal: float = 1.0
    ) -> Float64[np.ndarray, " p"]:
        """Median distance of the points in each second image from their expected places, at any depth.

        Args:
            motions: second_from_first, (p,).
            turn: Carries directions in an image to the axes of the motions; None for the identity.
            focal: The focal length over the one by which directions were found.
        """
        turn = np.eye(3) if turn is None else turn
        first, second = self._seen / focal
        rotations = turn.T @ motions.rotation @ turn
        rays = np.concatenate([first, np.ones((*first.shape[:2], 1))], axis=2) @ np.swapaxes(rotations, 1, 2)
        lengths = np.linalg.norm(motions.translation, axis=1)
        nearest = max(min(_NEAREST_M, float(np.quantile(lengths, 0.9))), 1e-9)  # less in a small scene
        moved = motions.translation @ turn / nearest
        far, near = _projected(rays), _projected(rays + moved[:, None])
        along = near - far
        fraction = np.sum((second - far) * along, axis=2) / np.maximum(np.sum(along**2, axis=2), 1e-12)
        apart = np.linalg.norm(second - far - np.clip(fraction, 0.0, 1.0)[..., None] * along, axis=2)
        medians = np.sort(apart, axis=1)[np.arange(len(apart)), self._middle]  # NaN comes last
        return np.minimum(medians, _CAP)


def _projected(rays: Float64[np.ndarray, "p m 3"]) -> Float64[np.ndarray, "p m 2"]:
    return rays[..., :2] / np.maximum(rays[..., 2:], 0.1)


def _check(by: By, pairs: Sequence[Pair]) -> ViewCheck:
    residuals, motions = Residuals(pairs), Poses.stack([pair.motions[by] for pair in pairs])
    known = all(pair.known_focal for pair in pairs)

    def means(scales: Sequence[float]) -> dict[str, float]:
        return {
            name: min(float(residuals.of(motions, turn, focal).mean()) for focal in scales)
            for name, turn in ORIENTATIONS.items()
        }

    coarse = _FOCAL[::4].tolist()
    found = means([1.0] if known else coarse)
    as_stated = found[AS_STATED]
    if known and min(found.values()) > _GOOD:  # through another lens, something may fit
        found = means(coarse)
    best = min(found.values())
    fits = tuple(sorted((name for name in found if found[name] <= _AS_GOOD * best), key=found.__getitem__))
    if best > _GOOD:
        return ViewCheck(by, len(pairs), as_stated, (), best, None)
    if best > _BETTER * found[AS_STATED]:  # nothing fits clearly better
        fits = (AS_STATED,)
    turn = ORIENTATIONS[fits[0]]
    focal = _focal([residuals.of(motions, turn, focal) for focal in _FOCAL]) if known else None
    return ViewCheck(by, len(pairs), as_stated, fits, found[fits[0]], focal)


def said_of_views(name: str, checks: Sequence[ViewCheck]) -> list[str]:
    """Notices on a recording whose images and poses do not agree; nothing where they do."""
    right = [check for check in checks if check.is_right]
    turned = [check for check in checks if check.orientations and not check.is_right]
    apart = [check for check in checks if not check.orientations]
    notices = []
    agree = f", while {right[0].by} and images agree" if right else ""
    if turned:
        worst = turned[0]
        shared = [o for o in worst.orientations if all(o in check.orientations for check in turned)]
        notices.append(
            f"{name}: {' or '.join(shared or worst.orientations)}, as images move against {_by(turned)}{agree}"
            f" ({np.degrees(worst.residual_turned):.1f}° off so, {np.degrees(worst.residual):.1f}° as stated): correct"
            " images, poses or where the camera sits (tf, --base-from-camera)"
        )
    if apart:
        notices.append(
            f"{name}: images do not move like {_by(apart)}, whichever way they are turned"
            f" ({np.degrees(apart[0].residual_turned):.1f}° off){agree}: are these of one recording, by one"
            " clock, and of this camera?"
        )
    return [*notices, *said_of_focal_length(name, checks)]


def said_of_focal_length(name: str, checks: Sequence[ViewCheck]) -> list[str]:
    """A notice on a recording whose focal length is not the stated one, by its images and poses; else nothing."""
    right, notices = [check for check in checks if check.is_right], []
    for check in [check for check in checks if check.focal is not None][:1]:
        odometry = "" if check.by == "true poses" else ", or odometry has turns too large or too small"
        fine = odometry and any(other.by == "true poses" for other in right)
        others = ", while true poses and images agree," if fine else ""
        notices.append(
            f"{name}: by {check.by}{others} the images move as through a focal length {check.focal:.2f} times the"
            " stated one: the intrinsics are wrong (camera_info, intrinsics.json), or images were scaled or cropped"
            f"{odometry}"
        )
    return notices


def _by(checks: Sequence[ViewCheck]) -> str:
    return " and ".join(check.by for check in checks)


def _focal(residuals: Sequence[np.ndarray]) -> float | None:
    """The best focal length over the stated one, by residuals of pairs with each of `_FOCAL`; None where 1 will do."""
    table, rng = np.array(residuals), np.random.default_rng(0)  # of each focal length and pair
    count = table.shape[1]
    drawn = [lowest(_LOG_FOCAL, table[:, rng.integers(count, size=count)].mean(axis=1)) for _ in range(_DRAWS)]
    means = table.mean(axis=1)
    best, error = lowest(_LOG_FOCAL, means), float(np.std(drawn))
    fits = means.min() < min(_GOOD / 2, _FOCAL_BETTER * means[_FOCAL == 1.0].item())
    return float(np.exp(best)) if fits and abs(best) > max(_OTHER_FOCAL, _CERTAIN * error) else None


def lowest(places: Float64[np.ndarray, " n"], means: Float64[np.ndarray, " n"]) -> float:
    """Where a parabola through the lowest mean and its neighbours is lowest; places lie equally far apart, n ≥ 3."""
    i, step = int(np.clip(np.nanargmin(means), 1, len(means) - 2)), float(places[1] - places[0])
    left, middle, right = means[i - 1 : i + 2].tolist()
    bend = left - 2 * middle + right
    return float(places[i]) + (0.5 * step * (left - right) / bend if bend > 0 else 0.0)
