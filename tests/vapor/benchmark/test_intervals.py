"""Intervals over walks: runs that are cut from one walk are no independent witnesses."""

import numpy as np
import pytest

from vapor.benchmark.figures import Walks, dissent, spread

RNG = np.random.default_rng


def each_times(count, values):
    return [value for value in values for _ in range(count)]


def test_the_interval_of_a_mean_is_as_wide_as_that_of_independent_walks_though_runs_are_many():
    rng = RNG(0)
    of_walk = rng.standard_normal(60).tolist()
    few, many = Walks(range(60)), Walks(each_times(5, range(60)))
    _, low, high = few.mean(of_walk)
    assert (high - low) / 2 == pytest.approx(1.96 * np.std(of_walk) / np.sqrt(60), rel=0.1)
    assert many.mean(each_times(5, of_walk)) == pytest.approx(few.mean(of_walk))  # copies add nothing
    assert many.count == 60


def test_intervals_hold_the_truth_in_about_95_of_100_samples():
    rng = RNG(1)
    held = 0
    for _ in range(200):
        shares = rng.beta(8, 2, size=(40, 1))
        _, low, high = Walks(each_times(3, range(40))).mean((rng.random((40, 3)) < shares).ravel().tolist())
        held += low <= 0.8 <= high
    assert 0.89 <= held / 200 <= 0.99


def test_the_median_is_that_of_the_drawn_runs_to_the_letter():
    rng = RNG(2)
    values, walks = rng.standard_normal(23).tolist(), Walks(rng.integers(0, 7, 23).tolist())
    drawn = [np.median(np.repeat(values, times)) for times in walks._times]
    assert walks.median(values) == pytest.approx((np.median(values), *np.percentile(drawn, [2.5, 97.5])))


def test_runs_without_a_value_do_not_count_and_weights_do():
    walks = Walks([0, 1, 1, 2, 2])
    assert walks.mean([0.5, None, 0.5, None, 0.5], [9, 9, 1, 0, 3]) == (0.5, 0.5, 0.5)
    assert walks.median([3.0, None, 3.0, None, None]) == (3.0, 3.0, 3.0)
    _, low, high = walks.mean([0.0, 1.0, 1.0, 1.0, 1.0], [1e9, 1, 1, 1, 1])
    assert low == pytest.approx(0.0, abs=1e-6)
    assert high == 1.0  # of draws without the heavy one


def test_one_walk_tells_nothing_of_others():
    walks = Walks([4, 4, 4])
    figures = [walks.mean([0.1, 0.2, 0.9]), walks.median([1.0, 2.0, 3.0]), walks.number([True, False, True])]
    walks = Walks([4, 4, 5])
    figures += [walks.mean([0.1, 0.2, None]), walks.median([1.0, 2.0, None])]
    assert [figure.value for figure in figures] == pytest.approx([0.4, 2.0, 2, 0.15, 1.5])
    assert {figure[1:] for figure in figures} == {(None, None)}
    assert walks.median([None] * 3) == walks.mean([None] * 3) == (None, None, None)


def test_a_number_of_runs_is_that_of_as_many_as_there_are():
    assert Walks(range(8)).number([True] * 8) == (8, 8.0, 8.0)
    _, low, high = Walks(range(8)).number([True] * 4 + [False] * 4)
    assert 0 <= low < 4 < high <= 8


def test_of_thirty_walks_that_agree_a_tenth_may_not():
    assert dissent(30) == pytest.approx(0.095, abs=1e-3)
    assert (1 - dissent(30)) ** 30 == pytest.approx(0.05)


def test_a_spread_is_the_median_between_the_extremes_of_what_is_known():
    assert spread([3.0, None, 1.0, 2.0]) == (2.0, 1.0, 3.0)
    assert spread([2.0, 2.0]) == (2.0, None, None)
    assert spread([None]) == (None, None, None)
