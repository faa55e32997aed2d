"""Work that is done one step ahead."""

import threading

import pytest

from vapor.training.augment import one_ahead


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
