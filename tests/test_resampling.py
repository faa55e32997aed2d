import numpy as np
import pytest
from filterpy.monte_carlo import systematic_resample

from filtering.errors import VaporTrackError
from filtering.particles import Particles
from filtering.resampling import multinomial, stratified, systematic
from filtering.se3 import Poses

SCHEMES = [systematic, stratified, multinomial]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_scheme_is_unbiased(scheme):
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(7))
    counts = sum(np.bincount(scheme(weights, 20, rng=rng), minlength=7) for _ in range(4000)) / 4000
    np.testing.assert_allclose(counts, 20 * weights, atol=0.12)  # at most 4 standard errors of multinomial draws


@pytest.mark.parametrize("scheme", SCHEMES)
def test_zero_weight_particles_are_never_drawn(scheme):
    weights = np.array([0.0, 0.3, 0.0, 0.7, 0.0])
    drawn = np.concatenate([scheme(weights, 50, rng=np.random.default_rng(s)) for s in range(200)])
    assert set(drawn) == {1, 3}


def test_systematic_gives_each_index_its_share_rounded_down_or_up():
    weights = np.random.default_rng(1).dirichlet(np.ones(30))
    counts = np.bincount(systematic(weights, 100, rng=np.random.default_rng(2)), minlength=30)
    assert (np.abs(counts - 100 * weights) < 1).all()


def test_systematic_agrees_with_filterpy_for_the_same_offset(monkeypatch):
    weights = np.random.default_rng(3).dirichlet(np.ones(64))
    monkeypatch.setattr("filterpy.monte_carlo.resampling.random", lambda: np.random.default_rng(4).random())
    theirs = systematic_resample(weights)
    np.testing.assert_array_equal(systematic(weights, 64, rng=np.random.default_rng(4)), theirs)


WEIGHTS = [
    np.random.default_rng(5).dirichlet(np.ones(8)),
    np.random.default_rng(6).dirichlet(np.full(8, 0.1)),  # a few hold nearly all
    np.full(8, 1 / 8),
    np.eye(8)[1],
    np.array([1e-300, 1 - 2e-16, 1e-17, 0.0, 0.0, 1e-300, 1e-12, 1e-8]),
]


@pytest.mark.parametrize("weights", WEIGHTS)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_counts_have_the_mean_of_filterpys_systematic_ones_and_no_scheme_but_the_independent_a_larger_variance(
    scheme, weights, monkeypatch
):
    """filterpy's draws from the same number of offsets: means agree within 4 standard errors of the binomial, for the
    systematic scheme every count is ⌊nw⌋ or ⌈nw⌉ and has filterpy's variance too."""
    n, repeats, rng = len(weights), 4000, np.random.default_rng(7)
    monkeypatch.setattr("filterpy.monte_carlo.resampling.random", lambda: rng.random())
    theirs = np.array([np.bincount(systematic_resample(weights), minlength=n) for _ in range(repeats)])
    counts = np.array([np.bincount(scheme(weights, n, rng=rng), minlength=n) for _ in range(repeats)])
    binomial = n * weights * (1 - weights)
    error = 4 * np.sqrt(2 * np.maximum(binomial, 0.0) / repeats) + 1e-3
    assert (np.abs(counts.mean(axis=0) - theirs.mean(axis=0)) < error).all()
    assert (counts.sum(axis=1) == n).all()
    fraction = n * weights % 1
    least_variance = fraction * (1 - fraction)
    if scheme is systematic:
        assert (np.abs(counts - n * weights) < 1 + 1e-9).all()
        for drawn in (counts, theirs):
            np.testing.assert_allclose(drawn.var(axis=0), least_variance, atol=0.02)
    elif scheme is multinomial:
        np.testing.assert_allclose(counts.var(axis=0), binomial, rtol=0.15, atol=0.02)
    else:
        assert (counts.var(axis=0) <= 1.15 * binomial + 0.02).all()


@pytest.mark.parametrize("weights", [[np.nan, 1.0], [-0.1, 1.1], [0.0, 0.0], [np.inf, 1.0]])
def test_weights_that_are_none_are_refused(weights):
    with pytest.raises(VaporTrackError, match="resampling weights"):
        systematic(np.array(weights), 5, rng=np.random.default_rng(0))


def test_effective_sample_size_spans_one_to_n():
    equal, _ = Particles.from_unnormalised(Poses.identity(8), np.zeros(8))
    assert equal.effective_sample_size == pytest.approx(8.0)
    one = np.full(8, -np.inf)
    one[3] = 5.0
    single, evidence = Particles.from_unnormalised(Poses.identity(8), one)
    assert single.effective_sample_size == pytest.approx(1.0)
    assert evidence == pytest.approx(5.0 - np.log(8))


@pytest.mark.parametrize(("bad", "message"), [(np.nan, "particle 2 is nan"), (np.inf, "particle 2 is inf")])
def test_weights_that_are_not_finite_are_refused_and_named(bad, message):
    log_weights = np.zeros(5)
    log_weights[2] = bad
    with pytest.raises(VaporTrackError, match=message):
        Particles.from_unnormalised(Poses.identity(5), log_weights)


def test_all_zero_weights_are_refused():
    with pytest.raises(VaporTrackError, match="all 4 particle weights are zero"):
        Particles.from_unnormalised(Poses.identity(4), np.full(4, -np.inf))
