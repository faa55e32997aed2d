"""Calibration of a trained network on held-out images and stretches of trajectory, by likelihood."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32, Float64
from scipy.optimize import minimize, minimize_scalar
from scipy.special import expit, logit

from filtering.density import KernelDensity
from filtering.errors import VaporTrackError
from filtering.localizer import LocalizerConfig
from filtering.se3 import Poses
from vapor.checkpoint import Calibration, find_model, load_checkpoint, read_safetensors, save_checkpoint, spaced
from vapor.network import VariationalPoseRegressor
from vapor.observation import Device, resolve_device
from vapor.stretches import GRIDS, Stretch, belief_scores, choose, find_stretches, simulated_odometry
from vapor.threads import limited_threads
from vapor.training_set import TrainingSet, load_training_set, open_sequences
from vapor.validation import predict

NUM_SAMPLES = 1000  # an image, as in use: fewer want wider kernels
LEAST_IMAGES, LEAST_STRETCHES = 50, 3
_KERNEL_BOUNDS = ((0.005, 1.0), (0.005, 1.0))  # metres, radians
_WIDEST_PRIOR = 3.0, 2.0
_FLOOR_BOUNDS = (0.01, 0.5)  # neighbouring images err alike: no outlier in 500 does not say that there are none
_BLOCK = 50  # images at a time: 50 × 2000 float32 fit the cache

Advance = Callable[[int, int], None]


@dataclass(frozen=True)
class Change:
    """What one fit changed.

    Attributes:
        what: In words.
        before: Values by the name of their setting.
        after: Likewise.
        gain: Log likelihood gained, nats per held-out image.
        error: Standard error of the gain over stretches; None where it is over single images.
        preferred: The value of highest score where a more cautious one was taken, else None.
    """

    what: str
    before: dict[str, float]
    after: dict[str, float]
    gain: float
    error: float | None = None
    preferred: float | None = None


@dataclass(frozen=True)
class CalibrationResult:
    """A calibration and where it comes from.

    Attributes:
        calibration: The values.
        changes: One for each fit.
        images: Held-out images of the fits image by image; 0 where there were too few.
        stretches: Held-out stretches with odometry; 0 where there were too few.
        odometry: Where that came from.
        notes: What was kept, and why.
    """

    calibration: Calibration
    changes: tuple[Change, ...] = ()
    images: int = 0
    stretches: int = 0
    odometry: str = "none"
    notes: tuple[str, ...] = ()

    @property
    def provenance(self) -> dict[str, Any]:
        """JSON for the model file: all but the values themselves."""
        return {key: value for key, value in asdict(self).items() if key != "calibration"}


def calibrate_model(
    model: str,
    data: Sequence[Path | str],
    output: Path,
    *,
    max_images: int = 500,
    seed: int = 0,
    device: Device = "auto",
    advance: Advance = lambda done, total: None,
) -> CalibrationResult:
    """Calibrate a model that was trained before, and write it with its weights untouched.

    Args:
        model: Model file, or name of a model that ships.
        data: Held-out files and folders with true poses, as for `train`.
        output: The model file to write.
        max_images: Held-out images of each kind of fit, at most.
        seed: Of latent noise and filter.
        device: Where the network runs.
        advance: Called with the number of filter runs done and of all.

    Raises:
        VaporTrackError: unusable model or data, or too little of it to calibrate anything.
    """
    file, output = find_model(model), Path(output)
    if output.is_dir() or not output.parent.is_dir():
        raise VaporTrackError(f"{output}: cannot be written, expected the name of a model file in an existing folder")
    checkpoint = load_checkpoint(file)
    config = checkpoint.network
    held_out = load_training_set(open_sequences(data), config.shortest_edge)
    if len(held_out) < LEAST_IMAGES:
        names = ", ".join(Path(str(entry)).name for entry in data)
        raise VaporTrackError(f"{names}: {len(held_out)} images with true poses, expected at least {LEAST_IMAGES}")
    result = calibrate(
        checkpoint.build_network().to(resolve_device(device)),
        held_out,
        checkpoint.prior_poses,
        checkpoint.calibration,
        max_images=max_images,
        seed=seed,
        advance=advance,
    )
    half = any(tensor.dtype == torch.float16 for tensor in read_safetensors(file)[1].values())
    names = {"data": [Path(str(entry)).name for entry in data]}
    training = {**checkpoint.training, "calibration": names | result.provenance}
    save_checkpoint(output, replace(checkpoint, calibration=result.calibration, training=training), half=half)
    return result


def calibrate(
    network: VariationalPoseRegressor,
    held_out: TrainingSet,
    prior_poses: Poses,
    calibration: Calibration,
    *,
    max_images: int,
    seed: int,
    advance: Advance = lambda done, total: None,
) -> CalibrationResult:
    """Fit kernel widths, prior and outlier floor image by image, and β, γ and β_d with the filter on stretches.

    Args:
        network: With its final weights.
        held_out: Images that it was not trained on, in order of time.
        prior_poses: Of the model, (n,).
        calibration: Values to start from, and to keep where there is too little data.
        max_images: Of each of the two kinds of fit, at most.
        seed: Of latent noise and filter.
        advance: Called with the number of filter runs done and of all.
    """
    if len(held_out) < LEAST_IMAGES:
        note = f"{len(held_out)} held-out images, at least {LEAST_IMAGES} are needed: calibration kept as it was"
        return CalibrationResult(calibration, notes=(note,))
    single = spaced(len(held_out), max_images)
    pieces = find_stretches(held_out, max_images)
    needed = np.unique(np.concatenate([single, *pieces]))
    samples = dict(zip(needed.tolist(), predict(network, held_out.select(needed), NUM_SAMPLES, seed), strict=True))
    calibration, changes = fit_images(
        [samples[i] for i in single.tolist()], held_out.poses[single], prior_poses, calibration
    )
    if len(pieces) < LEAST_STRETCHES:
        note = f"{len(pieces)} held-out stretches, at least {LEAST_STRETCHES} are needed: β, γ and β_d kept"
        return CalibrationResult(calibration, changes, len(single), notes=(note,))
    rng = np.random.default_rng(seed)
    stretches, simulated = [], 0
    for piece in pieces:
        odometry = [held_out.odometry[i] for i in piece]
        if any(increment is None for increment in odometry[1:]):
            odometry, simulated = simulated_odometry(held_out, piece, rng=rng), simulated + 1
        stretches.append(Stretch([samples[i] for i in piece.tolist()], odometry, held_out.poses[piece]))
    calibration, more = fit_stretches(stretches, prior_poses, calibration, seed=seed, advance=advance)
    source = "recorded" if not simulated else f"simulated from true poses on {simulated} of {len(pieces)} stretches"
    return CalibrationResult(calibration, changes + more, len(single), len(pieces), source)


def fit_images(
    samples: Sequence[Poses], truth: Poses, prior_poses: Poses, calibration: Calibration
) -> tuple[Calibration, tuple[Change, ...]]:
    """Widths of π, widths of p̂ and the outlier floor, from posterior samples of n images and their true poses (n,)."""
    prior_distances = _Distances.between([prior_poses], truth)
    before = calibration.prior_bandwidth_translation_m, calibration.prior_bandwidth_rotation_rad
    # A ratio p̂/π of a smooth density and a spiky one says little: π is never narrower than what it divides.
    least = calibration.place_bandwidth_translation_m, calibration.place_bandwidth_rotation_rad
    bounds = tuple((low, max(low, high)) for low, high in zip(least, _WIDEST_PRIOR, strict=True))
    widths = _likeliest_widths(lambda w: prior_distances.log_density(w[0], w[1]).mean(), before, bounds)
    log_prior_before, log_prior = (prior_distances.log_density(*pair) for pair in (before, widths))
    names = "prior_bandwidth_translation_m", "prior_bandwidth_rotation_rad"
    changes = [_change("prior π", names, before, widths, float((log_prior - log_prior_before).mean()))]
    calibration = replace(calibration, **changes[-1].after)

    distances = _Distances.between(samples, truth)

    def floored(h_t: float, h_r: float) -> float:
        return _best_floor(distances.log_density(h_t, h_r), log_prior)[1]

    before = calibration.bandwidth_translation_m, calibration.bandwidth_rotation_rad
    widths = _likeliest_widths(lambda w: floored(w[0], w[1]), before, _KERNEL_BOUNDS)
    names = "bandwidth_translation_m", "bandwidth_rotation_rad"
    changes.append(_change("kernel widths", names, before, widths, floored(*widths) - floored(*before)))
    calibration = replace(calibration, **changes[-1].after)

    # The floor that is stored is the one of the likelihood that tells places apart.
    likelihood = calibration.likelihood(prior_poses)
    places = [calibration.posterior(poses, likelihood).places for poses in samples]
    log_places = np.array([p.log_density(truth[[i]])[0] for i, p in enumerate(places) if p is not None])
    floor, best = _best_floor(log_places, log_prior)
    before = calibration.outlier_floor
    gain = best - _with_floor(before, log_places, log_prior)
    changes.append(_change("outlier floor ε", ("outlier_floor",), (before,), (floor,), gain))
    return replace(calibration, **changes[-1].after), tuple(changes)


def fit_stretches(
    stretches: Sequence[Stretch],
    prior_poses: Poses,
    calibration: Calibration,
    *,
    config: LocalizerConfig | None = None,
    seed: int = 0,
    advance: Advance = lambda done, total: None,
) -> tuple[Calibration, tuple[Change, ...]]:
    """β, γ and β_d one after the other, by the log density of the filter's belief at the true poses."""
    likelihoods = calibration.likelihood(prior_poses)
    known: dict[Calibration, Float64[np.ndarray, " s"]] = {}
    total = sum(len(grid) for grid in GRIDS.values()) - len(GRIDS) + 1

    def score(candidate: Calibration) -> Float64[np.ndarray, " s"]:
        if candidate not in known:
            likelihood = replace(
                likelihoods,
                temper=candidate.temper,
                preference=candidate.preference,
                detail_temper=candidate.detail_temper,
            )
            with limited_threads(torch.get_num_threads()):
                known[candidate] = belief_scores(
                    stretches, candidate, likelihood, config=config or LocalizerConfig(), seed=seed
                )
            advance(len(known), max(total, len(known)))
        return known[candidate]

    changes: list[Change] = []
    for name, what in (("temper", "tempering β"), ("preference", "preference γ"), ("detail_temper", "detail β_d")):
        before = calibration
        calibration, choice = choose(name, calibration, score)
        names = [n for n in GRIDS if getattr(before, n) != getattr(calibration, n)] or [name]
        changes.append(
            Change(
                what,
                {n: getattr(before, n) for n in names},
                {n: getattr(calibration, n) for n in names},
                choice.gain,
                choice.error,
                choice.preferred if choice.preferred != choice.value else None,
            )
        )
    return calibration, tuple(changes)


