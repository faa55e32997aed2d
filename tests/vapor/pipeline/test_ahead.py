"""A stage that works ahead of the next, in a thread."""

import threading
from collections.abc import Iterator
from contextlib import nullcontext

import pytest

from vapor.pipeline.localize import ahead

ROOM = 2


class Counted:
    """Numbers, and how many were asked for; perhaps an error after them."""

    def __init__(self, count: int, error: Exception | None = None) -> None:
        self.count, self.error = count, error
        self.given, self.closed = 0, False
        self.full = threading.Event()

    def __iter__(self) -> Iterator[int]:
        try:
            for i in range(self.count):
                self.given += 1
                if self.given > ROOM:
                    self.full.set()
                yield i
            if self.error is not None:
                raise self.error
        finally:
            self.closed = True


def test_items_come_in_order_and_none_is_lost():
    with ahead(range(1000)) as items:
        assert list(items) == list(range(1000))


def test_no_more_items_are_computed_than_there_is_room_for():
    source = Counted(100)
    with ahead(source) as items:
        for i in items:
            if i == 0:
                assert source.full.wait(5.0)  # it works ahead while the first is in use
            assert source.given <= i + 2 + ROOM
    assert source.given == 100


def test_an_error_comes_in_the_place_of_the_item_that_it_kept_from_being_computed():
    with ahead(Counted(5, ValueError("the sixth"))) as items:
        assert [next(items) for _ in range(5)] == [0, 1, 2, 3, 4]
        with pytest.raises(ValueError, match="the sixth"):
            next(items)


@pytest.mark.parametrize("error", [None, OSError("disk"), KeyboardInterrupt()])
def test_when_the_block_ends_early_the_thread_has_ended_and_closed_what_it_read(error):
    def take_one() -> None:
        with ahead(source) as items:
            assert next(items) == 0
            if error is not None:
                raise error

    threads, source = {*threading.enumerate()}, Counted(100)
    with pytest.raises(type(error)) if error is not None else nullcontext():
        take_one()
    assert {*threading.enumerate()} <= threads
    assert source.closed
    assert source.given < 100


def test_stages_in_a_row_end_together():
    source, threads = Counted(100), {*threading.enumerate()}
    with ahead(source) as first, ahead(i * i for i in first) as second:
        assert [next(second) for _ in range(4)] == [0, 1, 4, 9]
    assert {*threading.enumerate()} <= threads
    assert source.closed
