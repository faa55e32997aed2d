"""What is said of images that a model does not recognise."""

from collections.abc import Callable

import numpy as np
import pytest

from vapor.pipeline.unrecognised import are_unrecognised, why_unrecognised

SCENE = np.random.default_rng(3).integers(60, 180, (12, 12, 3)).astype(np.uint8)
SCENE[..., 0] += 60  # reddish


def unlike_the_scene(image: np.ndarray, camera: object) -> float:
    """Stands for a network to which an image has the higher a score the more it differs from one scene."""
    return 0.3 + float(np.abs(image / 255.0 - SCENE / 255.0).mean()) * 5.0


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (lambda image: image[..., ::-1], "only when red and blue are swapped"),
        (lambda image: np.rot90(image, 2), "only when turned by 180° (a camera mounted upside down)"),
        (lambda image: np.rot90(image, 1), "only when turned by 90° to the right"),
        (lambda image: np.rot90(image, -1), "only when turned by 90° to the left"),
        (lambda image: image[:, ::-1], "only when mirrored"),
        (lambda image: 255 - image, "only when their brightness is inverted"),
        (lambda image: image // 4, "only when brightened"),
        (lambda image: np.repeat(image[..., 1:2], 3, axis=2), "images are grey"),
        (lambda image: np.roll(image, 5, axis=0), "unlike all that the model learned from"),
        (lambda image: image, "`vapor-track inspect`"),
    ],
)
def test_the_change_that_makes_images_familiar_is_named(fault: Callable[[np.ndarray], np.ndarray], said: str):
    images = [(np.ascontiguousarray(fault(SCENE)), None)] * 3
    assert said in why_unrecognised(images, unlike_the_scene)


def test_a_change_that_makes_another_place_only_a_little_less_unlike_explains_nothing():
    def of_another_place(image: np.ndarray, camera: object) -> float:
        return 1.5 if image[0, 0, 0] < SCENE[0, 0, 0] else 2.2

    assert 255 - SCENE[0, 0, 0] < SCENE[0, 0, 0]
    said = why_unrecognised([(SCENE, None)] * 3, of_another_place)
    assert said.startswith("images look unlike all that the model learned from: another place")


@pytest.mark.parametrize("verifies", [False, True])
def test_landmarks_must_agree_with_a_change_that_is_named(verifies: bool):
    turned = np.ascontiguousarray(np.rot90(SCENE, 2))

    def is_verified(image: np.ndarray, camera: object) -> bool:
        return verifies and np.array_equal(image, SCENE)

    said = why_unrecognised([(turned, None)] * 3, unlike_the_scene, is_verified)
    assert ("only when turned by 180°" in said) == verifies


def test_images_are_unrecognised_where_many_are_lost_and_few_converge():
    assert are_unrecognised(("lost",) * 6 + ("ambiguous",) * 14)
    assert not are_unrecognised(("lost",) * 5 + ("ambiguous",) * 15)
    assert not are_unrecognised(("lost",) * 18 + ("converged",) * 2)
