"""The most probable trajectory: it changes its place only where the camera was carried off."""

import numpy as np
import pytest

from filtering.config import GapConfig
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import Odometry
from filtering.se3 import Poses
from filtering.trajectory_search import SearchStep, most_probable_path
from tests.helpers.simulation import lifted, seen_at

STOREYS = (0.0, 3.0)
STD = (0.02, 0.02, 0.02, 0.01, 0.01, 0.01)
# Landmarks are known to centimetres, what the network says alone to metres.
NOISE = MeasurementNoise(typical_std=(3.0, 3.0, 3.0, 0.05, 0.05, 0.05), verified=MeasurementNoise(typical_std=STD))
STILL = Odometry(Poses.identity(), np.diag([1e-4] * 3 + [1e-5] * 3), 0.2)
PLACES = lifted(Poses.identity(), STOREYS)


def step_of(shares, hypotheses):
    """An image that shows both storeys, and on which of them the filter has hypotheses after it."""
    seen = seen_at(PLACES, shares, noise=NOISE, std=np.array(STD))
    weights = np.full(len(hypotheses), 1 / len(hypotheses))
    return SearchStep(seen, STILL, 0.2, 1.0, 10.0, PLACES[np.array(hypotheses)], weights)


@pytest.mark.parametrize("end", [0, 1])
def test_a_storey_on_which_the_filter_lacks_a_hypothesis_for_an_image_is_kept(end):
    """Its other hypotheses are metres away: they are no part of this place."""
    shares = [(0.7, 0.3)] * 3 + [(0.3, 0.7)] * 4
    known = [(0, 1)] * 3 + [(1 - end,)] + [(0, 1)] * 3
    steps = [step_of(*each) for each in zip(shares, known, strict=True)]
    path = most_probable_path(steps, PLACES[end], NOISE, 1e-6, GapConfig())
    assert not path.carried_off.any()
    np.testing.assert_allclose(path.poses.translation[:, 2], STOREYS[end], atol=0.1)


def test_a_camera_that_is_carried_off_to_another_storey_is_seen_to_be():
    steps = [step_of(shares, (0, 1)) for shares in [(1.0, 0.0)] * 20 + [(0.0, 1.0)] * 20]
    path = most_probable_path(steps, PLACES[1], NOISE, 1e-3, GapConfig())
    assert np.flatnonzero(path.carried_off).tolist() == [20]
    np.testing.assert_allclose(path.poses.translation[:, 2], np.repeat(STOREYS, 20), atol=0.1)
