"""Images and odometry that come by callbacks, in any order -> estimates, with the pairing of `run` and `live`."""

from __future__ import annotations

import heapq
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError, require_within
from filtering.estimate import Estimate
from filtering.localizer import ParticleLocalizer
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import MotionNoise, Odometry, WhiteNoise
from filtering.observation import ONLY_CAMERA, Observation, require_time
from filtering.se3 import Poses
from sequences.reading.counts import NOT_INCREASING
from sequences.reading.frame_times import FrameTimes
from sequences.reading.odometry_stream import OdometryStream

_MOST_WAITING = 64  # observations, some hundred kilobytes each
_CLOCK_SET_NS = 10 * 10**9  # further back no message is late
_KEPT_NS = 2 * 10**9  # of odometry after the last image, beside what an image may be late by
_NO_PLACE = "no place in the first image"


@dataclass(frozen=True)
class StreamEstimate:
    """The belief after one image came to its turn, and the robot's poses by it.

    Attributes:
        time_ns: Time of the belief: that of the latest image, also after a late one.
        estimate: The filter's estimate.
        map_from_base: Pose of the base then, by the best mode, one pose.
        map_from_odom: Transform from the map to the odometry's frame, one pose; None unless converged, and where no
            odometry covers the time. That of velocities or increments is where these began.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> place = vapor.Poses.from_quat_xyzw([[1, 2, 0]], [[0, 0, 0, 1]])
        >>> posterior = vapor.PosePosterior.from_estimates(place, 0.1, 0.05, vapor.MeasurementNoise())  # m, rad
        >>> localizer = vapor.ParticleLocalizer(None, rng=np.random.default_rng(0))
        >>> stream = vapor.StreamLocalizer(localizer, wait_s=0.0)
        >>> (now,) = stream.add_observation(vapor.Observation.of_posterior(posterior, None, time_ns=5))
        >>> now.time_ns, now.map_from_base.translation.round(1), now.map_from_odom  # no odometry yet
        (5, array([1., 2., 0.]), None)
    """

    time_ns: int
    estimate: Estimate
    map_from_base: Poses
    map_from_odom: Poses | None


