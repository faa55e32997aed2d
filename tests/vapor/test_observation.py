from dataclasses import replace

import numpy as np
import pytest
import torch

from filtering.errors import VaporTrackError
from filtering.localizer import ParticleLocalizer
from filtering.measurement_noise import MeasurementNoise
from filtering.posterior import PosePosterior
from filtering.training_prior import TrainingPrior
from tests.helpers.observing import CONFIG, IMAGE, observe, uncalibrated
from vapor.checkpoints.calibration import Calibration
from vapor.images import prepare
from vapor.observation import VaporObservationModel
from vapor.tensor_files import CheckpointError


def test_the_same_generator_gives_the_same_bits_and_another_one_others():
    first, again, other = observe(IMAGE), observe(IMAGE), observe(IMAGE, seed=1)
    np.testing.assert_array_equal(first.samples.as_matrix(), again.samples.as_matrix())
    assert np.abs(first.samples.translation - other.samples.translation).max() > 1e-4


def test_observing_draws_from_no_global_generator():
    torch_before, numpy_before = torch.get_rng_state(), np.random.get_state(legacy=False)["state"]["key"]  # noqa: NPY002
    observe(IMAGE)
    assert torch.equal(torch.get_rng_state(), torch_before)
    np.testing.assert_array_equal(np.random.get_state(legacy=False)["state"]["key"], numpy_before)  # noqa: NPY002


def test_samples_are_those_of_the_network_for_the_same_noise():
    noise = np.random.default_rng(0).standard_normal((50, 4), dtype=np.float32)
    small = np.full((40, 40, 3), 90, np.uint8)  # no scaling, and every crop alike
    network = uncalibrated().build_network()
    with torch.inference_mode():
        pixels = network.normalise(torch.full((1, 32, 32, 3), 90, dtype=torch.uint8))
        translation, _ = network(pixels, torch.from_numpy(noise)[None])
    np.testing.assert_allclose(observe(small).samples.translation, translation[0].numpy(), atol=1e-5)


def test_a_network_of_the_camera_s_aspect_sees_all_but_the_margin():
    config = replace(CONFIG, image_width=64, image_height=48, shortest_edge=50)
    assert config.frame_size == (67, 50)
    image = np.random.default_rng(0).integers(0, 256, (50, 67, 3), dtype=np.uint8)
    np.testing.assert_array_equal(prepare(image, config), image[1:49, 1:65])
    assert prepare(image[:20], config).shape == prepare(image[:, :20], config).shape == (48, 64, 3)


def test_only_the_centre_of_the_image_matters():
    wide = np.zeros((40, 120, 3), np.uint8)
    wide[:, 40:80] = IMAGE[:40, :40]
    other = wide.copy()
    other[:, :40] = 255
    other[:, 80:] = 17
    np.testing.assert_array_equal(observe(wide).samples.translation, observe(other).samples.translation)
    other[20, 60] = 255 - other[20, 60]
    assert (observe(wide).samples.translation != observe(other).samples.translation).any()


@pytest.mark.parametrize("shape", [(30, 45, 3), (480, 640, 3), (64, 48, 3)])
def test_images_of_any_size_and_aspect_are_taken(shape):
    assert observe(np.full(shape, 128, np.uint8)).samples.is_finite().all()


@pytest.mark.parametrize(
    ("shape", "dtype"),
    [((40, 40), np.uint8), ((40, 40, 4), np.uint8), ((40, 40, 3), np.float64), ((0, 9, 3), np.uint8)],
)
def test_what_is_no_rgb_image_is_refused(shape, dtype):
    with pytest.raises(VaporTrackError, match=r"expected \(H, W, 3\) uint8 RGB"):
        observe(np.zeros(shape, dtype))


def test_the_calibration_says_what_is_a_place_and_how_it_errs():
    noise = MeasurementNoise(radius_m=0.8, radius_rad=0.6, spread=1.5, noise_floor=(0.1, 0.2, 0.3, 0.01, 0.02, 0.03))
    checkpoint = replace(uncalibrated(), calibration=Calibration(errors=noise))
    posterior = observe(IMAGE, model=VaporObservationModel(checkpoint, num_samples=50, device="cpu"))
    expected = PosePosterior.from_samples(
        observe(IMAGE).samples, noise, prior=TrainingPrior(checkpoint.prior_poses, 0.8, 0.6)
    )
    np.testing.assert_array_equal(posterior.means.as_matrix(), expected.means.as_matrix())
    np.testing.assert_array_equal(posterior.covariances, expected.covariances)
    np.testing.assert_array_equal(posterior.weights, expected.weights)
    assert (posterior.noise, posterior.ood_score) == (noise, 0.0)


def test_unknown_models_and_absent_devices_are_refused():
    with pytest.raises(CheckpointError, match="atrium: no such model"):
        VaporObservationModel.from_checkpoint("atrium")
    with pytest.raises(VaporTrackError, match="num_samples is 0"):
        VaporObservationModel(uncalibrated(), num_samples=0)
    if not torch.cuda.is_available():
        with pytest.raises(VaporTrackError, match="no CUDA device"):
            VaporObservationModel(uncalibrated(), device="cuda")


def test_a_network_that_yields_nan_is_an_error_and_no_estimate():
    checkpoint = uncalibrated()
    state = {name: torch.full_like(value, float("nan")) if value.is_floating_point() else value
             for name, value in checkpoint.state_dict.items()}  # fmt: skip
    model = VaporObservationModel(replace(checkpoint, state_dict=state), num_samples=50, device="cpu")
    localizer = ParticleLocalizer(model, rng=np.random.default_rng(0))
    with pytest.raises(VaporTrackError, match="samples 0 of 50 is not finite"):
        localizer.step(IMAGE, None)
