"""Images that say nothing, and cameras that are frozen."""

import numpy as np
import pytest

from filtering.localizer import ParticleLocalizer
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import AHEAD, RNG, STAY, assert_same_belief, image_of, new_localizer, seen_at, walk


@pytest.mark.parametrize("nothing", [PosePosterior.nothing(), seen_at(Poses.identity(1), unfamiliarity=1.5)])
def test_an_image_that_says_nothing_leaves_the_belief_as_the_motion_alone_does(nothing):
    beliefs = []
    for seen in (None, nothing):
        localizer = new_localizer()
        walk(localizer, 20, shares=(0.6, 0.3), heights_m=(0.0, 3.0))
        beliefs.append(localizer.predict(AHEAD) if seen is None else localizer.update(seen, AHEAD))
    assert_same_belief(*beliefs, atol=0, rtol=0)
    for mode, other in zip(beliefs[0].modes, beliefs[1].modes, strict=True):
        np.testing.assert_array_equal(mode.covariance, other.covariance)
        assert mode.weight == other.weight


class Recording:
    """An observation model that knows where the camera is and counts the images it is shown."""

    def __init__(self):
        self.images = 0

    def observe(self, image, *, rng):
        self.images += 1
        return seen_at(Poses.exp(0.01 * self.images * np.eye(6)[:1]))


def test_an_image_that_equals_the_one_before_comes_from_a_frozen_camera_and_says_nothing():
    localizer = ParticleLocalizer(Recording(), rng=RNG(0))
    assert not localizer.observe(image_of(1)).says_nothing
    assert localizer.observe(image_of(1)).says_nothing
    assert not localizer.observe(image_of(2)).says_nothing
    assert not localizer.observe(image_of(1)).says_nothing


def test_a_frozen_camera_on_a_moving_robot_moves_the_belief_by_odometry_alone():
    frozen, moved = (ParticleLocalizer(Recording(), rng=RNG(0)) for _ in range(2))
    for localizer in (frozen, moved):
        for i in range(5):
            localizer.step(image_of(i), STAY)
    for _ in range(10):
        assert_same_belief(frozen.step(image_of(4), AHEAD), moved.predict(AHEAD), atol=0)
