"""Rows of estimates that others published: posterior samples of a network, or poses of single images."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float64

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.motion import MotionNoise, Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.estimates.sequence import EstimateOptions, EstimateSequence
from sequences.files import read_arrays
from sequences.frame import BASE_FROM_CAMERA
from sequences.odometry import OdometryNoise, simulate_odometry
from sequences.odometry_fit.fit import fit_odometry
from sequences.odometry_fit.pieces import OdometrySegment
from sequences.trajectories.interpolation import odometry_between
from vapor.benchmark.real.row import Draw, RowContext
from vapor.calibration.error_correlation import Travel
from vapor.calibration.image_errors import fit_errors
from vapor.calibration.places import Observations
from vapor.checkpoints.scene_scale import default_errors
from vapor.pipeline.fuse import EstimateConfig, EstimateModel, errors_of, over_sequences
from vapor.tracking.follow import Segment


@dataclass(frozen=True)
class StoredPosteriors:
    """Posterior samples of a network that others trained, with one draw of simulated odometry.

    How images err and how wrong the odometry is are fitted on the first half, the former on images that the network was
    not trained on; the second half is evaluated.

    Attributes:
        file: File of the data.
        own_seed: Seed of the draw in the file; those of further draws count up from it.
        simulated: Whether there are several draws of its odometry.
    """

    name: str
    file: str
    own_seed: int
    simulated: bool = True

    @property
    def group(self) -> str:
        """A group of its own."""
        return self.name

    @property
    def needs(self) -> tuple[str, ...]:
        """Files and folders of the data that must be there."""
        return (self.file,)

    def prepare(self, context: RowContext, seed: int) -> dict[str, Any]:
        """Nothing to make."""
        return {"file": self.file, "seed": seed}

    def draw(self, context: RowContext, seed: int, config: LocalizerConfig) -> Draw:
        """The odometry of the file, or another draw of it; everything is fitted on the first half."""
        stored = read_arrays(context.data / self.file)
        times_ns, previous_from_current = stored["time_ns"], poses_of(stored["previous_from_current"])
        covariance, trained_on = stored["odometry_covariance"], stored["trained_on"]
        samples, truth = [poses_of(each) for each in stored["samples"]], poses_of(stored["truth"])
        n = len(times_ns)
        steps_s = np.diff(times_ns, prepend=times_ns[:1]) * 1e-9
        odometry = tuple(Odometry(previous_from_current[i], covariance[i], float(steps_s[i])) for i in range(n))
        if seed > 0:
            rng = np.random.default_rng(self.own_seed + seed)
            odometry = simulated_motions(times_ns, truth, OdometryNoise(), rng=rng)
        first = np.arange(n) < n // 2
        fit = fit_odometry([OdometrySegment(odometry[1 : n // 2], truth[first])])
        (unseen,) = np.nonzero(first & ~trained_on)
        way = Travel.along(truth[unseen], np.cumsum(np.diff(unseen, prepend=unseen[:1]) > 1))
        scene = truth[trained_on]  # the places that the network knows
        seen = Observations([samples[i] for i in unseen], truth[unseen])
        errors = fit_errors(seen, way, scene, default_errors(scene)).errors
        segment = Segment(times_ns, odometry, truth, lambda image: PosePosterior.from_samples(samples[image], errors))
        localizer = replace(config, odometry_bias=fit.odometry_bias)
        return Draw(segment.restated(fit), errors, localizer, {"": ~first})


def simulated_motions(
    times_ns: np.ndarray, truth: Poses, noise: OdometryNoise, *, rng: np.random.Generator
) -> tuple[Odometry, ...]:
    """Motion of a camera since the previous image, (n,), as a reader finds it in a sequence that `convert` wrote.

    Args:
        times_ns: Stamps of the images, strictly increasing, (n,).
        truth: world_from_camera, batch (n,).
        noise: Of the odometry.
        rng: For its errors.
    """
    odom_from_base, twist = simulate_odometry(times_ns, truth @ BASE_FROM_CAMERA.inverse(), noise, rng=rng)
    spans = pairwise([times_ns[0], *times_ns])
    return tuple(
        odometry_between(
            times_ns,
            odom_from_base,
            twist,
            int(start),
            int(end),
            base_from_camera=BASE_FROM_CAMERA,
            motion_noise=MotionNoise(),
        )
        for start, end in spans
    )


def poses_of(rows: Float64[np.ndarray, "n 7"]) -> Poses:
    """Poses (n,) from rows of tx ty tz qx qy qz qw."""
    rows = np.asarray(rows, np.float64)
    return Poses.from_quat_xyzw(rows[:, :3], rows[:, 3:])


@dataclass(frozen=True)
class PoseEstimates:
    """Pose estimates of others, with simulated odometry.

    Attributes:
        group: Name of all rows with the same unit.
        files: Files of the data, one for each method.
        truth: File of the data with true poses.
        unit_m: So many metres are taken for one: all lengths are larger by this factor, those of noise too.
        simulated: Whether there are several draws of its odometry.
    """

    name: str
    group: str
    files: tuple[str, ...]
    truth: str
    unit_m: float = 1.0
    simulated: bool = True

    @property
    def needs(self) -> tuple[str, ...]:
        """Files and folders of the data that must be there."""
        return (*self.files, self.truth)

    def prepare(self, context: RowContext, seed: int) -> dict[str, Any]:
        """Nothing to make."""
        return {"files": self.needs, "unit_m": self.unit_m, "seed": seed, "trust": asdict(EstimateConfig())}

    def draw(self, context: RowContext, seed: int, config: LocalizerConfig) -> Draw:
        """The estimates with odometry simulated from the true poses, all lengths in the unit."""
        usual, noise = EstimateConfig(), OdometryNoise()
        trust = replace(usual, std_m=tuple(std_m * self.unit_m for std_m in usual.std_m))
        noise = replace(
            noise,
            translation_bias_m_per_s=noise.translation_bias_m_per_s * self.unit_m,
            translation_white_m_per_sqrt_s=noise.translation_white_m_per_sqrt_s * self.unit_m,
        )
        sequence = EstimateSequence(
            [context.data / file for file in self.files],
            simulate_odometry_from=context.data / self.truth,
            options=EstimateOptions(direction="world-to-camera", noise=noise, unit_m=self.unit_m),
            seed=seed,
        )
        errors = errors_of(sequence, trust)
        model = EstimateModel(len(self.files), trust, errors)
        frames = list(sequence)
        truth = [frame.world_from_camera for frame in frames if frame.world_from_camera is not None]
        if len(truth) < len(frames):
            raise VaporTrackError(
                f"{self.truth}: no true pose of {len(frames) - len(truth)} frames, expected one of all"
            )
        rng = np.random.default_rng(0)  # nothing is drawn from it
        return Draw(
            Segment(
                np.array([frame.time_ns for frame in frames], np.int64),
                tuple(frame.odometry for frame in frames),
                Poses.stack(truth),
                lambda image: model.observe(frames[image].estimates, rng=rng),
            ),
            errors,
            over_sequences(config),
            {"": np.ones(len(frames), bool)},
            self.unit_m,
        )
