"""Reliability diagrams."""

import numpy as np
import pytest

from vapor.evaluation.reliability import Reliability


def test_images_are_counted_by_what_was_stated_and_the_error_is_the_distance_from_the_diagonal():
    found = Reliability.of(np.array([0.55, 0.55, 0.95, 1.0]), np.array([True, False, True, True]), worth=0.5)
    half, sure = found.bins
    assert (half.low, half.high, half.images, half.effective_images) == (0.5, 0.6, 2, 1.0)
    assert (half.stated, half.right) == (pytest.approx(0.55), 0.5)
    assert (sure.low, sure.images, sure.stated, sure.right) == (0.9, 2, pytest.approx(0.975), 1.0)
    assert found.expected_error == pytest.approx(0.5 * 0.05 + 0.5 * 0.025)
