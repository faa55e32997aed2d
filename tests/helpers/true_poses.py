"""What is read of a walk of twelve images."""

from pathlib import Path

from sequences.datasets.frames import posed_frames
from sequences.frame import Frame
from sequences.options import SequenceOptions
from tests.helpers.sequence_files import BASE_FROM_CAMERA
from tests.helpers.tf_files import body

TYPES = ["nav_msgs/Odometry", "geometry_msgs/TransformStamped"]

TYPES_OF_UNSAID = ["geometry_msgs/PoseStamped", "geometry_msgs/PoseWithCovarianceStamped", "nav_msgs/Path"]


def require_true(frames: list[Frame], tolerance_m: float = 1e-3) -> None:
    """All twelve frames have the walk's true pose: interpolated over 20 ms, which costs half a millimetre at most."""
    assert len(frames) == 12
    for frame in frames:
        assert frame.world_from_camera is not None
        expected = body(frame.time_ns) @ BASE_FROM_CAMERA
        metres, radians = frame.world_from_camera.distance(expected)
        assert metres < tolerance_m
        assert radians < 1e-3


def read(path: Path, **options: object) -> list[Frame]:
    return list(posed_frames(path, options=SequenceOptions(**options)))  # pyright: ignore[reportArgumentType]
