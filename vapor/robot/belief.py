"""What is believed of a moving robot: by the filter at its last image, and by odometry from there on."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import overload

import numpy as np
from jaxtyping import Float64

from filtering.error_model import ErrorModel
from filtering.estimate import Estimate
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.novelty import NoveltyTracker
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.frame import Frame
from sequences.live.reader import LiveReader
from sequences.odometry_fit.result import OdometryFit
from vapor.observation import VaporObservationModel
from vapor.robot.network import Job

_NEW_VIEW, _VERIFIED_S = 0.1, 1.0  # normalized distance and seconds until landmarks are looked for again
_FITS = 0.9  # agreement below which every image is looked at
_SETTLE_S, _SETTLED_S = 4.0, 2.0  # without images the belief follows odometry for good after so long, to so long ago


@dataclass(frozen=True)
class Anchor:
    """What is believed of the last image that was localized, or of what somebody stated, and what leads on from it.

    Attributes:
        time_ns: Its stamp.
        reading: Of which reading it is, see `LiveReader.readings`.
        estimate: What the filter believes.
        map_from_odom: By the best mode, one pose; None where the odometry at that time is not known.
        frame: The image; None where it was stated.
        began_s: When it was there, of `time.monotonic`.
    """

    time_ns: int
    reading: int
    estimate: Estimate
    map_from_odom: Poses | None
    frame: Frame | None
    began_s: float = field(default_factory=time.monotonic)

    @property
    def age_s(self) -> float:
        """How long it has been there."""
        return time.monotonic() - self.began_s


class LiveBelief:
    """The belief about a robot that moves on while its images are at the network.

    Args:
        localizer: The filter.
        model: What it observes images by.
        reader: What odometry is from.
        fit: What the model's calibration found of odometry; None to believe what the odometry says of itself.

    Attributes:
        localizer: The filter.
        reader: What odometry is from.
        anchor: The last image that was localized; None before the first.
        now: What was published last, which is of a later time where images are silent; None before the first.
    """

    def __init__(
        self,
        localizer: ParticleLocalizer,
        model: VaporObservationModel,
        reader: LiveReader,
        fit: OdometryFit | None,
    ) -> None:
        self.localizer, self.reader, self._model, self._fit = localizer, reader, model, fit
        self.anchor: Anchor | None = None
        self.now: Estimate | None = None
        errors = model.description.calibration.errors.finest
        self._views = NoveltyTracker(errors.length_m, errors.length_rad)
        self._verified_s = -np.inf  # when landmarks were last looked for, of `time.monotonic`

    def observe(self, frame: Frame) -> PosePosterior:
        """The posterior of an image, see `ParticleLocalizer.observe`.

        With a map of landmarks, an image whose view is not new has no places: by odometry it would say what the one
        before said, and landmarks are not looked for in it.
        """
        self._model.camera = frame.camera  # which may zoom
        self._model.verifies = self._model.verifier is None or self._is_new(frame.odometry)
        posterior = self.localizer.observe(frame.image)
        return posterior if self._model.verifies else posterior.without_places()

    def _is_new(self, motion: Odometry | None) -> bool:
        """Whether landmarks are to be looked for: unless the belief is sure, and the view is that of the last time.

        That is so where odometry says that the camera has hardly moved since, less than a second ago.
        """
        if motion is not None:
            self._views, _ = self._views.predict(motion.previous_from_current)
        now_s = time.monotonic()
        anchor, lately = self.anchor, now_s - self._verified_s < _VERIFIED_S
        sure = anchor is not None and anchor.estimate.status == "converged" and anchor.estimate.agreement >= _FITS
        if sure and motion is not None and lately and self._views.normalized_distance < _NEW_VIEW:
            return False
        self._views, self._verified_s = self._views.observe()[0], now_s
        return True

    def update(self, job: Job, posterior: PosePosterior) -> Anchor:
        """Step the filter by what the network says of an image.

        Raises:
            VaporTrackError: the filter cannot use it; the belief is as before.
        """
        odometry = self._restated(job.frame.odometry)
        estimate = self.localizer.update(posterior, odometry, elapsed_s=self._until_s(job))
        map_from_odom = self._map_from_odom(estimate, job.odom_from_base)
        self.anchor = Anchor(job.frame.time_ns, job.reading, estimate, map_from_odom, job.frame, job.began_s)
        return self.anchor

    def forget(self) -> None:
        """Know nothing, from the latest odometry on."""
        self.localizer.forget()
        self._begin_at(self.reader.odometry_ns)

    def start_at(self, time_ns: int, pose: Poses, covariance: Float64[np.ndarray, "6 6"], errors: ErrorModel) -> Anchor:
        """Believe what somebody stated of a time.

        Args:
            time_ns: The time, which odometry has come to.
            pose: Of the camera, one pose.
            covariance: In the tangent at it.
            errors: Of the model, as `ParticleLocalizer.start_at` has them.
        """
        estimate = self.localizer.start_at(pose, covariance, errors)
        map_from_odom = self._map_from_odom(estimate, self.reader.odom_from_base(time_ns))
        self._begin_at(time_ns)
        self.anchor = Anchor(time_ns, self.reader.readings, estimate, map_from_odom, None)
        return self.anchor

    def _begin_at(self, time_ns: int | None) -> None:
        """Have neither the belief before count any longer, nor the motion."""
        self.anchor = self.now = None
        self._verified_s = -np.inf
        if time_ns is not None:
            self.reader.settle(time_ns)

    def settle(self) -> None:
        """Follow odometry for good where images are missing for long: what lies before need not be remembered.

        No image may be at the network.
        """
        reader, anchor = self.reader, self.anchor
        odometry_ns, frame_ns = reader.odometry_ns, reader.frame_ns
        if odometry_ns is None or frame_ns is None or odometry_ns - frame_ns <= _SETTLE_S * 1e9:
            return
        settled_ns = odometry_ns - round(_SETTLED_S * 1e9)
        motion, odom_from_base = self._restated(reader.moved_until(settled_ns)), reader.odom_from_base(settled_ns)
        reader.settle(settled_ns)
        self._verified_s = -np.inf  # its motion until then comes with no image
        if anchor is None:
            return
        elapsed_s = max(settled_ns - anchor.time_ns, 0) * 1e-9 if anchor.reading == reader.readings else _SETTLE_S
        estimate = self.localizer.predict(motion, elapsed_s=elapsed_s)
        self.anchor = replace(
            anchor,
            time_ns=settled_ns,
            reading=reader.readings,
            estimate=estimate,
            map_from_odom=self._map_from_odom(estimate, odom_from_base),
        )

    def predicted(self, anchor: Anchor, at_network: Job | None, *, by_odometry: bool) -> tuple[int, Estimate]:
        """The belief of now, and its stamp, where no image tells of it; that of the filter stays as it is.

        Args:
            anchor: The last image.
            at_network: One more image, which is at the network.
            by_odometry: Whether odometry tells of now; else one may have come as far as in that time one can.
        """
        time_ns, motion = self.reader.odometry_ns, None
        if by_odometry and time_ns is not None and anchor.reading == self.reader.readings:
            motion = self._motion_until(time_ns, at_network)
        later = self.localizer.predicted(motion, elapsed_s=anchor.age_s)
        return time_ns or anchor.time_ns, later

    def covariance_of_base(
        self, anchor: Anchor, time_ns: int, at_network: Job | None
    ) -> Float64[np.ndarray, "6 6"] | None:
        """Covariance of the base's pose in the tangent at it, by the best mode; None where the motion is not known."""
        if (motion := self._motion_until(time_ns, at_network)) is None:
            return None
        covariance = motion.carry @ anchor.estimate.modes[0].covariance @ motion.carry.T + motion.covariance
        carry = self.reader.base_from_camera.adjoint()
        return carry @ covariance @ carry.T

    def _motion_until(self, time_ns: int, at_network: Job | None) -> Odometry | None:
        """Motion of the camera since the anchor, with the errors of the fit; None where it is not known."""
        begin_ns = self.reader.frame_ns
        if begin_ns is None or time_ns <= begin_ns:
            later = Odometry(Poses.identity(), np.zeros((6, 6)), 0.0)
        elif (moved := self.reader.moved_until(time_ns)) is not None:
            later = moved
        else:
            return None
        if at_network is None:
            return self._restated(later)
        between = at_network.frame.odometry
        return None if between is None else self._restated(between.then(later))

    @overload
    def _restated(self, odometry: Odometry) -> Odometry: ...
    @overload
    def _restated(self, odometry: Odometry | None) -> Odometry | None: ...

    def _restated(self, odometry: Odometry | None) -> Odometry | None:
        """With the errors that the model's calibration found of its kind."""
        return odometry if odometry is None or self._fit is None else self._fit.restated(odometry)

    def _until_s(self, job: Job) -> float:
        """Seconds from the anchor: by stamps, but across a clock that was set by when images were there."""
        if self.anchor is None:
            return 0.0
        if self.anchor.reading != job.reading:
            return max(job.began_s - self.anchor.began_s, 0.0)
        return max(job.frame.time_ns - self.anchor.time_ns, 0) * 1e-9

    def _map_from_odom(self, estimate: Estimate, odom_from_base: Poses | None) -> Poses | None:
        if odom_from_base is None:
            return None
        return self.map_from_base(estimate) @ odom_from_base.inverse()

    def map_from_base(self, estimate: Estimate) -> Poses:
        """Pose of the base by the best mode, one pose."""
        return estimate.modes[0].world_from_camera @ self.reader.base_from_camera.inverse()
