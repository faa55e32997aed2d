"""Visual odometry: the motion of a camera from image to image, by its images alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import cv2
import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError
from filtering.motion import Odometry, OdometryBias
from filtering.se3 import Poses
from sequences.frame import Camera
from sequences.visual_odometry.adjustment import adjust
from sequences.visual_odometry.alignment import Alignment, MotionPrior, align
from sequences.visual_odometry.features import Grey, detect, pixel_covariance, track
from sequences.visual_odometry.tracks import KeyFrame, Tracks, project
from sequences.visual_odometry.two_view import initialize

USUAL_DEPTH_M = 2.0
"""How far away the scene is in a room, metres."""

_USUAL_DEPTH = 2.0  # of features in the map, whose unit is arbitrary
_WIDTH = 340  # pixels: larger images are scaled down
_MOST_FEATURES, _LEAST_FEATURES = 200, 8
_KEY_FRAMES = 6
_PARALLAX = 0.05  # of the width: a key frame is needed after so much
_TURN = 4.0  # times that: or after a turn that moves the features so far
_LEAST_SHARED, _LEAST_SEEN = 20, 0.5  # features of the latest key frame, else one is needed
_UNKNOWN = 0.7  # standard deviation of an unknown inverse depth, over its mean
_KNOWN = 0.3  # below, a depth is known
_NEIGHBOURS, _LEAST_KNOWN = 5, 10
_LEAK = 0.2  # of the usual depth in that of a new feature: a unit that runs away comes back
_UNIT = 0.1  # of the logarithm of the usual depth in that of the map's unit, at each key frame: likewise
_SPEED_UP, _TURN_UP = 1.0, 7.0  # depths / s² and rad / s², standard deviations of the accelerations
_FARTHEST_PX = 80.0  # of a prediction from where the feature was
_MOST_LOST = 0.8  # of the features in one image: another scene
_INFLATION, _BY_SURPRISE = 1.3, 0.5  # of the covariance, measured on recordings
_PER_SQRT_M = 0.04  # standard deviation that grows with the square root of the distance
_FIRST_SURPRISE, _MOST_SURPRISE = 3.0, 20.0
_FIRST_COST = 1.5
_FOLLOWS = 0.3  # of cost and surprise at the latest image or key frame
_NEW_MAP = 2  # key frames, which hold the unit
_LONGEST_S, _LEAST_S = 1.0, 1 / 60  # between images; for less the prior is as wide
_MOST_TIMES = 3.0  # of the motion before: a prediction
_FARTHEST_M = 1e9
_ALIKE = 0.01  # of focal lengths and of the size: intrinsics of one camera


class VisualOdometry:
    """Monocular visual odometry, a step for each image.

    Features are tracked from image to image; their depths and the poses of a few key frames are those that fit best
    (bundle adjustment over a window). The length of a motion is in a unit in which the scene is about as far away as is
    usual: a filter finds how long it is, with `LocalizerConfig(odometry_bias=VisualOdometry.bias)`. Its covariance is
    wider where features are few, move among themselves, or do not determine the motion, and where key frames corrected
    the motions lately by more than was expected.

    Source: keyframe-based monocular odometry as of Klein and Murray, "Parallel tracking and mapping for small AR
    workspaces", ISMAR 2007; inverse depths as of Civera et al., T-RO 2008.

    Example:
        >>> import vapor
        >>> images = vapor.ImageSequence("room/", rate_hz=10.0)
        >>> odometry = vapor.VisualOdometry(images.camera)
        >>> motions = [odometry.step(frame.image, frame.time_ns) for frame in images]
        >>> motions[0] is None  # of the first image
        True
    """

    bias: ClassVar[OdometryBias] = OdometryBias(scale=1.0, relative_drift=1.0, time_s=5.0, scale_time_s=200.0)
    """How the motions err beside their covariances: their unit is unknown and changes slowly. For
    `LocalizerConfig.odometry_bias`."""

    def __init__(self, camera: Camera, *, usual_depth_m: float = USUAL_DEPTH_M) -> None:
        """Before the first image.

        Args:
            camera: Intrinsics of the undistorted images.
            usual_depth_m: How far away the scene usually is, metres: two in a room, twenty in a square.

        Raises:
            VaporTrackError: the depth is not positive, or larger than any.
        """
        if not 0.0 < usual_depth_m < _FARTHEST_M:
            raise VaporTrackError(
                f"usual_depth_m is {usual_depth_m}, expected more than 0 and less than {_FARTHEST_M:g}"
            )
        self._set_camera(camera)
        self._unit_m = usual_depth_m / _USUAL_DEPTH
        self._time_ns: int | None = None
        self._image: Grey | None = None
        self._begin_map()

    def _set_camera(self, camera: Camera) -> None:
        self.camera = camera
        scale = min(1.0, _WIDTH / camera.width)
        small = camera.scaled(*(max(round(scale * side), 1) for side in (camera.width, camera.height)))
        self._size = small.width, small.height
        self._focal, self._centre = np.array([small.fx, small.fy]), np.array([small.cx, small.cy])

    def _begin_map(self) -> None:
        self._tracks = Tracks.none()
        self._key_frames: tuple[KeyFrame, ...] = ()
        self._pose = Poses.identity()  # camera_from_map
        self._motion = Poses.identity()  # camera_from_previous
        self._usual = 1.0 / _USUAL_DEPTH
        self._next_id = self._next_frame = 0
        self._since_s = self._usual_s = 0.0  # since the latest image that differs, and of the latest motion
        self._has_depths, self._cost = False, _FIRST_COST
        # The covariance of the motion since the latest key frame; the squared distance, by it and for each degree of
        # freedom, of the corrections that key frames brought.
        self._since_key_frame, self._surprise = np.zeros((6, 6)), _FIRST_SURPRISE

    def step(self, image: np.ndarray, time_ns: int, camera: Camera | None = None) -> Odometry | None:
        """The motion since the image before.

        Args:
            image: RGB (h, w, 3) or grey (h, w), uint8, undistorted.
            time_ns: When it was taken, nanoseconds.
            camera: Its intrinsics, where they are not those of the image before.

        Returns:
            The motion, and its covariance apart from the unit of its length. None for the first image, and where the
            images do not say how the camera moved: too few features, another scene, more than a second between them, or
            the same image again for longer than that.

        Raises:
            VaporTrackError: the image is not one, has another size than its camera, or its time is not later than that
                of the one before.
        """
        camera = camera or self.camera
        _require_image(image, camera)
        before, before_ns = self._image, self._time_ns
        if before_ns is not None and time_ns <= before_ns:
            raise VaporTrackError(f"time_ns is {time_ns} after {before_ns}, expected later images")
        if camera != self.camera:
            before = before if _is_alike(camera, self.camera) else None
            self._set_camera(camera)
        grey = self._grey(image)
        self._image, self._time_ns = grey, time_ns
        if before is None or before_ns is None:
            self._start(grey)
            return None
        duration_s = 1e-9 * (time_ns - before_ns)
        self._since_s += duration_s
        if np.array_equal(before, grey):
            return self._repeated(duration_s)
        motion = self._follow(before, grey, duration_s) if duration_s <= _LONGEST_S else None
        self._since_s = 0.0
        if motion is None:
            self._start(grey)
            return None
        return motion.in_unit(self._unit_m)

    def _repeated(self, duration_s: float) -> Odometry | None:
        """The motion to the same image again: none yet, and the next image will show it."""
        if self._since_s > _LONGEST_S or self._usual_s == 0.0:
            return None
        moved = self._motion.log() * min(duration_s / self._usual_s, 1.0)
        repeated = Odometry(Poses.identity(), np.outer(moved, moved) + 1e-8 * np.eye(6), duration_s)
        return repeated.in_unit(self._unit_m)

    def _grey(self, image: np.ndarray) -> Grey:
        """The image as it is tracked: a copy, as callers may use their memory again."""
        grey = image.copy() if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        if self._size != grey.shape[::-1]:
            grey = cv2.resize(grey, self._size, interpolation=cv2.INTER_AREA)
        return np.asarray(grey, np.uint8)

    # --- one image ----------------------------------------------------------------------------------

    def _start(self, grey: Grey) -> None:
        """Begin a new map at an image."""
        self._begin_map()
        self._add_key_frame(grey)

    def _follow(self, before: Grey, grey: Grey, duration_s: float) -> Odometry | None:
        """The motion to an image; None where its features are lost."""
        tracked = track(before, grey, self._tracks.pixels, self._predicted())
        count, found = len(self._tracks), int(tracked.found.sum())
        if found < max(_LEAST_FEATURES, (1.0 - _MOST_LOST) * count):
            return None
        self._tracks = replace(self._tracks, pixels=tracked.points)[tracked.found]
        previous = self._pose
        alignment = self._aligned(self._since_s)
        self._pose = alignment.pose
        self._cost += _FOLLOWS * (alignment.cost - self._cost)
        self._motion, self._usual_s = self._pose @ previous.inverse(), self._since_s
        self._since_key_frame = self._since_key_frame + alignment.covariance
        covariance = (_INFLATION + _BY_SURPRISE * self._surprise) * alignment.covariance
        motion = previous @ self._pose.inverse()
        walk = np.repeat([_PER_SQRT_M**2 * float(np.linalg.norm(motion.translation)), 0.0], 3)
        odometry = Odometry(motion, 0.5 * (covariance + covariance.T) + np.diag(walk), duration_s)
        if self._has_depths:
            self._tracks = self._tracks[alignment.fits]
        self._map(grey)
        return odometry

    def _aligned(self, since_s: float) -> Alignment:
        predicted = self._expected_motion() @ self._pose
        std = np.repeat([_SPEED_UP * _USUAL_DEPTH, _TURN_UP], 3) * max(since_s, _LEAST_S) ** 2
        prior = MotionPrior(predicted, std)
        return align(
            self._tracks,
            self._key_frames,
            [predicted, self._pose],
            prior,
            self._focal,
            self._centre,
            np.array(self._size),
            self._cost,
        )

    def _expected_motion(self) -> Poses:
        """The motion to the image if the camera goes on as it does."""
        times = self._since_s / self._usual_s if self._usual_s > 0.0 else 1.0
        return Poses.exp(min(times, _MOST_TIMES) * self._motion.log())

    def _predicted(self) -> np.ndarray:
        """Where the features are in the next image if the camera goes on as it does."""
        points = project(self._tracks, self._expected_motion() @ self._pose, self._key_frames).points
        at = points[:, :2] / np.maximum(points[:, 2:], 1e-3) * self._focal + self._centre
        far = (points[:, 2] < 1e-2) | (np.linalg.norm(at - self._tracks.pixels, axis=1) > _FARTHEST_PX)
        return np.where(far[:, None], self._tracks.pixels, at).astype(np.float32)

    # --- the map ------------------------------------------------------------------------------------

    def _map(self, grey: Grey) -> None:
        """Add a key frame where one is needed."""
        if not self._has_depths:
            self._find_depths(grey)
        elif self._needs_key_frame():
            self._add_key_frame(grey)
            self._adjust()
            self._rescale()

    def _find_depths(self, grey: Grey) -> None:
        first = self._key_frames[0]
        found = initialize(self._tracks, first, self._focal, self._centre, self._usual, _PARALLAX * self._size[0])
        if found is not None:
            self._tracks, self._pose = found.tracks, found.pose
            self._motion, self._has_depths = Poses.identity(), True
            self._add_key_frame(grey)
            self._adjust()
        elif np.isin(first.ids, self._tracks.ids).mean() < _LEAST_SEEN:
            self._start(grey)

    def _needs_key_frame(self) -> bool:
        latest = self._key_frames[-1]
        _, of_latest, of_tracks = np.intersect1d(latest.ids, self._tracks.ids, return_indices=True)
        if len(of_latest) < max(_LEAST_SHARED, _LEAST_SEEN * len(latest.ids)):
            return True
        before = (latest.pixels[of_latest] - self._centre) / self._focal
        after = (self._tracks.pixels[of_tracks] - self._centre) / self._focal
        rotation = (self._pose @ latest.pose.inverse()).rotation
        turned = np.column_stack([before, np.ones(len(before))]) @ rotation.T
        turned = turned[:, :2] / turned[:, 2:]
        parallax, turn = (
            float(np.median(np.linalg.norm((turned - other) * self._focal, axis=1))) for other in (after, before)
        )
        return parallax > _PARALLAX * self._size[0] or turn > _TURN * _PARALLAX * self._size[0]

    def _add_key_frame(self, grey: Grey) -> None:
        covariance = pixel_covariance(grey, self._tracks.pixels)
        self._tracks = replace(self._tracks, covariance=covariance).joined(self._new_tracks(grey))
        frame = KeyFrame(self._next_frame, self._pose, self._tracks.ids, self._tracks.pixels)
        self._next_frame += 1
        self._key_frames = (*self._key_frames, frame)
        if len(self._key_frames) > _KEY_FRAMES:
            self._tracks = _without_first(self._tracks, self._key_frames, self._focal, self._centre)
            self._key_frames = self._key_frames[1:]

    def _new_tracks(self, grey: Grey) -> Tracks:
        pixels = detect(grey, self._tracks.pixels, _MOST_FEATURES)
        depths, count = self._guessed(pixels), len(pixels)
        ids = self._next_id + np.arange(count)
        self._next_id += count
        return Tracks(
            ids,
            pixels,
            pixel_covariance(grey, pixels),
            np.full(count, self._next_frame),
            (pixels - self._centre) / self._focal,
            depths,
            np.square(_UNKNOWN * depths),
        )

    def _guessed(self, pixels: np.ndarray) -> Float64[np.ndarray, " n"]:
        """Inverse depths of new features: as their neighbours', and a little as usual."""
        known = self._tracks[self._tracks.variance < np.square(_KNOWN * self._tracks.inverse_depth)]
        if len(known) <= _LEAST_KNOWN:
            return np.full(len(pixels), self._usual)
        self._usual = float(np.median(known.inverse_depth))
        distances = np.linalg.norm(pixels[:, None] - known.pixels[None], axis=2)
        nearest = np.argpartition(distances, _NEIGHBOURS, axis=1)[:, :_NEIGHBOURS]
        return np.median(known.inverse_depth[nearest], axis=1) ** (1.0 - _LEAK) * (1.0 / _USUAL_DEPTH) ** _LEAK

    def _rescale(self) -> None:
        """Move the unit of the map a little to where the scene is as far away as is usual: else it would run away."""
        known = self._tracks.variance < np.square(_KNOWN * self._tracks.inverse_depth)
        if known.sum() <= _LEAST_KNOWN:
            return
        times = float(np.median(self._tracks.inverse_depth[known]) * _USUAL_DEPTH) ** _UNIT
        self._tracks = replace(
            self._tracks,
            inverse_depth=self._tracks.inverse_depth / times,
            variance=self._tracks.variance / times**2,
        )
        self._key_frames = tuple(replace(each, pose=_scaled(each.pose, times)) for each in self._key_frames)
        self._pose, self._motion = _scaled(self._pose, times), _scaled(self._motion, times)
        self._usual /= times

    def _adjust(self) -> None:
        before = self._pose
        self._tracks, self._key_frames = adjust(self._tracks, self._key_frames, self._focal, self._centre)
        self._pose = self._key_frames[-1].pose
        corrected = (self._pose @ before.inverse()).log()
        if len(self._key_frames) > _NEW_MAP:
            squared = corrected @ np.linalg.solve(self._since_key_frame + 1e-8 * np.eye(6), corrected)
            self._surprise += _FOLLOWS * (min(float(squared) / 6.0, _MOST_SURPRISE) - self._surprise)
        self._since_key_frame = np.zeros((6, 6))


