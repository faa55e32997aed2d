"""What matching the features of an image with landmarks would take on a device; the library matches by numpy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Float, Float32, Int8, Int64
from torch import Tensor

from vapor.benchmark.gpu.setting import Setting
from vapor.benchmark.gpu.stages import Deadline, Finding
from vapor.benchmark.gpu.timing import timed
from vapor.landmarks.features import SIZE, mutual_matches, restored, stored, unit_vectors

_FEATURES, _PLACES, _RATIO = 300, 8, 0.9  # as in `vapor.landmarks.localize`, at most
_SHOWN = 100  # features of an image that are landmarks of its first place
_NOISE = 0.05  # of their descriptors, along each axis
_MAP = 20  # landmarks of the map, in those of a place
_IMAGES = 8
_MOST_OTHER = 0.01  # fraction of matches: nearly equal likenesses may be ordered otherwise


def time_matching(setting: Setting, deadline: Deadline) -> Iterator[Finding]:
    """Times of the matches of images with their places, by numpy and on a device, and whether these are the same.

    Descriptors are random, as many as those of an image and its places at most.
    """
    device, rng, count = setting.torch_device, np.random.default_rng(0), setting.sizes.landmarks
    repetitions = setting.sizes.repetitions
    known = stored(unit_vectors(rng.standard_normal((_MAP * count, SIZE)).astype(np.float32)))
    points = np.stack([rng.permutation(len(known))[:count] for _ in range(_PLACES)])
    images = np.stack([_image(known, points[0], rng) for _ in range(_IMAGES)])
    on_device = torch.from_numpy(known).to(device)

    def by_numpy(image: Float32[np.ndarray, "f d"]) -> list[tuple[np.ndarray, np.ndarray]]:
        return [mutual_matches(image, restored(known[own]), _RATIO) for own in points]

    def by_torch(of: Float32[np.ndarray, "i f d"]) -> Int64[np.ndarray, "i p f"]:
        found = matched(torch.from_numpy(of).to(device), on_device, torch.from_numpy(points).to(device), _RATIO)
        return found.cpu().numpy()

    sizes = f"{_FEATURES} features, {_PLACES} places of {count} landmarks"
    yield timed(f"by numpy, {sizes}", lambda: by_numpy(images[0]), device, deadline, repetitions=repetitions)
    for number in (1, _IMAGES):
        of = images[:number]
        what = f"by torch on {setting.device}, {number} {'image' if number == 1 else 'images'}, copies included"
        yield timed(what, lambda of=of: by_torch(of), device, deadline, repetitions=repetitions)
    pairs, others = 0, 0
    for image, found in zip(images, by_torch(images), strict=True):
        for own, (features, landmarks) in zip(found, by_numpy(image), strict=True):
            expected = np.full(len(image), -1)
            expected[features] = landmarks
            pairs += len(features)
            others += int((own != expected).sum())
    share = others / max(pairs, 1)
    yield Finding("other matches than by numpy", 100.0 * share, "%", most=100.0 * _MOST_OTHER, note=f"of {pairs}")


def _image(
    known: Int8[np.ndarray, "m d"], place: Int64[np.ndarray, " p"], rng: np.random.Generator
) -> Float32[np.ndarray, "f d"]:
    """Descriptors of an image of which some features are landmarks of a place."""
    descriptors = rng.standard_normal((_FEATURES, SIZE)).astype(np.float32)
    shown = restored(known[place[:_SHOWN]])
    descriptors[: len(shown)] = shown + _NOISE * descriptors[: len(shown)]
    return unit_vectors(descriptors)


def matched(
    images: Float[Tensor, "i f d"], known: Int8[Tensor, "m d"], points: Int64[Tensor, "p k"], ratio: float
) -> Int64[Tensor, "i p f"]:
    """For each image, place and feature the landmark of the place that it matches, −1 for none, as `mutual_matches`.

    Args:
        images: Descriptors of the features, unit vectors.
        known: Descriptors of all landmarks, as stored; they stay on the device.
        points: The landmarks of each place, at least two.
        ratio: Greatest ratio of the distances of the nearest and second nearest.
    """
    likeness = images[:, None] @ (known[points].float() / 127.0).mT
    best, landmark = likeness.topk(2, dim=-1)
    distinct = 1.0 - best[..., 0] < ratio**2 * (1.0 - best[..., 1])
    nearest = landmark[..., 0]
    back = likeness.argmax(dim=-2).gather(-1, nearest)
    mutual = back == torch.arange(images.shape[-2], device=images.device)
    return torch.where(distinct & mutual, nearest, -1)
