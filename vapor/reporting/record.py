"""What a run leaves in memory for its report: little per image, and a few keyframes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from filtering.estimate import Status
from filtering.floors import Floors
from filtering.se3 import Poses
from sequences.frame import Trajectory
from sequences.reading.counts import ImageCounts
from vapor.landmarks.verify import ShownLandmarks
from vapor.reporting.keyframes import Keyframe
from vapor.reporting.moments import Moment
from vapor.tracking.methods import in_order


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
