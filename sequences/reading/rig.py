"""Where the camera is mounted on the bodies whose poses are recorded."""

from __future__ import annotations

from dataclasses import dataclass, replace

from filtering.se3 import Poses
from sequences.reading.extrinsics import Extrinsics, find_extrinsics
from sequences.recordings.source import MessageSource
from sequences.recordings.transforms import Step, TransformTree

BASES = ("base_link", "base_footprint")


@dataclass(frozen=True)
class Rig:
    """The names by which tf knows a camera, and the body that its odometry is of.

    Attributes:
        camera: Frame of the camera.
        base: Frame of the body; '' where no odometry is read.
        base_from_camera: The pose of one on the other where an option gives it.
        odometry_topic: Topic of the odometry, which is none of true poses unless named; '' where there is none.
        odometry_frame: Frame that the odometry is in; '' where none is read.
    """

    camera: str
    base: str = ""
    base_from_camera: Poses | None = None
    odometry_topic: str = ""
    odometry_frame: str = ""

    def on(self, bag: MessageSource, body: str, body_is: str = "") -> Extrinsics:
        """Where the camera sits on a body. Raises SequenceError where neither tf nor the option says it."""
        if not body or body == self.camera:
            return Extrinsics(Poses.identity())
        if self.base_from_camera is None:
            return find_extrinsics(
                bag, body, self.camera, body_is=body_is, instead="--ground-truth-child-frame or --base-from-camera"
            )
        if self.base in ("", body):
            return Extrinsics(self.base_from_camera)
        carrier = find_extrinsics(bag, body, self.base, body_is=body_is, instead="--ground-truth-child-frame")
        return replace(carrier, body_from_camera=carrier.body_from_camera @ self.base_from_camera)

    def path(self, tree: TransformTree, frame: str) -> list[Step] | None:
        """The links from a frame to the camera, or to the body on which an option says where it sits."""
        return tree.path(frame, self.camera if self.base_from_camera is None else self._carrier(tree, frame))

    def _carrier(self, tree: TransformTree, frame: str) -> str:
        if self.base:
            return self.base
        return next((name for name in BASES if frame in tree.ancestors(name)), self.camera)

    @property
    def end(self) -> Poses:
        """What follows at the end of such a path, one pose."""
        return Poses.identity() if self.base_from_camera is None else self.base_from_camera
