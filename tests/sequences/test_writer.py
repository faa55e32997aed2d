"""Frames and estimates -> MCAP, and back through the reader and the library's own decoder."""

import os
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from filtering.motion import accumulated
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.reader import SequenceReader
from sequences.recordings.estimate_messages import EstimateWriter
from sequences.recordings.messages import covariance_from_ros
from sequences.writer import SequenceWriter

CAMERA = Camera(64, 48, 50.0, 51.0, 31.5, 23.5)
BEGIN_NS = 1_700_000_000_987_654_321


def decoded(path: Path, topic: str) -> list:
    """Messages of a topic as the file's own definitions have them, which is how Foxglove and RViz read them."""
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [m.decoded_message for m in reader.iter_decoded_messages(topics=[topic])]


def pose_of(message: object) -> Poses:
    p, q = message.position, message.orientation  # pyright: ignore[reportAttributeAccessIssue]
    return Poses.from_quat_xyzw(np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w]))


def sequence_writer(path: Path, **options: object) -> SequenceWriter:
    return SequenceWriter(path, camera=CAMERA, base_from_camera=Poses.exp(np.arange(6) * 0.2), **options)  # pyright: ignore[reportArgumentType]


def write_short(writer: SequenceWriter) -> None:
    y, x = np.mgrid[0:48, 0:64]
    image = np.stack([4 * x, 5 * y, 255 - 2 * x - 2 * y], axis=-1).astype(np.uint8)
    for i in range(3):
        pose = Poses.exp(np.array([0.1, 0.2, 0.0, 0.0, 0.0, 0.3]) * i)
        writer.write_odometry(BEGIN_NS + i * 10**8, pose, np.eye(6) * 0.01)
        writer.write_true_pose(BEGIN_NS + i * 10**8, pose)
        writer.write_image(BEGIN_NS + i * 10**8, image)


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    with sequence_writer(path, metadata={"odometry": "simulated: test", "seed": "3"}) as writer:
        write_short(writer)
    reader = SequenceReader(path)
    frames = list(reader)
    assert [frame.time_ns for frame in frames] == [BEGIN_NS + i * 10**8 for i in range(3)]
    assert reader.camera == CAMERA
    assert reader.odometry_description == "simulated: test"
    y, x = np.mgrid[0:48, 0:64]
    expected = np.stack([4 * x, 5 * y, 255 - 2 * x - 2 * y], axis=-1)
    assert np.abs(frames[0].image - expected.astype(float)).mean() < 4  # JPEG; swapped channels would be 80 off
    tangent = np.array([0.1, 0.2, 0.0, 0.0, 0.0, 0.3])
    increment = Poses.exp(tangent)
    covariance = accumulated(tangent, np.eye(6) * 0.01 * 0.1**2)  # of the base; it comes evenly along the way
    base_from_camera = Poses.exp(np.arange(6) * 0.2)
    camera_increment = base_from_camera.inverse() @ increment @ base_from_camera
    carry = base_from_camera.inverse().adjoint()
    for i, frame in enumerate(frames):
        assert frame.world_from_camera is not None
        truth = Poses.exp(np.array([0.1, 0.2, 0.0, 0.0, 0.0, 0.3]) * i)
        np.testing.assert_allclose(frame.world_from_camera.as_matrix(), truth.as_matrix(), atol=1e-12)
        if i:
            assert frame.odometry is not None
            found = frame.odometry.previous_from_current.as_matrix()
            np.testing.assert_allclose(found, camera_increment.as_matrix(), atol=1e-12)
            np.testing.assert_allclose(frame.odometry.covariance, carry @ covariance @ carry.T, atol=1e-15)


def test_messages_are_as_ros_has_them(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    with sequence_writer(path) as writer:
        write_short(writer)
    (odometry, *_), (info, *_) = decoded(path, "/odom"), decoded(path, "/camera/camera_info")
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("odom", "base_link")
    assert (odometry.header.stamp.sec, odometry.header.stamp.nanosec) == (1_700_000_000, 987_654_321)
    assert odometry.twist.covariance[0] == 0.01
    assert list(info.k) == [50.0, 0.0, 31.5, 0.0, 51.0, 23.5, 0.0, 0.0, 1.0]
    (tf,) = decoded(path, "/tf_static")
    (transform,) = tf.transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("base_link", "camera_optical_frame")
    with open(path, "rb") as file:
        reader = make_reader(file)
        header, summary = reader.get_header(), reader.get_summary()
    assert header.profile == "ros2"
    assert summary is not None
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_an_interrupted_writer_leaves_nothing_and_harms_nothing(error: type[BaseException], tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    path.write_text("before")

    def interrupted() -> None:
        with sequence_writer(path) as writer:
            write_short(writer)
            assert len(list(tmp_path.iterdir())) == 2
            raise error

    with pytest.raises(error):
        interrupted()
    assert [p.name for p in tmp_path.iterdir()] == ["out.mcap"]
    assert path.read_text() == "before"


def test_a_failing_disk_is_one_error_that_names_the_file(tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full on this system")
    path = tmp_path / "out.mcap"

    def write_to_a_full_disk() -> None:
        with sequence_writer(path) as writer:
            (partial,) = tmp_path.glob(".*.partial/out.mcap")
            fd = next(f for f in Path("/proc/self/fd").iterdir() if f.exists() and f.resolve() == partial)
            full = os.open("/dev/full", os.O_WRONLY)
            os.dup2(full, int(fd.name))
            os.close(full)
            write_short(writer)

    with pytest.raises(SequenceError, match=r"out\.mcap: cannot write: No space"):
        write_to_a_full_disk()
    assert list(tmp_path.iterdir()) == []


def test_an_estimate_is_written_in_ros_conventions(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(scale=0.1, size=(6, 6))
    poses = Poses.exp(rng.normal(size=(2, 6)))
    modes = [(poses[0], root @ root.T, 0.7), (poses[1], np.eye(6), 0.3)]
    particles = Poses.exp(rng.normal(size=(300, 6)))
    path = tmp_path / "estimate.mcap"
    with EstimateWriter(path) as writer:
        writer.write(BEGIN_NS, modes, particles)
        writer.write(BEGIN_NS + 10**8, modes[:1], particles[:3])
    best = decoded(path, "/estimate/pose")[0]
    assert best.header.frame_id == "map"
    np.testing.assert_allclose(pose_of(best.pose.pose).as_matrix(), poses[0].as_matrix(), atol=1e-12)
    covariance = np.array(best.pose.covariance).reshape(6, 6)
    np.testing.assert_allclose(covariance_from_ros(covariance, poses[0]), root @ root.T, atol=1e-12)
    assert not np.allclose(covariance, root @ root.T, atol=1e-3)

    first, second = decoded(path, "/estimate/modes")
    assert [marker.action for marker in first.markers] == [3, 0, 0]  # the arrows of the image before go first
    assert len(second.markers) == 2
    np.testing.assert_allclose([marker.color.a for marker in first.markers[1:]], [0.7, 0.3], rtol=1e-6)
    tail, tip = (np.array([p.x, p.y, p.z]) for p in first.markers[2].points)
    np.testing.assert_allclose(tip - tail, 0.5 * poses[1].rotation[:, 2], atol=1e-12)

    clouds = [message.poses for message in decoded(path, "/estimate/particles")]
    assert [len(cloud) for cloud in clouds] == [300, 3]
    for message, particle in zip(clouds[1], particles.translation, strict=False):
        np.testing.assert_allclose([message.position.x, message.position.y, message.position.z], particle)
    transform = decoded(path, "/tf")[0].transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "camera_estimate")
