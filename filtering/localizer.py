"""The particle filter: image by image, from posteriors and odometry to an estimate."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from filtering.belief import Belief
from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.estimate import Estimate
from filtering.history import History, fuse
from filtering.hypotheses import without_correlation
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import Odometry
from filtering.observation import ONLY_CAMERA, Observation, View
from filtering.posterior import ObservationModel, PosePosterior
from filtering.se3 import Poses, require_one_pose
from filtering.step import describe, hypotheses_of, initialize, step


class ParticleLocalizer:
    """Localizes a camera, or a rig of several, from images and odometry; the filter's one mutable object.

    Args:
        model: Maps an image to its posterior over poses; None where posteriors are at hand, for `update` alone.
        config: Settings of the filter.
        rng: Source of all randomness; the model's draws and the filter's come from two streams spawned from it.

    Attributes:
        model, config: As given.
        belief: The state of the filter; each step replaces it. A step that fails leaves it as before.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> sequence = vapor.SequenceReader("walk.mcap")
        >>> model = vapor.VaporObservationModel.from_checkpoint("place.safetensors", camera=sequence.camera)
        >>> localizer = vapor.ParticleLocalizer(model, rng=np.random.default_rng(0))
        >>> for frame in sequence:
        ...     estimate = localizer.step(frame.image, frame.odometry, time_ns=frame.time_ns)
        >>> estimate.status in ("converged", "ambiguous", "lost")
        True
        >>> best = estimate.modes[0]  # pose, covariance, weight
        >>> best.world_from_camera.translation.shape
        (3,)
    """

    def __init__(
        self, model: ObservationModel | None, config: LocalizerConfig | None = None, *, rng: np.random.Generator
    ) -> None:
        self.model = model
        self.config = config or LocalizerConfig()
        self._model_rng, filter_rng = rng.spawn(2)
        self._last_images: dict[str, np.ndarray] = {}  # by camera
        self.belief, self._history = Belief(filter_rng), History()

    def step(
        self, image: np.ndarray, odom: Odometry | None, *, elapsed_s: float = 1.0, time_ns: int | None = None
    ) -> Estimate:
        """Localize one image.

        Args:
            image: RGB, uint8, (H, W, 3).
            odom: Motion of the camera since the previous step; not used on the first one. None on a later step means
                that the motion is unknown: see `GapConfig`. Of a late image as in `update`.
            elapsed_s: Seconds since the previous step; used where `odom` is None, and there is no time.
            time_ns: When the image was taken, integer nanoseconds; see `update`. The model draws in the order in which
                images come.

        Raises:
            VaporTrackError: the image is refused by the model, or as `update`. The localizer is then as it was before,
                so the step can be repeated with good input.
        """
        posterior, model_rng = self._observed(image)
        estimate = self.update(posterior, odom, elapsed_s=elapsed_s, time_ns=time_ns)
        self._model_rng, self._last_images[ONLY_CAMERA] = model_rng, np.array(image)
        return estimate

    def observe(self, image: np.ndarray, *, camera: str = ONLY_CAMERA) -> PosePosterior:
        """The posterior of one image (H, W, 3), uint8 RGB: the first half of `step`, one call of the model.

        An image that equals the one before it of its camera, pixel by pixel, comes from a camera that froze, and is
        uninformative: no two exposures are equal. Its score stays: a black image is out of distribution however often
        it comes. Only uint8 images are checked for repeats.

        Raises:
            VaporTrackError: there is no model, or it refuses the image.
        """
        posterior, self._model_rng = self._observed(image, camera)
        self._last_images[camera] = np.array(image)
        return posterior

    def _observed(self, image: np.ndarray, camera: str = ONLY_CAMERA) -> tuple[PosePosterior, np.random.Generator]:
        """The posterior of an image, and the model's source of randomness after it."""
        if self.model is None:
            raise VaporTrackError("this localizer has no observation model, expected posteriors through `update`")
        rng = copy.deepcopy(self._model_rng)
        posterior = self.model.observe(image, rng=rng)
        last = self._last_images.get(camera)
        frozen = image.dtype == np.uint8 and last is not None and np.array_equal(last, image)
        return posterior.without_places() if frozen else posterior, rng

    def update(
        self,
        seen: PosePosterior | Sequence[View],
        odom: Odometry | None,
        *,
        elapsed_s: float = 1.0,
        time_ns: int | None = None,
    ) -> Estimate:
        """Localize one moment by a posterior: the second half of `step`.

        With times, moments may come in any order: one that is late by at most `LocalizerConfig.late_window_s` is fused
        at its own time, and the estimate is still that of the latest time. The views of several calls of one time are
        views of one moment.

        Args:
            seen: The posterior of the camera's image, or views of several cameras at one moment.
            odom: Motion since the previous step of the camera, or of the frame that the extrinsics of several lead to.
                Of a late moment: since the one before it in time; None splits the motion that is known. Not used at a
                time that had a step.
            elapsed_s: Seconds since the previous step; used where `odom` is None, and there is no time.
            time_ns: When the views were taken, integer nanoseconds, in all steps or in none.

        Raises:
            VaporTrackError: the odometry is invalid (`require_odometry`), the elapsed time is negative, two views are
                of one camera, no posterior has any place at a first step, or the time is earlier than the window or the
                first step. The localizer is then as it was before.
        """
        if isinstance(seen, PosePosterior):
            return self.advance(Observation.of_posterior(seen, odom, elapsed_s, time_ns))
        return self.advance(Observation(tuple(seen), odom, elapsed_s, time_ns))

    def advance(self, observation: Observation) -> Estimate:
        """Localize one moment by all that was observed; `update` with its arguments in one.

        Raises:
            VaporTrackError: as `update`; the localizer is then as it was before.
        """
        self._history, self.belief, estimate = fuse(self._history, self.belief, observation, self.config)
        return estimate

    def predict(self, odom: Odometry | None, *, elapsed_s: float = 0.0, time_ns: int | None = None) -> Estimate:
        """Move the belief without an image.

        Args:
            odom: Motion since the previous step; None where it is unknown, see `GapConfig`.
            elapsed_s: Seconds since the previous step; used where `odom` is None, and there is no time.
            time_ns: When the motion ended, integer nanoseconds; as in `update`.

        Raises:
            VaporTrackError: there is no belief yet, or as `update`.
        """
        self._require_belief()
        return self.advance(Observation((), odom, elapsed_s, time_ns))

    def predicted(self, odom: Odometry | None, *, elapsed_s: float = 0.0) -> Estimate:
        """The estimate that `predict` would give after the latest step; the belief stays."""
        self._require_belief()
        return step(self.belief, Observation((), odom, elapsed_s), self.config)[1]

    def _require_belief(self) -> None:
        if self.belief.hypotheses is None:
            raise VaporTrackError("nothing to predict from: no image was localized yet")

    def forget(self) -> None:
        """Forget where the camera is: the next informative image is a first one, of any time."""
        self.belief, self._last_images, self._history = self.belief.forgotten(), {}, History()

    def start_at(
        self,
        world_from_camera: Poses,
        covariance: Float64[np.ndarray, "6 6"],
        noise: MeasurementNoise,
        *,
        time_ns: int | None = None,
    ) -> Estimate:
        """Start at a stated pose.

        Args:
            world_from_camera: One pose.
            covariance: Of ξ = (v, ω), metres and radians, in the tangent at the pose; positive definite.
            noise: Noise of the images to come.
            time_ns: When the camera is there, integer nanoseconds, before which no image is taken; None for any.

        Raises:
            VaporTrackError: the pose, its covariance or the time is invalid. The localizer is then as it was before.
        """
        require_one_pose("world_from_camera", world_from_camera)
        pose = Poses.stack([world_from_camera])
        stated = PosePosterior(pose, np.asarray(covariance, np.float64)[None], np.ones(1), noise, pose)
        begun = initialize(
            self.belief.forgotten(), Observation.of_posterior(stated, None, time_ns=time_ns).views, self.config
        )
        hypotheses = hypotheses_of(begun)
        # The error of the stated pose is not correlated with those of the images.
        apart = replace(hypotheses, covariance=without_correlation(hypotheses.covariance, 0))
        belief, estimate = describe(replace(begun, hypotheses=apart, unassigned=0.0), [], 0.0, self.config)
        self.belief, self._last_images, self._history = belief, {}, History.beginning_at(time_ns)
        return estimate
