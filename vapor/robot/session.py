"""The loop of live localization: messages in, the newest image to the network, its posterior to the filter, poses out.

One thread takes messages, steps the filter, publishes, and holds all state.
"""

from __future__ import annotations

import asyncio
import queue
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate
from filtering.posterior import PosePosterior
from sequences.live.transport import Offer, Transport
from sequences.options import ReadingOptions
from sequences.recordings.message_definitions import decoder
from sequences.recordings.messages import frame_name, stamp_ns
from sequences.recordings.source import RawMessage
from vapor.pipeline.model import LoadedModel
from vapor.pipeline.odometry import require_one_source
from vapor.reporting.rerun_place import Place
from vapor.reporting.rerun_viewer import RerunViewer
from vapor.robot.belief import LiveBelief, LiveEstimate
from vapor.robot.config import LiveConfig
from vapor.robot.health import Health
from vapor.robot.network import Job, Network, Observed
from vapor.robot.opening import open_belief, what_is_used
from vapor.robot.publisher import Publisher, camera_of_initial_pose
from vapor.robot.recorder import MessageRecorder, write_snapshot
from vapor.robot.viewers import FoxgloveServer, WatchingViewer
from vapor.threads import limited_threads

LAYOUT = Path(__file__).with_name("foxglove_layout.json")
"""For Foxglove, to import."""
_TICK_S = 1.0  # between diagnostics
_REFRESH_TICKS = 5  # between looks at who publishes
_AT_ONCE = 500
_BEFORE_CLOCK = 2000
_MOST_WAITING = 10  # each has its image
_CLOCK, _INITIAL_POSE = "/clock", "/initialpose"


class _Stopped(Exception):
    """An event: end."""