@dataclass(frozen=True)
class _Distances:
    """Squared distances of true poses (n,) from kernel centres (n, m), or the same (m,) for all: computed once.

    Attributes:
        squared_m2: Of translation.
        squared_chord: 2 − 2 cos of the angle.
    """

    squared_m2: Float32[np.ndarray, "n m"]
    squared_chord: Float32[np.ndarray, "n m"]

    @staticmethod
    def between(centres: Sequence[Poses], poses: Poses) -> _Distances:
        apart = [centres[i if len(centres) > 1 else 0].distance(poses[i]) for i in range(len(poses))]
        squared_m2 = np.array([np.square(metres) for metres, _ in apart], np.float32)
        return _Distances(squared_m2, np.array([2 - 2 * np.cos(radians) for _, radians in apart], np.float32))

    def log_density(self, width_m: float, width_rad: float) -> Float64[np.ndarray, " n"]:
        """Log of the kernel density at each true pose, (n,), per m³ rad³."""
        n, m = self.squared_m2.shape
        log_sum = np.empty(n)
        scale_m, scale_rad = np.float32(-0.5 / width_m**2), np.float32(-0.5 / width_rad**2)
        for start in range(0, n, _BLOCK):
            rows = slice(start, start + _BLOCK)
            exponent = self.squared_m2[rows] * scale_m
            exponent += self.squared_chord[rows] * scale_rad
            top = exponent.max(axis=1, keepdims=True)
            log_sum[rows] = top[:, 0] + np.log(np.exp(exponent - top).sum(axis=1), dtype=np.float64)
        kernel = KernelDensity(Poses.identity(1), width_m, width_rad)
        return log_sum - np.log(m) - kernel.log_normaliser[0]


