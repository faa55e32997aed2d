"""Held-out stretches of trajectory, and how well the filter's belief does on them: for β, γ and β_d."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int64

from filtering.estimate import Estimate
from filtering.localizer import LocalizerConfig, ParticleLocalizer
from filtering.motion import MotionNoise, Odometry, covariance_factor
from filtering.posterior import LikelihoodModel, PosteriorSamples
from filtering.se3 import Poses
from vapor.checkpoint import Calibration
from vapor.training_set import TrainingSet

STRETCH_IMAGES = 100
LEAST_STRETCHES = 3  # fewer cannot tell a gain from noise
LEAST_IMAGES = 40  # of a stretch: the filter needs some to choose between places
SAFE_PREFERENCE = 0.02
"""γβ, at most. Beyond it the preference of one place over another that looks alike, which neighbouring images share,
adds up to a belief that calls itself converged where nothing unique was seen (measured on synthetic sequences)."""
_BREAK_S = 1.0  # of images without odometry: so far apart they are different stretches
_FLOOR = 1e-3  # share of π in a belief, so that single images do not decide

GRIDS: dict[str, tuple[float, ...]] = {
    "temper": (0.1, 0.2, 0.3, 0.4),
    "preference": (0.03, 0.06, 0.1),
    "detail_temper": (0.1, 0.2, 0.35, 0.5, 1.0),
}
"""Values tried of each; the smallest are the most cautious."""


@dataclass(frozen=True)
class Stretch:
    """Consecutive images with what the filter needs of them.

    Attributes:
        samples: Posterior samples of each image, n batches (m,).
        odometry: Motion since the image before; the first is not used.
        truth: world_from_camera, (n,).
    """

    samples: Sequence[Poses]
    odometry: Sequence[Odometry | None]
    truth: Poses


@dataclass(frozen=True)
class Choice:
    """The value taken of one setting.

    Attributes:
        value: Taken.
        preferred: The one of highest score, whether safe and clear of the noise or not.
        gain: Score of the value taken less that of the one before, nats per image.
        error: Standard error of the gain over the stretches.
    """

    value: float
    preferred: float
    gain: float
    error: float


def find_stretches(images: TrainingSet, limit: int) -> list[Int64[np.ndarray, " k"]]:
    """Indices of consecutive images, about 100 in each stretch, `limit` or three stretches in all, over the whole set.

    Images are consecutive where odometry leads from one to the next, and in sequences without any where less than a
    second lies between.
    """
    first = np.diff(images.sequence, prepend=-1) != 0
    led = np.array([odometry is not None for odometry in images.odometry], bool)
    recorded = np.isin(images.sequence, images.sequence[led])
    near = np.diff(images.times_ns, prepend=0) < _BREAK_S * 1e9
    begins = np.flatnonzero(first | ~np.where(recorded, led, near))
    pieces: list[np.ndarray] = []
    for begin, end in zip(begins, [*begins[1:], len(images)], strict=True):
        count = max(1, round((end - begin) / STRETCH_IMAGES))
        pieces += [piece for piece in np.array_split(np.arange(begin, end), count) if len(piece) >= LEAST_IMAGES]
    wanted = max(LEAST_STRETCHES, limit // STRETCH_IMAGES)
    if len(pieces) <= wanted:
        return pieces
    return [pieces[k] for k in np.linspace(0, len(pieces) - 1, wanted).round().astype(np.int64)]


def simulated_odometry(
    images: TrainingSet, indices: Int64[np.ndarray, " k"], *, rng: np.random.Generator
) -> list[Odometry | None]:
    """Odometry of consecutive images (k,) from their true poses, with the noise that `MotionNoise` states."""
    odometry: list[Odometry | None] = [None]
    for before, now in pairwise(indices.tolist()):
        motion = images.poses[before].inverse() @ images.poses[now]
        covariance = MotionNoise().covariance(motion, float(images.times_ns[now] - images.times_ns[before]) * 1e-9)
        error = covariance_factor(covariance) @ rng.standard_normal(6)
        odometry.append(Odometry(motion @ Poses.exp(error).inverse(), covariance))
    return odometry


def belief_scores(
    stretches: Sequence[Stretch],
    calibration: Calibration,
    likelihood: LikelihoodModel,
    *,
    config: LocalizerConfig,
    seed: int,
) -> Float64[np.ndarray, " s"]:
    """Mean log density of the filter's belief at the true pose, each stretch's mean, (s,), per m³ rad³.

    The filter starts anew on every stretch. The same seed gives every calibration the same random numbers.
    """
    scores = np.empty(len(stretches))
    for k, stretch in enumerate(stretches):
        localizer = ParticleLocalizer[PosteriorSamples](None, config, rng=np.random.default_rng([seed, k]))
        log_prior = likelihood.log_prior(stretch.truth)
        total = 0.0
        for i, samples in enumerate(stretch.samples):
            estimate = localizer.update(calibration.posterior(samples, likelihood), stretch.odometry[i] if i else None)
            log_belief = log_belief_density(estimate, stretch.truth[i])
            total += np.logaddexp(np.log1p(-_FLOOR) + log_belief, np.log(_FLOOR) + log_prior[i])
        scores[k] = total / len(stretch.samples)
    return scores


def log_belief_density(estimate: Estimate, pose: Poses) -> float:
    """Log density of an estimate at one pose, per m³ rad³: a Gaussian each for its modes.

    What is reported of a belief is what is judged. A kernel density over the particles scores worse, and differently at
    every draw: in six dimensions a few thousand particles leave holes.
    """
    terms = []
    for mode in estimate.modes:
        error = (mode.world_from_camera.inverse() @ pose).log()
        covariance = mode.covariance + 1e-9 * np.eye(6)
        log_volume = np.linalg.slogdet(2 * np.pi * covariance)[1]
        squared = error @ np.linalg.solve(covariance, error)
        terms.append(np.log(max(mode.weight, 1e-300)) - 0.5 * (squared + log_volume))
    return float(np.logaddexp.reduce(terms))


def choose(
    name: str, calibration: Calibration, score: Callable[[Calibration], Float64[np.ndarray, " s"]]
) -> tuple[Calibration, Choice]:
    """The value of highest score, or a more cautious one whose score is within its standard error of that.

    Of β and γ nothing is taken that is less than both the value before and the best one, as caution there costs time to
    converge. Caution with β_d costs a somewhat wide covariance only, and images that err alike in all stretches do not
    show in the standard error.

    Args:
        name: A key of `GRIDS`.
        calibration: All other settings; γ is lowered where γβ would exceed what is safe.
        score: Scores of the stretches, (s,).
    """
    before = getattr(calibration, name)
    candidates = {value: _with(calibration, name, value) for value in sorted({*GRIDS[name], before})}
    scores = {value: score(candidate) for value, candidate in candidates.items()}
    preferred = max(scores, key=lambda value: scores[value].mean())
    safe = {v: s for v, s in scores.items() if name != "preference" or v * calibration.temper <= SAFE_PREFERENCE + 1e-9}
    best = max(safe, key=lambda value: safe[value].mean())
    least = 0.0 if name == "detail_temper" else min(before, best) if before in safe else best
    value = min(v for v in safe if v >= least and (lost := _mean_and_error(safe[best] - safe[v]))[0] <= lost[1])
    return candidates[value], Choice(value, preferred, *_mean_and_error(scores[value] - scores[before]))


def _with(calibration: Calibration, name: str, value: float) -> Calibration:
    if name == "temper":
        return replace(calibration, temper=value, preference=min(calibration.preference, SAFE_PREFERENCE / value))
    return replace(calibration, **{name: value})


def _mean_and_error(values: Float64[np.ndarray, " s"]) -> tuple[float, float]:
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))