class LiveSession:
    """Localizes one robot from its topics until it is stopped; see `live` for the arguments."""

    def __init__(
        self,
        model: LoadedModel,
        transport: Transport,
        reading: ReadingOptions,
        config: LiveConfig,
        notify: Callable[[str], None],
    ) -> None:
        require_one_source(config.odometry, reading)
        self._model, self._transport, self._reading, self._config = model, transport, reading, config
        self._on_estimate: Callable[[LiveEstimate], None] = lambda _: None
        self._notify, self._has_begun = notify, False
        self._events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._controls = {
            _INITIAL_POSE: ("geometry_msgs/PoseWithCovarianceStamped", self._set_pose),
            f"{config.under}/reset": ("std_msgs/Empty", self._reset),
            f"{config.under}/save_snapshot": ("std_msgs/Empty", self._save_snapshot),
        }
        if config.sim_time:
            self._controls[_CLOCK] = ("rosgraph_msgs/Clock", self._set_clock)
        self._health = Health()
        self._belief: LiveBelief | None = None  # before topics are found
        self._clock_ns: int | None = None
        self._before_clock: deque[RawMessage] = deque(maxlen=_BEFORE_CLOCK)
        self._status = ""

    @property
    def skipped(self) -> dict[str, int]:
        """Number of images that were left out so far, by reason."""
        return self._health.skipped

    @property
    def localized(self) -> int:
        """Number of images that were localized so far."""
        return self._health.localized

    def stop(self) -> None:
        """End soon; callable from any thread."""
        self._events.put(_Stopped())

    async def __aiter__(self) -> AsyncIterator[LiveEstimate]:
        """Estimates as they come, until the loop over them ends; of ten that wait the oldest is dropped.

        Raises:
            VaporTrackError: as `run`.
        """
        loop = asyncio.get_running_loop()
        waiting: asyncio.Queue[LiveEstimate | BaseException | None] = asyncio.Queue()

        def put(item: LiveEstimate | BaseException | None) -> None:
            if waiting.qsize() >= _MOST_WAITING:
                waiting.get_nowait()
            waiting.put_nowait(item)

        def hand_over(item: LiveEstimate | BaseException | None) -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(put, item)

        def work() -> None:
            end: BaseException | None = None
            try:
                self.run(hand_over)
            except BaseException as error:
                end = error
            hand_over(end)

        thread = threading.Thread(target=work, name="live", daemon=True)
        thread.start()
        try:
            while (item := await waiting.get()) is not None:
                if isinstance(item, BaseException):
                    raise item
                yield item
        finally:
            self.stop()
            await asyncio.to_thread(thread.join)

    def run(self, on_estimate: Callable[[LiveEstimate], None] = lambda _: None) -> None:
        """Localize until `stop` is called, or an interruption comes, and close the transport.

        Args:
            on_estimate: Called after every image; until it returns, the loop waits.

        Raises:
            VaporTrackError: the topics cannot be used, or an output cannot be written or served.
        """
        if self._has_begun:
            raise VaporTrackError("this live localization has ended, expected another call of `live`")
        self._has_begun = True
        config, self._on_estimate = self._config, on_estimate
        with ExitStack() as block:
            block.callback(self._transport.close)
            block.enter_context(limited_threads(config.threads))
            self._recorder: MessageRecorder | None = None
            if config.record is not None:
                path = config.record.with_name(time.strftime(config.record.name))
                self._recorder = self._health.recorder = block.enter_context(MessageRecorder(path))
            self._foxglove: FoxgloveServer | None = None
            if config.foxglove:
                server = FoxgloveServer(config.foxglove_host, config.foxglove_port)
                self._foxglove = block.enter_context(server)
                host = f"[{config.foxglove_host}]" if ":" in config.foxglove_host else config.foxglove_host
                self._notify(f"Foxglove: ws://{host}:{server.port}, layout {LAYOUT}")
            self._viewer: WatchingViewer | None = None
            if config.view or config.view_at is not None:
                started = time.strftime("%Y-%m-%d %H:%M:%S")  # distinguishes two sessions in one viewer
                place = Place.of_model(self._model.observation.description)
                title = f"{self._model.name} {started}"
                opened = partial(
                    RerunViewer, spawn=config.view, connect=config.view_at, title=title, place=place, live=True
                )
                self._viewer = block.enter_context(WatchingViewer(opened, self._notify))
            self._publisher = Publisher(
                self._transport,
                self._foxglove,
                config,
                hardware=self._model.name,
                storeys=self._model.observation.storeys,
                now_ns=self._now_ns,
                notify=self._notify,
            )
            for topic, (message_type, _) in self._controls.items():
                offer = Offer(topic, message_type, reliable=False, latched=False)  # hears both kinds of publishers
                self._transport.subscribe(offer, self._events.put)
            try:
                self._loop(self._open())
            except _Stopped:
                return

    def _open(self) -> LiveBelief:
        belief = open_belief(
            self._model,
            self._config,
            self._reading,
            transport=self._transport,
            events=self._events,
            admit=self._admit,
            waiting=self._say_waiting,
        )
        self._belief = self._health.belief = belief
        used = what_is_used(belief, self._model.observation.description.cameras, self._reading)
        for line in [*used, *self._model.observation.notices, *self._health.notices()]:
            self._notify(line)
        return belief

    # --- events -------------------------------------------------------------------------------------

    def _loop(self, belief: LiveBelief) -> None:
        with Network(belief.observe, self._events.put) as self._network:
            ticks, next_s = 0, time.monotonic() + _TICK_S
            while True:
                self._take_all(belief, max(next_s - time.monotonic(), 0.0))
                self._submit(belief)
                self._publisher.send_motion(belief, self._network.job)
                if time.monotonic() >= next_s:
                    ticks, next_s = ticks + 1, time.monotonic() + _TICK_S
                    if ticks % _REFRESH_TICKS == 0:
                        belief.reader.sensors.look_again(changed=belief.reader.heard.refresh())
                    self._tick(belief)

    def _take_all(self, belief: LiveBelief, timeout_s: float) -> None:
        for _ in range(_AT_ONCE):
            try:
                event = self._events.get(timeout=timeout_s)
            except queue.Empty:
                return
            timeout_s = 0.0
            if isinstance(event, Observed):
                self._localize(belief, event)
            elif (raw := self._admit(event)) is not None:
                is_later = belief.reader.take(raw)
                if raw.topic in belief.reader.lenses:
                    self._health.image_came(raw.topic)
                elif is_later:
                    self._health.odometry_came()

    def _admit(self, event: Any) -> RawMessage | None:
        """Record and serve an event; gives the messages to be read. Raises _Stopped after `stop`."""
        if isinstance(event, _Stopped):
            raise event
        if not isinstance(event, RawMessage):
            return None
        if self._config.sim_time and event.topic != _CLOCK:
            if self._clock_ns is None:
                self._before_clock.append(event)
                return None
            event = event._replace(log_time_ns=self._clock_ns)
        if self._recorder is not None:
            self._recorder.write(event)
        if event.topic in self._controls:
            self._control(event)
            return None
        if self._foxglove is not None:
            self._foxglove.write(event)
        return event

    # --- control messages -----------------------------------------------------------------------------

    def _control(self, raw: RawMessage) -> None:
        message_type, control = self._controls[raw.topic]
        try:
            message = decoder(message_type)(raw.data)
        except Exception as error:  # damaged bytes raise whatever they lead to
            problem = error or type(error).__name__
            self._notify(f"{raw.topic}: {len(raw.data)} bytes cannot be decoded as {message_type}: {problem}")
            return
        try:
            control(message)
        except (VaporTrackError, OSError) as error:
            self._notify(f"{raw.topic}: {error}")

    def _now_ns(self) -> int:
        return time.time_ns() if self._clock_ns is None else self._clock_ns

    def _set_clock(self, message: Any) -> None:
        self._clock_ns = int(message.clock.sec) * 1_000_000_000 + int(message.clock.nanosec)
        while self._before_clock:
            self._events.put(self._before_clock.popleft())

    def _reset(self, _: Any) -> None:
        if self._belief is not None:
            self._belief.forget()
            self._network.forget()
            self._publisher.forget()
        self._notify("reset")

    def _set_pose(self, message: Any) -> None:
        belief = self._belief
        if belief is None or (time_ns := belief.reader.latest_ns) is None:
            raise VaporTrackError("no odometry and no image yet, expected some before a pose is stated")
        frame = frame_name(message.header.frame_id)
        if frame != frame_name(self._config.map_frame):
            raise VaporTrackError(f"pose in {frame!r}, expected one in {self._config.map_frame!r}")
        description = self._model.observation.description
        pose, covariance = camera_of_initial_pose(message, belief.reader.base_from_camera, description.prior_poses)
        if belief.reader.odom_from_base(stamp_ns(message.header)) is not None:  # else it holds for now
            time_ns = stamp_ns(message.header)
        anchor = belief.start_at(time_ns, pose, covariance, description.calibration.errors)
        self._network.forget()
        self._publisher.forget()
        self._believe(belief, time_ns, anchor.estimate)
        self._notify(f"starts at x {pose.translation[0]:.2f} m, y {pose.translation[1]:.2f} m, by {_INITIAL_POSE}")

    def _save_snapshot(self, _: Any) -> None:
        anchor = None if self._belief is None else self._belief.anchor
        if anchor is None or anchor.frame is None:
            raise VaporTrackError("no image was localized yet, expected an estimate to save")
        path = write_snapshot(self._config.snapshots, anchor.frame, self._publisher.last_sent)
        self._notify(f"snapshot {path}")

    # --- images -------------------------------------------------------------------------------------

    def _submit(self, belief: LiveBelief) -> None:
        reader = belief.reader
        belief.frames.advance()
        if self._network.job is not None or (frame := belief.frames.newest()) is None:
            return
        arrived_ns = reader.arrived_ns(frame.time_ns)
        pose = reader.odom_from_base(frame.time_ns)
        self._network.start(Job(frame, reader.readings, pose, self._now_ns() if arrived_ns is None else arrived_ns))

    def _localize(self, belief: LiveBelief, observed: Observed) -> None:
        job, posterior = observed.job, observed.posterior
        counts = self._network.end(job)
        self._submit(belief)
        if isinstance(posterior, BaseException):
            if not isinstance(posterior, VaporTrackError):
                raise posterior
            self._refuse(posterior)
            posterior = PosePosterior.uninformative()  # the belief moves all the same
        if not counts:
            return
        try:
            anchor = belief.update(job, posterior)
        except VaporTrackError as error:
            self._refuse(error)
            return
        self._believe(belief, anchor.time_ns, anchor.estimate)
        self._publisher.send_lagged(belief)
        self._publisher.send_motion(belief, self._network.job)
        latency_ms = (self._now_ns() - job.arrived_ns) * 1e-6
        self._health.image_was_localized(latency_ms)
        self._health.left_out(anchor.estimate.left_out)
        estimate, frame = anchor.estimate, anchor.frame
        assert frame is not None
        if self._viewer is not None and frame is job.frame:
            self._viewer.log(frame, estimate, posterior.samples)
        map_from_odom = belief.map_from_odom(anchor) if estimate.status == "converged" else None
        map_from_base = belief.map_from_base(estimate)
        self._on_estimate(LiveEstimate(frame, estimate, map_from_base, map_from_odom, latency_ms, self.skipped))

    def _refuse(self, error: VaporTrackError) -> None:
        if not self._health.refused:
            self._notify(f"an image could not be used: {error}")
        self._health.refused += 1

    # --- reports ------------------------------------------------------------------------------------

    def _believe(self, belief: LiveBelief, time_ns: int, estimate: Estimate) -> None:
        belief.now = estimate
        self._publisher.send_belief(time_ns, estimate)
        if estimate.status != self._status:
            self._status = estimate.status
            best = estimate.modes[0]
            self._notify(f"{estimate.status}: best of {len(estimate.modes)} modes {100 * best.weight:.0f} %")
            self._send_diagnostics()

    def _tick(self, belief: LiveBelief) -> None:
        for notice in self._health.notices():
            self._notify(notice)
        if self._network.job is None:
            belief.settle()
        anchor = belief.anchor
        if anchor is not None and self._health.is_old(anchor):
            self._believe(belief, *belief.predicted(anchor, self._network.job, by_odometry=self._health.has_odometry))
        self._send_diagnostics()

    def _send_diagnostics(self, waits: str | None = None) -> None:
        belief = self._belief
        silent = waits or self._health.silent(None if belief is None else belief.anchor)
        self._publisher.send_diagnostics(None if belief is None else belief.now, silent, self._health.values())

    def _say_waiting(self, problem: str) -> None:
        if self._config.sim_time and self._clock_ns is None:
            problem = f"no message on {_CLOCK} yet (--sim-time)"
        self._notify(f"waits: {problem}")
        self._send_diagnostics(f"waits: {problem}")
