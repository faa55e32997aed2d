"""What live localization takes: time from images and odometry to poses, memory, processor time."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError, listed
from sequences.live.replay import replay
from sequences.live.transport import DdsOptions, Offer, Transport, join
from vapor.benchmark.live.traffic import IMAGE, ODOMETRY, REPLAYED, AlteringTransport, Walk, stamp_of, write_walk

POSE, BASE_POSE = "/estimate/pose", "/estimate/base_pose"
POSE_TYPE = "geometry_msgs/PoseWithCovarianceStamped"
_START_S = 120.0  # until the first answer: a model may have to be compiled
_LAST_ANSWERS_S = 2.0
_FOUND_S = 1.0  # until a participant knows of all others
_END_S = 30.0
_WARM_UP_S, _AVERAGED_S = 20.0, 300.0


@dataclass(frozen=True)
class Latency:
    """From messages to the answers with their stamps, the first of each.

    Attributes:
        sent: How many messages.
        answered: How many of them were answered.
        median_ms: Of those, milliseconds; NaN where there are none.
        p99_ms: 99 %.
        max_ms: The longest.
    """

    sent: int
    answered: int
    median_ms: float
    p99_ms: float
    max_ms: float


@dataclass(frozen=True)
class Measured:
    """Measurements of one camera.

    Attributes:
        speed: Seconds of the recording that were played in one.
        pose: From an image to the pose of the camera.
        base_pose: From odometry to the pose of the base, which is not published while the estimate is not converged.
        first_mb: Resident memory of the process in megabytes, the mean of five minutes after it has warmed up.
        last_mb: The mean of as many minutes at the end.
        processor: Seconds of its processor time a second.
        late_p99_ms: How late messages were published, milliseconds, 99 %.
    """

    speed: float
    pose: Latency
    base_pose: Latency
    first_mb: float
    last_mb: float
    processor: float
    late_p99_ms: float


def latency_of(sent_ns: Mapping[int, int], arrived_ns: Iterable[tuple[int, int]]) -> Latency:
    """Latency of the messages that were sent.

    Args:
        sent_ns: When each was sent, by its stamp.
        arrived_ns: Stamps of answers and when they came, by the same clock, in their order; others may be among them.
    """
    first: dict[int, int] = {}
    for stamp_ns, at_ns in arrived_ns:
        if stamp_ns in sent_ns:
            first.setdefault(stamp_ns, at_ns)
    taken_ms = np.array([at_ns - sent_ns[stamp_ns] for stamp_ns, at_ns in first.items()]) * 1e-6
    median_ms, p99_ms, max_ms = np.percentile(taken_ms, [50, 99, 100]) if len(taken_ms) else [np.nan] * 3
    return Latency(len(sent_ns), len(taken_ms), float(median_ms), float(p99_ms), float(max_ms))


def first_and_last(times_s: Sequence[float], values: Sequence[float]) -> tuple[float, float]:
    """Means of a series at its beginning and its end: five minutes of each, or a sixth where it is shorter.

    Before the beginning 20 s are left out, or a sixth.

    Args:
        times_s: Of n > 0 values, increasing.
        values: The values.
    """
    at_s: Float64[np.ndarray, " n"] = np.asarray(times_s, np.float64) - times_s[0]
    of = np.asarray(values, np.float64)
    begin_s = min(_WARM_UP_S, at_s[-1] / 6)
    averaged_s = min(_AVERAGED_S, at_s[-1] / 6)
    first = of[(at_s >= begin_s) & (at_s <= begin_s + averaged_s)]
    last = of[at_s >= at_s[-1] - averaged_s]
    return float(first.mean() if len(first) else of[0]), float(last.mean())


# --- the process ------------------------------------------------------------------------------------


@dataclass
class LiveProcess:
    """`vapor-track live`, running.

    Attributes:
        process: The process.
        log: File with all that it prints.
    """

    process: subprocess.Popen[bytes]
    log: Path

    def require_running(self) -> None:
        """Check that it has not ended. Raises VaporTrackError with what it printed."""
        if (status := self.process.poll()) is not None:
            raise VaporTrackError(f"`vapor-track live` ended with status {status}: {self.printed}")

    def end(self) -> None:
        """End it by SIGTERM. Raises VaporTrackError where it does not end well."""
        self.require_running()
        self.process.terminate()
        try:
            status = self.process.wait(_END_S)
        except subprocess.TimeoutExpired:
            raise VaporTrackError(f"`vapor-track live` goes on {_END_S:.0f} s after SIGTERM") from None
        if status:
            raise VaporTrackError(f"`vapor-track live` ended with status {status} by SIGTERM: {self.printed}")

    @property
    def memory_mb(self) -> float:
        """Its resident memory, megabytes."""
        pages = Path(f"/proc/{self.process.pid}/statm").read_text(encoding="ascii").split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE") * 1e-6

    @property
    def processor_s(self) -> float:
        """Processor time that it has taken so far, seconds."""
        text = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="ascii", errors="replace")
        user, system = text.rpartition(")")[2].split()[11:13]
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")

    @property
    def printed(self) -> str:
        """What it printed."""
        return self.log.read_text(encoding="utf-8", errors="replace").strip() or "it printed nothing"


@contextmanager
def running_live(domain: int, words: Sequence[str]) -> Iterator[LiveProcess]:
    """Run `vapor-track live` in a ROS domain of this machine; it is ended at the end, whatever happens.

    Raises:
        VaporTrackError: it does not end well by itself.
    """
    command = [sys.executable, "-m", "vapor.track", "live", "--localhost", "--domain", str(domain), *words]
    with TemporaryDirectory(prefix="vapor-track-live-") as folder:
        log = Path(folder) / "live.log"
        with log.open("wb") as out:
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT)
        live = LiveProcess(process, log)
        try:
            yield live
            live.end()
        finally:
            process.kill()
            process.wait()


# --- measuring --------------------------------------------------------------------------------------


def measure(
    walk: Walk,
    words: Sequence[str],
    *,
    domain: int,
    rate: float,
    size: tuple[int, int],
    duration_s: float,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> Measured:
    """Play a walk to `vapor-track live`, and measure from its first answer on.

    Args:
        words: Options of `live`, its model among them.
        domain: ROS domain to do it in, of this machine.
        rate: Images a second.
        advance: Called with the number of seconds done and of all.

    Raises:
        VaporTrackError: others are in the domain, or `live` ends by itself, does not answer within two minutes, or does
            not end well.
    """
    sent_ns: defaultdict[str, dict[int, int]] = defaultdict(dict)
    late_s: list[float] = []
    times_s: list[float] = []
    each_mb: list[float] = []

    def note(topic: str, data: bytes) -> bytes:
        stamp_ns = stamp_of(data)  # when it is due
        late_s.append((time.time_ns() - stamp_ns) * 1e-9)
        sent_ns[topic][stamp_ns] = time.monotonic_ns()
        return data

    with (
        TemporaryDirectory(prefix="vapor-track-walk-") as folder,
        closing(join(DdsOptions(domain=domain, localhost=True))) as transport,
    ):
        timeline = write_walk(Path(folder) / "walk.mcap", walk, rate, size)
        time.sleep(_FOUND_S)
        require_alone(transport)
        with running_live(domain, words) as live:
            poses, base_poses = (_listen(transport, topic) for topic in (POSE, BASE_POSE))
            playing = replay(Path(folder) / "walk.mcap", AlteringTransport(transport, note), REPLAYED)
            _play_until_answered(playing, live, poses)
            sent_ns.clear()
            late_s.clear()
            begin_s, begin_processor_s = time.monotonic(), live.processor_s
            for _ in playing:
                elapsed_s = time.monotonic() - begin_s
                if elapsed_s >= len(times_s):  # each second
                    live.require_running()
                    times_s.append(elapsed_s)
                    each_mb.append(live.memory_mb)
                    advance(int(elapsed_s), int(duration_s))
                if elapsed_s >= duration_s:
                    break
            processor = (live.processor_s - begin_processor_s) / (time.monotonic() - begin_s)
            time.sleep(_LAST_ANSWERS_S)
    return Measured(
        timeline.speed,
        latency_of(sent_ns[IMAGE], poses),
        latency_of(sent_ns[ODOMETRY], base_poses),
        *first_and_last(times_s, each_mb),
        processor,
        float(np.percentile(late_s, 99)) * 1e3,
    )


def _listen(transport: Transport, topic: str) -> list[tuple[int, int]]:
    """Stamps of all that comes on a topic from now on, and when by the monotonic clock, in nanoseconds."""
    arrived_ns: list[tuple[int, int]] = []

    def take(raw: Any) -> None:
        at_ns = time.monotonic_ns()
        arrived_ns.append((stamp_of(raw.data), at_ns))

    transport.subscribe(Offer(topic, POSE_TYPE, reliable=True, latched=False), take)
    return arrived_ns


def require_alone(transport: Transport) -> None:
    """Check that nobody else publishes anything. Raises VaporTrackError with the publishers."""
    if offers := transport.offers():
        names = listed((offer.topic for offer in offers), 3)
        raise VaporTrackError(
            f"{transport.name}: others publish {names}, expected nobody there: choose another --domain"
        )


def _play_until_answered(playing: Iterator[object], live: LiveProcess, poses: Sequence[tuple[int, int]]) -> None:
    end_s = look_s = time.monotonic()
    end_s += _START_S
    for _ in playing:
        if poses:
            return
        if (now_s := time.monotonic()) > look_s:
            live.require_running()
            look_s = now_s + 1.0
        if now_s > end_s:
            raise VaporTrackError(f"no {POSE} in {_START_S:.0f} s: {live.printed}")
