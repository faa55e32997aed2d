"""The network, in a thread of its own: one image at a time, so that odometry goes on while it works."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType

from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.frame import Frame


@dataclass(frozen=True)
class Job:
    """An image at the network.

    Attributes:
        frame: The image.
        reading: Of which reading it is, see `LiveReader.readings`.
        odom_from_base: Pose of the base in the frame of the odometry at its time; None where that is not known.
        arrived_ns: When it came, by the clock that messages are logged by.
        began_s: When the network got it, of `time.monotonic`.
    """

    frame: Frame
    reading: int
    odom_from_base: Poses | None
    arrived_ns: int
    began_s: float = field(default_factory=time.monotonic)


@dataclass(frozen=True)
class Observed:
    """What the network says of an image, or the error that it ended by."""

    job: Job
    posterior: PosePosterior | BaseException


class Network:
    """Observes the images that it is given, one after the other.

    Args:
        observe: What to call with each image.
        put: Called, in the thread of the network, with what it says.

    Attributes:
        job: The image at the network; None while it is free.
    """

    def __init__(self, observe: Callable[[Frame], PosePosterior], put: Callable[[Observed], None]) -> None:
        self._observe, self._put = observe, put
        self.job: Job | None = None
        self._outdated: Job | None = None
        self._jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="network", daemon=True)

    def __enter__(self) -> Network:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._jobs.put(None)
        self._thread.join()

    def start(self, job: Job) -> None:
        """Observe an image; the network must be free."""
        self.job = job
        self._jobs.put(job)

    def forget(self) -> None:
        """Have the image at the network, if there is one, count no longer."""
        self._outdated = self.job

    def end(self, job: Job) -> bool:
        """Be free again. Says whether what was said of the image counts."""
        self.job = None
        return job is not self._outdated

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            posterior: PosePosterior | BaseException
            try:
                posterior = self._observe(job.frame)
            except BaseException as error:
                posterior = error
            self._put(Observed(job, posterior))
