from dataclasses import replace

import numpy as np
import pytest

from filtering.density import KernelDensity
from filtering.errors import VaporTrackError
from filtering.posterior import LikelihoodModel, PosteriorSamples
from filtering.se3 import Poses


def test_the_prior_divides_the_posterior():
    """A place with twice the training poses is no likelier when the posterior merely repeats that."""
    twice_as_dense = Poses(np.eye(3)[None].repeat(3, 0), np.array([[0.0, 0, 0], [0.01, 0, 0], [9.0, 0, 0]]))
    prior = KernelDensity(twice_as_dense, 0.2, 0.2)
    places = twice_as_dense[[0, 2]]
    with_prior = PosteriorSamples(prior, LikelihoodModel(prior, 0.05, 1.0, 1e-9)).log_likelihood(places)
    assert with_prior[0] == pytest.approx(with_prior[1], abs=1e-3)
    without = PosteriorSamples(prior, LikelihoodModel(None, 0.05, 1.0, 1e-9)).log_likelihood(places)
    assert without[0] - without[1] == pytest.approx(np.log(2), abs=0.01)


def test_the_outlier_floor_bounds_the_likelihood_from_below_and_the_temper_scales_it():
    posterior = KernelDensity(Poses.identity(1), 0.1, 0.1)
    nowhere = Poses(np.eye(3)[None], np.array([[50.0, 0, 0]]))
    sharp = PosteriorSamples(posterior, LikelihoodModel(None, 0.05, 1.0, 1e-4))
    soft = PosteriorSamples(posterior, LikelihoodModel(None, 0.05, 0.3, 1e-4))
    assert sharp.log_likelihood(nowhere)[0] == pytest.approx(0.0, abs=1e-9)
    here = Poses.identity(1)
    assert soft.log_likelihood(here)[0] == pytest.approx(0.3 * sharp.log_likelihood(here)[0])


def test_another_likelihood_of_the_same_posterior_is_its_own():
    at = Poses.identity(3)
    first = PosteriorSamples(KernelDensity(at, 0.1, 0.1), LikelihoodModel(prior_floor=1e-4))
    second = replace(first, likelihood=LikelihoodModel(prior_floor=1e-2))
    assert first.log_likelihood(at)[0] != second.log_likelihood(at)[0]


@pytest.mark.parametrize("bad", [{"outlier_floor": 0.0}, {"temper": -1.0}, {"preference": 2.0}, {"detail_floor": 0.0}])
def test_a_likelihood_of_impossible_settings_is_refused(bad):
    with pytest.raises(VaporTrackError, match=next(iter(bad))):
        LikelihoodModel(**bad)
