"""The loop of live localization: messages in, the newest image to the network, what it says to the filter, poses out.

One thread has all state: it takes messages, steps the filter and publishes. The network has a thread of its own, so
that odometry goes on while it works; whenever it is free it gets the newest image.
"""

from __future__ import annotations

import copy
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, overload

import numpy as np

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.frame import Frame
from sequences.live.reader import LiveReader, open_live
from sequences.live.transport import Offer, Transport
from sequences.options import ReadingOptions
from sequences.reading.counts import OVERTAKEN
from sequences.recordings.estimate_messages import estimate_messages
from sequences.recordings.message_definitions import decoder
from sequences.recordings.messages import frame_name, stamp_ns
from sequences.recordings.source import RawMessage
from vapor.pipeline.model import LoadedModel
from vapor.reporting.rerun_place import Place
from vapor.reporting.rerun_viewer import RerunViewer
from vapor.reporting.viewer import NullViewer, Viewer
from vapor.robot.config import LiveConfig
from vapor.robot.estimate import LiveEstimate
from vapor.robot.foxglove_server import FoxgloveServer
from vapor.robot.initial_pose import camera_of_initial_pose
from vapor.robot.messages import diagnostics_message, pose_message, tf_message
from vapor.robot.outbox import Outbox, Sink
from vapor.robot.recorder import MessageRecorder
from vapor.robot.snapshot import write_snapshot
from vapor.robot.watching import WatchingViewer
from vapor.threads import limited_threads

LAYOUT = Path(__file__).with_name("foxglove_layout.json")
"""For Foxglove, to import."""
PARTICLES = 500
"""How many particles are published after each image."""
_TICK_S = 1.0  # between diagnostics, and between looks at what is silent
_REFRESH_TICKS = 5  # between looks at who publishes
_SILENT_S = 1.0
_ODOMETRY_SILENT_S = 0.5
_SETTLE_S, _SETTLED_S = 4.0, 2.0  # without images the belief follows odometry for good after so long, to so long ago
_LATENCIES = 1000
_AT_ONCE = 500
_BEFORE_CLOCK = 2000
_REFUSED = "refused"
_APART, _ENOUGH_IMAGES = "images and odometry are by different clocks", 10
_USUAL = (OVERTAKEN, _REFUSED)
_CLOCK, _INITIAL_POSE = "/clock", "/initialpose"
"""Topics that are listened to; under the name of those that are published also `start_anew` and `save_snapshot`."""


class Stop:
    """An event: end."""


class _Stopped(Exception):
    """There was one."""


@dataclass(frozen=True)
class _Job:
    """An image at the network."""

    frame: Frame
    reading: int
    odom_from_base: Poses | None
    arrived_ns: int  # by the clock of `_now_ns`
    began_s: float = field(default_factory=time.monotonic)


@dataclass(frozen=True)
class _Observed:
    job: _Job
    posterior: PosePosterior | BaseException


@dataclass(frozen=True)
class _Anchor:
    """What is believed of the last image that was localized, or of what somebody stated, and what leads on from it."""

    time_ns: int
    reading: int
    estimate: Estimate
    map_from_odom: Poses | None
    frame: Frame | None  # None where it was stated
    began_s: float = field(default_factory=time.monotonic)


