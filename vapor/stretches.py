"""Held-out stretches of trajectory, and how well the filter's belief does on them: for β, γ and β_d."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int64
from scipy.stats import chi2

from filtering.estimate import Estimate, Mode
from filtering.localizer import LocalizerConfig, ParticleLocalizer
from filtering.motion import MotionNoise, Odometry, covariance_factor
from filtering.posterior import LikelihoodModel, PosteriorSamples
from filtering.se3 import Poses
from vapor.checkpoint import Calibration
from vapor.evaluate import REGIONS
from vapor.training_set import TrainingSet

STRETCH_IMAGES = 100
LEAST_STRETCHES = 3  # fewer cannot tell a gain from noise
LEAST_IMAGES = 40  # of a stretch: the filter needs some to choose between places
SAFE_PREFERENCE = 0.02
"""γβ, at most. Beyond it the preference of one place over another that looks alike, which neighbouring images share,
adds up to a belief that calls itself converged where nothing unique was seen (measured on synthetic sequences)."""
COVERAGE = 0.9
"""Least share of the true poses that 95 % regions must hold."""
_GATE = chi2.ppf(REGIONS["95%"], df=6)  # of the squared error in six dimensions
_LEAST_RIGHT = 50  # images in the right place, from which on a coverage is told
_BREAK_S = 1.0  # of images without odometry: so far apart they are different stretches
_FLOOR = 1e-3  # share of π in a belief, so that single images do not decide

GRIDS: dict[str, tuple[float, ...]] = {
    "temper": (0.1, 0.2, 0.3, 0.4),
    "preference": (0.03, 0.06, 0.1),
    "detail_temper": (0.1, 0.15, 0.2, 0.35, 0.5, 1.0),
}
"""Values tried of each, the more cautious first."""


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
class Scores:
    """How well the filter's belief does on s stretches.

    Attributes:
        log_density: Mean log density of the belief at the true pose, each stretch's mean, per m³ rad³, (s,).
        right: Number of images whose true pose lies in the place of the best mode.
        covered: Of these, number of those with it in the best mode's 95 % region.
    """

    log_density: Float64[np.ndarray, " s"]
    right: int
    covered: int


@dataclass(frozen=True)
class Choice:
    """The value taken of one setting.

    Attributes:
        value: Taken.
        preferred: The one of highest mean log density, whether taken or not.
        gain: Mean log density with the value taken less that with the one before, nats per image.
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
) -> Scores:
    """How well the filter's belief does on stretches.

    The filter starts anew on every stretch. The same seed gives every calibration the same random numbers.
    """
    log_density, right, covered = np.empty(len(stretches)), 0, 0
    for k, stretch in enumerate(stretches):
        localizer = ParticleLocalizer[PosteriorSamples](None, config, rng=np.random.default_rng([seed, k]))
        log_prior = likelihood.log_prior(stretch.truth)
        total = 0.0
        for i, samples in enumerate(stretch.samples):
            estimate = localizer.update(calibration.posterior(samples, likelihood), stretch.odometry[i] if i else None)
            log_belief = log_belief_density(estimate, stretch.truth[i])
            total += np.logaddexp(np.log1p(-_FLOOR) + log_belief, np.log(_FLOOR) + log_prior[i])
            best = estimate.modes[0]
            if config.modes.same_place(best.world_from_camera, stretch.truth[i]):
                right += 1
                covered += bool(_squared_error(best, stretch.truth[i]) <= _GATE)
        log_density[k] = total / len(stretch.samples)
    return Scores(log_density, right, covered)


def log_belief_density(estimate: Estimate, pose: Poses) -> float:
    """Log density of an estimate at one pose, per m³ rad³: a Gaussian each for its modes.

    What is reported of a belief is what is judged. A kernel density over the particles scores worse, and differently at
    every draw: in six dimensions a few thousand particles leave holes.
    """
    terms = []
    for mode in estimate.modes:
        log_volume = np.linalg.slogdet(2 * np.pi * _regular(mode.covariance))[1]
        terms.append(np.log(max(mode.weight, 1e-300)) - 0.5 * (_squared_error(mode, pose) + log_volume))
    return float(np.logaddexp.reduce(terms))


