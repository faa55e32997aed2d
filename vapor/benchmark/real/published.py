"""Rows of estimates that others published: posterior samples of a network, or poses of single images."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.estimates.sequence import EstimateOptions, EstimateSequence
from sequences.files import read_arrays
from sequences.odometry import OdometryNoise
from sequences.odometry_fit.fit import fit_odometry
from sequences.odometry_fit.pieces import OdometrySegment
from vapor.benchmark.real.row import Draw, Row, RowContext, simulated_motions
from vapor.calibration.error_correlation import Travel
from vapor.calibration.image_errors import fit_errors
from vapor.calibration.places import Observations
from vapor.checkpoints.scene_scale import default_errors
from vapor.pipeline.fuse import EstimateConfig, EstimateModel, noise_of, over_sequences
from vapor.tracking.follow import Segment


@dataclass(frozen=True)
class StoredPosteriors(Row):
    """Posterior samples of a network that others trained, with one draw of simulated odometry.

    How images err and how wrong the odometry is are fitted on the first half, the former on images that the network was
    not trained on; the second half is evaluated.

    Attributes:
        file: File of the data.
        own_seed: Seed of the draw in the file; those of further draws count up from it.
    """

    file: str
    own_seed: int

    @property
    def needs(self) -> tuple[str, ...]:
        """Files and folders of the data that must be there."""
        return (self.file,)

    def prepare(self, context: RowContext, seed: int) -> dict[str, Any]:
        """Nothing to make."""
        return {"file": self.file, "seed": seed}

    def draw(self, context: RowContext, seed: int) -> Draw:
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
            odometry = simulated_motions(times_ns, truth, rng=rng)
        first = np.arange(n) < n // 2
        fit = fit_odometry([OdometrySegment(odometry[1 : n // 2], truth[first])])
        (unseen,) = np.nonzero(first & ~trained_on)
        way = Travel.along(truth[unseen], np.cumsum(np.diff(unseen, prepend=unseen[:1]) > 1))
        scene = truth[trained_on]  # the places that the network knows
        seen = Observations([samples[i] for i in unseen], truth[unseen])
        noise = fit_errors(seen, way, scene, default_errors(scene)).noise
        segment = Segment(times_ns, odometry, truth, lambda image: PosePosterior.from_samples(samples[image], noise))
        localizer = replace(context.config.localizer, odometry_bias=fit.odometry_bias)
        return Draw(segment.restated(fit), noise, localizer, {"": ~first})


def poses_of(rows: Float64[np.ndarray, "n 7"]) -> Poses:
    """Poses (n,) from rows of tx ty tz qx qy qz qw."""
    rows = np.asarray(rows, np.float64)
    return Poses.from_quat_xyzw(rows[:, :3], rows[:, 3:])


@dataclass(frozen=True)
class PoseEstimates(Row):
    """Pose estimates of others, with simulated odometry.

    Attributes:
        of_group: Name of all rows with the same unit.
        files: Files of the data, one for each method.
        truth: File of the data with true poses.
        unit_m: So many metres are taken for one: all lengths are larger by this factor, those of noise too.
    """

    of_group: str
    files: tuple[str, ...]
    truth: str
    unit_m: float = 1.0

    @property
    def group(self) -> str:
        """All rows with the same unit."""
        return self.of_group

    @property
    def needs(self) -> tuple[str, ...]:
        """Files and folders of the data that must be there."""
        return (*self.files, self.truth)

    def prepare(self, context: RowContext, seed: int) -> dict[str, Any]:
        """Nothing to make."""
        return {"files": self.needs, "unit_m": self.unit_m, "seed": seed, "trust": asdict(EstimateConfig())}

    def draw(self, context: RowContext, seed: int) -> Draw:
        """The estimates with odometry simulated from the true poses, all lengths in the unit."""
        usual, odometry_noise = EstimateConfig(), OdometryNoise()
        trust = replace(usual, std_m=tuple(std_m * self.unit_m for std_m in usual.std_m))
        odometry_noise = replace(
            odometry_noise,
            translation_bias_m_per_s=odometry_noise.translation_bias_m_per_s * self.unit_m,
            translation_white_m_per_sqrt_s=odometry_noise.translation_white_m_per_sqrt_s * self.unit_m,
        )
        sequence = EstimateSequence(
            [context.data / file for file in self.files],
            simulate_odometry_from=context.data / self.truth,
            options=EstimateOptions(direction="world-to-camera", noise=odometry_noise, unit_m=self.unit_m),
            seed=seed,
        )
        noise = noise_of(sequence, trust)
        model = EstimateModel(len(self.files), trust, noise)
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
            noise,
            over_sequences(context.config.localizer),
            {"": np.ones(len(frames), bool)},
            self.unit_m,
        )
