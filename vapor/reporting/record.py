"""What a run leaves in memory for its report: little per image, and a few keyframes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate, Mode, Status
from filtering.floors import Floors
from filtering.se3 import Poses
from sequences.frame import Frame, Trajectory
from sequences.reading.counts import ImageCounts
from vapor.landmarks.shown import ShownLandmarks
from vapor.tracking.loop import Step
from vapor.tracking.methods import in_order

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


_MOST = 300
_PARTICLES = 60
_IMAGE_SIDE = 200  # pixels
_JPEG_QUALITY = 70


@dataclass(frozen=True)
class Moment:
    """What was believed after one image.

    Attributes:
        index: Number of the image.
        particles: Positions of 60 particles, equally weighted, (60, 3), metres.
        modes: Positions of the hypotheses, best first, (k, 3), metres.
        weights: Their weights, (k,).
        jpeg: The image, its longer side at most 200 pixels, as a JPEG file; empty where there is none.
    """

    index: int
    particles: Float32[np.ndarray, "60 3"]
    modes: Float32[np.ndarray, "k 3"]
    weights: Float64[np.ndarray, " k"]
    jpeg: bytes


class MomentCollector:
    """Keeps every image's moment, or, of more than 300 images, those of every second, fourth, eighth, ..."""

    def __init__(self) -> None:
        self._moments: list[Moment] = []
        self._seen, self._every = 0, 1

    def add(self, keyframe: Keyframe) -> None:
        """Take the next image."""
        if self._seen % self._every == 0:
            which = np.linspace(0, len(keyframe.cloud) - 1, _PARTICLES).astype(int)
            places = np.stack([mode.world_from_camera.translation for mode in keyframe.modes]).astype(np.float32)
            weights = np.array([mode.weight for mode in keyframe.modes])
            particles = keyframe.cloud.translation[which].astype(np.float32)
            self._moments.append(Moment(self._seen, particles, places, weights, _small_jpeg(keyframe.thumbnail)))
            if len(self._moments) > _MOST:
                self._every *= 2
                self._moments = self._moments[::2]
        self._seen += 1

    @property
    def moments(self) -> tuple[Moment, ...]:
        """Those that are kept, in order of time."""
        return tuple(self._moments)


def _small_jpeg(image: UInt8[np.ndarray, "height width 3"]) -> bytes:
    if image.size == 0:
        return b""
    import cv2

    small = cv2.cvtColor(shrunk(image, _IMAGE_SIDE), cv2.COLOR_RGB2BGR)
    return cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


@dataclass(frozen=True)
class RunRecord:
    """Everything a report is made of, n images.

    Attributes:
        times_ns: Header stamps, (n,).
        methods: Trajectory of every tracking method by its name, in the order of `METHODS`; absent ones are left out.
            Of single images it is the best mode of each one's posterior. Dead reckoning starts at the first true pose,
            or at the first estimate where that is unknown, and anew where there is no odometry; a sequence without any
            has none.
        covariance: Covariance of ξ = (v, ω) in the tangent at the filter's best mode, metres and radians, (n, 6, 6).
        status: The filter's own status, (n,).
        num_modes: Number of hypotheses, (n,).
        best_weight: Weight of the reported hypothesis, (n,).
        num_particles: Number of particles, (n,).
        effective_sample_size: Effective number of particles, (n,).
        agreement: Fraction of the belief that the latest images fitted, (n,).
        unfamiliarity: How unlike the training data each image was, see `PosePosterior`, (n,).
        step_ms: Wall-clock milliseconds of each step, (n,).
        truth: True poses of the images that have one; None if none has.
        smoothed_agreement: How well the images about each smoothed pose fit it, in [0, 1], (n,); None without any.
        keyframes: A few in order of time, the first and last image among them.
        moments: What was believed at up to 300 images, in order of time.
        skipped: Number of images and other messages skipped, by reason.
        images: What became of the images that the sequence states; None if not counted.
        peak_rss_mb: Peak resident memory of the process, MiB; None if not measured.
        floors: Of the building; None where there is one only, or it is not known.
        floor_belief: Fraction of the filter's belief on each of the f floors, (n, f); None without floors.
        verified: How many of the images landmarks verified a place of; None without a map of landmarks.
        landmarks: What one of these images shows of the landmarks; None without any.
    """

    times_ns: Int64[np.ndarray, " n"]
    methods: Mapping[str, Trajectory]
    covariance: Float64[np.ndarray, "n 6 6"]
    status: tuple[Status, ...]
    num_modes: Int64[np.ndarray, " n"]
    best_weight: Float64[np.ndarray, " n"]
    num_particles: Int64[np.ndarray, " n"]
    effective_sample_size: Float64[np.ndarray, " n"]
    agreement: Float64[np.ndarray, " n"]
    unfamiliarity: Float64[np.ndarray, " n"]
    step_ms: Float64[np.ndarray, " n"]
    truth: Trajectory | None
    smoothed_agreement: Float64[np.ndarray, " n"] | None
    keyframes: tuple[Keyframe, ...]
    moments: tuple[Moment, ...]
    skipped: Mapping[str, int]
    images: ImageCounts | None
    peak_rss_mb: float | None
    floors: Floors | None = None
    floor_belief: Float64[np.ndarray, "n f"] | None = None
    verified: int | None = None
    landmarks: ShownLandmarks | None = None

    def with_methods(
        self, poses: Mapping[str, Poses], *, smoothed_agreement: Float64[np.ndarray, " n"] | None = None
    ) -> RunRecord:
        """The same with more methods: those that see the whole run at once.

        Args:
            poses: Their poses, world_from_camera, batches (n,), by name.
            smoothed_agreement: How well the images about each smoothed pose fit it, (n,).
        """
        more = {name: Trajectory(self.times_ns, each) for name, each in poses.items()}
        methods = in_order({**self.methods, **more})
        return replace(self, methods=methods, smoothed_agreement=smoothed_agreement)


