"""Collects the record of a run, image by image."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np

from filtering.errors import VaporTrackError
from filtering.estimate import Status
from filtering.se3 import Poses
from sequences.frame import Frame, Trajectory
from sequences.reading.counts import ImageCounts
from vapor.reporting.keyframes import Keyframe, choose_keyframes, make_keyframe
from vapor.reporting.moments import MomentCollector
from vapor.reporting.record import RunRecord
from vapor.tracking.loop import Step
from vapor.tracking.methods import in_order

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