def _scaled(pose: Poses, times: float) -> Poses:
    return Poses(pose.rotation, times * pose.translation)


def _require_image(image: np.ndarray, camera: Camera) -> None:
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise VaporTrackError(
            f"image is {image.dtype} {image.shape}, expected uint8 (height, width, 3), or (height, width)"
        )
    if image.shape[:2] != (camera.height, camera.width):
        raise VaporTrackError(
            f"image is {image.shape[1]} x {image.shape[0]} pixels, its camera {camera.width} x {camera.height}"
        )


def _is_alike(camera: Camera, other: Camera) -> bool:
    """Whether two intrinsics are of one camera that focuses."""
    if (camera.width, camera.height) != (other.width, other.height):
        return False
    focal = abs(camera.fx / other.fx - 1.0), abs(camera.fy / other.fy - 1.0)
    centre = abs(camera.cx - other.cx) / camera.width, abs(camera.cy - other.cy) / camera.height
    return max(*focal, *centre) <= _ALIKE


def _without_first(
    tracks: Tracks,
    key_frames: Sequence[KeyFrame],
    focal: Float64[np.ndarray, " 2"],
    centre: Float64[np.ndarray, " 2"],
) -> Tracks:
    """The features anchored in key frames but the first one; its own become the second one's where that saw them."""
    first, second = key_frames[:2]
    own = tracks.anchor == first.number
    _, of_second, of_tracks = np.intersect1d(second.ids, tracks.ids, return_indices=True)
    again = of_tracks[own[of_tracks]]
    pixels = second.pixels[of_second[own[of_tracks]]]
    depth = project(tracks, second.pose, key_frames).points[again, 2]
    anchor, ray = tracks.anchor.copy(), tracks.ray.copy()
    inverse_depth, variance = tracks.inverse_depth.copy(), tracks.variance.copy()
    in_front = np.maximum(depth, 1e-3)
    anchor[again], ray[again] = second.number, (pixels - centre) / focal
    inverse_depth[again] /= in_front
    variance[again] /= in_front**2
    kept = ~own
    kept[again] = depth > 1e-3
    return replace(tracks, anchor=anchor, ray=ray, inverse_depth=inverse_depth, variance=variance)[kept]
