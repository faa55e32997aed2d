"""Every reader of files, each with a small sample made here, and what is to be known of a reading."""

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from mcap.writer import CompressionType, IndexType
from torch import Tensor

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.datasets.frames import posed_frames
from sequences.estimates.options import EstimateOptions
from sequences.estimates.sequence import EstimateSequence
from sequences.frame import Camera, Frame, Trajectory
from sequences.options import OdometryUse, SequenceOptions
from sequences.reader import SequenceReader
from sequences.trajectories.pose_tables import read_pose_table
from sequences.trajectories.tum import read_tum, write_tum
from tests import data_sets, foxglove_files, phone_data_sets, pose_table_files, pose_text, tf_files
from tests.fuzz.damage import in_order, zipped
from tests.fuzz.mcap_damage import stated_images
from tests.sequence_files import BEGIN_NS, CAMERA, Walk, as_split_folder, picture, rewrite
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import load_checkpoint, save_checkpoint
from vapor.evaluation.validation import Validation
from vapor.regressors.base import PoseRegressor
from vapor.regressors.familiarity import Familiarity, description_size
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.registry import make_regressor
from vapor.regressors.retrieval import RetrievalRegressor
from vapor.regressors.scene_box import SceneBox
from vapor.training.state import TrainingState, load_state, save_state

_IMAGES = 6
_WALK_TOPIC, _ROBOT_TOPIC = "/camera/image/compressed", "/image/compressed"


class UnsoundError(Exception):
    """What was read cannot be: a camera of negative focal length, a pose that is not finite."""


@dataclass(frozen=True)
class Reading:
    """What a reader made of a file.

    Attributes:
        content: Digest of all that was read.
        items: How many images, poses or tensors.
        told: What was left out, by reason, and notices.
    """

    content: bytes
    items: int
    told: Mapping[str, int] = field(default_factory=dict)

    @property
    def images_told(self) -> int:
        """How many images were counted as left out."""
        others = ("odometry time", "unusable odometry", "true pose time", "odometry from", "notice")
        return sum(count for reason, count in self.told.items() if not reason.startswith(others))


@dataclass(frozen=True)
class Reader:
    """One way to read one kind of file.

    Attributes:
        make: Writes the sample into an empty folder; gives what is to be read.
        read: Reads it.
        image_topic: Of a recording, the topic whose messages are counted; None where nothing says how many there are.
        counts_images: Whether images lost must be counted.
    """

    make: Callable[[Path], Path]
    read: Callable[[Path], Reading]
    image_topic: str | None = None
    counts_images: bool = False

    def stated(self, path: Path) -> int | None:
        """How many images a recording says it has; None where it does not say."""
        if self.image_topic is None:
            return None
        files = [path] if path.is_file() else sorted(path.glob("*.mcap"))
        counts = [stated_images(file.read_bytes(), self.image_topic) for file in files]
        return sum(count or 0 for count in counts) or None


class _Content:
    """A digest of values of any kind, which must be sound."""

    def __init__(self) -> None:
        self._hash = hashlib.blake2b(digest_size=16)

    def add(self, *values: Any) -> None:
        for value in values:
            if isinstance(value, Poses):
                self._pose(value)
            elif isinstance(value, Odometry):
                self._pose(value.previous_from_current)
                _require(np.isfinite(value.covariance).all(), "covariance of odometry", value.covariance)
                self._hash.update(value.covariance.tobytes())
            elif isinstance(value, Camera):
                numbers = (value.fx, value.fy, value.cx, value.cy)
                _require(bool(np.isfinite(numbers).all()) and value.fx > 0 and value.fy > 0, "camera", value)
                _require(value.width > 0 and value.height > 0, "camera", value)
                self._hash.update(repr(value).encode())
            else:
                self._hash.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())

    def _pose(self, poses: Poses) -> None:
        _require(bool(poses.is_finite().all()), "pose", poses)
        rotation = poses.rotation
        skew = np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)).max(initial=0.0)
        _require(bool(skew < 1e-5), "rotation", poses)
        self._hash.update(rotation.tobytes() + poses.translation.tobytes())

    @property
    def digest(self) -> bytes:
        return self._hash.digest()