def _likeliest_widths(
    mean_log: Callable[[np.ndarray], float],
    start: tuple[float, float],
    bounds: Sequence[tuple[float, float]],
) -> tuple[float, float]:
    """Widths of highest mean log likelihood."""
    found = minimize(
        lambda x: -mean_log(np.exp(x)),
        np.log([np.clip(value, *bound) for value, bound in zip(start, bounds, strict=True)]),
        method="Nelder-Mead",
        bounds=np.log(bounds),
        options={"xatol": 0.01, "fatol": 1e-4},
    )
    width_m, width_rad = np.exp(found.x)
    return float(width_m), float(width_rad)


def _best_floor(log_density: Float64[np.ndarray, " n"], log_prior: Float64[np.ndarray, " n"]) -> tuple[float, float]:
    """ε of highest mean log likelihood, and that."""
    found = minimize_scalar(
        lambda x: -_with_floor(expit(x), log_density, log_prior), bounds=logit(_FLOOR_BOUNDS), method="bounded"
    )
    return float(expit(found.x)), -float(found.fun)


def _with_floor(floor: float, log_density: Float64[np.ndarray, " n"], log_prior: Float64[np.ndarray, " n"]) -> float:
    """Mean of log[(1 − ε) p̂ + ε π] over images: an image is an outlier with probability ε."""
    return float(np.logaddexp(np.log1p(-floor) + log_density, np.log(floor) + log_prior).mean())


def _change(
    what: str, names: tuple[str, ...], before: tuple[float, ...], after: tuple[float, ...], gain: float
) -> Change:
    return Change(what, dict(zip(names, before, strict=True)), dict(zip(names, after, strict=True)), gain)
