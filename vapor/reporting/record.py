"""What a run leaves in memory for its report: little per image, and a few moments in full."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate, Mode, Status
from filtering.se3 import Poses
from sequences.frame import Frame, Trajectory
from sequences.reading.counts import ImageCounts

_KEPT_MOMENTS = 24
_CLOUD_SIZE = 300
_THUMBNAIL_SIDE = 320  # pixels


@dataclass(frozen=True)
class Moment:
    """One image of the run in full: what the camera saw and what the filter believed.

    Attributes:
        time_ns: Header stamp of the image.
        thumbnail: The image, its longer side at most 320 pixels, RGB; empty where there is none.
        cloud: 300 poses that stand for the belief, equally weighted, world_from_camera.
        modes: The hypotheses, the reported one first.
        status: The filter's own verdict.
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


@dataclass(frozen=True)
class RunRecord:
    """Everything a report and its pictures are made of, n images.

    Attributes:
        times_ns: Header stamps, (n,).
        single_image: Best mode of each image's posterior alone, (n,).
        filter: Best mode of the filter, (n,).
        covariance: Of ξ = (v, ω) in the tangent at the filter's best mode, metres and radians, (n, 6, 6).
        status: The filter's verdict on itself, (n,).
        num_modes: Number of hypotheses, (n,).
        best_weight: Weight of the reported hypothesis, (n,).
        num_particles: Number of particles, (n,).
        effective_sample_size: In particles, (n,).
        agreement: Share of the belief that the latest images fitted, (n,).
        unfamiliarity: How unlike the training data each image was, see `PosePosterior`, (n,).
        step_ms: Wall-clock milliseconds of each step, (n,).
        dead_reckoning: Poses from odometry alone, (n,), started at the first true pose, or at the first estimate
            where that is unknown, and anew where there is no odometry; None for a sequence without any.
        truth: True poses of the images that have one; None if none has.
        smoothed: Smoothed trajectory, if any.
        smoothed_agreement: How well the images about each of its poses fit it, in [0, 1], (n,); if there is one.
        kalman: Trajectory of the single-hypothesis baseline, if any.
        gaussian_sum: Trajectory of the baseline to which no hypothesis is added after the first image, if any.
        moments: A few moments in order of time, the first and last image among them.
        skipped: Number of images and other messages skipped, by reason.
        images: What became of the images that the sequence states; None if not counted.
        peak_rss_mb: Peak resident memory of the process, MiB; None if not measured.
    """

    times_ns: Int64[np.ndarray, " n"]
    single_image: Poses
    filter: Poses
    covariance: Float64[np.ndarray, "n 6 6"]
    status: tuple[Status, ...]
    num_modes: Int64[np.ndarray, " n"]
    best_weight: Float64[np.ndarray, " n"]
    num_particles: Int64[np.ndarray, " n"]
    effective_sample_size: Float64[np.ndarray, " n"]
    agreement: Float64[np.ndarray, " n"]
    unfamiliarity: Float64[np.ndarray, " n"]
    step_ms: Float64[np.ndarray, " n"]
    dead_reckoning: Poses | None
    truth: Trajectory | None
    smoothed: Trajectory | None
    smoothed_agreement: Float64[np.ndarray, " n"] | None
    kalman: Trajectory | None
    gaussian_sum: Trajectory | None
    moments: tuple[Moment, ...]
    skipped: Mapping[str, int]
    images: ImageCounts | None
    peak_rss_mb: float | None

    @cached_property
    def methods(self) -> dict[str, Trajectory]:
        """Trajectories by the name of their method, in the order of a report; absent ones are left out."""
        methods: dict[str, Trajectory | None] = {
            "single_image": Trajectory(self.times_ns, self.single_image),
            "dead_reckoning": None if self.dead_reckoning is None else Trajectory(self.times_ns, self.dead_reckoning),
            "kalman": self.kalman,
            "gaussian_sum": self.gaussian_sum,
            "filter": Trajectory(self.times_ns, self.filter),
            "smoothed": self.smoothed,
        }
        return {name: trajectory for name, trajectory in methods.items() if trajectory is not None}


