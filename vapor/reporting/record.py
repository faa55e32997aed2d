"""The record of a run in memory: little per image, and a few keyframes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate, Mode, Status
from filtering.motion import measured
from filtering.se3 import Poses
from filtering.storeys import Storeys
from sequences.frame import Frame, Trajectory
from sequences.options import OdometryOrigin
from sequences.reading.counts import ImageCounts
from vapor.landmarks.verify import ShownLandmarks
from vapor.reporting.drawing import as_jpeg, shrunk
from vapor.reporting.outline import Outline
from vapor.tracking.hindsight import LookBack
from vapor.tracking.loop import Step
from vapor.tracking.methods import in_order

Item = TypeVar("Item")

MOST_MOMENTS = 300
_MOST_KEYFRAMES = 24
_THUMBNAIL_SIDE, _MOMENT_SIDE = 320, 200  # pixels
_MOMENT_PARTICLES, _MOMENT_QUALITY = 60, 70


class EvenlySpaced(Generic[Item]):
    """At most `most` items of a stream of unknown length: all, or every second, fourth, eighth, ...

    Attributes:
        kept: Number in the stream, from 0, and item, in order.
    """

    def __init__(self, most: int) -> None:
        self.kept: list[tuple[int, Item]] = []
        self._most, self._seen, self._every = most, 0, 1

    @property
    def items(self) -> list[Item]:
        """Without their numbers."""
        return [item for _, item in self.kept]

    def add(self, make: Callable[[], Item]) -> None:
        """Take the next item, which is made only where it is kept."""
        if self._seen % self._every == 0:
            self.kept.append((self._seen, make()))
            if len(self.kept) > self._most:
                self.kept, self._every = self.kept[::2], 2 * self._every
        self._seen += 1


@dataclass(frozen=True)
class Keyframe:
    """One image of the run in full: the camera's image and the filter's belief.

    The thumbnail, RGB, has at most 320 pixels along its longer side, and is empty where there is no image. The cloud
    has 300 equally weighted poses, world_from_camera; the spread is their root mean square distance from their mean,
    metres.
    """

    time_ns: int
    thumbnail: UInt8[np.ndarray, "height width 3"]
    cloud: Poses
    modes: tuple[Mode, ...]
    status: Status
    world_from_camera: Poses | None
    spread_m: float

    @staticmethod
    def of(frame: Frame, estimate: Estimate) -> Keyframe:
        """An image and the belief after it."""
        cloud = estimate.shown
        return Keyframe(
            time_ns=frame.time_ns,
            thumbnail=shrunk(frame.image, _THUMBNAIL_SIDE).copy(),  # the decoder's buffer may be used again
            cloud=cloud,
            modes=estimate.modes,
            status=estimate.status,
            world_from_camera=frame.world_from_reference,
            spread_m=float(np.sqrt(cloud.translation.var(axis=0).sum())),
        )


def choose_keyframes(keyframes: list[Keyframe], count: int) -> list[Keyframe]:
    """At most `count` keyframes: the first, the last, and those where the belief changes.

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


@dataclass(frozen=True)
class Moment:
    """The belief after an image, small enough to show up to 300 of them on a page.

    It has 60 equally weighted particles, and the hypotheses, best first, with their weights; positions are in metres.
    The JPEG has at most 200 pixels along its longer side, and is empty where there is no image.
    """

    index: int
    particles: Float32[np.ndarray, "60 3"]
    modes: Float32[np.ndarray, "k 3"]
    weights: Float64[np.ndarray, " k"]
    jpeg: bytes

    @staticmethod
    def of(index: int, keyframe: Keyframe) -> Moment:
        """A few particles and a small image of a keyframe."""
        which = np.linspace(0, len(keyframe.cloud) - 1, _MOMENT_PARTICLES).astype(int)
        image = shrunk(keyframe.thumbnail, _MOMENT_SIDE)
        return Moment(
            index,
            keyframe.cloud.translation[which].astype(np.float32),
            np.stack([mode.world_from_camera.translation for mode in keyframe.modes]).astype(np.float32),
            np.array([mode.weight for mode in keyframe.modes]),
            as_jpeg(image, _MOMENT_QUALITY) if image.size else b"",
        )