class StreamLocalizer:
    """Localizes from images and odometry as they come, by callbacks, in any order.

    An image waits until odometry has come as far as it, and gets the motion since the image before it in time. The
    network sees it at once, so only its posterior waits. Each call returns the estimates of the images whose turn has
    come with it: none, one or several.

    Any thread may call any method: odometry is taken while the network is busy with an image. What comes out of order,
    and what is left out:

    - poses of odometry may come in any order, and count for the images whose turn comes after them; of velocities and
      increments, and of two messages of one time, what comes out of order is left out;
    - an image that is older than the latest one by at most `LocalizerConfig.late_window_s` is fused at its own time; an
      older one, and a second one of a camera and a time, is left out;
    - an image that odometry has not reached when something `wait_s` newer is there goes without: its motion is unknown;
    - where no image comes for seconds, the belief follows the odometry;
    - a message 10 s older than the latest one is an error: a clock was set back. `forget` begins anew. A clock that is
      set forward is a time without odometry.

    What is left out is counted in `skipped`. Memory is bounded: some seconds of odometry, and 64 posteriors.

    Args:
        localizer: The filter, with a model for `add_image`; nothing else may step it.
        base_from_camera: Pose of the camera on the base whose odometry comes, one pose; None where it is the camera's.
        motion_noise: Noise of odometry that comes without a covariance, such as a model's
            `description.calibration.odometry`; None for the usual one.
        wait_s: How long an image waits for odometry, seconds by the stamps; 0 for images alone.

    Attributes:
        skipped: How many images and messages of odometry were left out, by reason.

    Raises:
        VaporTrackError: `wait_s` is not from 0 to 60, or `base_from_camera` is not one finite pose.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> model = vapor.VaporObservationModel.from_checkpoint("place.safetensors")
        >>> localizer = vapor.ParticleLocalizer(model, rng=np.random.default_rng(0))
        >>> camera_on_robot = vapor.Poses.from_quat_xyzw([0.2, 0, 0.5], [-0.5, 0.5, -0.5, 0.5])
        >>> stream = vapor.StreamLocalizer(localizer, base_from_camera=camera_on_robot)
        >>> def publish(estimates):
        ...     for now in estimates:
        ...         print(now.time_ns, now.map_from_base.batch_shape)
        >>> image = np.random.default_rng(0).integers(0, 256, (32, 48, 3), np.uint8)
        >>> publish(stream.add_odometry(0, vapor.Poses.identity()))  # each in its callback
        >>> publish(stream.add_image(50_000_000, image))  # waits for odometry
        >>> publish(stream.add_odometry(100_000_000, vapor.Poses.from_quat_xyzw([0.1, 0, 0], [0, 0, 0, 1])))
        50000000 ()
    """

    def __init__(
        self,
        localizer: ParticleLocalizer,
        *,
        base_from_camera: Poses | None = None,
        motion_noise: WhiteNoise | None = None,
        wait_s: float = 0.5,
    ) -> None:
        self.wait_s = wait_s
        require_within(self, wait_s=(0.0, 60.0))
        self._localizer = localizer
        self._base_from_camera = Poses.identity() if base_from_camera is None else base_from_camera
        self._motion_noise = motion_noise or MotionNoise()
        self._late_ns = round(localizer.config.late_window_s * 1e9)
        self._state, self._network = threading.Lock(), threading.Lock()
        self._past = Counter[str]()
        self._numbers = count()
        self._at_network = 0  # images
        self._begin()

    def _begin(self) -> None:
        self._odometry = OdometryStream(self._base_from_camera, self._motion_noise)
        self._frames = FrameTimes(self._odometry, self._late_ns)
        self._waiting: list[tuple[int, int, Observation]] = []  # a heap, by time
        self._newest_ns: int | None = None  # stamp of anything

    @property
    def skipped(self) -> Counter[str]:
        """How many images and messages of odometry were left out so far, by reason."""
        with self._state:
            return self._past + self._odometry.skipped

    # --- odometry ---------------------------------------------------------------------------------

    def add_odometry(
        self, time_ns: int, odom_from_base: Poses, twist_covariance: Float64[np.ndarray, "6 6"] | None = None
    ) -> list[StreamEstimate]:
        """Take a pose of the base by odometry, as nav_msgs/Odometry has it.

        Args:
            time_ns: When the base was there, integer nanoseconds.
            odom_from_base: In a frame in which the base moves steadily, one pose; where it jumps the motion is unknown,
                and between poses more than 0.5 s apart.
            twist_covariance: Of the base's velocity (v, ω) on the way there, (m/s)² and (rad/s)²; None or zeros where
                unknown. That of a message is flat: `np.reshape(message.twist.covariance, (6, 6))`.

        Raises:
            VaporTrackError: a value is invalid, it is 10 s older than the latest message, or odometry came in another
                form. Nothing is changed then.
        """
        return self._with_odometry(time_ns, lambda: self._odometry.add_pose(time_ns, odom_from_base, twist_covariance))

    def add_velocity(
        self, time_ns: int, velocity: Float64[np.ndarray, " 6"], covariance: Float64[np.ndarray, "6 6"] | None = None
    ) -> list[StreamEstimate]:
        """Take a velocity of the base, which it had since the one before; after 0.5 s without any, motion is unknown.

        Args:
            time_ns: When it was measured, integer nanoseconds.
            velocity: (vx, vy, vz, ωx, ωy, ωz), m/s and rad/s, along and about the axes of the base.
            covariance: Of it; None or zeros where unknown.

        Raises:
            VaporTrackError: as `add_odometry`.
        """
        return self._with_odometry(time_ns, lambda: self._odometry.add_velocity(time_ns, velocity, covariance))

    def add_increment(self, time_ns: int, odometry: Odometry) -> list[StreamEstimate]:
        """Take a motion of the base, its duration and covariance. Where one is lost, the motion is unknown.

        Args:
            time_ns: When it ended, integer nanoseconds.
            odometry: The motion, of the base; a covariance of zeros is an unknown one. Over an `Odometry.turn` the
                rotation alone is known.

        Raises:
            VaporTrackError: as `add_odometry`.
        """
        return self._with_odometry(time_ns, lambda: self._odometry.add_increment(time_ns, odometry))

    def _with_odometry(self, time_ns: int, add: Callable[[], None]) -> list[StreamEstimate]:
        with self._state:
            self._require_clock(time_ns)
            add()
            estimates = self._come(time_ns)
            self._settle()
            return estimates

    # --- images -----------------------------------------------------------------------------------

    def add_image(
        self,
        time_ns: int,
        image: np.ndarray,
        *,
        camera: str = ONLY_CAMERA,
        reference_from_camera: Poses | None = None,
    ) -> list[StreamEstimate]:
        """Take an image, which the network sees at once.

        Args:
            time_ns: When it was taken, integer nanoseconds, by the clock of the odometry.
            image: RGB, uint8, (H, W, 3).
            camera: Name of the camera, of several.
            reference_from_camera: Pose of that camera in the one that is localized, one pose; None where it is that.

        Raises:
            VaporTrackError: the model refuses the image, or its time is invalid or 10 s older than the latest message.
                Nothing is changed then.
        """
        with self._state:
            self._require_clock(time_ns)
            if not self._frames.admits(time_ns, camera):
                self._past[NOT_INCREASING] += 1
                return []
            self._at_network += 1
        try:
            with self._network:
                posterior = self._localizer.observe(image, camera=camera)
        finally:
            with self._state:
                self._at_network -= 1
        return self.add_observation(
            Observation.of_posterior(
                posterior, None, time_ns=time_ns, reference_from_camera=reference_from_camera, camera=camera
            )
        )

    def add_observation(self, observation: Observation) -> list[StreamEstimate]:
        """Take what was observed at one time, without its motion: posteriors of your own, views of several cameras.

        Args:
            observation: With a time and without odometry: an `Observation` of a `View` of each camera or, of one,
                `Observation.of_posterior(posterior, None, time_ns=time_ns)`.

        Raises:
            VaporTrackError: there is no view or no time, there is odometry, or the time is 10 s older than the latest
                message. Nothing is changed then.
        """
        time_ns = observation.time_ns
        if time_ns is None or not observation.views or observation.odometry is not None:
            raise VaporTrackError(
                f"observation at {time_ns} with {len(observation.views)} views and odometry {observation.odometry},"
                " expected a time_ns, at least one view, and no odometry, which the stream has"
            )
        with self._state:
            self._require_clock(time_ns)
            heapq.heappush(self._waiting, (time_ns, next(self._numbers), observation))
            return self._come(time_ns)

    def flush(self) -> list[StreamEstimate]:
        """Let no image wait any longer, as at the end of a recording."""
        with self._state:
            return self._take(lambda _: True)

    # --- restarts ---------------------------------------------------------------------------------

    def forget(self) -> None:
        """Forget where the camera is, all odometry, and what waits: everything begins anew, at any time."""
        with self._network, self._state:
            self._past += self._odometry.skipped
            self._localizer.forget()
            self._begin()

    def start_at(
        self, time_ns: int, world_from_camera: Poses, covariance: Float64[np.ndarray, "6 6"], noise: MeasurementNoise
    ) -> Estimate:
        """Start at a stated pose, see `ParticleLocalizer.start_at`; earlier images are left out.

        Where odometry does not cover the time yet, the motion after it is unknown.

        Raises:
            VaporTrackError: the pose, its covariance or the time is invalid.
        """
        with self._network, self._state:
            self._require_clock(time_ns)
            estimate = self._localizer.start_at(world_from_camera, covariance, noise, time_ns=time_ns)
            self._frames.settle(time_ns)
            return estimate

    # --- turns ------------------------------------------------------------------------------------

    def _require_clock(self, time_ns: int) -> None:
        require_time(time_ns)
        newest_ns = self._newest_ns
        if newest_ns is not None and newest_ns - time_ns > _CLOCK_SET_NS:
            raise VaporTrackError(
                f"a message at {time_ns} ns is {(newest_ns - time_ns) * 1e-9:.1f} s older than the latest, at"
                f" {newest_ns} ns, expected at most {_CLOCK_SET_NS * 1e-9:g} s; if the clock was set back, `forget`"
                " begins anew"
            )

    def _come(self, time_ns: int) -> list[StreamEstimate]:
        """Estimates of what need not wait any longer, now that something of a time came."""
        newest_ns = self._newest_ns = max(time_ns, self._newest_ns or time_ns)
        waits_ns = round(self.wait_s * 1e9)

        def is_due(taken_ns: int) -> bool:
            is_too_many = len(self._waiting) > _MOST_WAITING
            return self._odometry.reaches(taken_ns) or newest_ns - taken_ns >= waits_ns or is_too_many

        return self._take(is_due)

    def _take(self, is_due: Callable[[int], bool]) -> list[StreamEstimate]:
        estimates: list[StreamEstimate] = []
        while self._waiting and is_due(self._waiting[0][0]):
            estimate = self._step(heapq.heappop(self._waiting)[2])
            estimates += [] if estimate is None else [estimate]
        return estimates

    def _step(self, observation: Observation) -> StreamEstimate | None:
        """Step the filter; None, and a count of why, where an observation is left out."""
        time_ns, cameras = observation.time_ns, [view.camera for view in observation.views]
        assert time_ns is not None
        if not all(self._frames.admits(time_ns, camera) for camera in cameras):
            self._past[NOT_INCREASING] += 1
            return None
        posteriors = [view.posterior for view in observation.views]
        if self._localizer.belief.hypotheses is None and not any(each.weights.any() for each in posteriors):
            self._past[_NO_PLACE] += 1
            return None
        estimate = self._localizer.advance(replace(observation, odometry=self._frames.motion_until(time_ns)))
        for camera in cameras:
            self._frames.add(time_ns, camera)
        latest_ns = self._frames.latest_taken_ns
        assert latest_ns is not None
        map_from_base = estimate.modes[0].world_from_camera @ self._base_from_camera.inverse()
        odom_from_base = self._odometry.odom_from_base(latest_ns)
        map_from_odom = None
        if estimate.status == "converged" and odom_from_base is not None:
            map_from_odom = map_from_base @ odom_from_base.inverse()
        return StreamEstimate(latest_ns, estimate, map_from_base, map_from_odom)

    def _settle(self) -> None:
        """Follow odometry for good where no image comes for long, so that no more of it need be kept."""
        end_ns, begin_ns = self._odometry.end_ns, self._frames.latest_ns
        if end_ns is None or self._waiting or self._at_network:
            return
        settled_ns = end_ns - _KEPT_NS - self._late_ns - round(self.wait_s * 1e9)
        if begin_ns is None:
            self._odometry.forget_before(settled_ns)
        elif settled_ns - begin_ns > _KEPT_NS:
            motion = self._frames.moved_until(settled_ns)
            if self._localizer.belief.hypotheses is not None:
                self._localizer.predict(motion, time_ns=settled_ns)
            self._frames.settle(settled_ns)
