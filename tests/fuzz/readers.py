"""Every reader of files, each with a small sample made here."""

import json
import struct
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from mcap.writer import CompressionType

from filtering.se3 import Poses
from sequences.datasets.frames import posed_frames
from sequences.estimates.sequence import EstimateOptions, EstimateSequence
from sequences.frame import Trajectory
from sequences.options import OdometryUse, SequenceOptions
from sequences.reader import SequenceReader
from sequences.trajectories.pose_tables import read_pose_table
from sequences.trajectories.tum import read_tum, write_tum
from tests.fuzz.damage import zipped
from tests.fuzz.model_files import (
    load_model,
    load_training,
    make_exported,
    make_model,
    make_training_state,
    read_exported,
)
from tests.fuzz.reading import NUM_IMAGES, Content, Reader, Reading, read_frames, require
from tests.helpers import data_sets, dot_scene, foxglove_files, pose_files, tf_files
from tests.helpers.sequence_files import (
    BEGIN_NS,
    CAMERA,
    Walk,
    as_file_without_index,
    as_packed_messages,
    as_ros1_bag,
    as_split_folder,
    as_sqlite_folder,
    picture,
    rewrite,
)

_WALK_TOPIC, _ROBOT_TOPIC = "/camera/image/compressed", "/image/compressed"
_TIMES_NS = tf_files.stamps(NUM_IMAGES)


# --- recordings -----------------------------------------------------------------------------------


def _recording(path: Path, odometry: OdometryUse = "required") -> Reading:
    return read_frames(SequenceReader(path, SequenceOptions(), odometry=odometry))


def _of_walk(folder: Path, form: Callable[[Path, Path], Path]) -> Path:
    """The walk in a form that another recorder writes."""
    source = Walk(NUM_IMAGES).write(folder / "source", {"odometry": "exact, for tests"})
    target = form(source, folder)
    source.unlink()
    return target


def _walk(folder: Path, **settings: Any) -> Path:
    return _of_walk(folder, lambda source, _: rewrite(source, folder / "walk.mcap", **{"chunk_size": 4000, **settings}))


def _foxglove(folder: Path, encoding: str) -> Path:
    parts = (foxglove_files.images(NUM_IMAGES), foxglove_files.calibration(), foxglove_files.camera_poses(NUM_IMAGES))
    return foxglove_files.write(folder / "walk.mcap", encoding, *parts, foxglove_files.robot())


def _robot(folder: Path, *parts: list[tf_files.Event]) -> Path:
    return tf_files.record(folder / "walk.mcap", tf_files.images(NUM_IMAGES), tf_files.mounted(), *parts)


def _tf(folder: Path) -> Path:
    moving = tf_files.tf("odom", "base_link", _TIMES_NS, tf_files.body)
    fixed = tf_files.tf("map", "odom", tf_files.stamps(NUM_IMAGES, every_ms=90), lambda _: tf_files.MAP_FROM_ODOM)
    return _robot(folder, moving, fixed)


def _true_poses(folder: Path, message_type: str) -> Path:
    return _robot(folder, tf_files.odometry(_TIMES_NS), tf_files.told_by(message_type, _TIMES_NS))


def _raw(folder: Path) -> Path:
    events = []
    for i in range(NUM_IMAGES):
        time_ns, pixels = BEGIN_NS + 100 * tf_files.MS * i, picture(i)
        height, width, _ = pixels.shape
        message = {"height": height, "width": width, "encoding": "rgb8", "is_bigendian": 0, "step": 3 * width}
        message |= {"header": tf_files.header(time_ns, "camera"), "data": pixels.tobytes()}
        events.append(tf_files.Event(time_ns, "/image", "sensor_msgs/Image", message))
    (info,) = tf_files.camera_infos([(BEGIN_NS, CAMERA)], "/camera_info")
    info.message["d"] = [0.1, -0.05, 0.0, 0.0, 0.0]
    odometry = tf_files.odometry(_TIMES_NS)
    return tf_files.record(folder / "walk.mcap", events, tf_files.mounted(), odometry, [info])


def _video(folder: Path, *, of_ros: bool) -> Path:
    from tests.helpers import video_files  # PyAV is an extra

    packets = video_files.encode(video_files.pictures(2 * NUM_IMAGES, 48, 32))
    file = folder / "walk.mcap"
    if of_ros:
        return tf_files.record(file, video_files.ffmpeg_packets(packets, "libx264"))
    return foxglove_files.write(file, "protobuf", video_files.video(packets))


