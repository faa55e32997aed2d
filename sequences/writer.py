"""Frames and estimates -> MCAP files with ROS 2 messages, complete or not there at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

import cv2
import numpy as np
from jaxtyping import Float64, UInt8
from mcap_ros2.writer import Writer

from filtering.se3 import Poses
from sequences.atomic import atomic_output
from sequences.bag import METADATA_NAME, Bag
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.message_definitions import schema_name, schema_text
from sequences.messages import covariance_to_ros
from sequences.undistortion import Lens, pinhole_of

MAP_FRAME, ODOM_FRAME, BASE_FRAME, CAMERA_FRAME = "map", "odom", "base_link", "camera_optical_frame"
ESTIMATE_FRAME = "camera_estimate"
_MAX_PARTICLES = 500
_ARROW_M = 0.5  # length of the arrow of a mode, along its optical axis
_MARKER_ARROW, _MARKER_DELETE_ALL = 0, 3


class _MessageWriter:
    """A context manager around an MCAP file that appears under its name only when it is complete."""

    def __init__(self, path: Path):
        self.path = Path(path)
        self._stack = ExitStack()
        self._schemas: dict[str, object] = {}

    def _open(self) -> None:
        with ExitStack() as stack:
            partial = stack.enter_context(atomic_output(self.path))
            file = stack.enter_context(open(partial, "wb"))
            self._writer = Writer(file)
            self._stack = stack.pop_all()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is None:
            try:
                self._writer.finish()
            except BaseException as failure:  # a full disk, an interruption: the partial file must go
                if not self._stack.__exit__(type(failure), failure, failure.__traceback__):
                    raise
        self._stack.__exit__(kind, error, traceback)

    def _write(self, topic: str, message_type: str, message: dict, time_ns: int) -> None:
        if message_type not in self._schemas:
            text = schema_text(message_type)
            self._schemas[message_type] = self._writer.register_msgdef(schema_name(message_type), text)
        self._writer.write_message(topic, self._schemas[message_type], message, log_time=int(time_ns))  # pyright: ignore[reportArgumentType]


class SequenceWriter(_MessageWriter):
    """Writes a sequence that `SequenceReader`, ROS 2 and Foxglove read; use it in a `with` statement.

    Topics: `/camera/image/compressed`, `/camera/camera_info`, `/odom` (odom -> base_link), `/ground_truth/pose` (of the
    camera, in map), `/tf_static` (base_link -> camera_optical_frame). Messages are logged at their stamps; write them
    roughly in order of time, so that readers need to hold little.
    """

    def __init__(
        self,
        path: Path,
        *,
        camera: Camera | Lens,
        base_from_camera: Poses,
        metadata: Mapping[str, str] = {},
        jpeg_quality: int = 92,
    ):
        """Set up a writer; the file is opened on entering the `with` statement.

        Args:
            path: File to write.
            camera: Intrinsics of the images as they are written, with the distortion of a lens.
            base_from_camera: Extrinsics, one pose.
            metadata: What the file should say of itself; `odometry` says where its odometry comes from.
            jpeg_quality: Quality of images that are given as pixels, 0 to 100.
        """
        super().__init__(path)
        self._camera = camera
        self._base_from_camera = base_from_camera
        self._metadata = dict(metadata)
        self._jpeg_quality = jpeg_quality
        self._has_tf = False

    def __enter__(self) -> SequenceWriter:
        self._open()
        if self._metadata:
            self._writer.add_metadata(METADATA_NAME, self._metadata)
        return self

    def write_image(self, time_ns: int, image_rgb: UInt8[np.ndarray, "height width 3"]) -> None:
        """Write an image as JPEG."""
        bgr = cv2.cvtColor(image_rgb, cv2.COLOR_RGB2BGR)
        encoded, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, self._jpeg_quality])
        if not encoded:
            raise SequenceError(f"{self.path}: image at {time_ns} ns of shape {image_rgb.shape} cannot be encoded")
        self.write_encoded_image(time_ns, data.tobytes(), "jpeg")

    def write_encoded_image(self, time_ns: int, data: bytes, format: str) -> None:
        """Write the bytes of a JPEG or PNG as they are; `format` is "jpeg" or "png"."""
        header = self._header(time_ns, CAMERA_FRAME)
        image = {"header": header, "format": format, "data": data}
        self._write("/camera/image/compressed", "sensor_msgs/CompressedImage", image, time_ns)
        lens = self._camera if isinstance(self._camera, Lens) else Lens(self._camera, "plumb_bob", (0.0,) * 5)
        c, p, d = lens.camera, pinhole_of(self._camera), list(lens.coefficients)
        if lens.model == "equidistant" and not any(d):
            d[-1] = 1e-12  # zeros would say that nothing is distorted
        info = {
            "header": header,
            "height": c.height,
            "width": c.width,
            "distortion_model": lens.model,
            "d": d,
            "k": [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0],
            "r": np.eye(3).ravel().tolist(),
            "p": [p.fx, 0.0, p.cx, 0.0, 0.0, p.fy, p.cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        }
        self._write("/camera/camera_info", "sensor_msgs/CameraInfo", info, time_ns)

    def write_odometry(
        self,
        time_ns: int,
        odom_from_base: Poses,
        twist_covariance: Float64[np.ndarray, "6 6"],
        twist: Float64[np.ndarray, " 6"] | None = None,
    ) -> None:
        """Write one odometry message.

        Args:
            time_ns: Header stamp.
            odom_from_base: One pose.
            twist_covariance: Covariance of the velocity (v, ω) in the base frame; zeros where it is unknown.
            twist: Velocity (v, ω) in the base frame, metres and radians per second; zeros where it is unknown.
        """
        v = np.zeros(6) if twist is None else twist
        message = {
            "header": self._header(time_ns, ODOM_FRAME),
            "child_frame_id": BASE_FRAME,
            "pose": {"pose": _pose(odom_from_base)},
            "twist": {
                "twist": {"linear": _xyz(v[:3]), "angular": _xyz(v[3:])},
                "covariance": twist_covariance.ravel().tolist(),
            },
        }
        self._write("/odom", "nav_msgs/Odometry", message, time_ns)

    def write_true_pose(self, time_ns: int, world_from_camera: Poses) -> None:
        """Write one true pose of the camera."""
        message = {"header": self._header(time_ns, MAP_FRAME), "pose": _pose(world_from_camera)}
        self._write("/ground_truth/pose", "geometry_msgs/PoseStamped", message, time_ns)

    def _header(self, time_ns: int, frame_id: str) -> dict:
        """A header; the static transform goes out with the first message, which has a stamp to give it."""
        if not self._has_tf:
            self._has_tf = True
            transform = _transform(time_ns, BASE_FRAME, CAMERA_FRAME, self._base_from_camera)
            self._write("/tf_static", "tf2_msgs/TFMessage", {"transforms": [transform]}, time_ns)
        return _header(time_ns, frame_id)


def is_own_sequence(path: Path) -> bool:
    """Whether a file is an MCAP file that a `SequenceWriter` wrote, with metadata."""
    try:
        return METADATA_NAME in Bag(path).metadata
    except SequenceError:
        return False


class EstimateWriter(_MessageWriter):
    """Writes what the filter believes, in messages that Foxglove and RViz show; use it in a `with` statement.

    Topics: `/estimate/pose` (best mode, PoseWithCovarianceStamped), `/estimate/modes` (MarkerArray: an arrow along each
    mode's optical axis, its opacity the weight), `/estimate/particles` (PoseArray, thinned), `/tf` (map ->
    camera_estimate). Poses are of the camera's optical frame: z is where it looks.
    """

    def __enter__(self) -> EstimateWriter:
        self._open()
        return self

    def write(
        self,
        time_ns: int,
        modes: Sequence[tuple[Poses, Float64[np.ndarray, "6 6"], float]],
        particles: Poses,
    ) -> None:
        """Write the belief after one image.

        Args:
            time_ns: Stamp of the image.
            modes: world_from_camera, covariance in the tangent at it (camera frame) and weight in [0, 1], best first.
            particles: world_from_camera, batch (n,); thinned evenly to at most 500.
        """
        header = _header(time_ns, MAP_FRAME)
        if modes:
            pose, covariance, _ = modes[0]
            ros_covariance = covariance_to_ros(covariance, pose).ravel().tolist()
            message = {"header": header, "pose": {"pose": _pose(pose), "covariance": ros_covariance}}
            self._write("/estimate/pose", "geometry_msgs/PoseWithCovarianceStamped", message, time_ns)
            transform = _transform(time_ns, MAP_FRAME, ESTIMATE_FRAME, pose)
            self._write("/tf", "tf2_msgs/TFMessage", {"transforms": [transform]}, time_ns)
        markers = [{"header": header, "ns": "modes", "action": _MARKER_DELETE_ALL}]
        markers += [_arrow(header, rank, pose, weight) for rank, (pose, _, weight) in enumerate(modes)]
        self._write("/estimate/modes", "visualization_msgs/MarkerArray", {"markers": markers}, time_ns)
        kept = np.unique(np.linspace(0, len(particles) - 1, min(_MAX_PARTICLES, len(particles))).astype(int))
        cloud = {"header": header, "poses": _poses(particles[kept])}
        self._write("/estimate/particles", "geometry_msgs/PoseArray", cloud, time_ns)


def _header(time_ns: int, frame_id: str) -> dict:
    """std_msgs/Header."""
    sec, nanosec = divmod(int(time_ns), 1_000_000_000)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame_id}


def _xyz(v: np.ndarray) -> dict:
    """geometry_msgs/Vector3 or Point of three numbers."""
    return {"x": v[0], "y": v[1], "z": v[2]}


def _pose(pose: Poses) -> dict:
    """geometry_msgs/Pose of one pose."""
    return _poses(Poses(pose.rotation[None], pose.translation[None]))[0]


def _poses(poses: Poses) -> list[dict]:
    """geometry_msgs/Pose of each of a batch (n,)."""
    rows = zip(poses.translation.tolist(), poses.as_quat_xyzw().tolist(), strict=True)
    return [
        {
            "position": {"x": t[0], "y": t[1], "z": t[2]},
            "orientation": {"x": q[0], "y": q[1], "z": q[2], "w": q[3]},
        }
        for t, q in rows
    ]


def _transform(time_ns: int, parent: str, child: str, parent_from_child: Poses) -> dict:
    """geometry_msgs/TransformStamped."""
    pose = _pose(parent_from_child)
    return {
        "header": _header(time_ns, parent),
        "child_frame_id": child,
        "transform": {"translation": pose["position"], "rotation": pose["orientation"]},
    }


def _arrow(header: dict, rank: int, world_from_camera: Poses, weight: float) -> dict:
    tip = world_from_camera.apply(np.array([0.0, 0.0, _ARROW_M]))
    return {
        "header": header,
        "ns": "modes",
        "id": rank,
        "type": _MARKER_ARROW,
        "pose": {"orientation": {"w": 1.0}},
        "points": [_xyz(world_from_camera.translation), _xyz(tip)],
        "scale": {"x": 0.1 * _ARROW_M, "y": 0.2 * _ARROW_M, "z": 0.3 * _ARROW_M},
        "color": {"r": 1.0, "g": 0.4, "b": 0.0, "a": float(np.clip(weight, 0.0, 1.0))},
        "text": f"{weight:.6g}",
    }
