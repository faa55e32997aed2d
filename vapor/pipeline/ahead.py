"""One stage of a run works ahead of the next, in a thread of its own."""

from __future__ import annotations

import queue
import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

Item = TypeVar("Item")

_TURN_S = 2e-4  # between threads: Python's 5 ms are as long as the network takes for an image


@contextmanager
def ahead(items: Iterable[Item], *, room: int = 2) -> Iterator[Iterator[Item]]:
    """The same items in the same order, computed while those before are in use; used in a `with` statement.

    An error comes in the place of the item that it kept from being computed. At the end of the block, however it ends,
    the thread has ended, too: what was computed ahead is lost.

    Args:
        items: Where the items come from; nobody else may use it meanwhile.
        room: How many items wait at most; one more is being computed.
    """
    stage = _Stage(items, room)
    turn_s = sys.getswitchinterval()
    sys.setswitchinterval(min(turn_s, _TURN_S))
    try:
        yield iter(stage)
    finally:
        stage.stop()
        sys.setswitchinterval(turn_s)


class _Stage(Generic[Item]):
    """A thread that goes through items, and waits where it is too far ahead."""

    def __init__(self, items: Iterable[Item], room: int) -> None:
        self._done: queue.SimpleQueue[tuple[Item] | BaseException | None] = queue.SimpleQueue()
        self._room = threading.Semaphore(room)
        self._stopped = False
        self._thread = threading.Thread(target=self._work, args=(items,), daemon=True)
        self._thread.start()

    def _work(self, items: Iterable[Item]) -> None:
        try:
            for item in items:
                self._room.acquire()
                if self._stopped:
                    return
                self._done.put((item,))
        except BaseException as error:
            self._done.put(error)
        else:
            self._done.put(None)

    def __iter__(self) -> Iterator[Item]:
        while (done := self._done.get()) is not None:
            if isinstance(done, BaseException):
                raise done
            yield done[0]
            self._room.release()

    def stop(self) -> None:
        self._stopped = True
        self._room.release()
        self._thread.join()
