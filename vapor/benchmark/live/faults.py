"""Faults with live traffic: published messages, time without convergence, and recovery."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.live.transport import DdsOptions, Offer, Transport, join
from sequences.recordings.message_definitions import decoder
from sequences.recordings.messages import pose_from_message, stamp_ns
from sequences.recordings.source import RawMessage
from sequences.trajectories.interpolation import interpolate
from vapor.benchmark.live.measure import BASE_POSE, POSE, POSE_TYPE, require_alone, running_live
from vapor.benchmark.live.robot import RobotConfig
from vapor.benchmark.live.traffic import IMAGE, ODOMETRY, Timeline, Walk

_RATE, _ODOMETRY_HZ = 10.0, 50.0
_SURE_S, _MOST_S, _AFTER_S = 5.0, 120.0, 30.0
_FOUND_S, _AGAIN_S = 1.0, 1.0
_WRONG_M = 1.0
_LOSSY = (
    "<CycloneDDS><Domain><Internal><Test><XmitLossiness>200</XmitLossiness></Test></Internal></Domain></CycloneDDS>"
)


@dataclass(frozen=True)
class Fault:
    """A fault, or a way to run with one all the time.

    Attributes:
        label: For tables.
        begin: Command to the robot at its beginning.
        end: And at its end.
        lasts_s: How long.
        killed: Whether the robot is killed, and restarted at the end.
        words: Further options of `live`.
        lossy: Whether a fifth of the robot's datagrams is lost, all the time.
    """

    label: str
    begin: str = ""
    end: str = ""
    lasts_s: float = 10.0
    killed: bool = False
    words: tuple[str, ...] = ()
    lossy: bool = False


FAULTS = {
    "none": Fault("no fault"),
    "killed": Fault("robot killed for 5 s, odometry restarted", lasts_s=5.0, killed=True),
    "camera": Fault("camera silent", f"drop {IMAGE}", "resume"),
    "odometry": Fault("odometry silent", f"drop {ODOMETRY}", "resume"),
    "slow": Fault("images at twice the speed", words=("--num-samples", "100000")),
    "lossy": Fault("20 % of datagrams lost", lossy=True),
    "lossy-reliable": Fault("the same, --reliable", words=("--reliable",), lossy=True),
    "clock": Fault("clock steps back 5 s", "clock -5", lasts_s=1.0),
}


@dataclass
class Timelines:
    """Messages received, each with its time by the monotonic clock, seconds.

    Attributes:
        statuses: Statuses of the diagnostics.
        poses: Stamps of /estimate/pose.
        transforms: Of tf.
        bases: Stamps and positions of /estimate/base_pose.
    """

    statuses: list[tuple[float, str]] = field(default_factory=list)
    poses: list[tuple[float, int]] = field(default_factory=list)
    transforms: list[float] = field(default_factory=list)
    bases: list[tuple[float, int, Poses]] = field(default_factory=list)

    def listen(self, transport: Transport) -> None:
        """Take all that comes from now on."""

        def status(raw: RawMessage) -> None:
            (first, *_) = decoder("diagnostic_msgs/DiagnosticArray")(raw.data).status
            values = {each.key: each.value for each in first.values}
            self.statuses.append((time.monotonic(), values.get("status", "none")))

        def pose(raw: RawMessage) -> None:
            self.poses.append((time.monotonic(), stamp_ns(decoder(POSE_TYPE)(raw.data).header)))

        def base(raw: RawMessage) -> None:
            message = decoder(POSE_TYPE)(raw.data)
            self.bases.append((time.monotonic(), stamp_ns(message.header), pose_from_message(message.pose.pose)))

        def transform(_: RawMessage) -> None:
            self.transforms.append(time.monotonic())

        for topic, kind, take in (
            ("/diagnostics", "diagnostic_msgs/DiagnosticArray", status),
            (POSE, POSE_TYPE, pose),
            (BASE_POSE, POSE_TYPE, base),
            ("/tf", "tf2_msgs/TFMessage", transform),
        ):
            transport.subscribe(Offer(topic, kind, reliable=True, latched=False), take)


@dataclass(frozen=True)
class Outcome:
    """The outcome of a fault.

    Attributes:
        label: Of the fault.
        sure_after_s: Seconds from the first image to the estimate that was `converged` for 5 s; None for never.
        poses_per_s: Of the camera, during the fault.
        transforms_per_s: Likewise of tf.
        unsure_after_s: Seconds from the beginning of the fault until the status was not `converged`; None for never.
        statuses: All statuses from the beginning on, in their order, without repetitions.
        recovered_after_s: Seconds from the end of the fault until it was `converged` for a second; None for never.
        wrong_s: Seconds for which the pose of the base was published and more than 1 m off.
        worst_m: The furthest that it was off, metres; NaN where none was published.
    """

    label: str
    sure_after_s: float | None
    poses_per_s: float
    transforms_per_s: float
    unsure_after_s: float | None
    statuses: list[str]
    recovered_after_s: float | None
    wrong_s: float
    worst_m: float


def status_at(statuses: Sequence[tuple[float, str]], at_s: float) -> str:
    """The latest status before a time; "none" before the first."""
    return next((status for told_s, status in reversed(statuses) if told_s <= at_s), "none")


def changes(statuses: Sequence[tuple[float, str]]) -> list[tuple[float, str]]:
    """Statuses without repetitions."""
    return [now for before, now in pairwise([(0.0, ""), *statuses]) if now[1] != before[1]]


def sure_since(statuses: Sequence[tuple[float, str]], from_s: float, end_s: float) -> float | None:
    """From when on the status was `converged` up to the end; None where it was not at the end."""
    if status_at(statuses, end_s) != "converged":
        return None
    last = changes([each for each in statuses if each[0] <= end_s])[-1][0]
    return max(last, from_s)


def sure_from(statuses: Sequence[tuple[float, str]], from_s: float, end_s: float) -> float | None:
    """The first time from one on that it was `converged` and remained so for a second; None where there is none."""
    later = changes([(from_s, status_at(statuses, from_s)), *(each for each in statuses if from_s < each[0] <= end_s)])
    spans = pairwise([*later, (end_s, "")])
    return next((now[0] for now, then in spans if now[1] == "converged" and then[0] - now[0] >= _AGAIN_S), None)


def wrong_for(times_s: Sequence[float], errors_m: Sequence[float], *, most_s: float = 0.2) -> float:
    """Seconds during which published poses were more than a metre off.

    Args:
        times_s: When it was published, increasing.
        errors_m: How far off it was.
        most_s: For how long one counts where the next is late.
    """
    spans = np.minimum(np.diff([*times_s, times_s[-1] + most_s]), most_s) if times_s else np.zeros(0)
    return float(spans[np.asarray(errors_m) > _WRONG_M].sum()) if times_s else 0.0


# --- running ----------------------------------------------------------------------------------------


class _Robot:
    def __init__(self, config: RobotConfig, *, lossy: bool) -> None:
        command = [sys.executable, "-m", "vapor.benchmark.live.robot", config.word]
        env = {**os.environ, **({"CYCLONEDDS_URI": _LOSSY} if lossy else {})}
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env)
        assert self._process.stdout is not None
        begin = self._process.stdout.readline().strip()
        if not begin:
            raise VaporTrackError(f"the robot ended with status {self._process.wait()}")
        self.begin_ns = int(begin)

    def request(self, line: str) -> None:
        assert self._process.stdin is not None
        if line:
            self._process.stdin.write(f"{line}\n")
            self._process.stdin.flush()

    def kill(self) -> None:
        self._process.kill()
        self._process.communicate()


@contextmanager
def _ended(robot: _Robot) -> Iterator[list[_Robot]]:
    """Robots, of which the last one is killed at the end."""
    robots = [robot]
    try:
        yield robots
    finally:
        robots[-1].kill()


def run_fault(
    fault: Fault, recording: Path, walk: Walk, words: Sequence[str], *, domain: int, sleep: Callable[[float], None]
) -> Outcome:
    """Play a walk to `vapor-track live`, and let a fault happen once the estimate was sure for a while.

    Args:
        walk: The recording, read; it has true poses.
        words: Options of `live`, its model among them.
        domain: ROS domain to do it in, of this machine.

    Raises:
        VaporTrackError: others are in the domain, or `live` does not end well.
    """
    config = RobotConfig(str(recording), domain, _RATE, _ODOMETRY_HZ)
    received = Timelines()
    with closing(join(DdsOptions(domain=domain, localhost=True))) as transport:
        sleep(_FOUND_S)
        require_alone(transport)
        with running_live(domain, [*words, *fault.words]), _ended(_Robot(config, lossy=fault.lossy)) as robots:
            received.listen(transport)
            begun_s = time.monotonic()
            sure_s = None
            while sure_s is None and time.monotonic() < begun_s + _MOST_S:
                sleep(0.1)
                since_s = sure_since(received.statuses, begun_s, time.monotonic())
                if since_s is not None and time.monotonic() - since_s >= _SURE_S:
                    sure_s = time.monotonic()
            begin_s = time.monotonic()
            robots[0].request(fault.begin)
            if fault.killed:
                robots[0].kill()
            sleep(fault.lasts_s)
            if fault.killed:
                config = replace(config, begin_ns=robots[0].begin_ns, restarted=True)
                robots.append(_Robot(config, lossy=fault.lossy))
            robots[-1].request(fault.end)
            end_s = time.monotonic()
            sleep(_AFTER_S)
            until_s, begin_ns = time.monotonic(), robots[0].begin_ns
    return _outcome(fault, received, walk, begin_ns, (begun_s, sure_s, begin_s, end_s, until_s))


def _outcome(
    fault: Fault,
    received: Timelines,
    walk: Walk,
    walk_ns: int,
    at_s: tuple[float, float | None, float, float, float],
) -> Outcome:
    begun_s, sure_s, begin_s, end_s, until_s = at_s
    lasted_s = end_s - begin_s
    within = [each for each in received.statuses if begin_s < each[0] <= until_s]
    unsure_s = next((told_s for told_s, status in within if status != "converged"), None)
    again_s = sure_from(received.statuses, end_s, until_s)
    bases = [base for base in received.bases if begin_s <= base[0] <= until_s]
    shift_ns = 5_000_000_000 if fault.begin.startswith("clock") else 0
    errors_m = _errors_m([(s, n + shift_ns, pose) for s, n, pose in bases], walk, walk_ns)
    return Outcome(
        fault.label,
        None if sure_s is None else sure_s - begun_s - _SURE_S,
        sum(begin_s <= told_s < end_s for told_s, _ in received.poses) / lasted_s,
        sum(begin_s <= told_s < end_s for told_s in received.transforms) / lasted_s,
        None if unsure_s is None else unsure_s - begin_s,
        [status for _, status in changes([(begin_s, status_at(received.statuses, begin_s)), *within])],
        None if again_s is None else again_s - end_s,
        wrong_for([base[0] for base in bases], errors_m),
        max(errors_m, default=float("nan")),
    )


def _errors_m(bases: Sequence[tuple[float, int, Poses]], walk: Walk, walk_ns: int) -> list[float]:
    assert walk.world_from_camera is not None
    if not bases:
        return []
    elapsed_s = np.array([stamp - walk_ns for _, stamp, _ in bases]) * 1e-9
    at_ns = Timeline(walk.times_ns, _RATE).recorded_ns(elapsed_s)
    truth, _ = interpolate(walk.times_ns, walk.world_from_camera, at_ns, max_gap_s=np.inf)
    truth = truth @ walk.base_from_camera.inverse()
    away = Poses.stack([pose for _, _, pose in bases]).translation - truth.translation
    return np.linalg.norm(away, axis=-1).tolist()
