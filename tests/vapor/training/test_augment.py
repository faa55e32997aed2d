import itertools
import threading
from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.helpers.tiny_training import STILL
from vapor.training.augment import draw_variation, jitter_and_normalise, one_ahead, random_crops


def _cropped(images, indices, width, height, config, shrunk=None):
    spare = images.shape[1] - height, images.shape[2] - width
    variation = draw_variation(config, len(indices), spare, rng=np.random.default_rng(0))
    return random_crops(images, indices, variation, (width, height), shrunk)


def _jittered(images, config):
    mean, std = torch.tensor([100.0, 110.0, 120.0]), torch.tensor([50.0, 60.0, 70.0])
    variation = draw_variation(config, len(images), (0, 0), rng=np.random.default_rng(0))
    normalised = jitter_and_normalise(torch.from_numpy(images), mean, std, variation)
    return normalised * std[:, None, None] + mean[:, None, None]


def test_without_augmentation_images_are_only_cropped_and_normalised():
    images = np.random.default_rng(0).integers(0, 256, (3, 16, 16, 3), dtype=np.uint8)
    crops = _cropped(images, np.arange(3), 16, 16, STILL)
    np.testing.assert_array_equal(crops, images)
    np.testing.assert_allclose(_jittered(crops, STILL).permute(0, 2, 3, 1), images, atol=1e-3)


def test_every_crop_is_a_part_of_its_image_and_all_offsets_occur():
    rows, columns = np.mgrid[:8, :10].astype(np.uint8)
    images = np.stack([np.stack([rows, columns, np.full_like(rows, i)], axis=-1) for i in range(4)])
    indices = np.arange(400) % 4
    crops = _cropped(images, indices, 7, 6, STILL)
    np.testing.assert_array_equal(crops[:, 0, 0, 2], indices)
    np.testing.assert_array_equal(crops[:, :, :, :2] - crops[:, :1, :1, :2], images[:1, :6, :7, :2].repeat(400, axis=0))
    assert {tuple(c) for c in crops[:, 0, 0, :2].tolist()} == set(itertools.product(range(3), range(4)))


def test_small_images_are_the_means_of_what_larger_ones_would_show():
    images = np.random.default_rng(0).integers(0, 256, (3, 18, 26, 3), dtype=np.uint8)
    indices = np.arange(12) % 3
    whole = _cropped(images, indices, 24, 16, STILL).astype(float)
    means = whole.reshape(12, 8, 2, 12, 2, 3).mean(axis=(2, 4))
    np.testing.assert_allclose(_cropped(images, indices, 24, 16, STILL, (12, 8)), means, atol=0.51)


def test_some_images_of_a_batch_vary_as_they_would_in_the_whole():
    rows = np.array([1, 4])
    config = replace(STILL, contrast=0.5, light=0.2)
    variation = draw_variation(config, 6, (3, 5), rng=np.random.default_rng(0))
    images = np.random.default_rng(1).integers(0, 256, (6, 9, 12, 3), dtype=np.uint8)
    found = []
    for indices, drawn in ((np.arange(6), variation), (rows, variation[rows])):
        crops = random_crops(images, indices, drawn, (7, 6))
        found.append(jitter_and_normalise(torch.from_numpy(crops), torch.zeros(3), torch.ones(3), drawn))
    torch.testing.assert_close(found[1], found[0][rows])


def test_blur_touches_its_share_of_the_images_and_keeps_their_mean():
    images = np.random.default_rng(0).integers(0, 256, (1, 32, 32, 3), dtype=np.uint8)
    config = replace(STILL, blur_probability=0.3, blur_sigma_px=2.0)
    crops = _cropped(images, np.zeros(500, np.int64), 32, 32, config)
    blurred = (crops != images[0]).any(axis=(1, 2, 3))
    assert blurred.mean() == pytest.approx(0.3, abs=0.06)  # three standard deviations of 500 draws
    assert crops[blurred].mean() == pytest.approx(images.mean(), abs=1.0)
    assert crops[blurred].std() < 0.5 * images.std()


def test_uneven_light_is_smooth_and_as_strong_as_configured():
    images = np.full((400, 30, 40, 3), 100, np.uint8)
    factors = _jittered(images, replace(STILL, light=0.2)).permute(0, 2, 3, 1) / 100.0
    corners = factors[:, [0, 0, -1, -1], [0, -1, 0, -1], 0].log()
    assert float(corners.std()) == pytest.approx(0.2, abs=0.02)  # five standard deviations of 1600 draws
    assert np.corrcoef(corners.numpy().T)[0, 3] == pytest.approx(0.0, abs=0.2)
    torch.testing.assert_close(factors[..., 0], factors[..., 2])
    assert float((factors[:, 1:] - factors[:, :-1]).abs().max()) < 0.1
    brightest = _jittered(np.full_like(images, 255), replace(STILL, light=0.2))
    assert float(brightest.max()) <= 255.01


def test_brightness_scales_contrast_turns_about_the_mean_and_saturation_keeps_grey():
    images = np.random.default_rng(0).integers(60, 120, (64, 32, 32, 3), dtype=np.uint8)
    x = torch.from_numpy(images).permute(0, 3, 1, 2).float()
    ratio = _jittered(images, replace(STILL, brightness=0.3)) / x
    factors = ratio.mean(dim=(1, 2, 3))
    torch.testing.assert_close(ratio, factors[:, None, None, None].expand_as(ratio))
    assert factors.min() < 0.8
    assert factors.max() > 1.2
    assert ((factors > 0.7) & (factors < 1.3)).all()

    contrasted = _jittered(images, replace(STILL, contrast=0.5))
    spread = contrasted.std(dim=(1, 2, 3)) / x.std(dim=(1, 2, 3))
    assert spread.max() - spread.min() > 0.5
    assert (contrasted.mean(dim=(1, 2, 3)) - x.mean(dim=(1, 2, 3))).abs().max() < 3.0  # the mean is of a sixteenth

    luma = torch.tensor([0.299, 0.587, 0.114])[:, None, None]
    saturated = _jittered(images, replace(STILL, saturation=0.5))
    torch.testing.assert_close((saturated * luma).sum(1), (x * luma).sum(1), atol=1e-3, rtol=0)
    assert (saturated - x).abs().max() > 5.0


def test_results_come_in_order_and_one_is_made_while_the_one_before_is_used():
    begun, items = [], iter(range(5))
    second = threading.Event()

    def double(item):
        begun.append(item)
        if item == 1:
            second.set()
        return 2 * item

    results = one_ahead(double, items)
    assert next(results) == 0
    assert second.wait(5.0)  # nobody asked for it yet
    assert 2 not in begun
    assert next(items) == 2  # no more than that was looked at
    assert list(results) == [2, 6, 8]


def test_an_error_is_raised_where_its_result_would_have_come():
    results = one_ahead(lambda item: 1 / item, [2, 1, 0, 4])
    assert [next(results), next(results)] == [0.5, 1.0]
    with pytest.raises(ZeroDivisionError):
        next(results)
