"""The cameras that a localizer sees through: what one says now, and what is remembered of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from filtering.adaptation import ErrorScale
from filtering.error_model import ErrorModel
from filtering.motion import Odometry
from filtering.novelty import ViewMeter
from filtering.posterior import PosePosterior
from filtering.se3 import Poses


@dataclass(frozen=True)
class View:
    """What one camera of several says about one moment.

    Attributes:
        posterior: Of its image.
        reference_from_camera: Its extrinsics: from the camera to the frame that is localized, one pose.
        camera: Its name: the errors of one camera's images last, those of two are independent.
    """

    posterior: PosePosterior
    reference_from_camera: Poses
    camera: str


@dataclass(frozen=True)
class SeenCamera:
    """A camera that was seen before.

    Attributes:
        number: Its place in the state of a hypothesis.
        errors: How its images err.
        meter: How far it came, in lengths over which the errors of its images last.
        places: The same in lengths over which its images mistake one place for another.
        reference_from_camera: Its extrinsics at its last image.
        scale: Whether its images err more or less than their model says.
    """

    number: int
    errors: ErrorModel
    meter: ViewMeter
    places: ViewMeter
    reference_from_camera: Poses
    scale: ErrorScale

    @staticmethod
    def first_seen(view: View, number: int, *, unknown: float, adapts: bool) -> SeenCamera:
        """A camera before its first image counts.

        Args:
            view: Its first.
            number: Its place in the state.
            unknown: How far the camera may have come since any view before, in lengths.
            adapts: Whether odometry may say that its images err otherwise than modelled.
        """
        errors = view.posterior.errors
        longer = errors.mistaken_lengths
        meter = ViewMeter(errors.length_m, errors.length_rad, unknown=unknown)
        places = ViewMeter(longer * errors.length_m, longer * errors.length_rad, unknown=unknown)
        return SeenCamera(number, errors, meter, places, view.reference_from_camera, ErrorScale(adapts))

    def across_gap(self, distance_m: float, angle_rad: float) -> tuple[SeenCamera, float]:
        """After a motion of which only the likely distance and angle are known; that way in lengths."""
        meter, way = self.meter.across_gap(distance_m, angle_rad)
        places, _ = self.places.across_gap(distance_m, angle_rad)
        return replace(self, meter=meter, places=places, scale=replace(self.scale, place=None)), way

    def seen_through(self, reference_from_camera: Poses) -> SeenCamera:
        """The same on its mount of now; where that was turned, no image of before is compared with those that come."""
        mount = self.reference_from_camera
        if mount is reference_from_camera or np.array_equal(mount.as_matrix(), reference_from_camera.as_matrix()):
            return self
        return replace(self, reference_from_camera=reference_from_camera, scale=replace(self.scale, place=None))

    def moved(self, odom: Odometry) -> tuple[SeenCamera, float]:
        """After a motion of the reference frame; the way in lengths."""
        meter, way = self.meter.moved(odom.previous_from_current)
        places, _ = self.places.moved(odom.previous_from_current)
        motion = odom if self.reference_from_camera.is_identity else odom.of_another_frame(self.reference_from_camera)
        return replace(self, meter=meter, places=places, scale=self.scale.moved(motion, way)), way