@dataclass(frozen=True)
class RunRecord:
    """Everything a report is made of, n images.

    Attributes:
        times_ns: Header stamps, (n,).
        methods: Trajectory of every tracking method by its name, in the order of `METHODS`. That of single images has
            the best mode of each one's posterior. Dead reckoning starts at the first true pose, or else at the first
            estimate, and again after a gap in the odometry.
        restarts: How often dead reckoning starts again.
        odometry: What shows the motion between the images; None where nothing does.
        covariance: Covariance of ξ = (v, ω) in the tangent at the filter's best mode, metres and radians, (n, 6, 6).
        degrees_of_freedom: Of that mode, see `Mode`, (n,).
        innovation: Normalised innovation squared per degree of freedom of that mode, (n,); NaN where there is none.
        status: The filter's own status, (n,).
        num_modes: Number of hypotheses, (n,).
        best_weight: Weight of the reported hypothesis, (n,).
        num_particles: Number of particles, (n,).
        unassigned: Probability that the camera is at none of the hypotheses, (n,).
        log_likelihood: Log marginal likelihood of each image, see `Estimate`, (n,).
        agreement: Fraction of the belief that the latest images fitted, (n,).
        ood_score: How unlike the training data each image was, see `PosePosterior`, (n,).
        step_ms: Wall-clock milliseconds of each step, (n,).
        truth: True poses of the images that have one; None if none has.
        look_back: The run in hindsight; None without.
        keyframes: A few in order of time, the first and last image among them.
        moments: The belief at up to 300 images, in order of time.
        skipped: Number of images and other messages skipped, by reason.
        images: Counts of the images in the sequence; None if not counted.
        peak_rss_mb: Peak resident memory of the process, MiB; None if not measured.
        storeys: Of the building; None where there is one only, or it is not known.
        storey_belief: Fraction of the filter's belief on each of the f storeys, (n, f); None without storeys.
        inliers: Landmarks that agree with the best verified pose of each image, 0 where none is, (n,); None without a
            map of landmarks.
        landmarks: The landmarks in one of these images; None without any.
        outline: Of the place; None where it is not known.
        cameras: Name of the camera of each image, n; all '' where there is one.
        left_out: Whether the image did not count, as its camera's fit nowhere where those of the others fit, (n,).
    """

    times_ns: Int64[np.ndarray, " n"]
    methods: Mapping[str, Trajectory]
    covariance: Float64[np.ndarray, "n 6 6"]
    degrees_of_freedom: Float64[np.ndarray, " n"]
    innovation: Float64[np.ndarray, " n"]
    status: tuple[Status, ...]
    num_modes: Int64[np.ndarray, " n"]
    best_weight: Float64[np.ndarray, " n"]
    num_particles: Int64[np.ndarray, " n"]
    unassigned: Float64[np.ndarray, " n"]
    log_likelihood: Float64[np.ndarray, " n"]
    agreement: Float64[np.ndarray, " n"]
    ood_score: Float64[np.ndarray, " n"]
    step_ms: Float64[np.ndarray, " n"]
    truth: Trajectory | None
    keyframes: tuple[Keyframe, ...]
    moments: tuple[Moment, ...]
    skipped: Mapping[str, int]
    images: ImageCounts | None
    peak_rss_mb: float | None
    restarts: int = 0
    odometry: OdometryOrigin | None = "recorded"
    look_back: LookBack | None = None
    storeys: Storeys | None = None
    storey_belief: Float64[np.ndarray, "n f"] | None = None
    inliers: Int64[np.ndarray, " n"] | None = None
    landmarks: ShownLandmarks | None = None
    outline: Outline | None = None
    cameras: tuple[str, ...] = ()
    left_out: Bool[np.ndarray, " n"] = field(default_factory=lambda: np.zeros(0, bool))

    def in_hindsight(self, look_back: LookBack) -> RunRecord:
        """The same with the run in hindsight, and its trajectories among the methods."""
        more = {name: Trajectory(self.times_ns, each.poses) for name, each in look_back.trajectories.items()}
        return replace(self, methods=in_order({**self.methods, **more}), look_back=look_back)