def _require(sound: bool, what: str, value: Any) -> None:
    if not sound:
        raise UnsoundError(f"{what} {value}")


def _of_frames(frames: Iterable[Frame], told: Callable[[], Mapping[str, int]]) -> Reading:
    content, number, before_ns = _Content(), 0, None
    for frame in frames:
        _require(before_ns is None or frame.time_ns > before_ns, "stamp", frame.time_ns)
        before_ns, number = frame.time_ns, number + 1
        content.add(frame.time_ns, frame.image, frame.odometry, frame.world_from_camera, frame.camera)
    return Reading(content.digest, number, told())


def _of_trajectory(trajectory: Trajectory) -> Reading:
    content = _Content()
    content.add(trajectory.times_ns, trajectory.poses)
    _require(bool((np.diff(trajectory.times_ns) > 0).all()), "stamps", trajectory.times_ns)
    return Reading(content.digest, len(trajectory.times_ns))


# --- recordings ------------------------------------------------------------------------------------


def _recording(path: Path, odometry: OdometryUse = "required") -> Reading:
    reader = SequenceReader(path, SequenceOptions(), odometry=odometry)
    return _of_frames(reader, lambda: reader.skipped + Counter(f"notice: {notice}" for notice in reader.notices))


def _walk(folder: Path, **settings: Any) -> Path:
    source = Walk(_IMAGES).write(folder / "source", {"odometry": "exact, for tests"})
    target = rewrite(source, folder / "walk.mcap", **{"chunk_size": 4000, **settings})
    source.unlink()
    return target


_NO_INDEX = {
    "index_types": IndexType.NONE,
    "repeat_channels": False,
    "repeat_schemas": False,
    "use_statistics": False,
    "use_summary_offsets": False,
}


def _foxglove(folder: Path, encoding: str) -> Path:
    parts = (foxglove_files.images(_IMAGES), foxglove_files.calibration(), foxglove_files.camera_poses(_IMAGES))
    return foxglove_files.write(folder / "walk.mcap", encoding, *parts, foxglove_files.robot())


def _tf(folder: Path) -> Path:
    parts = (tf_files.images(_IMAGES), tf_files.mounted())
    moving = tf_files.tf("odom", "base_link", tf_files.stamps(_IMAGES), tf_files.body)
    fixed = tf_files.tf("map", "odom", tf_files.stamps(_IMAGES, every_ms=90), lambda _: tf_files.MAP_FROM_ODOM)
    return tf_files.record(folder / "walk.mcap", *parts, moving, fixed)


def _told_by(folder: Path, message_type: str) -> Path:
    times_ns = tf_files.stamps(_IMAGES)
    truth = tf_files.told_by(message_type, times_ns)
    parts = (tf_files.images(_IMAGES), tf_files.mounted(), tf_files.odometry(times_ns), truth)
    return tf_files.record(folder / "walk.mcap", *parts)


def _raw(folder: Path) -> Path:
    events = []
    for i in range(_IMAGES):
        time_ns, pixels = BEGIN_NS + 100 * tf_files.MS * i, picture(i)
        height, width, _ = pixels.shape
        message = {"height": height, "width": width, "encoding": "rgb8", "is_bigendian": 0, "step": 3 * width}
        message |= {"header": tf_files.header(time_ns, "camera"), "data": pixels.tobytes()}
        events.append(tf_files.Event(time_ns, "/image", "sensor_msgs/Image", message))
    poses = tf_files.odometry(tf_files.stamps(_IMAGES))
    return tf_files.record(folder / "walk.mcap", events, tf_files.mounted(), poses, [_camera_info()])