# --- data sets ------------------------------------------------------------------------------------


def _data_set(path: Path) -> Reading:
    return read_frames(posed_frames(path))


def _with_points(path: Path) -> Reading:
    frames = posed_frames(path)
    frames.seen_points()
    return read_frames(frames)


def _points(folder: Path, suffix: str) -> Path:
    if suffix == ".bin":
        root = dot_scene.make_colmap_binary(folder / "scene")
        point = struct.pack("<Q3d3BdQ", 12, 1.0, 2.0, 3.0, 1, 2, 3, 0.5, 1) + struct.pack("<ii", 4, 5)
        (root / "sparse" / "0" / "points3D.bin").write_bytes(struct.pack("<Q", 1) + point)
        return root
    root = data_sets.make_colmap(folder / "scene", "sparse/0", "images")
    (root / "sparse" / "0" / "points3D.txt").write_text("58396 1 2 3 1 2 3 0.5 5 0\n")
    return root


def _with_intrinsics(folder: Path) -> Path:
    sequence = data_sets.make_ambiguous(folder / "scene") / "train" / "seq00"
    (sequence / "intrinsics.json").write_text(json.dumps(data_sets.INTRINSICS))
    return sequence


def _r3d(folder: Path) -> Path:
    members = {"metadata": json.dumps(dot_scene.r3d_metadata()).encode()}
    members |= {f"rgbd/{i}.jpg": data for i, data in enumerate(dot_scene.r3d_images())}
    (folder / "walk.r3d").write_bytes(zipped(members))
    return folder / "walk.r3d"


# --- text -----------------------------------------------------------------------------------------


def _trajectory(path: Path, read: Callable[[Path], Trajectory]) -> Reading:
    trajectory, content = read(path), Content()
    content.add(trajectory.times_ns, trajectory.poses)
    require(bool((np.diff(trajectory.times_ns) > 0).all()), "stamps", trajectory.times_ns)
    return Reading(content.digest, len(trajectory.times_ns))


def _tum(folder: Path, name: str = "walk.tum") -> Path:
    track = Trajectory(np.array(_TIMES_NS, np.int64), Poses.stack([tf_files.body(t) for t in _TIMES_NS]))
    write_tum(folder / name, track)
    return folder / name


_WEIGHTED = "name qw qx qy qz tx ty tz weight"


def _timed_estimates(folder: Path) -> Path:
    _tum(folder, "odometry.txt")
    return _tum(folder, "estimates.txt").parent


def _named_estimates(folder: Path, *, weighted: bool = False) -> Path:
    poses = {name: pose for name, pose in pose_files.walk().items() if int(name[-16:-10]) < 10}
    for name in ("estimates.txt", "odometry.txt"):
        pose_files.write_named(folder / name, poses, world_to_camera=False)
    if weighted:  # two hypotheses a frame
        path = folder / "estimates.txt"
        lines = [line.rsplit(maxsplit=1)[0] for line in path.read_text().splitlines()]
        path.write_text("".join(f"{line} {weight}\n" for line in lines for weight in (120, 31.5)))
    return folder


def _read_estimates(folder: Path, options: EstimateOptions) -> Reading:
    sequence = EstimateSequence([folder / "estimates.txt"], odometry=folder / "odometry.txt", options=options)
    content, number = Content(), 0
    for frame in sequence:
        content.add(frame.time_ns, frame.odometry, frame.estimates)
        number += 1
    content.add(sequence.interval_s, sequence.speed_m_per_s)
    return Reading(content.digest, number, dict(sequence.skipped))


# --- all ------------------------------------------------------------------------------------------


def _mcap(make: Callable[[Path], Path], topic: str = _WALK_TOPIC, odometry: OdometryUse = "required") -> Reader:
    return Reader(make, partial(_recording, odometry=odometry), topic, counts_images=True)


def _other(form: Callable[[Path, Path], Path]) -> Reader:
    return Reader(partial(_of_walk, form=form), _recording, counts_images=True)


def _layout(make: Callable[[Path], Path], read: Callable[[Path], Reading] = _data_set) -> Reader:
    return Reader(make, read, counts_images=True)


