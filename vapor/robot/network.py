"""The network in a thread, one image at a time."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
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
        reading: Number of the reading, see `LiveReader.readings`.
        odom_from_base: Pose of the base in the odometry's frame at its time; None where unknown.
        arrived_ns: Time of arrival, by the clock of logged messages.
        began_s: Start at the network, of `time.monotonic`.
    """

    frame: Frame
    reading: int
    odom_from_base: Poses | None
    arrived_ns: int
    began_s: float = field(default_factory=time.monotonic)


@dataclass(frozen=True)
class Observed:
    """The posterior of an image, or the error of the network."""

    job: Job
    posterior: PosePosterior | BaseException


class Network:
    """Observes one image after the other in a thread, and puts each result; `job` is None while it is free."""

    def __init__(self, observe: Callable[[Frame], PosePosterior], put: Callable[[Observed], None]) -> None:
        self._observe, self._put = observe, put
        self.job: Job | None = None
        self._outdated: Job | None = None
        self._executor = ThreadPoolExecutor(1, "network")

    def __enter__(self) -> Network:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown()

    def start(self, job: Job) -> None:
        """Observe an image; the network must be free."""
        self.job = job
        self._executor.submit(self._work, job)

    def forget(self) -> None:
        """Discard the result of the image at the network, if there is one."""
        self._outdated = self.job

    def end(self, job: Job) -> bool:
        """Free the network; gives whether the result counts."""
        self.job = None
        return job is not self._outdated

    def _work(self, job: Job) -> None:
        posterior: PosePosterior | BaseException
        try:
            posterior = self._observe(job.frame)
        except BaseException as error:
            posterior = error
        self._put(Observed(job, posterior))
