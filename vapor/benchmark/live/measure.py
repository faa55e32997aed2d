"""What live localization takes: time from images and odometry to poses, memory, processor time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError
from sequences.live.transport import DdsOptions, Offer, Transport, join
from vapor.benchmark.live.traffic import IMAGE, ODOMETRY, Sent, Traffic, Walk, play, stamp_of

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
class Usage:
    """Resources of a process.

    Attributes:
        first_mb: Resident memory, the mean of the first minutes after it has warmed up, megabytes.
        last_mb: The mean of as many minutes at the end.
        most_mb: The most there ever was.
        processor: Seconds of processor time a second.
        each_mb: Memory each second.
    """

    first_mb: float
    last_mb: float
    most_mb: float
    processor: float
    each_mb: list[float]


@dataclass(frozen=True)
class Measured:
    """Measurements of one camera.

    Attributes:
        rate: Images a second.
        speed: Seconds of the recording that were played in one.
        pose: From an image to the pose of the camera.
        base_pose: From odometry to the pose of the base, which is not published while the estimate is not converged.
        usage: Of the process.
        late_p99_ms: How late messages were published, milliseconds, 99 %.
    """

    rate: float
    width: int
    height: int
    speed: float
    pose: Latency
    base_pose: Latency
    usage: Usage
    late_p99_ms: float

    @property
    def stored(self) -> dict[str, Any]:
        """All of it, as JSON; None for unknown values."""
        return {
            name: {key: None if each != each else each for key, each in value.items()}
            if isinstance(value, dict)
            else value
            for name, value in asdict(self).items()
        }


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
        """Check that it has not ended. Raises VaporTrackError with the last line that it printed."""
        if (status := self.process.poll()) is not None:
            raise VaporTrackError(f"`vapor-track live` ended with status {status}: {self._last_line}")

    def end(self) -> None:
        """End it as Ctrl-C does. Raises VaporTrackError where it does not end well."""
        self.require_running()
        self.process.send_signal(signal.SIGINT)
        try:
            status = self.process.wait(_END_S)
        except subprocess.TimeoutExpired:
            raise VaporTrackError(f"`vapor-track live` goes on {_END_S:.0f} s after Ctrl-C") from None
        if status:
            raise VaporTrackError(f"`vapor-track live` ended with status {status} by Ctrl-C: {self._last_line}")

    @property
    def memory_mb(self) -> float:
        """Its resident memory, megabytes."""
        lines = Path(f"/proc/{self.process.pid}/status").read_text(encoding="ascii", errors="replace").splitlines()
        return next((int(line.split()[1]) * 1024e-6 for line in lines if line.startswith("VmRSS")), 0.0)

    @property
    def processor_s(self) -> float:
        """Processor time that it has taken so far, seconds."""
        text = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="ascii", errors="replace")
        user, system = text.rpartition(")")[2].split()[11:13]
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")

    @property
    def _last_line(self) -> str:
        lines = self.log.read_text(encoding="utf-8", errors="replace").split("\n")
        return next((line for line in reversed(lines) if line.strip()), "it printed nothing")


@contextmanager
def running_live(domain: int, words: Sequence[str]) -> Iterator[LiveProcess]:
    """Run `vapor-track live` in a ROS domain of this machine; it is ended at the end, whatever happens.

    Raises:
        VaporTrackError: it does not end well by itself.
    """
    command = [sys.executable, "-m", "vapor.track", "live", "--localhost", "--domain", str(domain), *words]
    with TemporaryDirectory(prefix="vapor-track-live-") as folder:
        log = Path(folder) / "live.log"
        with log.open("wb") as out, _heeded_by_children(signal.SIGINT):
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT)
        live = LiveProcess(process, log)
        try:
            yield live
            live.end()
        finally:
            process.kill()
            process.wait()


@contextmanager
def _heeded_by_children(number: signal.Signals) -> Iterator[None]:
    """Have processes that are started heed a signal, which those in the background of a shell ignore otherwise."""
    if signal.getsignal(number) is not signal.SIG_IGN:
        yield
        return
    signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(number, signal.SIG_IGN)


# --- measuring --------------------------------------------------------------------------------------


@dataclass
class Answers:
    """What comes on a topic: stamps, and when by the monotonic clock, in nanoseconds."""

    arrived_ns: list[tuple[int, int]] = field(default_factory=list)

    def listen(self, transport: Transport, topic: str) -> None:
        """Take all that comes from now on."""

        def take(raw: Any) -> None:
            at_ns = time.monotonic_ns()
            self.arrived_ns.append((stamp_of(raw.data), at_ns))

        transport.subscribe(Offer(topic, POSE_TYPE, reliable=True, latched=False), take)


@dataclass
class _AllSent:
    """When messages were sent, by topic and stamp, and how late: numbers alone, which no garbage collector looks at."""

    at_ns: defaultdict[str, dict[int, int]] = field(default_factory=lambda: defaultdict(dict))
    late_s: list[float] = field(default_factory=list)

    def add(self, sent: Sent) -> None:
        self.at_ns[sent.topic][sent.stamp_ns] = sent.at_ns
        self.late_s.append(sent.late_s)


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
    traffic = Traffic(walk, rate, size)
    poses, base_poses = Answers(), Answers()
    with closing(join(DdsOptions(domain=domain, localhost=True))) as transport:
        time.sleep(_FOUND_S)
        require_alone(transport)
        with running_live(domain, words) as live:
            poses.listen(transport, POSE)
            base_poses.listen(transport, BASE_POSE)
            playing = play(transport, traffic)
            _play_until_answered(playing, live, poses)
            sent, usage = _play_and_watch(playing, live, duration_s, advance)
            time.sleep(_LAST_ANSWERS_S)
    return Measured(
        rate,
        *size,
        traffic.timeline.speed,
        latency_of(sent.at_ns[IMAGE], poses.arrived_ns),
        latency_of(sent.at_ns[ODOMETRY], base_poses.arrived_ns),
        usage,
        float(np.percentile(sent.late_s, 99)) * 1e3,
    )


def require_alone(transport: Transport) -> None:
    """Check that nobody else publishes anything. Raises VaporTrackError with the publishers."""
    if offers := transport.offers():
        names = ", ".join(offer.topic for offer in offers[:3]) + ", ..." * (len(offers) > 3)
        raise VaporTrackError(
            f"{transport.name}: others publish {names}, expected nobody there: choose another --domain"
        )


def _play_until_answered(playing: Iterator[Sent], live: LiveProcess, poses: Answers) -> None:
    end_s = look_s = time.monotonic()
    end_s += _START_S
    for _ in playing:
        if poses.arrived_ns:
            return
        if (now_s := time.monotonic()) > look_s:
            live.require_running()
            look_s = now_s + 1.0
        if now_s > end_s:
            raise VaporTrackError(f"no {POSE} in {_START_S:.0f} s: {live.log.read_text(encoding='utf-8').strip()}")


def _play_and_watch(
    playing: Iterator[Sent], live: LiveProcess, duration_s: float, advance: Callable[[int, int], None]
) -> tuple[_AllSent, Usage]:
    """Play for so long; gives the messages sent, and the resources of the process each second."""
    begin_s, begin_processor_s = time.monotonic(), live.processor_s
    sent = _AllSent()
    times_s: list[float] = []
    each_mb: list[float] = []
    for each in playing:
        sent.add(each)
        elapsed_s = time.monotonic() - begin_s
        if elapsed_s >= len(times_s):
            live.require_running()
            times_s.append(elapsed_s)
            each_mb.append(live.memory_mb)
            advance(int(elapsed_s), int(duration_s))
        if elapsed_s >= duration_s:
            break
    processor = (live.processor_s - begin_processor_s) / (time.monotonic() - begin_s)
    return sent, Usage(*first_and_last(times_s, each_mb), max(each_mb), processor, each_mb)
