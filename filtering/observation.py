"""The input of one step of the filter: the pose posteriors of images, and the odometry, of one moment."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from filtering.errors import VaporTrackError, quoted
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses, require_one_pose
from filtering.vertical import Vertical

ONLY_CAMERA = "camera"
"""Name of a camera beside which there is no other."""
_MOST_NS = 1 << 63


@dataclass(frozen=True)
class View:
    """The pose posterior of one image of one camera.

    Attributes:
        posterior: Of the camera's pose.
        reference_from_camera: Its extrinsics: from the camera to the frame that is localized, one pose.
        camera: Its name; errors are correlated among the images of one camera only.

    Raises:
        VaporTrackError: the posterior is none, or the extrinsics are not one finite pose.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> places = vapor.Poses.from_quat_xyzw([[1, 2, 0], [1, 6, 0]], [[0, 0, 0, 1], [0, 0, 0, 1]])
        >>> posterior = vapor.PosePosterior.from_estimates(places, 0.1, 0.05, vapor.MeasurementNoise())  # m, rad
        >>> aside = vapor.Poses.from_quat_xyzw([0.5, 0, 0], [0, 0, 0, 1])
        >>> views = [vapor.View(posterior, vapor.Poses.identity(), "left"), vapor.View(posterior, aside, "right")]
        >>> estimate = vapor.ParticleLocalizer(None, rng=np.random.default_rng(0)).update(views, None)
        >>> estimate.left_out
        ()
    """

    posterior: PosePosterior
    reference_from_camera: Poses
    camera: str

    def __post_init__(self) -> None:
        if not isinstance(self.posterior, PosePosterior):
            raise VaporTrackError(
                f"camera {quoted(self.camera)}: posterior is {quoted(self.posterior)}, expected a PosePosterior"
            )
        require_one_pose(f"reference_from_camera of camera {self.camera!r}", self.reference_from_camera)

    @property
    def rank(self) -> tuple[float | bytes, ...]:
        """A key for sorting: the most exact first, and nothing that depends on how cameras are called or listed."""
        posterior, mount = self.posterior, self.reference_from_camera
        covariances, weights = posterior.covariances, posterior.weights
        volume = float(np.linalg.slogdet(covariances[np.argmax(weights)])[1]) if len(weights) else np.inf
        poses = (posterior.means.rotation, posterior.means.translation, mount.rotation, mount.translation)
        return (volume, posterior.ood_score, *(each.tobytes() for each in (*poses, covariances, weights)))


@dataclass(frozen=True)
class Observation:
    """The observations of one moment.

    Attributes:
        views: One of each camera that took an image; empty without any.
        odometry: Motion of the frame that is localized since the previous observation, not used on the first one; None
            where it is unknown.
        elapsed_s: Seconds since the previous observation; used where `odometry` is None, and there is no time.
        time_ns: When it was observed, integer nanoseconds, 0 or more; None where the order of steps is that of time.
        vertical: Gravity in the frame that is localized, and its height; None where neither was measured.

    Raises:
        VaporTrackError: two views are of one camera, the elapsed time is negative or infinite, or the time is not an
            integer of 0 or more.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> places = vapor.Poses.from_quat_xyzw([[1, 2, 0], [1, 6, 3]], [[0, 0, 0, 1], [0, 0, 0, 1]])
        >>> posterior = vapor.PosePosterior.from_estimates(places, 0.1, 0.05, vapor.MeasurementNoise())  # m, rad
        >>> height = vapor.Vertical(heights=vapor.KnownHeight(3.0, std_m=0.2))
        >>> view = vapor.View(posterior, vapor.Poses.identity(), "camera")
        >>> localizer = vapor.ParticleLocalizer(None, rng=np.random.default_rng(0))
        >>> estimate = localizer.advance(vapor.Observation((view,), time_ns=0, vertical=height))
        >>> estimate.modes[0].world_from_camera.translation.round(1)
        array([1., 6., 3.])
    """

    views: tuple[View, ...] = ()
    odometry: Odometry | None = None
    elapsed_s: float = 1.0
    time_ns: int | None = None
    vertical: Vertical | None = None

    def __post_init__(self) -> None:
        names = [view.camera for view in self.views]
        if len(set(names)) < len(names):
            raise VaporTrackError(f"views of cameras {', '.join(names)}, expected each once")
        if not 0.0 <= self.elapsed_s < np.inf:
            raise VaporTrackError(f"{self.elapsed_s} s since the previous step, expected a finite time of 0 s or more")
        if self.time_ns is not None:
            require_time(self.time_ns)

    @staticmethod
    def of_posterior(
        posterior: PosePosterior,
        odometry: Odometry | None,
        elapsed_s: float = 1.0,
        time_ns: int | None = None,
        *,
        reference_from_camera: Poses | None = None,
        camera: str = ONLY_CAMERA,
    ) -> Observation:
        """One posterior, of the camera that is localized, or of another one that is fixed to it."""
        mount = Poses.identity() if reference_from_camera is None else reference_from_camera
        view = View(posterior, mount, camera)
        return Observation((view,), odometry, elapsed_s, time_ns)

    @property
    def ranked_views(self) -> tuple[View, ...]:
        """The views in an order that does not depend on the one in which they are listed, see `View.rank`."""
        return self.views if len(self.views) < 2 else tuple(sorted(self.views, key=lambda view: view.rank))

    @property
    def posterior(self) -> PosePosterior:
        """What the first view says of the frame that is localized; uninformative without any."""
        return self._of_first if self.views else PosePosterior.uninformative()

    @cached_property
    def _of_first(self) -> PosePosterior:
        return self.views[0].posterior.seen_from(self.views[0].reference_from_camera)


def require_time(time_ns: object) -> None:
    """Check that a time is integer nanoseconds, 0 or more.

    Raises:
        VaporTrackError: it is not.
    """
    if not isinstance(time_ns, int | np.integer) or isinstance(time_ns, bool) or not 0 <= time_ns < _MOST_NS:
        raise VaporTrackError(f"time_ns is {quoted(time_ns)}, expected integer nanoseconds from 0 to 2⁶³")