def _camera_info() -> tf_files.Event:
    c = CAMERA
    message = {
        "header": tf_files.header(BEGIN_NS, "camera"),
        "height": c.height,
        "width": c.width,
        "distortion_model": "plumb_bob",
        "d": [0.1, -0.05, 0.0, 0.0, 0.0],
        "k": [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0],
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
    return tf_files.Event(BEGIN_NS, "/camera_info", "sensor_msgs/CameraInfo", message)


def _video(folder: Path, *, of_ros: bool) -> Path:
    from tests import video_files  # PyAV is an extra

    packets = video_files.encode(video_files.pictures(2 * _IMAGES, 48, 32))
    file = folder / "walk.mcap"
    if of_ros:
        return tf_files.record(file, video_files.ffmpeg_packets(packets, "libx264"))
    return foxglove_files.write(file, "protobuf", video_files.video(packets))


def _split(folder: Path) -> Path:
    """Three images in each of two files."""
    source = Walk(_IMAGES).write(folder / "source")
    bag = as_split_folder(source, folder, cut_s=0.255)
    source.unlink()
    return bag


# --- data sets -------------------------------------------------------------------------------------


def _data_set(path: Path) -> Reading:
    frames = posed_frames(path)
    return _of_frames(frames, lambda: frames.skipped + Counter(f"notice: {notice}" for notice in frames.notices))


def _with_intrinsics(folder: Path) -> Path:
    sequence = data_sets.make_ambiguous(folder / "scene") / "train" / "seq00"
    (sequence / "intrinsics.json").write_text(json.dumps(data_sets.INTRINSICS))
    return sequence


def _r3d(folder: Path) -> Path:
    members = {"metadata": json.dumps(phone_data_sets.r3d_metadata()).encode()}
    members |= {f"rgbd/{i}.jpg": data for i, data in enumerate(phone_data_sets.r3d_images())}
    (folder / "walk.r3d").write_bytes(zipped(members))
    return folder / "walk.r3d"


# --- text ------------------------------------------------------------------------------------------


def _track() -> Trajectory:
    times_ns = tf_files.stamps(_IMAGES)
    return Trajectory(np.array(times_ns, np.int64), Poses.stack([tf_files.body(t) for t in times_ns]))


def _tum(folder: Path) -> Path:
    write_tum(folder / "walk.tum", _track())
    return folder / "walk.tum"


def _euroc_table(folder: Path) -> Path:
    return pose_table_files.as_euroc(folder)


def _kitti_table(folder: Path) -> Path:
    return pose_table_files.as_kitti(folder)


def _estimates(folder: Path, *, named: bool) -> Path:
    if not named:
        write_tum(folder / "odometry.txt", _track())
        write_tum(folder / "estimates.txt", _track())
        return folder
    poses = {name: pose for name, pose in pose_text.walk().items() if int(name[-16:-10]) < 10}
    for name in ("estimates.txt", "odometry.txt"):
        pose_text.write_named(folder / name, poses, world_to_camera=False)
    return folder


def _read_estimates(folder: Path, *, named: bool) -> Reading:
    options = EstimateOptions(direction="camera-to-world" if named else None)
    sequence = EstimateSequence([folder / "estimates.txt"], odometry=folder / "odometry.txt", options=options)
    content, number = _Content(), 0
    for frame in sequence:
        content.add(frame.time_ns, frame.odometry, frame.estimates)
        number += 1
    content.add(sequence.interval_s, sequence.speed_m_per_s)
    return Reading(content.digest, number, dict(sequence.skipped))


# --- models ----------------------------------------------------------------------------------------

_NETWORK = NetworkConfig(
    "resnet18-quarter", image_width=32, image_height=32, shortest_edge=36, feature_dim=16, latent_dim=4
)


def _numbers(like: Tensor, rng: np.random.Generator) -> Tensor:
    """The same on every machine, as random numbers of torch and what is computed from them are not."""
    return torch.from_numpy(rng.uniform(0.01, 0.1, tuple(like.shape)).astype(np.float32))


def _regressor(network: NetworkConfig, box: SceneBox, rng: np.random.Generator) -> PoseRegressor:
    regressor = make_regressor(network, box)
    with torch.no_grad():
        for weights in regressor.parameters():
            weights.copy_(_numbers(weights, rng))
    return regressor


def _model(folder: Path, *, retrieval: bool) -> Path:
    poses = Poses.stack([pose for _, pose in Walk(_IMAGES).truth])
    box = SceneBox.around(poses)
    network = replace(_NETWORK, head="retrieval", hidden_width=8, components=2) if retrieval else _NETWORK
    rng = np.random.default_rng(0)
    regressor, memory = _regressor(network, box, rng), None
    size = description_size(regressor)
    numbers = [rng.uniform(0.5, 1.0, shape).astype(np.float32) for shape in ((size,), (size,), (size, 4), (4,), (5, 4))]
    if retrieval:
        assert isinstance(regressor, RetrievalRegressor)
        features = _numbers(torch.empty(len(poses), len(regressor.centre)), rng)
        translation, rotation = (torch.from_numpy(each).float() for each in (poses.translation, poses.rotation))
        regressor.eval().remember(features, translation, rotation)
        memory = regressor.memory
        assert memory is not None
        memory = replace(memory, keys=_numbers(memory.keys, rng), views=_numbers(memory.views, rng))
    told = {"familiarity": Familiarity(*numbers, 0.5, 1.0), "camera": CAMERA, "memory": memory}
    checkpoint = Checkpoint(network, box, Calibration(), poses, regressor.state_dict(), **told)
    save_checkpoint(folder / "model.safetensors", checkpoint, store_float16=True)
    return _in_order(folder / "model.safetensors")


def _in_order(file: Path) -> Path:
    file.write_bytes(in_order(file.read_bytes()))
    return file


def _load_model(path: Path) -> Reading:
    loaded = load_checkpoint(path)
    content = _Content()
    content.add(loaded.network, loaded.box, loaded.calibration, loaded.prior_poses, loaded.camera, loaded.training)
    parts = dict(loaded.state_dict)
    for part in (loaded.familiarity, loaded.memory):
        parts |= vars(part) if part is not None else {}
    for name, values in sorted(parts.items()):
        array = np.asarray(values)
        _require(bool(np.isfinite(array).all()), "tensor", name)
        content.add(name, array)
    return Reading(content.digest, len(parts))


_TRAINING = {"seed": 0}
_BOX = SceneBox.around(Poses.stack([pose for _, pose in Walk(_IMAGES).truth]))


def _training(rng: np.random.Generator) -> TrainingState:
    """A training that has yet to begin."""
    network, average = _regressor(_NETWORK, _BOX, rng), make_regressor(_NETWORK, _BOX)
    return TrainingState(network, average, torch.optim.AdamW(network.parameters()))


def _training_state(folder: Path) -> Path:
    rng = np.random.default_rng(0)
    state = _training(rng)
    state.average.load_state_dict(state.network.state_dict())
    for weights in state.network.parameters():
        moments = {"exp_avg": _numbers(weights, rng), "exp_avg_sq": _numbers(weights, rng)}
        state.optimizer.state[weights] = {"step": torch.tensor(3.0), **moments}
    state.epochs, state.epoch, state.seconds = 3, 1, 2.5
    state.history, state.best = [Validation(1, -0.5, 0.25, 0.5, -3.0)], dict(state.average.state_dict())
    save_state(folder / "model.training.safetensors", state, _TRAINING)
    return _in_order(folder / "model.training.safetensors")


def _load_training(path: Path) -> Reading:
    state = _training(np.random.default_rng(1))
    notices = load_state(path, state, _TRAINING)
    # What a training that goes on does with it.
    max(state.history, key=lambda figures: figures.log_density, default=None)
    state.average.load_state_dict(state.best or state.average.state_dict())
    content = _Content()
    content.add(state.epochs, state.epoch, state.seconds, state.history)
    moments = [values for each in state.optimizer.state.values() for values in each.values()]
    tensors = [*state.network.state_dict().values(), *state.average.state_dict().values(), *moments]
    for values in tensors:
        content.add(values.numpy())
    return Reading(content.digest, len(tensors), Counter(f"notice: {notice}" for notice in notices))


# --- all -------------------------------------------------------------------------------------------


def _mcap(make: Callable[[Path], Path], topic: str = _WALK_TOPIC, odometry: OdometryUse = "required") -> Reader:
    return Reader(make, partial(_recording, odometry=odometry), topic, counts_images=True)


def _layout(make: Callable[[Path], Path]) -> Reader:
    return Reader(make, _data_set, counts_images=True)


READERS: Mapping[str, Reader] = MappingProxyType(
    {
        "mcap": _mcap(partial(_walk, compression=CompressionType.NONE)),
        "mcap-lz4": _mcap(partial(_walk, compression=CompressionType.LZ4)),
        "mcap-zstd": _mcap(partial(_walk, compression=CompressionType.ZSTD)),
        "mcap-without-checksums": _mcap(partial(_walk, enable_crcs=False)),
        "mcap-without-chunks": _mcap(partial(_walk, use_chunking=False)),
        "mcap-without-index": _mcap(partial(_walk, **_NO_INDEX)),
        "mcap-protobuf": _mcap(partial(_foxglove, encoding="protobuf"), "/camera/image"),
        "mcap-json": _mcap(partial(_foxglove, encoding="json"), "/camera/image"),
        "mcap-foxglove-cdr": _mcap(partial(_foxglove, encoding="cdr"), "/camera/image"),
        "mcap-tf": _mcap(_tf, _ROBOT_TOPIC),
        "mcap-path": _mcap(partial(_told_by, message_type="nav_msgs/Path"), _ROBOT_TOPIC),
        "mcap-covariance": _mcap(
            partial(_told_by, message_type="geometry_msgs/PoseWithCovarianceStamped"), _ROBOT_TOPIC
        ),
        "mcap-transform": _mcap(partial(_told_by, message_type="geometry_msgs/TransformStamped"), _ROBOT_TOPIC),
        "mcap-raw": _mcap(_raw, "/image"),
        "mcap-video": _mcap(partial(_video, of_ros=False), "/camera/image", "unread"),
        "mcap-ffmpeg": _mcap(partial(_video, of_ros=True), "/camera/image/ffmpeg", "unread"),
        "rosbag2": _mcap(_split),
        "tum-rgbd": _layout(lambda folder: data_sets.make_tum(folder / "rgbd_dataset_freiburg1_x", num_images=5)),
        "seven-scenes": _layout(lambda folder: data_sets.make_7scenes(folder / "scene", num_images=5)),
        "ambiguous": _layout(lambda folder: data_sets.make_ambiguous(folder / "scene") / "train"),
        "intrinsics": _layout(_with_intrinsics),
        "ceiling": _layout(lambda folder: data_sets.make_ceiling(folder / "scene") / "train"),
        "cambridge": _layout(lambda folder: data_sets.make_cambridge(folder / "scene") / "dataset_train.txt"),
        "colmap": _layout(lambda folder: data_sets.make_colmap(folder / "scene", "sparse/0", "images")),
        "colmap-binary": _layout(lambda folder: phone_data_sets.make_colmap_binary(folder / "scene")),
        "euroc": _layout(lambda folder: phone_data_sets.make_euroc(folder / "MH_01", distorted=True)),
        "stray-scanner": _layout(lambda folder: phone_data_sets.make_stray(folder / "scan")),
        "stray-scanner-images": _layout(lambda folder: phone_data_sets.make_stray(folder / "scan", video=False)),
        "record3d": _layout(_r3d),
        "record3d-export": _layout(
            lambda folder: phone_data_sets.make_record3d_export(folder / "scan", phone_data_sets.r3d_metadata())
        ),
        "nerfstudio": _layout(lambda folder: phone_data_sets.make_nerfstudio(folder / "scene")),
        "tum": Reader(_tum, lambda path: _of_trajectory(read_tum(path))),
        "euroc-table": Reader(_euroc_table, lambda path: _of_trajectory(read_pose_table(path))),
        "kitti-table": Reader(_kitti_table, lambda path: _of_trajectory(read_pose_table(path))),
        "estimates": Reader(partial(_estimates, named=True), partial(_read_estimates, named=True)),
        "estimates-timed": Reader(partial(_estimates, named=False), partial(_read_estimates, named=False)),
        "model": Reader(partial(_model, retrieval=False), _load_model),
        "model-retrieval": Reader(partial(_model, retrieval=True), _load_model),
        "training-state": Reader(_training_state, _load_training),
    }
)
"""By name; what follows a dash is the kind of file."""
