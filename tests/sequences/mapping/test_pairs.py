"""Which images are compared."""

import numpy as np

from sequences.mapping.pairs import image_pairs, image_vectors


def descriptors_of(place: int, rng: np.random.Generator) -> np.ndarray:
    """Features of a place, noisy."""
    true = np.random.default_rng(1000 + place).integers(0, 200, (80, 128))
    return np.clip(true + rng.integers(-5, 6, true.shape), 0, 255).astype(np.uint8)


def test_of_few_images_all_pairs_are_compared():
    none = [np.zeros((0, 128), np.uint8)] * 7
    pairs = image_pairs([3, 4], none, np.random.default_rng(0))
    assert pairs == [(a, b) for a in range(7) for b in range(a + 1, 7)]


def test_of_many_those_near_in_time_and_those_that_look_alike_are_compared():
    """Two walks past 75 places, the second one the other way round."""
    rng = np.random.default_rng(0)
    places = [*range(75), *reversed(range(75))]
    pairs = image_pairs([75, 75], [descriptors_of(place, rng) for place in places], np.random.default_rng(0))
    assert {(a, a + 10) for a in range(65)} <= {*pairs}
    assert {(a, 149 - a) for a in range(75)} <= {*pairs}
    assert len(pairs) < 0.45 * 150 * 149 / 2
    assert pairs == sorted(pairs)
    assert all(a < b for a, b in pairs)


def test_images_without_features_are_like_none():
    rng = np.random.default_rng(0)
    images = [descriptors_of(place, rng) for place in [*range(10), *range(10)]]
    vectors = image_vectors([*images, np.zeros((0, 128), np.uint8)], rng)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), [1] * 20 + [0], atol=1e-5)
    alike = vectors[:10] @ vectors[10:20].T
    np.testing.assert_array_equal(np.argmax(alike, axis=1), np.arange(10))
