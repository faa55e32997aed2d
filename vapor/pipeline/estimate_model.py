"""Pose estimates of others as an observation model: how far to trust them, and how they err."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64, Shaped

from filtering.error_model import ErrorModel
from filtering.errors import VaporTrackError, require_within
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.estimates.sequence import EstimateSequence


@dataclass(frozen=True)
class EstimateConfig:
    """How far to trust estimates."""

    std_m: tuple[float, ...] = (0.05,)
    """Stated standard deviation of position along each axis, metres; one for all files or one for each."""
    std_deg: tuple[float, ...] = (1.0,)
    """Stated standard deviation of rotation about each axis, degrees; one for all files or one for each."""
    tail: float = 4.0
    """Degrees of freedom of the Student t distribution of their errors: the fewer, the heavier the tails."""
    outlier_weight: float = 0.0
    """Of estimates with weights: how much weight stands for "none of them". A hypothesis is as probable as its weight
    over the sum of those of its file and frame and this. With counts of inliers it is the number that a wrong pose has
    by chance, such as 10; at 0 weights are of any unit, and only their ratios count."""
    outlier_probability: float = 0.1
    """Fraction of the frames in which no estimate says where the camera is."""
    independent_after_s: float = 1.0
    """Frames so far apart err independently, at the speed that the camera has on the whole; frames of a camera that
    stands do not."""

    def __post_init__(self) -> None:
        require_within(self, tail=(1.0, 1e6), outlier_probability=(1e-6, 0.999999), independent_after_s=(1e-6, 1e6))
        require_within(self, outlier_weight=(0.0, 1e12))
        for name, high in (("std_m", 1e3), ("std_deg", 180.0)):
            for value in getattr(self, name):
                if not 1e-4 <= value <= high:
                    raise VaporTrackError(f"{name} is {value}, expected between 0.0001 and {high}")


class EstimateModel:
    """Pose estimates as an observation model: `observe` takes them instead of an image, and draws nothing.

    Args:
        num_files: How many methods there are.
        config: How far to trust them.
        errors: How they err over time.

    Raises:
        VaporTrackError: as many uncertainties are stated as neither one nor the number of files.
    """

    def __init__(self, num_files: int, config: EstimateConfig, errors: ErrorModel) -> None:
        self.config = config
        self.errors = errors
        for name, values in (("std_m", config.std_m), ("std_deg", config.std_deg)):
            if len(values) not in (1, num_files):
                raise VaporTrackError(f"{name} has {len(values)} values, expected one, or one for each of {num_files}")
        self._std_m = np.broadcast_to(config.std_m, num_files).astype(float)
        self._std_rad = np.radians(np.broadcast_to(config.std_deg, num_files))

    def observe(self, image: Shaped[np.ndarray, " h"], *, rng: np.random.Generator) -> PosePosterior:
        """The posterior of one image: of m methods with an estimate of it each has 1/m, shared by its hypotheses.

        Args:
            image: Hypotheses of dtype `HYPOTHESIS`, (h,).
            rng: Not used.

        Raises:
            VaporTrackError: there is no hypothesis.
        """
        file = image["file"]
        return PosePosterior.from_estimates(
            Poses.from_matrix(image["world_from_camera"]),
            self._std_m[file],
            self._std_rad[file],
            self.errors,
            weights=mixture_weights(file, image["weight"], self.config.outlier_weight),
        )


def mixture_weights(
    file: Int64[np.ndarray, " h"], weight: Float64[np.ndarray, " h"], outlier_weight: float
) -> Float64[np.ndarray, " h"]:
    """Probabilities (h,) of a frame's hypotheses: w / (Σ w + w₀) / m, the sum over those of the same file.

    With counts of inliers each is a vote for its hypothesis, and w₀ votes are for none of them: the mean of a Dirichlet
    distribution with these counts. In all they are 1 where w₀ is 0.

    Args:
        file: Number of the file of each; of m files.
        weight: Above 0, in the unit of w₀.
        outlier_weight: w₀, 0 or more.
    """
    files, own = np.unique(file, return_inverse=True)
    total = np.bincount(own, weight, minlength=len(files)) + outlier_weight
    return weight / total[own] / len(files)


def errors_of(sequence: EstimateSequence, trust: EstimateConfig) -> ErrorModel:
    """How estimates err: as stated, alike while the camera comes as far as it does in the time stated.

    Poses are taken to be spread evenly over a box, and all rotations. It holds the middle 98 % of the positions along
    each axis, and a tenth of its diagonal more on each side: cameras can be where no estimate is.
    """
    positions = np.concatenate([file.poses.translation for file in sequence.files])
    low, high = np.percentile(positions, [1, 99], axis=0)
    std_m, std_rad = float(np.median(trust.std_m)), float(np.radians(np.median(trust.std_deg)))
    margin = max(0.1 * float(np.linalg.norm(high - low)), std_m)
    volume = float(np.prod(high - low + 2 * margin)) * 8 * np.pi**2
    typical = (std_m, std_m, std_m, std_rad, std_rad, std_rad)
    return ErrorModel(
        radius_m=std_m,
        floor=typical,
        tail=trust.tail,
        outlier_probability=trust.outlier_probability,
        flat_log_density=-float(np.log(volume)),
        length_m=max(sequence.speed_m_per_s * trust.independent_after_s, std_m),
        constant_fraction=0.0,
        typical_std=typical,
    )
