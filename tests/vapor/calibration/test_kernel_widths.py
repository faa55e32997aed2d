"""Kernel widths, found from samples of known spread."""

import numpy as np
import pytest

from filtering.se3 import Poses
from tests.helpers.erring_posteriors import anywhere
from vapor.calibration.calibrate import fit_widths

pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.mark.parametrize(("spread_m", "spread_rad"), [(0.2, 0.05), (0.05, 0.15)])
def test_the_scale_of_the_kernels_is_found_from_samples_of_known_spread(spread_m, spread_rad):
    rng = np.random.default_rng(0)
    std = np.repeat([spread_m, spread_rad], 3)
    truth = anywhere(300, rng=rng)
    # As of a calibrated posterior: the truth lies in the samples as any other draw would.
    centres = truth @ Poses.exp(rng.standard_normal((300, 6)) * std)
    samples = [centres[i] @ Poses.exp(rng.standard_normal((200, 6)) * std) for i in range(300)]
    (width_m, width_rad), change = fit_widths(samples, truth, truth, (0.1, 0.1))
    # Of 200 samples in six dimensions the best kernel is narrower than the posterior: Silverman's factor is 0.55.
    assert 0.35 * spread_m < width_m < 0.9 * spread_m
    assert 0.35 * spread_rad < width_rad < 0.9 * spread_rad
    assert change.after == {"bandwidth_translation_m": width_m, "bandwidth_rotation_rad": width_rad}
    assert change.gain is not None
    assert change.gain >= -1e-4


def test_kernels_of_a_single_sample_get_exactly_the_spread_of_its_error():
    rng = np.random.default_rng(1)
    truth = anywhere(500, rng=rng)
    samples = [truth[[i]] @ Poses.exp(rng.standard_normal((1, 6)) * np.repeat([0.1, 0.04], 3)) for i in range(500)]
    width_m, width_rad = fit_widths(samples, truth, truth, (0.1, 0.1))[0]
    assert width_m == pytest.approx(0.1, rel=0.08)
    assert width_rad == pytest.approx(0.04, rel=0.08)
