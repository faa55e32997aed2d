"""The prior of the training, divided out of the weights of places."""

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.measurement_noise import MeasurementNoise
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.training_prior import TrainingPrior

FLOOR_M = 3.0
NOISE = MeasurementNoise(radius_m=0.5, radius_rad=0.5, weight_power=1.0)


def along_a_corridor(count: int, height_m: float, rng: np.random.Generator) -> Poses:
    turned = np.zeros((count, 6))
    turned[:, 5] = rng.uniform(-0.5, 0.5, count)
    position = np.column_stack([rng.uniform(0.0, 10.0, count), np.zeros(count), np.full(count, height_m)])
    return Poses(Poses.exp(turned).rotation, position)


def of_two_floors(lower: int, upper: int) -> Poses:
    rng = np.random.default_rng(0)
    return Poses.concatenate([along_a_corridor(lower, 0.0, rng), along_a_corridor(upper, FLOOR_M, rng)])


def seen_on_both(lower: int, upper: int) -> Poses:
    """Samples around the same spot of either floor."""
    rng = np.random.default_rng(1)
    offsets = 0.05 * rng.standard_normal((lower + upper, 6))
    offsets[:, 0] += 5.0
    offsets[lower:, 2] += FLOOR_M
    return Poses.exp(offsets)


def test_a_floor_with_three_times_the_training_images_is_not_preferred():
    prior = TrainingPrior(of_two_floors(500, 1500), NOISE.radius_m, NOISE.radius_rad)
    samples = seen_on_both(100, 300)  # as the network has learned
    plain = PosePosterior.from_samples(samples, NOISE)
    divided = PosePosterior.from_samples(samples, NOISE, prior=prior)
    assert sorted(plain.weights) == pytest.approx([0.25, 0.75], abs=0.02)
    assert (divided.weights == plain.weights).all()  # the first image counts it once,
    assert sorted(divided.shares) == pytest.approx([0.25, 0.75], abs=0.02)
    assert divided.possible == pytest.approx([1.0, 1.0], abs=0.15)  # and what follows does not
    assert min(plain.possible) == pytest.approx(1 / 3, abs=0.03)


def test_what_the_image_itself_shows_remains():
    prior = TrainingPrior(of_two_floors(500, 1500), NOISE.radius_m, NOISE.radius_rad)
    clear = PosePosterior.from_samples(seen_on_both(300, 100), NOISE, prior=prior)
    assert min(clear.possible) == pytest.approx(1 / 9, abs=0.03)  # 3 to 1 against a prior of 1 to 3
    assert clear.means.translation[int(np.argmax(clear.possible)), 2] < 0.5 * FLOOR_M


def test_directions_count_as_positions_do():
    ahead, back = Poses.identity(90), Poses.exp(np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 3.0], (30, 1)))
    prior = TrainingPrior(Poses.concatenate([ahead, back]), NOISE.radius_m, NOISE.radius_rad)
    places = Poses.concatenate([ahead[:1], back[:1]])
    many, few = prior.density(places)
    assert many / few == pytest.approx(3.0, rel=1e-3)


def test_a_place_where_nothing_was_trained_counts_as_one_of_the_rarest_that_was():
    trained = of_two_floors(500, 1500)
    prior = TrainingPrior(trained, NOISE.radius_m, NOISE.radius_rad)
    nowhere, lower, upper = prior.density(
        Poses.exp(np.array([[5.0, 0, 50, 0, 0, 0], [5, 0, 0, 0, 0, 0], [5, 0, 3, 0, 0, 0]]))
    )
    assert 0.3 * lower < nowhere <= lower
    assert upper / lower == pytest.approx(3.0, rel=0.2)


def test_it_is_the_same_far_from_the_origin_and_at_any_scale():
    trained, places = of_two_floors(50, 150), seen_on_both(1, 1)
    here = TrainingPrior(trained, 0.5, 0.5).density(places)
    moved = [Poses(each.rotation, 1000.0 * each.translation + 1e6) for each in (trained, places)]
    assert TrainingPrior(moved[0], 500.0, 0.5).density(moved[1]) == pytest.approx(here, rel=1e-3)


def test_a_prior_of_no_pose_is_an_error():
    with pytest.raises(VaporTrackError, match="at least one pose"):
        TrainingPrior(Poses.identity(0), 0.5, 0.5)
