"""What a localizer remembers of its cameras."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from filtering.adaptation import ErrorScale
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import GapMotion, Odometry
from filtering.novelty import NoveltyTracker
from filtering.observation import View
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.unchecked import unchecked_replace


@dataclass(frozen=True)
class Source:
    """A source of places whose errors are correlated: the network of a camera, or the landmarks in its images.

    Attributes:
        number: Of its correlated error in the state of a hypothesis.
        noise: Noise of its places.
        tracker: Of the camera's motion, in lengths over which these errors are correlated.
        place_tracker: Likewise, in lengths over which outliers are correlated.
        scale: Of its noise, by odometry.
    """

    number: int
    noise: MeasurementNoise
    tracker: NoveltyTracker
    place_tracker: NoveltyTracker
    scale: ErrorScale

    @staticmethod
    def first_seen(noise: MeasurementNoise, number: int, *, unknown: float, adapts: bool) -> Source:
        """A source before its first place; the camera may have come `unknown` lengths since any earlier view."""
        tracker, place_tracker = (
            NoveltyTracker(lengths * noise.length_m, lengths * noise.length_rad, unknown=unknown)
            for lengths in (1.0, noise.outlier_lengths)
        )
        return Source(number, noise, tracker, place_tracker, ErrorScale(adapts))

    @property
    def applied(self) -> MeasurementNoise:
        """Noise of its places, scaled by what odometry has shown."""
        return self.scale.applied(self.noise)

    @property
    def unlinked(self) -> Source:
        """The same without the image that the next one is compared with."""
        return unchecked_replace(self, scale=unchecked_replace(self.scale, place=None))

    def across_gap(self, motion: GapMotion) -> tuple[Source, float]:
        """After a motion of the camera without odometry; its normalized distance."""
        trackers, distances = [], []
        for tracker in (self.tracker, self.place_tracker):
            tracker, likely = tracker.predict(motion.likely)
            tracker, unknown = tracker.after_unknown(motion.unknown_m, motion.unknown_rad)
            trackers.append(tracker)
            distances.append(likely + unknown)
        return unchecked_replace(self.unlinked, tracker=trackers[0], place_tracker=trackers[1]), distances[0]

    def predict(self, camera_motion: Odometry) -> tuple[Source, float]:
        """After a motion of the camera; its normalized distance."""
        tracker, moved = self.tracker.predict(camera_motion.previous_from_current)
        place_tracker, _ = self.place_tracker.predict(camera_motion.previous_from_current)
        scale = self.scale.predict(camera_motion, moved)
        return unchecked_replace(self, tracker=tracker, place_tracker=place_tracker, scale=scale), moved

    def observe(self, posterior: PosePosterior) -> Source:
        """After an image with places of this source."""
        scale = self.scale.observe(posterior, self.tracker.normalized_distance)
        return unchecked_replace(self, tracker=self.tracker.observe()[0], scale=scale)


@dataclass(frozen=True)
class CameraMemory:
    """The memory of one camera.

    Attributes:
        sources: Of its places, by the numbers of `PosePosterior.sources`: its network, and landmarks if there is a map.
        reference_from_camera: Its extrinsics at its last image.
        agreement: Fraction of the belief that fits its latest images with places, in [0, 1].
        unseen_s: Seconds since the latest of these.
    """

    sources: tuple[Source, ...]
    reference_from_camera: Poses
    agreement: float = 1.0
    unseen_s: float = 0.0

    def later(self, elapsed_s: float) -> CameraMemory:
        """After so many seconds."""
        return unchecked_replace(self, unseen_s=self.unseen_s + elapsed_s)

    def after_view(self, fits: float, follow: float) -> CameraMemory:
        """After an image that fits so much of the belief, which the average follows by a fraction."""
        return unchecked_replace(self, agreement=self.agreement + follow * (fits - self.agreement), unseen_s=0.0)

    @staticmethod
    def first_seen(view: View, number: int, *, unknown: float, adapts: bool) -> CameraMemory:
        """A camera before its first image.

        Args:
            view: Its first.
            number: Of its first correlated error in the state.
            unknown: Distance that it may have come since any earlier view, in lengths.
            adapts: Whether odometry scales its noise.
        """
        network = Source.first_seen(view.posterior.noise, number, unknown=unknown, adapts=adapts)
        camera = CameraMemory((network,), view.reference_from_camera)
        return camera.with_landmarks(view, number + 1, unknown=unknown, adapts=adapts)

    def with_landmarks(self, view: View, number: int, *, unknown: float, adapts: bool) -> CameraMemory:
        """The same with landmarks as its second source, where there is a map and they are not one yet."""
        noise = view.posterior.noise.verified
        if noise is None or len(self.sources) > 1:
            return self
        landmarks = Source.first_seen(noise, number, unknown=unknown, adapts=adapts)
        return unchecked_replace(self, sources=(*self.sources, landmarks))

    @cached_property
    def noise(self) -> MeasurementNoise:
        """Noise of its images, scaled by what odometry has shown."""
        network = self.sources[0].applied
        return network if len(self.sources) == 1 else unchecked_replace(network, verified=self.sources[1].applied)

    def across_gap(self, motion: GapMotion) -> tuple[CameraMemory, list[float]]:
        """After a motion of the reference frame without odometry; its normalized distance by source."""
        camera_motion = motion.of_another_frame(self.reference_from_camera)
        after = [source.across_gap(camera_motion) for source in self.sources]
        return unchecked_replace(self, sources=tuple(source for source, _ in after)), [moved for _, moved in after]

    def has_extrinsics(self, reference_from_camera: Poses) -> bool:
        """Whether these are its extrinsics, so that the camera did not move on its mount."""
        known = self.reference_from_camera
        return known is reference_from_camera or np.array_equal(known.as_matrix(), reference_from_camera.as_matrix())

    def moved_to(self, reference_from_camera: Poses) -> tuple[CameraMemory, list[float]]:
        """After a motion on its mount, which is known exactly; its normalized distance by source."""
        moved = self.reference_from_camera.inverse() @ reference_from_camera
        camera, distances = self._after(Odometry(moved, np.zeros((6, 6)), 0.0))
        return unchecked_replace(camera, reference_from_camera=reference_from_camera), distances

    def predict(self, odom: Odometry) -> tuple[CameraMemory, list[float]]:
        """After a motion of the reference frame; its normalized distance by source."""
        mount = self.reference_from_camera
        return self._after(odom if mount.is_identity else odom.of_another_frame(mount))

    def _after(self, camera_motion: Odometry) -> tuple[CameraMemory, list[float]]:
        after = [source.predict(camera_motion) for source in self.sources]
        return unchecked_replace(self, sources=tuple(source for source, _ in after)), [moved for _, moved in after]

    def observe(self, posterior: PosePosterior) -> tuple[CameraMemory, float, float]:
        """After an image; sources without a place in it stay as they are.

        Returns:
            The camera; the novelty of the view, in [0, 1]; and the power of the image's likelihood, in [0, 1]: its
            novelty in lengths over which outliers are correlated, of landmarks where they verify a place.
        """
        after, novelty = [], []
        for number, source in enumerate(self.sources):
            has_places = len(posterior.sources[number]) > 0
            observes = has_places or number == 0
            place_tracker, new = source.place_tracker.observe() if observes else (source.place_tracker, 0.0)
            source = source.observe(posterior.of_source(number)) if has_places else source
            after.append(unchecked_replace(source, place_tracker=place_tracker))
            novelty.append(new)
        return unchecked_replace(self, sources=tuple(after)), novelty[0], novelty[1 if posterior.has_verified else 0]