_MOST_KEYFRAMES = 24


class RunRecorder:
    """Collects a run image by image: under 2 kB per image, beside at most 24 keyframes and 300 moments."""

    def __init__(self) -> None:
        self._times_ns: list[int] = []
        self._poses: dict[str, list[Poses]] = {}
        self._dead_reckoning: list[Poses] = []
        self._has_odometry = False
        self._truth_ns: list[int] = []
        self._truth: list[Poses] = []
        self._covariance: list[np.ndarray] = []
        self._status: list[Status] = []
        self._numbers: list[tuple[int, float, int, float, float, float, float]] = []
        self._keyframes: list[Keyframe] = []
        self._moments = MomentCollector()

    def __len__(self) -> int:
        return len(self._times_ns)

    def add(self, frame: Frame, step: Step) -> None:
        """Append one image.

        Args:
            frame: The image, with its odometry and true pose where known.
            step: What the methods made of it.
        """
        estimate = step.estimate
        best = estimate.modes[0]
        if frame.odometry is not None and self._dead_reckoning:
            self._has_odometry = True
            self._dead_reckoning.append(self._dead_reckoning[-1] @ frame.odometry.previous_from_current)
        else:  # the first image, of the run or after a gap; a sequence without odometry shows no dead reckoning
            start = best.world_from_camera if frame.world_from_camera is None else frame.world_from_camera
            self._dead_reckoning.append(start)
        if frame.world_from_camera is not None:
            self._truth_ns.append(frame.time_ns)
            self._truth.append(frame.world_from_camera)
        self._times_ns.append(frame.time_ns)
        for name, modes in {"single_image": step.image_modes, **step.baselines, "filter": estimate.modes}.items():
            self._poses.setdefault(name, []).append(modes[0].world_from_camera)
        self._covariance.append(best.covariance)
        self._status.append(estimate.status)
        self._numbers.append(
            (
                len(estimate.modes),
                best.weight,
                len(estimate.particles),
                estimate.effective_sample_size,
                estimate.agreement,
                estimate.unfamiliarity,
                step.step_ms,
            )
        )
        self._keyframes.append(make_keyframe(frame, estimate))
        self._moments.add(self._keyframes[-1])
        if len(self._keyframes) > _MOST_KEYFRAMES:
            self._keyframes = choose_keyframes(self._keyframes, _MOST_KEYFRAMES)

    def finish(
        self,
        *,
        skipped: Mapping[str, int] | None = None,
        images: ImageCounts | None = None,
        peak_rss_mb: float | None = None,
    ) -> RunRecord:
        """The record of all images added.

        Args:
            skipped: See `RunRecord`, like the others.
            images: What became of the images that the sequence states.
            peak_rss_mb: Peak resident memory of the process, MiB.

        Raises:
            VaporTrackError: no image was added.
        """
        if not self._times_ns:
            raise VaporTrackError(f"no image was localized, {sum((skipped or {}).values())} were skipped")
        num_modes, best_weight, num_particles, sample_size, agreement, unfamiliarity, step_ms = np.array(
            self._numbers, float
        ).T
        truth = Trajectory(np.array(self._truth_ns, np.int64), Poses.stack(self._truth)) if self._truth else None
        times_ns = np.array(self._times_ns, np.int64)
        methods = {name: Poses.stack(poses) for name, poses in self._poses.items()}
        if self._has_odometry:
            methods["dead_reckoning"] = Poses.stack(self._dead_reckoning)
        return RunRecord(
            times_ns=times_ns,
            methods={name: Trajectory(times_ns, poses) for name, poses in in_order(methods).items()},
            covariance=np.stack(self._covariance),
            status=tuple(self._status),
            num_modes=num_modes.astype(np.int64),
            best_weight=best_weight,
            num_particles=num_particles.astype(np.int64),
            effective_sample_size=sample_size,
            agreement=agreement,
            unfamiliarity=unfamiliarity,
            step_ms=step_ms,
            truth=truth,
            smoothed_agreement=None,
            keyframes=tuple(self._keyframes),
            moments=self._moments.moments,
            skipped=dict(sorted(Counter(skipped or {}).items())),
            images=images,
            peak_rss_mb=peak_rss_mb,
        )