class LiveSession:
    """Localizes one robot from its topics until it is stopped.

    Args:
        model: The model.
        transport: The system.
        reading: What to read of it.
        config: Settings.
        tell: Told what a person should know, in a line.
    """

    def __init__(
        self,
        model: LoadedModel,
        transport: Transport,
        reading: ReadingOptions,
        config: LiveConfig,
        *,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._model, self._transport, self._reading, self._config = model, transport, reading, config
        self._on_estimate: Callable[[LiveEstimate], None] = lambda _: None
        self._tell = tell
        self._events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._controls = {
            _INITIAL_POSE: ("geometry_msgs/PoseWithCovarianceStamped", self._set_pose),
            f"{config.under}/start_anew": ("std_msgs/Empty", self._start_anew),
            f"{config.under}/save_snapshot": ("std_msgs/Empty", self._save_snapshot),
        }
        if config.sim_time:
            self._controls[_CLOCK] = ("rosgraph_msgs/Clock", self._set_clock)
        settings = config.localizer
        calibration = model.observation.description.calibration
        self._fit = calibration.odometry if config.fitted_odometry else None
        if self._fit is not None:
            settings = replace(settings, slow_errors=self._fit.slow_errors)
        self._localizer = ParticleLocalizer(None, settings, rng=np.random.default_rng(config.seed))
        self._reader: LiveReader | None = None
        self._job: _Job | None = None  # at the network
        self._stale: _Job | None = None  # what was at the network when all began anew
        self._anchor: _Anchor | None = None
        self._now: Estimate | None = None  # of now, which is later than the anchor where images are silent
        self._kept_map_from_odom: Poses | None = None
        self._clock_ns: int | None = None
        self._before_clock: deque[RawMessage] = deque(maxlen=_BEFORE_CLOCK)
        self._told_ns = self._tf_ns = self._told_reading = 0  # of the latest odometry that was told, and its transform
        self._image_s = self._odometry_s = time.monotonic()  # when the last of them came
        self._latencies_ms: deque[float] = deque(maxlen=_LATENCIES)
        self._localized = self._refused = self._ticks = 0
        self._problems: set[str] = set()  # that were told
        self._status = ""
        self._last_sent: list[RawMessage] = []
        self._recorder: MessageRecorder | None = None

    @property
    def skipped(self) -> dict[str, int]:
        """How many images were left out so far, by reason."""
        skipped = {} if self._reader is None else dict(self._reader.counts.skipped)
        return skipped | ({_REFUSED: self._refused} if self._refused else {})

    @property
    def localized(self) -> int:
        """How many images were localized so far."""
        return self._localized

    def stop(self) -> None:
        """Have `run` end soon; may be called from any thread."""
        self._events.put(Stop())

    def run(self, on_estimate: Callable[[LiveEstimate], None] = lambda _: None) -> None:
        """Localize until `stop` is called, or an interruption comes.

        Args:
            on_estimate: Called after every image; until it returns, nothing else goes on.

        Raises:
            VaporTrackError: the topics cannot be used, or what was asked for cannot be written or served.
        """
        config, self._on_estimate = self._config, on_estimate
        with ExitStack() as block:
            block.enter_context(limited_threads(config.threads))
            sinks: list[Sink] = []
            if config.record is not None:
                path = config.record.with_name(time.strftime(config.record.name))
                self._recorder = block.enter_context(MessageRecorder(path))
            if config.foxglove:
                server = block.enter_context(FoxgloveServer(config.foxglove_host, config.foxglove_port))
                sinks.append(server)
                host = f"[{config.foxglove_host}]" if ":" in config.foxglove_host else config.foxglove_host
                self._tell(f"Foxglove: ws://{host}:{server.port}, layout {LAYOUT}")
            self._sinks = sinks
            self._viewer: Viewer = NullViewer()
            if config.view or config.view_at is not None:
                self._viewer = block.enter_context(WatchingViewer(self._open_viewer, self._tell))
            self._outbox = Outbox(self._transport, sinks, self._tell)
            self._advertise()
            for topic, (message_type, _) in self._controls.items():
                offer = Offer(
                    topic, message_type, reliable=False, latched=False
                )  # which hears both kinds of publishers
                self._transport.subscribe(offer, self._events.put)
            worker = threading.Thread(target=self._observe, name="network", daemon=True)
            worker.start()
            try:
                self._loop()
            finally:
                self._jobs.put(None)
                worker.join()

    def _open_viewer(self) -> RerunViewer:
        title = f"{self._model.name} {time.strftime('%Y-%m-%d %H:%M:%S')}"  # of two at once, each is shown for itself
        place = Place.of_model(self._model.observation.description)
        return RerunViewer(spawn=self._config.view, connect=self._config.view_at, title=title, place=place, live=True)

    def _advertise(self) -> None:
        """Be known by one's topics from the beginning."""
        for message in estimate_messages(0, [], Poses.identity(0), under=self._config.under):
            self._outbox.advertise(message.topic, message.type)
        for name in ("pose", "base_pose"):
            self._outbox.advertise(f"{self._config.under}/{name}", "geometry_msgs/PoseWithCovarianceStamped")
        self._outbox.advertise("/diagnostics", "diagnostic_msgs/DiagnosticArray")
        if self._config.tf:
            self._outbox.advertise("/tf", "tf2_msgs/TFMessage")

    # --- events -------------------------------------------------------------------------------------

    def _loop(self) -> None:
        try:
            reader = open_live(
                self._transport, self._events, self._reading, admit=self._admit, waiting=self._say_waiting
            )
        except _Stopped:
            return
        self._reader = reader
        self._localizer.model = self._model.observation.seen_by(reader.camera.camera)
        self._tell_roles(reader)
        next_s = time.monotonic() + _TICK_S
        while True:
            try:
                self._take_all(max(next_s - time.monotonic(), 0.0))
            except _Stopped:
                return
            self._submit()
            self._tell_motion()
            if time.monotonic() >= next_s:
                next_s = time.monotonic() + _TICK_S
                self._tick()

    def _take_all(self, timeout_s: float) -> None:
        """Take the events that are there, or wait for one."""
        for _ in range(_AT_ONCE):
            try:
                event = self._events.get(timeout=timeout_s)
            except queue.Empty:
                return
            timeout_s = 0.0
            if isinstance(event, _Observed):
                self._localize(event)
            elif (raw := self._admit(event)) is not None:
                self._take(raw)

    def _take(self, raw: RawMessage) -> None:
        assert self._reader is not None
        is_later = self._reader.take(raw)
        if raw.topic == self._reader.roles.image.name:
            self._image_s = time.monotonic()
        elif is_later:
            self._odometry_s = time.monotonic()

    def _admit(self, event: Any) -> RawMessage | None:
        """Record and serve a message; gives it where it is to be read. Raises _Stopped where that was asked for."""
        if isinstance(event, Stop):
            raise _Stopped
        if not isinstance(event, RawMessage):
            return None
        is_clock = event.topic == _CLOCK and self._config.sim_time
        if self._config.sim_time and not is_clock:
            if self._clock_ns is None:
                self._before_clock.append(event)
                return None
            event = event._replace(log_time_ns=self._clock_ns)
        if self._recorder is not None:
            self._recorder.write(event)
        if event.topic in self._controls:
            message_type, control = self._controls[event.topic]
            try:
                control(decoder(message_type)(event.data))
            except Exception as error:  # damaged bytes, or what cannot be done
                self._tell(f"{event.topic}: {error or type(error).__name__}")
            return None
        for sink in self._sinks:
            sink.write(event)
        return event

    def _now_ns(self) -> int:
        return time.time_ns() if self._clock_ns is None else self._clock_ns

    def _set_clock(self, message: SimpleNamespace) -> None:
        self._clock_ns = int(message.clock.sec) * 1_000_000_000 + int(message.clock.nanosec)
        while self._before_clock:
            self._events.put(self._before_clock.popleft())

    def _start_anew(self, _: SimpleNamespace) -> None:
        self._localizer.forget()
        self._begin_at(None if self._reader is None else self._reader.odometry_ns)
        self._tell("starts anew")

    def _begin_at(self, time_ns: int | None) -> None:
        """Have what was before count no longer: neither the belief, nor an image at the network, nor the motion."""
        self._anchor = self._now = self._kept_map_from_odom = None
        self._stale = self._job
        if self._reader is not None and time_ns is not None:
            self._reader.settle(time_ns)

    def _set_pose(self, message: SimpleNamespace) -> None:
        reader = self._reader
        if reader is None or (time_ns := reader.odometry_ns) is None:
            raise VaporTrackError("there is no odometry yet, expected some before a pose is stated")
        frame = frame_name(message.header.frame_id)
        if frame != frame_name(self._config.map_frame):
            raise VaporTrackError(f"pose in {frame!r}, expected one in {self._config.map_frame!r}")
        description = self._model.observation.description
        pose, covariance = camera_of_initial_pose(message, reader.base_from_camera, description.prior_poses)
        if reader.odom_from_base(stamp_ns(message.header)) is not None:  # else it is of now
            time_ns = stamp_ns(message.header)
        estimate = self._localizer.start_at(pose, covariance, description.calibration.errors)
        map_from_odom = self._map_from_odom(estimate, reader.odom_from_base(time_ns))
        self._begin_at(time_ns)
        self._anchor = _Anchor(time_ns, reader.readings, estimate, map_from_odom, None)
        self._send_belief(time_ns, estimate)
        self._tell(f"starts at x {pose.translation[0]:.2f} m, y {pose.translation[1]:.2f} m, as {_INITIAL_POSE} says")

    def _save_snapshot(self, _: SimpleNamespace) -> None:
        if self._anchor is None or self._anchor.frame is None:
            raise VaporTrackError("nothing was localized yet, expected an estimate to save")
        path = write_snapshot(self._config.snapshots, self._anchor.frame, self._last_sent)
        self._tell(f"snapshot {path}")

    # --- images -------------------------------------------------------------------------------------

    def _observe(self) -> None:
        """The thread of the network."""
        while (job := self._jobs.get()) is not None:
            try:
                posterior = self._localizer.observe(job.frame.image)
            except BaseException as error:
                posterior = error
            self._events.put(_Observed(job, posterior))

    def _submit(self) -> None:
        """Give the network the newest image, if it is free and there is one."""
        reader = self._reader
        if reader is None or self._job is not None or (frame := reader.newest_frame()) is None:
            return
        arrived_ns = reader.arrived_ns(frame.time_ns)
        pose = reader.odom_from_base(frame.time_ns)
        self._job = _Job(frame, reader.readings, pose, self._now_ns() if arrived_ns is None else arrived_ns)
        self._jobs.put(self._job)

    def _localize(self, observed: _Observed) -> None:
        """Step the filter by what the network says of an image, and tell what comes of it."""
        job, posterior = observed.job, observed.posterior
        self._job = None
        self._submit()
        if job is self._stale and not isinstance(posterior, BaseException):
            return
        if isinstance(posterior, BaseException):
            if not isinstance(posterior, VaporTrackError):
                raise posterior
            self._refuse(posterior)
            posterior = PosePosterior.nothing()  # the belief moves all the same
        frame, odometry = job.frame, self._restated(job.frame.odometry)
        try:
            estimate = self._localizer.update(posterior, odometry, elapsed_s=self._since_anchor_s(job))
        except VaporTrackError as error:
            self._refuse(error)
            return
        map_from_odom = self._map_from_odom(estimate, job.odom_from_base)
        self._anchor = anchor = _Anchor(frame.time_ns, job.reading, estimate, map_from_odom, frame, job.began_s)
        self._told_ns = 0
        self._send_belief(frame.time_ns, estimate)
        self._tell_motion()
        latency_ms = (self._now_ns() - job.arrived_ns) * 1e-6
        self._latencies_ms.append(latency_ms)
        self._localized += 1
        self._viewer.log(frame, estimate, posterior.samples)
        self._on_estimate(self._live_estimate(frame, anchor, latency_ms))

    def _live_estimate(self, frame: Frame, anchor: _Anchor, latency_ms: float) -> LiveEstimate:
        assert self._reader is not None
        best = anchor.estimate.modes[0].world_from_camera
        converged = anchor.estimate.status == "converged"
        return LiveEstimate(
            frame,
            anchor.estimate,
            best @ self._reader.base_from_camera.inverse(),
            anchor.map_from_odom if converged else None,
            latency_ms,
            self.skipped,
        )

    def _refuse(self, error: VaporTrackError) -> None:
        if not self._refused:
            self._tell(f"an image could not be used: {error}")
        self._refused += 1

    @overload
    def _restated(self, odometry: Odometry) -> Odometry: ...
    @overload
    def _restated(self, odometry: None) -> None: ...
    @overload
    def _restated(self, odometry: Odometry | None) -> Odometry | None: ...

    def _restated(self, odometry: Odometry | None) -> Odometry | None:
        """With the errors that the model's calibration found of its kind."""
        return odometry if odometry is None or self._fit is None else self._fit.restated(odometry)

    def _since_anchor_s(self, job: _Job) -> float:
        """Seconds since the last image: by stamps, but across a clock that was set by when images were there."""
        if self._anchor is None:
            return 0.0
        before = self._anchor
        if before.reading != job.reading:
            return max(job.began_s - before.began_s, 0.0)
        return max(job.frame.time_ns - before.time_ns, 0) * 1e-9

    def _map_from_odom(self, estimate: Estimate, odom_from_base: Poses | None) -> Poses | None:
        if odom_from_base is None or self._reader is None:
            return None
        map_from_base = estimate.modes[0].world_from_camera @ self._reader.base_from_camera.inverse()
        return map_from_base @ odom_from_base.inverse()

    # --- what is told -------------------------------------------------------------------------------

    def _send_belief(self, time_ns: int, estimate: Estimate) -> None:
        """Publish what is believed of a time; it is the belief of now."""
        self._now = estimate
        modes = [(mode.world_from_camera, mode.covariance, mode.weight) for mode in estimate.modes]
        cloud = estimate.cloud(PARTICLES)
        messages = estimate_messages(time_ns, modes, cloud, under=self._config.under, frame=self._config.map_frame)
        self._last_sent = self._outbox.send(messages, self._now_ns())
        if estimate.status != self._status:
            self._status = estimate.status
            best = estimate.modes[0]
            self._tell(f"{estimate.status}: best of {len(estimate.modes)} modes {100 * best.weight:.0f} %")
            self._send_diagnostics()

    def _tell_motion(self) -> None:
        """Publish the pose of the base at the latest odometry, and tf; neither while the estimate is not converged."""
        reader, anchor, now = self._reader, self._anchor, self._now
        if reader is None or anchor is None or now is None or (time_ns := reader.odometry_ns) is None:
            return
        if time_ns == self._told_ns:
            return
        if now.status == "converged" and anchor.reading == reader.readings:
            map_from_odom = self._kept_map_from_odom = anchor.map_from_odom
        elif self._config.keep_tf:
            map_from_odom = self._kept_map_from_odom
        else:
            return
        odom_from_base = reader.odom_from_base(time_ns)
        if map_from_odom is None or odom_from_base is None:
            return
        frame, messages = self._config.map_frame, []
        if now.status == "converged":
            if (motion := self._restated(self._motion_since_anchor(time_ns))) is None:
                return
            covariance = motion.carry @ anchor.estimate.modes[0].covariance @ motion.carry.T + motion.covariance
            carry = reader.base_from_camera.adjoint()
            pose, topic = map_from_odom @ odom_from_base, f"{self._config.under}/base_pose"
            messages.append(pose_message(topic, frame, time_ns, pose, carry @ covariance @ carry.T))
        if self._config.tf:
            # A transform that was told with its stamp before is refused by those who listen.
            before_ns = self._tf_ns if self._told_reading == reader.readings else 0
            self._tf_ns = max(time_ns + round(self._config.tf_ahead_s * 1e9), before_ns + 1)
            messages.append(tf_message(self._tf_ns, frame, reader.roles.odometry_frame, map_from_odom))
        self._outbox.send(messages, self._now_ns())
        self._told_ns, self._told_reading = time_ns, reader.readings

    def _motion_since_anchor(self, time_ns: int) -> Odometry | None:
        """Motion of the camera since the last image that was localized; None where it is unknown."""
        assert self._reader is not None
        begin_ns = self._reader.frame_ns
        if begin_ns is None or time_ns <= begin_ns:
            later = Odometry(Poses.identity(), np.zeros((6, 6)), 0.0)
        elif (moved := self._reader.moved_until(time_ns)) is not None:
            later = moved
        else:
            return None
        if self._job is None:
            return later
        between = self._job.frame.odometry  # one more image may be at the network
        return None if between is None else between.then(later)

    def _tick(self) -> None:
        """Once a second: go on without images where none come, and say how things are."""
        assert self._reader is not None
        self._ticks += 1
        if self._ticks % _REFRESH_TICKS == 0:
            self._reader.heard.refresh()
        self._tell_problems()
        self._settle()
        if self._anchor is not None and self._age_s(self._anchor) > _SILENT_S:
            self._go_on_without_images(self._anchor)
        self._send_diagnostics()

    def _tell_problems(self) -> None:
        """Say once of every reason why something is left out that there is one, and what is new of the camera."""
        reader = self._reader
        assert reader is not None
        for reason in [*self.skipped, *reader.messages_left_out]:
            if reason not in self._problems and reason not in _USUAL:
                self._tell(f"left out: {reason}{reader.problems.get(reason, '')}")
            self._problems.add(reason)
        lost = [] if self._recorder is None or self._recorder.error is None else [self._recorder.error]
        apart = [reader.apart] if reader.apart is not None and reader.counts.read > _ENOUGH_IMAGES else []
        for notice in [*reader.camera.notices, *lost, *(_APART for _ in apart)]:
            if notice not in self._problems:
                self._tell(notice if notice != _APART else f"{_APART}: {apart[0]}")
            self._problems.add(notice)

    def _age_s(self, anchor: _Anchor) -> float:
        return time.monotonic() - anchor.began_s

    def _settle(self) -> None:
        """Follow odometry for good where images are missing for long: what lies before need not be remembered."""
        reader, anchor = self._reader, self._anchor
        assert reader is not None
        odometry_ns, frame_ns = reader.odometry_ns, reader.frame_ns
        if self._job is not None or odometry_ns is None or frame_ns is None:
            return
        if odometry_ns - frame_ns <= _SETTLE_S * 1e9:
            return
        settled_ns = odometry_ns - round(_SETTLED_S * 1e9)
        motion, odom_from_base = self._restated(reader.moved_until(settled_ns)), reader.odom_from_base(settled_ns)
        reader.settle(settled_ns)
        if anchor is None:
            return
        elapsed_s = max(settled_ns - anchor.time_ns, 0) * 1e-9 if anchor.reading == reader.readings else _SETTLE_S
        estimate = self._localizer.predict(motion, elapsed_s=elapsed_s)
        self._anchor = replace(
            anchor,
            time_ns=settled_ns,
            reading=reader.readings,
            estimate=estimate,
            map_from_odom=self._map_from_odom(estimate, odom_from_base),
        )

    def _go_on_without_images(self, anchor: _Anchor) -> None:
        """Predict the belief to now, by odometry or, where that is unknown, by how far one may have come.

        The image that is missing may be at the network, which takes its time.
        """
        reader = self._reader
        assert reader is not None
        time_ns, motion = reader.odometry_ns, None
        is_told = time.monotonic() - self._odometry_s < _ODOMETRY_SILENT_S and anchor.reading == reader.readings
        if is_told and time_ns is not None:
            motion = self._restated(self._motion_since_anchor(time_ns))
        later = copy.copy(self._localizer).predict(motion, elapsed_s=self._age_s(anchor))
        self._send_belief(time_ns or anchor.time_ns, later)

    def _send_diagnostics(self, silent: str | None = None) -> None:
        reader = self._reader
        now_s = time.monotonic()
        values: dict[str, object] = {}
        if reader is not None:
            counts = reader.counts
            if now_s - self._odometry_s > _SILENT_S:
                silent = f"no odometry for {now_s - self._odometry_s:.0f} s"
            elif now_s - self._image_s > _SILENT_S:
                silent = f"no image for {now_s - self._image_s:.0f} s"
            elif self._anchor is not None and self._age_s(self._anchor) > _SILENT_S:
                silent = f"no image that can be used for {self._age_s(self._anchor):.0f} s"
            values = {
                "images": counts.read,
                "images localized": self._localized,
            }
            values |= {f"images skipped, {reason}": number for reason, number in sorted(self.skipped.items())}
            values |= {f"messages left out, {why}": n for why, n in sorted(reader.messages_left_out.items())}
        if self._latencies_ms:
            median, late = np.percentile(self._latencies_ms, [50, 99])
            values |= {"latency, median, ms": f"{median:.1f}", "latency, 99 %, ms": f"{late:.1f}"}
        if self._recorder is not None:
            values |= {"messages recorded": self._recorder.number, "messages not recorded": self._recorder.lost}
        message = diagnostics_message(
            self._now_ns(), hardware=self._model.name, estimate=self._now, silent=silent, values=values
        )
        self._outbox.send([message], self._now_ns())

    def _say_waiting(self, problem: str) -> None:
        if self._config.sim_time and self._clock_ns is None:
            problem = f"no message on {_CLOCK} yet (--sim-time)"
        self._tell(f"waits: {problem}")
        self._send_diagnostics(f"waits: {problem}")

    def _tell_roles(self, reader: LiveReader) -> None:
        roles = reader.roles
        odometry = roles.odometry.name if roles.odometry is not None else f"tf from {roles.odometry_frame}"
        info = f", {roles.camera_info.name}" if roles.camera_info is not None else ""
        self._tell(f"localizes by {roles.image.name}{info} and {odometry}")
        for notice in self._model.observation.notices:
            self._tell(notice)
        self._tell_problems()