class RunRecorder:
    """Collects a run image by image; what it keeps per image is under 2 kB, beside at most 24 moments."""

    def __init__(self) -> None:
        self._times_ns: list[int] = []
        self._single_image: list[Poses] = []
        self._filter: list[Poses] = []
        self._dead_reckoning: list[Poses] = []
        self._has_odometry = False
        self._truth_ns: list[int] = []
        self._truth: list[Poses] = []
        self._covariance: list[np.ndarray] = []
        self._status: list[Status] = []
        self._numbers: list[tuple[int, float, int, float, float, float, float]] = []
        self._moments: list[Moment] = []

    def __len__(self) -> int:
        return len(self._times_ns)

    def add(self, frame: Frame, single_image: Poses, estimate: Estimate, step_ms: float) -> None:
        """Append one image.

        Args:
            frame: The image, with its odometry and true pose where known.
            single_image: Best mode of the image's posterior alone, one pose.
            estimate: What the filter believes after the image.
            step_ms: Wall-clock milliseconds of the step.
        """
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
        self._single_image.append(single_image)
        self._filter.append(best.world_from_camera)
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
                step_ms,
            )
        )
        self._moments.append(_moment(frame, estimate))
        if len(self._moments) > _KEPT_MOMENTS:
            self._moments = telling_moments(self._moments, _KEPT_MOMENTS)

    def finish(
        self,
        *,
        skipped: Mapping[str, int] | None = None,
        images: ImageCounts | None = None,
        smoothed: Trajectory | None = None,
        smoothed_agreement: Float64[np.ndarray, " n"] | None = None,
        kalman: Trajectory | None = None,
        gaussian_sum: Trajectory | None = None,
        peak_rss_mb: float | None = None,
    ) -> RunRecord:
        """The record of all images added.

        Raises:
            VaporTrackError: no image was added.
        """
        if not self._times_ns:
            raise VaporTrackError(f"no image was localized, {sum((skipped or {}).values())} were skipped")
        num_modes, best_weight, num_particles, sample_size, agreement, unfamiliarity, step_ms = np.array(
            self._numbers, float
        ).T
        truth = Trajectory(np.array(self._truth_ns, np.int64), Poses.stack(self._truth)) if self._truth else None
        return RunRecord(
            times_ns=np.array(self._times_ns, np.int64),
            single_image=Poses.stack(self._single_image),
            filter=Poses.stack(self._filter),
            covariance=np.stack(self._covariance),
            status=tuple(self._status),
            num_modes=num_modes.astype(np.int64),
            best_weight=best_weight,
            num_particles=num_particles.astype(np.int64),
            effective_sample_size=sample_size,
            agreement=agreement,
            unfamiliarity=unfamiliarity,
            step_ms=step_ms,
            dead_reckoning=Poses.stack(self._dead_reckoning) if self._has_odometry else None,
            truth=truth,
            smoothed=smoothed,
            smoothed_agreement=smoothed_agreement,
            kalman=kalman,
            gaussian_sum=gaussian_sum,
            moments=tuple(self._moments),
            skipped=dict(sorted(Counter(skipped or {}).items())),
            images=images,
            peak_rss_mb=peak_rss_mb,
        )


def telling_moments(moments: list[Moment], count: int) -> list[Moment]:
    """At most `count` moments that tell the story best: the first, the last, and those where the belief changes.

    The curve of doubt over time (the share of the belief outside the best hypothesis, and the log of the spread) is
    simplified: as long as there are too many, the moment goes that lies nearest to the line between its neighbours.
    What a moment stands for in time counts too, so that calm stretches stay present and neighbours do not crowd.
    """
    moments = list(moments)
    start_ns, duration_ns = moments[0].time_ns, max(moments[-1].time_ns - moments[0].time_ns, 1)
    time = np.array([(moment.time_ns - start_ns) / duration_ns for moment in moments])
    doubt = np.array([[1.0 - moment.modes[0].weight, 0.3 * np.log10(moment.spread_m + 0.1)] for moment in moments])
    while len(moments) > max(count, 2):
        gap = time[2:] - time[:-2]
        fraction = (time[1:-1] - time[:-2]) / np.maximum(gap, 1e-12)
        line = doubt[:-2] + (doubt[2:] - doubt[:-2]) * fraction[:, None]
        nearer = np.minimum(time[1:-1] - time[:-2], time[2:] - time[1:-1])
        loss = np.linalg.norm(doubt[1:-1] - line, axis=1) * np.sqrt(nearer) + 0.2 * gap
        leaving = 1 + int(np.argmin(loss))
        del moments[leaving]
        time, doubt = np.delete(time, leaving), np.delete(doubt, leaving, axis=0)
    return moments


def _moment(frame: Frame, estimate: Estimate) -> Moment:
    cloud = estimate.cloud(_CLOUD_SIZE)
    return Moment(
        time_ns=frame.time_ns,
        thumbnail=_thumbnail(frame.image),
        cloud=cloud,
        modes=estimate.modes,
        status=estimate.status,
        world_from_camera=frame.world_from_camera,
        spread_m=float(np.sqrt(cloud.translation.var(axis=0).sum())),
    )


def _thumbnail(image: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "h w 3"]:
    import cv2

    height, width = image.shape[:2]
    if image.size == 0:  # estimates without images
        return image
    scale = min(1.0, _THUMBNAIL_SIDE / max(height, width))
    if scale == 1.0:
        return image.copy()  # the decoder's buffer may be used again
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
