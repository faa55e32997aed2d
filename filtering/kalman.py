"""The single-hypothesis baseline: an error-state Kalman filter on SE(3), the linear algebra by filterpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.stats import chi2

from filtering.errors import require_within
from filtering.estimate import Mode
from filtering.motion import Odometry, covariance_factor
from filtering.se3 import Poses


@dataclass(frozen=True)
class KalmanConfig:
    """Settings of the baseline."""

    gate_probability: float = 0.99
    """A measurement outside the region of this probability is taken for an outlier."""
    max_rejections: int = 20
    """After this many outliers in a row the filter starts anew at the measurement."""

    def __post_init__(self) -> None:
        require_within(
            self,
            gate_probability=(1e-6, 1.0),
            max_rejections=(0, 10**9),
        )


class KalmanLocalizer:
    """Follows one pose: odometry predicts it, the best mode of each image's posterior corrects it.

    The state is the error ξ in the tangent at the present pose, camera frame; it is folded into the pose and set to
    zero after every update (Solà et al., "A micro Lie theory", 2018).
    """

    def __init__(self, config: KalmanConfig | None = None) -> None:
        self.config = config or KalmanConfig()
        self._pose: Poses | None = None
        self._filter = KalmanFilter(dim_x=6, dim_z=6)
        self._filter.H = np.eye(6)
        self._gate = float(chi2.ppf(self.config.gate_probability, df=6))
        self._rejections = 0

    def update(self, measurement: Mode, odom: Odometry | None) -> Mode:
        """Follow one image.

        Args:
            measurement: Best mode of the image's posterior.
            odom: Motion since the previous image; None starts anew at the measurement.

        Returns:
            The one hypothesis, weight 1.

        Raises:
            VaporTrackError: the odometry covariance is no covariance.
        """
        if self._pose is None or odom is None:
            return self._start(measurement)
        covariance_factor(odom.covariance)
        self._pose = self._pose @ odom.previous_from_current
        self._filter.predict(F=odom.previous_from_current.inverse().adjoint(), Q=odom.covariance)
        innovation = (self._pose.inverse() @ measurement.world_from_camera).log()
        # A mode of few or equal samples has a singular covariance: a millimetre and a milliradian keep it regular.
        noise = measurement.covariance + 1e-6 * np.eye(6)
        squared_distance = innovation @ np.linalg.solve(self._filter.P + noise, innovation)
        if squared_distance > self._gate:
            self._rejections += 1
            if self._rejections > self.config.max_rejections:
                return self._start(measurement)
        else:
            self._rejections = 0
            self._filter.update(innovation, R=noise)
            self._pose = self._pose @ Poses.exp(self._filter.x.ravel())
            self._filter.x = np.zeros((6, 1))
        return Mode(self._pose, self._filter.P.copy(), 1.0)

    def _start(self, measurement: Mode) -> Mode:
        self._pose = measurement.world_from_camera
        self._filter.x = np.zeros((6, 1))
        self._filter.P = measurement.covariance + 1e-6 * np.eye(6)
        self._rejections = 0
        return Mode(self._pose, self._filter.P.copy(), 1.0)
