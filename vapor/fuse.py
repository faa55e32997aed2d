"""One run of `vapor-track fuse`: a filter over pose estimates of others, without images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from filtering.density import KernelDensity
from filtering.errors import VaporTrackError, require_within
from filtering.estimate import Mode
from filtering.posterior import LikelihoodModel, PosteriorSamples
from filtering.se3 import Poses
from filtering.smoothing import SmoothingConfig
from sequences.estimates import EstimateOptions, EstimateSequence
from sequences.pose_files import PoseFile
from vapor.run import FilteringConfig, RunResult, complete_directory, localize, refuse_file, write_results

_LEAST_TEMPER = 1e-3  # of a likelihood: below, a filter would follow odometry alone
_MARGIN_M = 0.5  # around the estimates: cameras can be where none is


@dataclass(frozen=True)
class EstimateConfig:
    """How far to trust estimates."""

    std_m: tuple[float, ...] = (0.05,)
    """Stated standard deviation of position along each axis, metres; one for all files or one for each."""
    std_deg: tuple[float, ...] = (1.0,)
    """Stated standard deviation of rotation about each axis, degrees; one for all files or one for each."""
    outlier_share: float = 0.1
    """Share of the estimates whose errors are much larger than stated."""
    outlier_spread: float = 8.0
    """How many times larger."""
    independent_after_s: float = 1.0
    """Images so far apart err independently; nearer ones count for less, in proportion."""

    def __post_init__(self) -> None:
        require_within(
            self,
            outlier_share=(1e-6, 0.999999),
            outlier_spread=(1.0, 1e3),
            independent_after_s=(0.0, 1e6),
        )
        for name, high in (("std_m", 1e3), ("std_deg", 180.0)):
            for value in getattr(self, name):
                if not 1e-4 <= value <= high:
                    raise VaporTrackError(f"{name} is {value}, expected between 0.0001 and {high}")


class EstimateModel:
    """Pose estimates as an observation model: `observe` takes them instead of an image, and draws nothing.

    Args:
        num_files: How many methods there are.
        config: How far to trust them.
        likelihood: How their density becomes a likelihood.

    Raises:
        VaporTrackError: as many uncertainties are stated as neither one nor the number of files.
    """

    def __init__(self, num_files: int, config: EstimateConfig, likelihood: LikelihoodModel) -> None:
        self.config = config
        self.likelihood = likelihood
        for name, values in (("std_m", config.std_m), ("std_deg", config.std_deg)):
            if len(values) not in (1, num_files):
                raise VaporTrackError(f"{name} has {len(values)} values, expected one, or one for each of {num_files}")
        self._std_m = np.broadcast_to(config.std_m, num_files).astype(float)
        self._std_rad = np.radians(np.broadcast_to(config.std_deg, num_files))

    def observe(self, image: Float64[np.ndarray, "files 4 4"], *, rng: np.random.Generator) -> PosteriorSamples:
        """The posterior of one image.

        Args:
            image: world_from_camera by each method, homogeneous matrices; NaN where a method has none.
            rng: Not used.

        Raises:
            VaporTrackError: no method has an estimate.
        """
        present = np.isfinite(image).all(axis=(1, 2))
        return PosteriorSamples.from_estimates(
            Poses.from_matrix(image[present]),
            self._std_m[present],
            self._std_rad[present],
            outlier_share=self.config.outlier_share,
            outlier_spread=self.config.outlier_spread,
            likelihood=self.likelihood,
        )


def estimate_modes(posterior: PosteriorSamples, _: np.random.Generator | None = None) -> tuple[Mode, ...]:
    """The estimates behind a posterior, each with its stated covariance, that of the highest density first."""
    density = posterior.density
    if not isinstance(density, KernelDensity):
        raise TypeError(f"{type(density).__name__} is no density of estimates")
    count = len(posterior.poses) // 2  # the other half are the wide kernels
    estimates = posterior.poses[:count]
    std_m = np.broadcast_to(density.bandwidth_translation_m, 2 * count)[:count]
    std_rad = np.broadcast_to(density.bandwidth_rotation_rad, 2 * count)[:count]
    order = np.argsort(-density.log_density(estimates), kind="stable")
    return tuple(
        Mode(estimates[i], np.diag(np.repeat([std_m[i] ** 2, std_rad[i] ** 2], 3)), 1.0 / count) for i in order
    )


def fuse(
    estimates: Sequence[Path],
    output: Path,
    config: FilteringConfig | None = None,
    *,
    odometry: Path | None = None,
    simulate_odometry: Path | None = None,
    ground_truth: Path | None = None,
    trust: EstimateConfig | None = None,
    reading: EstimateOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RunResult:
    """Localize frames of which others gave pose estimates, and write everything about it into a directory.

    Args:
        estimates: Files of poses, one for each method.
        output: Directory for the results, as of `vapor.run.run`.
        config: Settings of the run.
        odometry: Recorded odometry.
        simulate_odometry: True poses to simulate odometry from, where there is none.
        ground_truth: True poses; None for those that the odometry is simulated from.
        trust: How far to trust the estimates.
        reading: How to read the files.
        progress: Called after every frame with the number done and an upper bound of all.

    Raises:
        VaporTrackError: unusable files or output, or no frame left to localize.
    """
    config, trust, reading = config or FilteringConfig(), trust or EstimateConfig(), reading or EstimateOptions()
    refuse_file(output)
    sequence = EstimateSequence(
        estimates,
        odometry=odometry,
        simulate_odometry_from=simulate_odometry,
        ground_truth=ground_truth,
        options=reading,
        seed=config.seed,
    )
    likelihood = likelihood_of(sequence.files, trust, sequence.interval_s)
    model = EstimateModel(len(sequence.files), trust, likelihood)
    with complete_directory(output) as partial:
        record = localize(
            sequence,
            model,
            partial,
            config,
            image_modes=estimate_modes,
            observed=lambda frame: frame.estimates,
            smoothing=SmoothingConfig(correlation=1.0 / likelihood.temper),
            progress=progress,
        )
        settings = {
            "estimates": [{"name": file.path.name, "frames": len(file.frames)} for file in sequence.files],
            "odometry": sequence.odometry_description,
            "run": asdict(config),
            "trust": asdict(trust),
            "reading": asdict(reading),
            "likelihood": {
                "temper": likelihood.temper,
                "outlier_floor": likelihood.outlier_floor,
                "flat_prior_per_m3_rad3": likelihood.prior_floor,
            },
        }
        return write_results(record, partial, settings, title=", ".join(file.path.stem for file in sequence.files))


def likelihood_of(files: Sequence[PoseFile], trust: EstimateConfig, interval_s: float) -> LikelihoodModel:
    """How estimates weigh a belief: against a flat prior over their bounding box and all rotations.

    The box holds the middle 98 % of the positions along each axis and half a metre more on each side. An image counts
    as the share of an independent one that its interval is of `independent_after_s`.
    """
    positions = np.concatenate([file.poses.translation for file in files])
    low, high = np.percentile(positions, [1, 99], axis=0)
    volume = float(np.prod(high - low + 2 * _MARGIN_M)) * 8 * np.pi**2
    temper = 1.0 if interval_s >= trust.independent_after_s else interval_s / trust.independent_after_s
    return LikelihoodModel(temper=max(temper, _LEAST_TEMPER), prior_floor=1.0 / volume)
