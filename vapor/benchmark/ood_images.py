"""How often images of a place are flagged as other, and other images are not: counts over sequences."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from filtering.errors import VaporTrackError
from vapor.observation import VaporObservationModel
from vapor.training_data.entries import open_sequences

Image = UInt8[np.ndarray, "h w 3"]
Change = Callable[[np.ndarray, np.random.Generator], np.ndarray]

IN_A_ROW = 10
"""Number of images whose median score decides, where a single image does not."""


def _gains(red: float, green: float, blue: float) -> Change:
    gains = np.array([red, green, blue])
    return lambda image, rng: np.clip(image * gains, 0.0, 255.0).astype(np.uint8)


def _grey(image: Image) -> Image:
    return np.repeat(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None], 3, axis=2)


OUT_OF_DISTRIBUTION: Mapping[str, Change] = {
    "upside down": lambda image, rng: image[::-1, ::-1],
    "mirrored": lambda image, rng: image[:, ::-1],
    "red and blue swapped": lambda image, rng: image[..., ::-1],
    "grey": lambda image, rng: _grey(image),
    "uniform noise": lambda image, rng: rng.integers(0, 256, image.shape, dtype=np.uint8),
    "Gaussian noise": lambda image, rng: np.clip(rng.normal(127.0, 50.0, image.shape), 0, 255).astype(np.uint8),
    "black": lambda image, rng: np.zeros_like(image),
    "white": lambda image, rng: np.full_like(image, 255),
    "blurred by 1/30 of the width": lambda image, rng: cv2.GaussianBlur(image, (0, 0), image.shape[1] / 30),
}
"""Changes that turn a known image into a other one."""

CHANGED: Mapping[str, Change] = {
    "30 % darker": _gains(0.7, 0.7, 0.7),
    "30 % brighter": _gains(1.3, 1.3, 1.3),
    "red 5 % up, blue 5 % down": _gains(1.05, 1.0, 0.95),
    "noise of 10 of 255": lambda image, rng: np.clip(image + rng.normal(0.0, 10.0, image.shape), 0, 255).astype(
        np.uint8
    ),
}
"""Changes that leave the place recognisable."""


@dataclass(frozen=True)
class Flagged:
    """How often images of a kind were flagged as other.

    Attributes:
        kind: Name of the data, or of the change of the known images.
        median: Median score.
        fraction: Fraction of the images with a score above 1.
        fraction_in_a_row: Of the images with nine before them, the fraction where the median of the ten is above 1; NaN
            if there are none.
    """

    kind: str
    images: int
    median: float
    fraction: float
    fraction_in_a_row: float


def evaluate_flags(
    model: VaporObservationModel,
    known: Sequence[Path | str],
    other: Sequence[Path | str],
    *,
    every: int = 1,
    seed: int = 0,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> list[Flagged]:
    """Score known data, the same data made other or changed, and each of the other data.

    Args:
        model: One with an OOD model; how many samples it draws makes no difference.
        known: Files and folders with images of its place that it was not trained on, or `PATH@START:STOP`.
        other: Likewise, of other places.
        every: Take only every so many images of each.
        advance: Called with the number of files and folders evaluated and that of all.

    Raises:
        VaporTrackError: the model has no OOD model, or data cannot be read.
    """
    if model.description.ood_model is None:
        raise VaporTrackError("the model file has no OOD model, expected one with it (`vapor-track calibrate` adds it)")
    changes: dict[str, Change] = {"known": lambda image, rng: image, **OUT_OF_DISTRIBUTION, **CHANGED}
    scores: dict[str, list[Float64[np.ndarray, " n"]]] = {kind: [] for kind in changes}
    total = len(known) + len(other)
    for done, images in enumerate(_images(known, every), 1):
        found = _scores(model, images, changes, seed)
        for number, kind in enumerate(changes):
            scores[kind].append(found[:, number])
        advance(done, total)
    rows = [_count(kind, of_kind) for kind, of_kind in scores.items()]
    for done, (entry, images) in enumerate(zip(other, _images(other, every), strict=True), len(known) + 1):
        found = _scores(model, images, {"known": changes["known"]}, seed)
        rows.append(_count(Path(str(entry)).name, [found[:, 0]]))
        advance(done, total)
    return rows


def _images(data: Sequence[Path | str], every: int) -> Iterator[Iterable[np.ndarray]]:
    for frames in open_sequences(data).values():
        yield (frame.image for number, frame in enumerate(frames) if number % every == 0)


def _scores(
    model: VaporObservationModel, images: Iterable[np.ndarray], changes: Mapping[str, Change], seed: int
) -> Float64[np.ndarray, "n k"]:
    """Score of each image after each of the changes, each change with random numbers of its own."""
    streams = [np.random.default_rng([seed, number]) for number in range(len(changes))]
    scores = [
        [
            model.observe(np.ascontiguousarray(change(image, rng)), rng=rng).ood_score
            for change, rng in zip(changes.values(), streams, strict=True)
        ]
        for image in images
    ]
    return np.array(scores, np.float64).reshape(-1, len(changes))


def _count(kind: str, sequences: Sequence[Float64[np.ndarray, " n"]]) -> Flagged:
    scores = np.concatenate(sequences)
    if not len(scores):
        raise VaporTrackError(f"{kind}: no images with true poses, expected at least one")
    rows = [np.lib.stride_tricks.sliding_window_view(s, IN_A_ROW) for s in sequences if len(s) >= IN_A_ROW]
    medians = np.concatenate([np.median(row, axis=1) for row in rows]) if rows else np.array([])
    in_a_row = float((medians > 1.0).mean()) if len(medians) else float("nan")
    return Flagged(kind, len(scores), float(np.median(scores)), float((scores > 1.0).mean()), in_a_row)
