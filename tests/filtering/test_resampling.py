import numpy as np
import pytest
from filterpy.monte_carlo import systematic_resample
from hypothesis import given, settings
from hypothesis import strategies as st

from filtering.resampling import heaviest, optimal_resample, systematic

WEIGHTS = [
    np.random.default_rng(5).dirichlet(np.ones(8)),
    np.random.default_rng(6).dirichlet(np.full(8, 0.1)),  # a few hold nearly all
    np.full(8, 1 / 8),
    np.eye(8)[1],
    np.array([1e-300, 1 - 2e-16, 1e-17, 0.0, 0.0, 1e-300, 1e-12, 1e-8]),
]


def log(weights):
    with np.errstate(divide="ignore"):
        return np.log(weights)


@pytest.mark.parametrize("weights", WEIGHTS)
def test_systematic_gives_each_index_its_share_rounded_down_or_up_whatever_the_weights_add_up_to(weights):
    for total in (1.0, 1e-9, 7.0):
        counts = np.bincount(systematic(total * weights, 100, rng=np.random.default_rng(2)), minlength=8)
        assert (np.abs(counts - 100 * weights) < 1 + 1e-9).all()


def test_systematic_agrees_with_filterpy_for_the_same_offset(monkeypatch):
    weights = np.random.default_rng(3).dirichlet(np.ones(64))
    monkeypatch.setattr("filterpy.monte_carlo.resampling.random", lambda: np.random.default_rng(4).random())
    theirs = systematic_resample(weights)
    np.testing.assert_array_equal(systematic(weights, 64, rng=np.random.default_rng(4)), theirs)


@settings(max_examples=200)
@given(
    size=st.integers(2, 60),
    kept=st.floats(0.0, 1.0),
    concentration=st.sampled_from([0.02, 0.1, 1.0, 100.0]),
    seed=st.integers(0, 10_000),
)
def test_thinning_out_keeps_exactly_as_many_as_asked_each_once_and_the_sum_of_weights(size, kept, concentration, seed):
    rng = np.random.default_rng(seed)
    count = 1 + int(kept * (size - 2))
    weights = rng.dirichlet(np.full(size, concentration)) + 1e-12
    weights /= weights.sum()
    index, log_weights = optimal_resample(np.log(weights), count, rng=rng)
    assert len(index) == len(log_weights) == count
    assert len(set(index)) == count
    assert np.exp(log_weights).sum() == pytest.approx(1.0)
    lightest = np.exp(log_weights.min())
    heavy = np.flatnonzero(weights > lightest * (1 + 1e-9))
    assert set(heavy) <= set(index)  # what is above the threshold is kept,
    own = np.isin(index, heavy)
    np.testing.assert_allclose(np.exp(log_weights[own]), weights[index[own]])  # with its weight,
    np.testing.assert_allclose(np.exp(log_weights[~own]), lightest)  # and the others all weigh the same


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("weights", [*WEIGHTS[:3], np.array([0.4, 0.3, 0.1, 0.1, 0.05, 0.03, 0.015, 0.005])])
@pytest.mark.parametrize("count", [1, 3, 7])
def test_the_expected_weight_of_each_is_what_it_was(weights, count):
    rng, repeats = np.random.default_rng(7), 4000
    after = np.zeros((repeats, len(weights)))
    for row in after:
        index, log_weights = optimal_resample(np.log(weights), count, rng=rng)
        row[index] = np.exp(log_weights)
    error = 4 * after.std(axis=0) / np.sqrt(repeats) + 1e-3 * weights.max()
    assert (np.abs(after.mean(axis=0) - weights) <= error + 1e-12).all()


def test_what_weighs_nothing_is_never_kept_while_enough_else_is_there():
    weights = np.array([0.0, 0.6, 0.0, 0.3, 0.1])
    for seed in range(50):
        index, _ = optimal_resample(log(weights), 2, rng=np.random.default_rng(seed))
        assert set(index) <= {1, 3, 4}


def test_the_heaviest_are_kept_with_their_weights():
    weights = np.array([0.1, 0.4, 0.05, 0.3, 0.15])
    kept, log_weights = heaviest(np.log(weights), 3, rng=np.random.default_rng(0))
    assert kept.tolist() == [1, 3, 4]
    np.testing.assert_allclose(np.exp(log_weights), weights[kept])
