"""The single-hypothesis baseline: an error-state Kalman filter on SE(3), the linear algebra by filterpy.

It has the same noise as the particle filter: covariances of an image's places, correlated errors, heavy tails, odometry
bias. It lacks a second hypothesis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from filterpy.kalman import KalmanFilter
from jaxtyping import Float64
from scipy.special import fdtri

from filtering.association import Correlation, corrected_poses, pair
from filtering.cameras import CameraMemory, Source
from filtering.config import GapConfig, LocalizerConfig
from filtering.errors import VaporTrackError, require_within
from filtering.estimate import Mode
from filtering.hypotheses import DRIFT, POSE, RIGHT, Hypotheses, birth, with_drift, with_source
from filtering.measurement_noise import MeasurementNoise
from filtering.moments import settle
from filtering.motion import Odometry, OdometryBias, measured, require_odometry
from filtering.observation import Observation
from filtering.posterior import PosePosterior
from filtering.prediction import Gap, gap_motion, limit_rotation, motion_of_state
from filtering.se3 import Poses
from filtering.vertical import Vertical, VerticalMemory, corrected_by


@dataclass(frozen=True)
class KalmanConfig:
    """Settings of the baseline."""

    gate_probability: float = 0.99
    """Places outside the region of this probability are rejected."""
    rejected_s: float = 2.0
    """The filter restarts after rejecting images for so long, seconds."""
    adapt_errors: bool = True
    """As of the particle filter, see `LocalizerConfig`."""
    odometry_bias: OdometryBias = field(default_factory=lambda: LocalizerConfig().odometry_bias)
    """Scale error and drift of the odometry; as of the particle filter."""
    gap: GapConfig = field(default_factory=GapConfig)
    """Motion where odometry is missing."""

    def __post_init__(self) -> None:
        require_within(self, gate_probability=(1e-6, 0.999999), rejected_s=(0.0, 1e9))


class KalmanLocalizer:
    """Follows one pose: odometry predicts it, the place of each image that is nearest to the prediction corrects it.

    The state is that of one of the particle filter's `Hypotheses`: the error of the pose, folded into the pose after
    every step (Solà et al., "A micro Lie theory", 2018), odometry bias, and the correlated error of images.
    """

    def __init__(self, config: KalmanConfig | None = None) -> None:
        self.config = config or KalmanConfig()
        self._pose: Poses | None = None
        self._filter = KalmanFilter(dim_x=19, dim_z=6)
        self._sources: tuple[Source, ...] = ()
        self._vertical: VerticalMemory | None = None
        self._provisional = False  # whether the next informative image restarts it
        self._drift: tuple[np.ndarray, np.ndarray] | None = None  # of odometry, before a gap
        self._rejected_s: float | None = None  # since the first of the images rejected in a row
        self._unseen_s = 0.0  # since the latest image with a place, in a gap

    def update(self, posterior: PosePosterior, odom: Odometry | None, *, elapsed_s: float = 1.0) -> Mode:
        """Follow one image.

        Args:
            posterior: Of the image.
            odom: Motion since the previous image. On the first step it is not used; None on a later step means that
                the motion is unknown: see `GapConfig`.
            elapsed_s: Seconds since the previous image; used where `odom` is None.

        Returns:
            The one hypothesis, weight 1, with the constant errors added.

        Raises:
            VaporTrackError: the odometry is invalid (`require_odometry`), the elapsed time is negative, or the
                posterior has no place at a first step. The localizer is then as it was before.
        """
        return self.advance(Observation.of_posterior(posterior, odom, elapsed_s))

    def advance(self, observation: Observation) -> Mode:
        """Follow one image; `update` with its arguments in one.

        Of several cameras it has the one that is localized: images of others start it, and do not correct it.

        Raises:
            VaporTrackError: as `update`, there are other views, or it has a time: late images are not fused.
        """
        if observation.time_ns is not None:
            raise VaporTrackError(f"time_ns is {observation.time_ns}, expected None: this baseline keeps no history")
        views, odom, elapsed_s = observation.views, observation.odometry, observation.elapsed_s
        if len(views) != 1:
            raise VaporTrackError(f"{len(views)} views, expected one: this baseline has one camera")
        posterior, is_other = observation.posterior, not views[0].reference_from_camera.is_identity
        if is_other and self._pose is not None:
            posterior = posterior.without_places()
        if odom is not None:
            require_odometry(odom)
        if self._pose is None and not posterior.weights.any():
            raise VaporTrackError("the first image has no place of any weight, expected at least one")
        if measured(odom) is None and self.config.gap.action == "forget":
            self._provisional = True
        if self._pose is None or (self._provisional and not posterior.is_uninformative):
            self._start(posterior, None)
            self._provisional |= is_other
        else:
            self._predict(self._pose, odom, elapsed_s)
            if not posterior.is_uninformative:
                self._unseen_s = 0.0
                self._know(posterior.noise)
                correlations = [
                    Correlation(source.number, source.tracker.normalized_distance) for source in self._sources
                ]
                self._sources = tuple(
                    source.observe(posterior.of_source(number)) if len(posterior.sources[number]) else source
                    for number, source in enumerate(self._sources)
                )
                posterior = posterior.inflated(*(source.scale.factor for source in self._sources))
                if not self._correct(posterior, correlations):
                    self._reject(posterior, elapsed_s if odom is None else odom.duration_s)
        self._level(observation.vertical)
        pose, covariance = self._pose, self._filter.P[POSE, POSE]
        assert pose is not None
        noise = CameraMemory(self._sources, Poses.identity()).noise
        return Mode(pose, covariance + noise.constant_covariance(covariance), 1.0)

    def _know(self, noise: MeasurementNoise) -> None:
        """Add the correlated errors of landmarks to the state where there is a map of them."""
        if noise.verified is None or len(self._sources) > 1 or self._pose is None:
            return
        number = 1 + (self._vertical is not None)
        landmarks = Source.first_seen(noise.verified, number, unknown=1.0, adapts=self.config.adapt_errors)
        self._sources = (*self._sources, landmarks)
        self._take(with_source(self._hypothesis(self._pose)))

    def _level(self, vertical: Vertical | None) -> None:
        """Correct by gravity and height."""
        if vertical is None or vertical.degrees_of_freedom == 0 or self._pose is None:
            return
        hypothesis, memory = self._hypothesis(self._pose), self._vertical
        if memory is None:
            hypothesis, memory = with_source(hypothesis), VerticalMemory(len(self._sources), vertical.lengths)
        hypothesis = corrected_by(vertical, hypothesis, memory)
        self._take(hypothesis)
        self._pose, self._vertical = hypothesis.poses[0], memory.observe(vertical)

    def _hypothesis(self, pose: Poses) -> Hypotheses:
        mean, covariance = self._filter.x[6:].T.copy(), self._filter.P[None].copy()
        return Hypotheses(
            Poses(pose.rotation[None], pose.translation[None]), mean, covariance, np.zeros(1), np.full(1, RIGHT)
        )

    def _start(self, posterior: PosePosterior, before: Hypotheses | None) -> None:
        """Start at the image's heaviest place; the odometry bias is kept."""
        known, adapts = self._sources, self.config.adapt_errors
        noise = [posterior.noise, *([posterior.noise.verified] if posterior.noise.verified else [])]
        self._sources = tuple(
            Source.first_seen(each, number, unknown=0.0, adapts=adapts) for number, each in enumerate(noise)
        )
        self._sources = tuple(
            replace(source, scale=replace(known[number].scale, place=None, since=None, normalized_distance=0.0))
            if number < len(known)
            else source
            for number, source in enumerate(self._sources)
        )
        places = birth(posterior, 0, len(noise), self.config.odometry_bias, before, len(noise) - 1)
        heaviest = int(np.argmax(posterior.weights))
        self._pose = places.poses[heaviest]
        self._filter = KalmanFilter(dim_x=13 + 6 * len(noise), dim_z=6)
        self._filter.x = np.concatenate([np.zeros(6), places.mean[heaviest]])[:, None]
        self._filter.P = places.covariance[heaviest].copy()
        self._provisional = posterior.is_uninformative
        self._rejected_s, self._vertical = None, None

    def _predict(self, pose: Poses, odom: Odometry | None, elapsed_s: float) -> None:
        bias, hypothesis = self.config.odometry_bias, self._hypothesis(pose)
        if odom is None or not odom.knows_translation:
            gap = Gap.of(odom, elapsed_s, self.config.gap.velocity)
            bias, odom, elapsed_s = gap.velocity, gap.known, gap.known.duration_s
            if self._drift is None:
                self._drift = hypothesis.mean[0, 1:7], hypothesis.covariance[0, DRIFT, DRIFT]
                hypothesis = with_drift(hypothesis, np.zeros(6), np.eye(6))
                self._take(hypothesis)
            motion = gap_motion(hypothesis, self._unseen_s, gap, self.config.gap)
            self._unseen_s += elapsed_s
            after = [source.across_gap(motion) for source in self._sources]
        else:
            likely = odom.rescaled(hypothesis.mean[0, 0])
            after = [source.predict(likely) for source in self._sources]
            if self._drift is not None:
                self._take(with_drift(hypothesis, *self._drift))
                self._drift = None
        self._sources = tuple(source for source, _ in after)
        distances = {source.number: moved for source, moved in after}
        if self._vertical is not None:
            self._vertical, distances[self._vertical.number] = self._vertical.predict(distances[0])
        motion = motion_of_state(odom, bias, [distances[number] for number in sorted(distances)])
        self._filter.predict(F=motion.transition, Q=motion.noise)
        settle(self._filter.P)
        limit_rotation(self._filter.P[None])
        self._fold((pose @ odom.previous_from_current).orthonormal())

    def _take(self, hypothesis: Hypotheses) -> None:
        """Take the state of a hypothesis, which may be larger than before; its pose is kept apart."""
        mean, covariance = hypothesis.mean[0], hypothesis.covariance[0]
        if len(covariance) != len(self._filter.P):
            self._filter = KalmanFilter(dim_x=len(covariance), dim_z=6)
        self._filter.x, self._filter.P = np.concatenate([np.zeros(6), mean])[:, None], covariance

    def _correct(self, posterior: PosePosterior, correlations: Sequence[Correlation]) -> bool:
        """Correct by the nearest place, if it is inside the gate; returns whether it is.

        Args:
            posterior: Of the image.
            correlations: Of each source of places.
        """
        pose = self._pose
        assert pose is not None
        hypothesis, nearest = self._hypothesis(pose), None
        for source, correlation in enumerate(correlations):
            places = posterior.sources[source]
            if len(places) == 0:
                continue
            pairs = pair(hypothesis, posterior, source, correlation, np.zeros(len(places), np.int64), places)
            k = int(np.argmin(pairs.squared))
            # A verified place inside its gate is preferred to one of the network.
            if pairs.squared[k] <= _gate(self.config.gate_probability, posterior.noise_of(source).degrees_of_freedom):
                nearest = pairs, k
        if nearest is None:
            return False
        pairs, k = nearest
        measurement, taken = pairs.measurement, np.array([k])
        shows = np.zeros((6, len(self._filter.x)))
        for part, matrix in measurement.jacobian:
            shows[:, part] = np.eye(6) if matrix is None else matrix[k]
        expected = shows @ self._filter.x[:, 0]
        before = self._filter.P.diagonal().copy()
        self._filter.update((measurement.innovation[k] + expected)[:, None], R=measurement.noise[k], H=shows)
        settle(self._filter.P, before)
        change = self._filter.x[POSE].T
        self._pose = corrected_poses(hypothesis.poses, posterior.means, pairs, taken, change)[0]
        self._filter.x[POSE] = 0.0
        self._rejected_s = None
        return True

    def _reject(self, posterior: PosePosterior, duration_s: float) -> None:
        self._rejected_s = 0.0 if self._rejected_s is None else self._rejected_s + duration_s
        if self._rejected_s >= self.config.rejected_s and self._pose is not None:
            self._start(posterior, self._hypothesis(self._pose))

    def _fold(self, pose: Poses) -> None:
        """Fold the error of the pose into the pose."""
        change: Float64[np.ndarray, " 6"] = self._filter.x[POSE, 0]
        self._pose = pose @ Poses.exp(change)
        self._filter.x[POSE] = 0.0


@cache
def _gate(probability: float, degrees_of_freedom: float) -> float:
    """Squared distance within which an error of six Student t distributed components is with that probability."""
    return float(6.0 * fdtri(6, degrees_of_freedom, probability))
