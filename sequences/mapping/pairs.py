"""Which pairs of images are compared: all of few, of many those near in time and those that look alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, UInt8
from scipy.cluster.vq import kmeans2

_FEW = 100  # images of which all pairs are compared
_NEIGHBOURS = 10  # images behind each one of its walk that it is compared with
_ALIKE = 10  # images that look most like one: so many of its walk, and so many of all others
_WORDS, _SAMPLE = 64, 20_000  # clusters of descriptors, and descriptors that they are found by


def image_pairs(
    counts: Sequence[int], descriptors: Sequence[UInt8[np.ndarray, "k d"]], rng: np.random.Generator
) -> list[tuple[int, int]]:
    """Pairs of images, each the lower index first, in order.

    Args:
        counts: How many images each walk has, n in all.
        descriptors: Of the features of each image, n.
        rng: Of the clusters by which images are compared.
    """
    total = sum(counts)
    if total <= _FEW:
        return [(a, b) for a in range(total) for b in range(a + 1, total)]
    walk = np.repeat(np.arange(len(counts)), counts)
    chosen = {(a, b) for a in range(total) for b in range(a + 1, min(a + 1 + _NEIGHBOURS, total)) if walk[a] == walk[b]}
    vectors = image_vectors(descriptors, rng)
    alike = vectors @ vectors.T
    indices = np.arange(total)
    for image in range(total):
        near = (walk == walk[image]) & (np.abs(indices - image) <= _NEIGHBOURS)
        for others in (walk == walk[image], walk != walk[image]):
            candidates = np.flatnonzero(others & ~near)
            best = candidates[np.argsort(-alike[image, candidates], kind="stable")[:_ALIKE]]
            chosen |= {(min(image, int(other)), max(image, int(other))) for other in best}
    return sorted(chosen)


def image_vectors(
    descriptors: Sequence[UInt8[np.ndarray, "k d"]], rng: np.random.Generator
) -> Float32[np.ndarray, "n v"]:
    """Unit vectors, (n, v), of images whose features are alike: VLAD (Jégou et al., CVPR 2010).

    Each is the sum of the differences between the features and the cluster next to each, after the square root of its
    size. Images without features have zeros.
    """
    every = np.concatenate([*descriptors]).astype(np.float32)
    if len(every) < _WORDS:
        return np.zeros((len(descriptors), 1), np.float32)
    sample = every[rng.choice(len(every), min(_SAMPLE, len(every)), replace=False)]
    words = kmeans2(sample, _WORDS, iter=10, minit="points", rng=rng)[0].astype(np.float32)
    vectors = np.zeros((len(descriptors), words.size), np.float32)
    for vector, features in zip(vectors, descriptors, strict=True):
        features = features.astype(np.float32)
        nearest = np.argmin((words**2).sum(axis=1) - 2.0 * features @ words.T, axis=1)
        sums = np.zeros_like(words)
        np.add.at(sums, nearest, features - words[nearest])
        vector[:] = (np.sign(sums) * np.sqrt(np.abs(sums))).ravel()
        vector /= max(float(np.linalg.norm(vector)), 1e-9)
    return vectors
