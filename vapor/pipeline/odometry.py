"""Where the motion of the camera comes from, in runs and live (`--odometry`)."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, runtime_checkable

from filtering.errors import VaporTrackError
from sequences.frame import Camera
from sequences.options import OdometryUse, ReadingOptions
from sequences.visual_odometry.odometry import USUAL_DEPTH_M
from vapor.landmarks.verify import Landmarks
from vapor.pipeline.config import OdometrySource

USES: dict[OdometrySource, OdometryUse] = {
    "auto": "auto",
    "recorded": "required",
    "visual": "ignored",
    "both": "required",
    "none": "ignored",
}
"""What becomes of odometry that is recorded or published."""


@runtime_checkable
class Seeing(Protocol):
    """What is asked of a model: see `vapor.checkpoints.checkpoint.ModelDescription`."""

    @property
    def camera(self) -> Camera | None:
        """Of its training images."""
        ...

    @property
    def landmarks(self) -> Landmarks | None:
        """Their points."""
        ...


def makes_odometry(source: OdometrySource, *, is_recorded: bool) -> bool:
    """Whether odometry is made from the images."""
    return source in ("visual", "both") or (source == "auto" and not is_recorded)


def require_one_source(source: OdometrySource, reading: ReadingOptions) -> None:
    """Raise VaporTrackError where published or recorded odometry is named, and not used."""
    if USES[source] == "ignored" and (reading.odometry_topic or reading.odometry_frame):
        raise VaporTrackError(f"--odometry {source} beside --odometry-topic or --odometry-frame, expected one of them")


def camera_of_motion(path: Path, camera: Camera | None, model: Seeing, source: OdometrySource) -> Camera | None:
    """The camera of images without intrinsics of their own, to make odometry from; None where it is unknown.

    Args:
        path: Of the images, for errors.
        camera: As stated beside the images.
        model: Whose training camera it is otherwise.
        source: Where the motion comes from.

    Raises:
        VaporTrackError: odometry from images is asked for, and no intrinsics are known.
    """
    camera = camera or model.camera
    if camera is None and source != "auto":
        raise VaporTrackError(
            f"{path}: --odometry {source} without intrinsics, expected CameraInfo or an intrinsics.json, or a model"
            " whose training images had them"
        )
    return camera


def usual_depth_m(model: Seeing) -> float:
    """How far away the scene usually is, by the landmarks of a model, metres."""
    return USUAL_DEPTH_M if model.landmarks is None else model.landmarks.map.depth_m
