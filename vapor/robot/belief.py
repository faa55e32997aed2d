"""The belief about a moving robot: the filter's at the last image, carried on by odometry."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from filtering.estimate import Estimate
from filtering.hindsight import FilterStep
from filtering.localizer import ParticleLocalizer
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import Odometry, measured
from filtering.novelty import NoveltyTracker
from filtering.observation import ONLY_CAMERA, Observation
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.frame import Frame
from sequences.live.frames import LiveFrames
from vapor.observation import VaporObservationModel
from vapor.pipeline.verticals import Verticals
from vapor.robot.network import Job
from vapor.tracking.hindsight import fixed_lag_smoother

if TYPE_CHECKING:
    from filtering.fixed_lag import LaggedPose

_NEW_VIEW, _VERIFIED_S = 0.1, 1.0  # normalized distance and seconds until landmarks are looked for again
_FITS = 0.9  # agreement below which every image is looked at
_SETTLE_S, _SETTLED_S = 4.0, 2.0  # without images the belief follows odometry for good after so long, to so long ago


@dataclass(frozen=True)
class Anchor:
    """The belief at the last localized image, or at a stated pose (without a frame), from which odometry leads on.

    `odom_from_base` is the base's pose by odometry at `time_ns`, None where it is unknown. `reading` is that of
    `LiveReader.readings`, `began_s` the time of arrival by `time.monotonic`.
    """

    time_ns: int
    reading: int
    estimate: Estimate
    odom_from_base: Poses | None
    frame: Frame | None
    began_s: float = field(default_factory=time.monotonic)

    @property
    def age_s(self) -> float:
        """Seconds since its arrival."""
        return time.monotonic() - self.began_s


@dataclass(frozen=True)
class LiveEstimate:
    """The belief after one image, and the robot's poses by it.

    Attributes:
        frame: The newest image, its stamp, and the odometry since the image before; the same again after a late image.
        estimate: The filter's estimate.
        map_from_base: Pose of the odometry's child frame at the time of the image, by the best mode, one pose; without
            published odometry of the base, or of the camera where nothing says how it is mounted.
        map_from_odom: Transform from the map to the odometry's frame, one pose; None unless converged, and without
            published odometry.
        latency_ms: Milliseconds from the arrival of the image, or the late one, to this estimate.
        skipped: Number of images that were skipped so far, by reason.

    Example:
        >>> import vapor
        >>> def say(now: vapor.LiveEstimate) -> None:
        ...     print(now.time_ns, now.estimate.status, now.map_from_base.translation, f"{now.latency_ms:.0f} ms")
        >>> session = vapor.live("place.safetensors")  # then session.run(say)
        >>> session.localized
        0
    """

    frame: Frame
    estimate: Estimate
    map_from_base: Poses
    map_from_odom: Poses | None
    latency_ms: float
    skipped: Mapping[str, int]

    @property
    def time_ns(self) -> int:
        """Stamp of the image, integer nanoseconds."""
        return self.frame.time_ns


class LiveBelief:
    """The belief about a robot that moves on while the network processes its images.

    `anchor` is None before the first image. `now` is the latest published belief, later than the anchor if images are
    missing. With a `lag_s` above 0 it also has the pose of each image by the images until so many seconds later.
    `verticals` know a planar robot's tilt and height, and what gravity says.
    """

    def __init__(
        self,
        localizer: ParticleLocalizer,
        model: VaporObservationModel,
        frames: LiveFrames,
        lag_s: float,
        verticals: Verticals,
    ) -> None:
        self.localizer, self.frames, self.reader, self._model = localizer, frames, frames.reader, model
        self.verticals = verticals
        self.anchor: Anchor | None = None
        self.now: Estimate | None = None
        noise = model.description.calibration.errors.finest
        errors = model.description.calibration.errors
        self._smoother = None if lag_s == 0.0 else fixed_lag_smoother(errors, localizer.config, lag_s)
        self._waiting: deque[int] = deque()  # stamps of images whose fixed-lag pose is to come
        self._lagged: list[tuple[int, LaggedPose]] = []
        self._new_view = NoveltyTracker(noise.length_m, noise.length_rad)
        self._views: dict[str, NoveltyTracker] = {}  # since landmarks were last looked for, by camera
        self._verified_s: dict[str, float] = {}  # when that was, of `time.monotonic`
        self._ahead_ns = 0  # the filter's clock, which is never set, ahead of the stamps

    def observe(self, frame: Frame) -> PosePosterior:
        """The posterior of an image, see `ParticleLocalizer.observe`.

        With a map of landmarks, an image whose view is not new has no places, and no landmarks are looked for in it.
        """
        self._model.camera = frame.camera  # which may zoom
        self._model.verifies = self._model.verifier is None or self._is_new(frame)
        posterior = self.localizer.observe(frame.image, camera=frame.camera_name or ONLY_CAMERA)
        return posterior if self._model.verifies else posterior.without_places()

    def _is_new(self, frame: Frame) -> bool:
        """Whether to look for landmarks: the belief is unsure, or motion or a second passed since the last time."""
        motion, newest_ns, camera = measured(frame.odometry), self.reader.frame_ns, frame.camera_name
        is_late = newest_ns is not None and frame.time_ns < newest_ns  # its motion is part of one that was added
        if motion is not None and not is_late:
            step = motion.previous_from_current
            self._views = {name: views.predict(step)[0] for name, views in self._views.items()}
        views, now_s = self._views.get(camera, self._new_view), time.monotonic()
        anchor, lately = self.anchor, now_s - self._verified_s.get(camera, -np.inf) < _VERIFIED_S
        sure = anchor is not None and anchor.estimate.status == "converged" and anchor.estimate.agreement >= _FITS
        if sure and motion is not None and lately and views.normalized_distance < _NEW_VIEW:
            return False
        self._views[camera], self._verified_s[camera] = views.observe()[0], now_s
        return True

    def update(self, job: Job, posterior: PosePosterior) -> Anchor:
        """Step the filter by an image's posterior.

        Raises:
            VaporTrackError: the filter cannot use it; the belief is as before.
        """
        frame, anchor = job.frame, self.anchor
        ahead_ns = self._ahead_of(frame.time_ns, job.reading, job.began_s - (0.0 if anchor is None else anchor.began_s))
        time_ns = frame.time_ns + ahead_ns
        elapsed_s = 0.0 if anchor is None else max(time_ns - anchor.time_ns - self._ahead_ns, 0) * 1e-9
        observation = Observation.of_posterior(
            posterior,
            frame.odometry,
            elapsed_s,
            time_ns,
            reference_from_camera=frame.reference_from_camera,
            camera=frame.camera_name or ONLY_CAMERA,
        )
        is_localized = frame.reference_from_camera is None
        vertical = self.verticals.step(observation.posterior, frame.gravity, is_localized=is_localized)
        observation = replace(observation, vertical=vertical)
        estimate = self.localizer.advance(observation)
        self._ahead_ns = ahead_ns
        if anchor is not None and anchor.reading == job.reading and frame.time_ns < anchor.time_ns:  # it was late
            self.anchor = replace(anchor, estimate=estimate)
        else:
            self.anchor = Anchor(frame.time_ns, job.reading, estimate, job.odom_from_base, frame, job.began_s)
            if self._smoother is not None:  # a late image comes too late for it
                self._waiting.append(frame.time_ns)
                self._give(self._smoother.update(FilterStep.of(observation, estimate)))
        return self.anchor

    def _ahead_of(self, time_ns: int, reading: int, elapsed_s: float) -> int:
        """How far the filter's clock is ahead of a stamp, so many seconds after the anchor where a clock was set."""
        anchor = self.anchor
        if anchor is None or anchor.reading == reading:
            return self._ahead_ns
        return anchor.time_ns + self._ahead_ns + max(round(elapsed_s * 1e9), 1) - time_ns

    def take_lagged(self) -> list[tuple[int, LaggedPose]]:
        """Fixed-lag poses of the camera that have come since the last call, with the stamps of their images."""
        taken, self._lagged = self._lagged, []
        return taken

    def _give(self, poses: Sequence[LaggedPose]) -> None:
        self._lagged += [(self._waiting.popleft(), pose) for pose in poses]

    def _end_lag(self) -> None:
        """Give the fixed-lag poses that are left: the next image does not follow the last one."""
        if self._smoother is not None:
            self._give(self._smoother.finish())

    def forget(self) -> None:
        """Start without a belief at the latest odometry."""
        self.localizer.forget()
        self._begin_at(self.reader.odometry_ns)

    def start_at(
        self, time_ns: int, pose: Poses, covariance: Float64[np.ndarray, "6 6"], noise: MeasurementNoise
    ) -> Anchor:
        """Start at a stated pose; the arguments are those of `ParticleLocalizer.start_at`, at a time with odometry."""
        estimate = self.localizer.start_at(pose, covariance, noise, time_ns=time_ns)
        odom_from_base = self.reader.odom_from_base(time_ns)
        self._begin_at(time_ns)
        self.anchor = Anchor(time_ns, self.reader.readings, estimate, odom_from_base, None)
        return self.anchor

    def _begin_at(self, time_ns: int | None) -> None:
        self.anchor = self.now = None
        self._end_lag()
        self._ahead_ns = 0
        self._verified_s.clear()
        if time_ns is not None:
            self.frames.settle(time_ns)

    def settle(self) -> None:
        """Follow odometry permanently where images are missing for long; no image may be at the network."""
        reader, anchor = self.reader, self.anchor
        odometry_ns, frame_ns = reader.odometry_ns, reader.frame_ns
        if odometry_ns is None or frame_ns is None or odometry_ns - frame_ns <= _SETTLE_S * 1e9:
            return
        settled_ns = odometry_ns - round(_SETTLED_S * 1e9)
        motion, odom_from_base = self.frames.moved_until(settled_ns), reader.odom_from_base(settled_ns)
        self.frames.settle(settled_ns)
        self._end_lag()
        self._verified_s.clear()  # its motion until then comes with no image
        if anchor is None:
            return
        self._ahead_ns = self._ahead_of(settled_ns, reader.readings, _SETTLE_S)
        estimate = self.localizer.predict(motion, time_ns=settled_ns + self._ahead_ns)
        self.anchor = replace(
            anchor, time_ns=settled_ns, reading=reader.readings, estimate=estimate, odom_from_base=odom_from_base
        )

    def predicted(self, anchor: Anchor, at_network: Job | None, *, by_odometry: bool) -> tuple[int, Estimate]:
        """The belief of now and its stamp, without changing the filter.

        Without `by_odometry` the motion since the anchor is unknown, of which that to an image `at_network` is a part.
        """
        time_ns, motion = self.reader.odometry_ns, None
        if by_odometry and time_ns is not None and anchor.reading == self.reader.readings:
            motion = self._motion_since(anchor, time_ns, at_network)
        later = self.localizer.predicted(motion, elapsed_s=anchor.age_s)
        return anchor.time_ns + round(anchor.age_s * 1e9) if time_ns is None else time_ns, later

    def covariance_of_base(
        self, anchor: Anchor, time_ns: int, at_network: Job | None
    ) -> Float64[np.ndarray, "6 6"] | None:
        """Covariance of the base's pose in its tangent, by the best mode; None where the motion is unknown."""
        if (motion := measured(self._motion_since(anchor, time_ns, at_network))) is None:
            return None
        covariance = motion.carry @ anchor.estimate.modes[0].covariance @ motion.carry.T + motion.covariance
        carry = self.reader.base_from_camera.adjoint()
        return carry @ covariance @ carry.T

    def _motion_since(self, anchor: Anchor, time_ns: int, at_network: Job | None) -> Odometry | None:
        motion = self.frames.moved_until(time_ns)
        if motion is not None and at_network is not None and at_network.frame.time_ns > anchor.time_ns:  # not late
            between = at_network.frame.odometry
            motion = None if between is None else between.then(motion)
        return motion

    def map_from_odom(self, anchor: Anchor) -> Poses | None:
        """Transform from the map to the odometry's frame by the best mode, one pose; None where odometry is unknown."""
        if anchor.odom_from_base is None:
            return None
        return self.map_from_base(anchor.estimate) @ anchor.odom_from_base.inverse()

    def map_from_base(self, estimate: Estimate) -> Poses:
        """Pose of the base by the best mode, one pose."""
        return estimate.modes[0].world_from_camera @ self.reader.base_from_camera.inverse()
