import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.measurement_noise import MeasurementNoise


def test_an_error_is_as_wide_as_the_samples_times_the_spread_and_the_noise_floor_together():
    model = MeasurementNoise(spread=4.0, noise_floor=(0.1, 0.2, 0.3, 0.01, 0.02, 0.03))
    samples = np.diag([0.25, 0.5, 0.0, 1.0, 0.0, 0.0])[None]
    samples[0, 0, 1] = samples[0, 1, 0] = 0.1
    covariance = model.covariance(samples)[0]
    np.testing.assert_allclose(np.diag(covariance), [1.01, 2.04, 0.09, 4.0001, 0.0004, 0.0009])
    assert covariance[0, 1] == pytest.approx(0.4)


def test_what_no_number_of_images_takes_away_is_a_share_of_an_ordinary_images_error():
    model = MeasurementNoise(constant_fraction=0.25, typical_std=(0.1, 0.2, 0.4, 0.01, 0.02, 0.04))
    np.testing.assert_allclose(
        np.sqrt(np.diag(model.constant_covariance(np.zeros((6, 6))))), [0.05, 0.1, 0.2, 0.005, 0.01, 0.02]
    )


def test_the_variances_of_an_image_grow_with_twice_the_power_of_its_score():
    model = MeasurementNoise(ood_power=1.5, typical_ood_score=0.4)
    assert model.growth(0.4) == 1.0
    assert model.growth(0.8) == pytest.approx(8.0)
    assert model.growth(0.2) == pytest.approx(1 / 8)
    assert model.growth(0.01) == model.growth(0.05) > 0.0
    assert model.growth(0.0) == 1.0  # no score
    assert model.growth(np.inf) == model.growth(2.0) == model.growth(1.0)


def test_scaling_multiplies_lengths_and_scaling_back_gives_the_model_itself():
    model = MeasurementNoise(verified=MeasurementNoise(noise_floor=(0.01, 0.01, 0.02, 0.001, 0.001, 0.001)))
    scaled = model.scaled(1000.0)
    assert (scaled.radius_m, scaled.length_m) == (1000.0 * model.radius_m, 1000.0 * model.length_m)
    back = scaled.scaled(1e-3)
    for after, before in ((back, model), (back.verified, model.verified)):
        for name in vars(before).keys() - {"verified"}:
            np.testing.assert_allclose(getattr(after, name), getattr(before, name), rtol=1e-12)


@pytest.mark.parametrize("name", ["noise_floor", "typical_std"])
@pytest.mark.parametrize("bad", [0.0, -0.1, float("nan"), float("inf")])
def test_standard_deviations_that_are_none_are_refused(name, bad):
    with pytest.raises(VaporTrackError, match=rf"^{name} is .*, expected six positive numbers"):
        MeasurementNoise(**{name: (0.1, 0.1, bad, 0.1, 0.1, 0.1)})
