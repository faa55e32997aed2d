"""One run of `vapor-track fuse`: a filter over pose estimates of others, without images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64, Shaped

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError, require_within
from filtering.measurement_noise import MeasurementNoise
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.estimates.sequence import EstimateOptions, EstimateSequence
from sequences.outputs import results_folder
from vapor.pipeline.config import FilteringConfig
from vapor.pipeline.localize import localize
from vapor.pipeline.results import RESULTS, RunResult, write_results
from vapor.reporting.rerun_place import Place


@dataclass(frozen=True)
class EstimateConfig:
    """Errors and weights of estimates."""

    std_m: tuple[float, ...] = (0.05,)
    """Stated standard deviation of position along each axis, metres; one for all files or one for each."""
    std_deg: tuple[float, ...] = (1.0,)
    """Stated standard deviation of rotation about each axis, degrees; one for all files or one for each."""
    degrees_of_freedom: float = 4.0
    """Degrees of freedom of the Student t distribution of their errors: the fewer, the heavier the tails."""
    outlier_weight: float = 0.0
    """For estimates with weights: the weight of "none of them". The probability of a hypothesis is its weight over the
    sum of all weights of its file and frame, this one included. For counts of inliers, state how many a wrong pose has
    by chance, such as 10. At 0 only ratios of weights count."""
    outlier_probability: float = 0.1
    """Fraction of the frames in which no estimate is right."""
    independent_after_s: float = 1.0
    """Frames so many seconds apart have independent errors, at the camera's mean speed. Frames of a camera that stands
    share theirs."""

    def __post_init__(self) -> None:
        require_within(
            self, degrees_of_freedom=(1.0, 1e6), outlier_probability=(1e-6, 0.999999), independent_after_s=(1e-6, 1e6)
        )
        require_within(self, outlier_weight=(0.0, 1e12))
        for name, high in (("std_m", 1e3), ("std_deg", 180.0)):
            for value in getattr(self, name):
                if not 1e-4 <= value <= high:
                    raise VaporTrackError(f"{name} is {value}, expected between 0.0001 and {high}")


class EstimateModel:
    """Pose estimates of a number of methods as an observation model: `observe` takes them instead of an image.

    Raises:
        VaporTrackError: the number of stated uncertainties is neither one nor the number of files.
    """

    def __init__(self, num_files: int, config: EstimateConfig, noise: MeasurementNoise) -> None:
        self.config = config
        self.noise = noise
        for name, values in (("std_m", config.std_m), ("std_deg", config.std_deg)):
            if len(values) not in (1, num_files):
                raise VaporTrackError(f"{name} has {len(values)} values, expected one, or one for each of {num_files}")
        self._std_m = np.broadcast_to(config.std_m, num_files).astype(float)
        self._std_rad = np.radians(np.broadcast_to(config.std_deg, num_files))

    def observe(self, image: Shaped[np.ndarray, " h"], *, rng: np.random.Generator) -> PosePosterior:
        """The posterior of one frame's hypotheses, of dtype `HYPOTHESIS`, (h,); weights are of `mixture_weights`.

        Raises:
            VaporTrackError: there is no hypothesis.
        """
        file = image["file"]
        return PosePosterior.from_estimates(
            Poses.from_matrix(image["world_from_camera"]),
            self._std_m[file],
            self._std_rad[file],
            self.noise,
            weights=mixture_weights(file, image["weight"], self.config.outlier_weight),
        )


def mixture_weights(
    file: Int64[np.ndarray, " h"], weight: Float64[np.ndarray, " h"], outlier_weight: float
) -> Float64[np.ndarray, " h"]:
    """Probabilities (h,) of a frame's hypotheses: w / (Σ w + w₀) / m, the sum over those of the same of m files.

    With counts of inliers each is a vote for its hypothesis, and w₀ votes are for none of them: the mean of a Dirichlet
    distribution with these counts. In all they are 1 where w₀ is 0.
    """
    files, own = np.unique(file, return_inverse=True)
    total = np.bincount(own, weight, minlength=len(files)) + outlier_weight
    return weight / total[own] / len(files)


def noise_of(sequence: EstimateSequence, trust: EstimateConfig) -> MeasurementNoise:
    """Errors as stated, alike while the camera comes as far as it does in the time stated.

    Poses are taken to be spread evenly over a box, and all rotations. It holds the middle 98 % of the positions along
    each axis, and a tenth of its diagonal more on each side: cameras can be where no estimate is.
    """
    positions = np.concatenate([file.poses.translation for file in sequence.files])
    low, high = np.percentile(positions, [1, 99], axis=0)
    std_m, std_rad = float(np.median(trust.std_m)), float(np.radians(np.median(trust.std_deg)))
    margin = max(0.1 * float(np.linalg.norm(high - low)), std_m)
    volume = float(np.prod(high - low + 2 * margin)) * 8 * np.pi**2
    typical = (std_m, std_m, std_m, std_rad, std_rad, std_rad)
    return MeasurementNoise(
        radius_m=std_m,
        noise_floor=typical,
        degrees_of_freedom=trust.degrees_of_freedom,
        outlier_probability=trust.outlier_probability,
        log_clutter_density=-float(np.log(volume)),
        length_m=max(sequence.speed_m_per_s * trust.independent_after_s, std_m),
        constant_fraction=0.0,
        typical_std=typical,
    )


def fuse(
    estimates: Sequence[Path | str],
    output: Path | str,
    config: FilteringConfig | None = None,
    *,
    odometry: Path | str | None = None,
    simulate_odometry: Path | str | None = None,
    ground_truth: Path | str | None = None,
    trust: EstimateConfig | None = None,
    reading: EstimateOptions | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
    command: str = "",
) -> RunResult:
    """Localize frames of which others gave pose estimates, and write everything about it into a directory.

    Args:
        estimates: Files of poses, one for each method; one pose a frame, or several with weights.
        output: Directory for the results, see `vapor.pipeline.run.run`.
        config: Settings of the run.
        odometry: Recorded odometry.
        simulate_odometry: True poses to simulate odometry from, where there is none.
        ground_truth: True poses; None for those that the odometry is simulated from.
        trust: Errors and weights of the estimates.
        reading: How to read the files.
        overwrite: See `vapor.pipeline.run.run`.
        progress: Called after every frame with the number done and an upper bound of all.
        command: See `vapor.pipeline.run.run`.

    Raises:
        VaporTrackError: unusable files or output, or fewer than one in ten of the estimated frames left to localize.

    Example:
        >>> import vapor
        >>> result = vapor.fuse(["estimates.tum"], "fused/", odometry="odometry.tum", ground_truth="truth.tum")
        >>> result.report["filter"]["median_translation_m"] < 0.1
        True
    """
    config, trust, reading = config or FilteringConfig(), trust or EstimateConfig(), reading or EstimateOptions()
    files = [Path(path) for path in estimates]
    beside = [None if path is None else Path(path) for path in (odometry, simulate_odometry, ground_truth)]
    reads = [path for path in (*files, *beside) if path is not None]
    with results_folder(Path(output), "fuse", writes=RESULTS, reads=reads, overwrite=overwrite) as directory:
        sequence = EstimateSequence(
            files,
            odometry=beside[0],
            simulate_odometry_from=beside[1],
            ground_truth=beside[2],
            options=reading,
            seed=config.seed,
        )
        stated = [file.path.name for file in sequence.files if file.weights is None]
        if trust.outlier_weight > 0.0 and stated:
            raise VaporTrackError(
                f"{stated[0]}: no weights, expected a column of them (--columns) beside an outlier_weight of"
                f" {trust.outlier_weight:g}"
            )
        noise = noise_of(sequence, trust)
        model = EstimateModel(len(sequence.files), trust, noise)
        config = replace(config, localizer=over_sequences(config.localizer))
        record = localize(
            sequence,
            model,
            directory,
            config,
            noise,
            observed=lambda frame: frame.estimates,
            place=Place(Poses.concatenate([file.poses for file in sequence.files]), "given estimates"),
            allow_few_images=reading.allow_few_images,
            progress=progress,
        )
        settings = {
            "estimates": [
                {"name": file.path.name, "frames": len(set(file.frames)), "hypotheses": len(file.frames)}
                for file in sequence.files
            ],
            "odometry": sequence.odometry_description,
            "run": asdict(config),
            "trust": asdict(trust),
            "reading": asdict(reading),
            "errors": asdict(noise),
        }
        title = ", ".join(file.path.stem for file in sequence.files)
        return write_results(record, directory, settings, title=title, notices=sequence.notices, command=command)


def over_sequences(config: LocalizerConfig) -> LocalizerConfig:
    """Settings under which the frames of another sequence are another recording, not a gap in the odometry."""
    return replace(config, gap=replace(config.gap, action="forget"))