def _squared_error(mode: Mode, pose: Poses) -> float:
    """Squared Mahalanobis distance of one pose from a mode."""
    error = (mode.world_from_camera.inverse() @ pose).log()
    return float(error @ np.linalg.solve(_regular(mode.covariance), error))


def _regular(covariance: Float64[np.ndarray, "6 6"]) -> Float64[np.ndarray, "6 6"]:
    return covariance + 1e-9 * np.eye(6)


def choose(name: str, calibration: Calibration, score: Callable[[Calibration], Scores]) -> tuple[Calibration, Choice]:
    """The best safe value of γ, or the value of β nearest to the one before within a standard error of the best.

    The best has the highest mean log density; the standard error is that of its gain over the other value. So β, which
    nothing else bounds, changes only as far as the stretches can tell.

    Args:
        name: "temper" or "preference".
        calibration: All other settings; γ is lowered where γβ would exceed what is safe.
        score: How well a calibration does.
    """
    before = getattr(calibration, name)
    candidates = {value: _with(calibration, name, value) for value in sorted({*GRIDS[name], before})}
    scores = {value: score(candidate).log_density for value, candidate in candidates.items()}
    safe = {v: s for v, s in scores.items() if name != "preference" or v * calibration.temper <= SAFE_PREFERENCE + 1e-9}
    best = max(safe, key=lambda value: safe[value].mean())
    value = best
    if name == "temper":
        as_good = [v for v in safe if (lost := _mean_and_error(safe[best] - safe[v]))[0] <= lost[1]]
        value = min(as_good, key=lambda v: (round(abs(v - before), 9), v))
    return candidates[value], _choice(scores, before, value)


def choose_detail(
    calibration: Calibration, score: Callable[[Calibration], Scores]
) -> tuple[Calibration, Choice, float | None]:
    """The likeliest β_d whose 95 % regions hold at least 90 % of the true poses, or the smallest of all.

    By likelihood alone it could be larger: what a user trusts is the covariance. All of 95 % are not asked for: a few
    stretches in which images err alike decide about the last ones, and what covers these is far too wide elsewhere.

    Args:
        calibration: All other settings.
        score: How well a calibration does.

    Returns:
        The calibration, what was chosen, and the share of the true poses that the regions hold; as it was, and None,
        where too few images are in the right place to tell.
    """
    before = calibration.detail_temper
    candidates = {v: replace(calibration, detail_temper=v) for v in sorted({*GRIDS["detail_temper"], before})}
    scores = {value: score(candidate) for value, candidate in candidates.items()}
    told = all(s.right >= _LEAST_RIGHT for s in scores.values())
    value = before
    if told:
        true = [v for v, s in scores.items() if s.covered >= COVERAGE * s.right]
        value = max(true, key=lambda v: scores[v].log_density.mean(), default=min(scores))
    choice = _choice({v: s.log_density for v, s in scores.items()}, before, value)
    return candidates[value], choice, scores[value].covered / scores[value].right if told else None


def _choice(log_densities: Mapping[float, Float64[np.ndarray, " s"]], before: float, value: float) -> Choice:
    preferred = max(log_densities, key=lambda v: log_densities[v].mean())
    return Choice(value, preferred, *_mean_and_error(log_densities[value] - log_densities[before]))


def _with(calibration: Calibration, name: str, value: float) -> Calibration:
    if name == "temper":
        return replace(calibration, temper=value, preference=min(calibration.preference, SAFE_PREFERENCE / value))
    return replace(calibration, **{name: value})


def _mean_and_error(values: Float64[np.ndarray, " s"]) -> tuple[float, float]:
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))