READERS: Mapping[str, Reader] = MappingProxyType(
    {
        "mcap": _mcap(partial(_walk, compression=CompressionType.NONE)),
        "mcap-lz4": _mcap(partial(_walk, compression=CompressionType.LZ4)),
        "mcap-zstd": _mcap(partial(_walk, compression=CompressionType.ZSTD)),
        "mcap-without-checksums": _mcap(partial(_walk, enable_crcs=False)),
        "mcap-without-chunks": _mcap(partial(_walk, use_chunking=False)),
        "mcap-without-index": _mcap(partial(_of_walk, form=as_file_without_index)),
        "mcap-protobuf": _mcap(partial(_foxglove, encoding="protobuf"), "/camera/image"),
        "mcap-json": _mcap(partial(_foxglove, encoding="json"), "/camera/image"),
        "mcap-foxglove-cdr": _mcap(partial(_foxglove, encoding="cdr"), "/camera/image"),
        "mcap-tf": _mcap(_tf, _ROBOT_TOPIC),
        "mcap-path": _mcap(partial(_true_poses, message_type="nav_msgs/Path"), _ROBOT_TOPIC),
        "mcap-covariance": _mcap(
            partial(_true_poses, message_type="geometry_msgs/PoseWithCovarianceStamped"), _ROBOT_TOPIC
        ),
        "mcap-transform": _mcap(partial(_true_poses, message_type="geometry_msgs/TransformStamped"), _ROBOT_TOPIC),
        "mcap-raw": _mcap(_raw, "/image"),
        "mcap-video": _mcap(partial(_video, of_ros=False), "/camera/image", "unread"),
        "mcap-ffmpeg": _mcap(partial(_video, of_ros=True), "/camera/image/ffmpeg", "unread"),
        "rosbag2": _mcap(partial(_of_walk, form=partial(as_split_folder, cut_s=0.255))),
        "rosbag2-sqlite": _other(as_sqlite_folder),
        "rosbag2-packed": _other(as_packed_messages),
        "ros1": _other(as_ros1_bag),
        "tum-rgbd": _layout(lambda folder: data_sets.make_tum(folder / "rgbd_dataset_freiburg1_x", num_images=5)),
        "seven-scenes": _layout(lambda folder: data_sets.make_7scenes(folder / "scene", num_images=5)),
        "ambiguous": _layout(lambda folder: data_sets.make_ambiguous(folder / "scene") / "train"),
        "intrinsics": _layout(_with_intrinsics),
        "ceiling": _layout(lambda folder: data_sets.make_ceiling(folder / "scene") / "train"),
        "cambridge": _layout(lambda folder: data_sets.make_cambridge(folder / "scene") / "dataset_train.txt"),
        "colmap": _layout(lambda folder: data_sets.make_colmap(folder / "scene", "sparse/0", "images")),
        "colmap-binary": _layout(lambda folder: dot_scene.make_colmap_binary(folder / "scene")),
        "colmap-points": _layout(partial(_points, suffix=".txt"), _with_points),
        "colmap-points-binary": _layout(partial(_points, suffix=".bin"), _with_points),
        "euroc": _layout(lambda folder: dot_scene.make_euroc(folder / "MH_01", distorted=True)),
        "stray-scanner": _layout(lambda folder: dot_scene.make_stray(folder / "scan")),
        "stray-scanner-images": _layout(lambda folder: dot_scene.make_stray(folder / "scan", video=False)),
        "record3d": _layout(_r3d),
        "record3d-export": _layout(
            lambda folder: dot_scene.make_record3d_export(folder / "scan", dot_scene.r3d_metadata())
        ),
        "nerfstudio": _layout(lambda folder: dot_scene.make_nerfstudio(folder / "scene")),
        "tum": Reader(_tum, partial(_trajectory, read=read_tum)),
        "euroc-table": Reader(pose_files.as_euroc, partial(_trajectory, read=read_pose_table)),
        "kitti-table": Reader(pose_files.as_kitti, partial(_trajectory, read=read_pose_table)),
        "estimates": Reader(
            _named_estimates, partial(_read_estimates, options=EstimateOptions(direction="camera-to-world"))
        ),
        "estimates-timed": Reader(_timed_estimates, partial(_read_estimates, options=EstimateOptions())),
        "estimates-weighted": Reader(
            partial(_named_estimates, weighted=True),
            partial(_read_estimates, options=EstimateOptions(direction="camera-to-world", columns=_WEIGHTED)),
        ),
        "model": Reader(partial(make_model, retrieval=False), load_model),
        "model-retrieval": Reader(partial(make_model, retrieval=True), load_model),
        "model-landmarks": Reader(partial(make_model, retrieval=False, landmarks=True), load_model),
        "model-exported": Reader(make_exported, read_exported),
        "training-state": Reader(make_training_state, load_training),
    }
)
"""By name; what follows a dash is the kind of file."""