class RunRecorder:
    """Collects a run image by image: under 2 kB per image, beside at most 24 keyframes and 300 moments."""

    def __init__(self) -> None:
        self._times_ns: list[int] = []
        self._poses: dict[str, list[Poses]] = {}
        self._dead_reckoning: list[Poses] = []
        self._has_odometry, self._starts = False, 0
        self._truth: list[tuple[int, Poses]] = []
        self._covariance: list[np.ndarray] = []
        self._status: list[Status] = []
        self._cameras: list[tuple[str, bool]] = []  # of each image, and whether it was left out
        self._numbers: list[tuple[float, ...]] = []
        self._keyframes: list[Keyframe] = []
        self._moments: EvenlySpaced[Moment] = EvenlySpaced(MOST_MOMENTS)

    def add(self, frame: Frame, step: Step) -> None:
        """Append one image, and the estimates of all methods after it."""
        estimate, number = step.estimate, len(self._times_ns)
        best = estimate.modes[0]
        if (motion := measured(frame.odometry)) is not None and self._dead_reckoning:
            self._has_odometry = True
            self._dead_reckoning.append(self._dead_reckoning[-1] @ motion.previous_from_current)
        else:  # the first image, of the run or after a gap; a sequence without odometry shows no dead reckoning
            start = best.world_from_camera if frame.world_from_reference is None else frame.world_from_reference
            self._dead_reckoning.append(start)
            self._starts += 1
        if frame.world_from_reference is not None:
            self._truth.append((frame.time_ns, frame.world_from_reference))
        self._times_ns.append(frame.time_ns)
        for name, modes in {"single_image": step.image_modes, **step.baselines, "filter": estimate.modes}.items():
            self._poses.setdefault(name, []).append(modes[0].world_from_camera)
        self._covariance.append(best.covariance)
        self._status.append(estimate.status)
        self._cameras.append((frame.camera_name, bool(estimate.left_out)))
        self._numbers.append(
            (
                len(estimate.modes),
                best.weight,
                len(estimate.particles),
                best.degrees_of_freedom,
                np.nan if best.innovation is None else best.innovation.squared / best.innovation.degrees_of_freedom,
                estimate.unassigned,
                estimate.log_likelihood,
                estimate.agreement,
                estimate.ood_score,
                step.step_ms,
            )
        )
        keyframe = Keyframe.of(frame, estimate)
        self._moments.add(lambda: Moment.of(number, keyframe))
        self._keyframes.append(keyframe)
        if len(self._keyframes) > _MOST_KEYFRAMES:
            self._keyframes = choose_keyframes(self._keyframes, _MOST_KEYFRAMES)

    @property
    def times_ns(self) -> Int64[np.ndarray, " n"]:
        """Stamps of the images so far, (n,)."""
        return np.array(self._times_ns, np.int64)

    def finish(
        self,
        *,
        skipped: Mapping[str, int] | None = None,
        images: ImageCounts | None = None,
        peak_rss_mb: float | None = None,
    ) -> RunRecord:
        """The record of all images added; arguments as the attributes of `RunRecord`.

        Raises:
            VaporTrackError: no image was added.
        """
        if not self._times_ns:
            raise VaporTrackError(f"no image was localized, {sum((skipped or {}).values())} were skipped")
        numbers = np.array(self._numbers, float).T
        num_modes, best_weight, num_particles, degrees_of_freedom, innovation = numbers[:5]
        unassigned, log_likelihood, agreement, ood_score, step_ms = numbers[5:]
        truth = None
        if self._truth:
            truth_ns, true_poses = zip(*self._truth, strict=True)
            truth = Trajectory(np.array(truth_ns, np.int64), Poses.stack(list(true_poses)))
        times_ns = self.times_ns
        methods = self._poses | ({"dead_reckoning": self._dead_reckoning} if self._has_odometry else {})
        return RunRecord(
            times_ns=times_ns,
            methods={name: Trajectory(times_ns, Poses.stack(poses)) for name, poses in in_order(methods).items()},
            covariance=np.stack(self._covariance),
            degrees_of_freedom=degrees_of_freedom,
            innovation=innovation,
            status=tuple(self._status),
            num_modes=num_modes.astype(np.int64),
            best_weight=best_weight,
            num_particles=num_particles.astype(np.int64),
            unassigned=unassigned,
            log_likelihood=log_likelihood,
            agreement=agreement,
            ood_score=ood_score,
            step_ms=step_ms,
            truth=truth,
            keyframes=tuple(self._keyframes),
            moments=tuple(self._moments.items),
            skipped=dict(sorted((skipped or {}).items())),
            images=images,
            peak_rss_mb=peak_rss_mb,
            restarts=self._starts - 1 if self._has_odometry else 0,
            cameras=tuple(name for name, _ in self._cameras),
            left_out=np.array([left_out for _, left_out in self._cameras], bool),
        )
