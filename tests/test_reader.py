"""Recorded sequences -> frames, in every form in which they lie on disk, and everything that can be wrong with them."""

import re
import struct
import tracemalloc
from collections.abc import Callable, Collection
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.writer import Writer

from filtering.motion import MotionNoise
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.options import OdometryUse, SequenceOptions
from sequences.reader import SequenceReader
from sequences.reading.counts import OUTSIDE
from sequences.recordings.bag import Bag
from sequences.recordings.message_definitions import decoder, schema_name, schema_text
from sequences.recordings.messages import odometry_from_message
from sequences.trajectories.increments import odometry_between
from tests.sequence_files import (
    BASE_FROM_CAMERA,
    BEGIN_NS,
    CAMERA,
    FORMS,
    TWIST_COVARIANCE,
    Walk,
    as_file_without_index,
    picture,
    rewrite,
    world_from_camera,
)

Form = Callable[[Path, Path], Path]
IMAGES = "/camera/image/compressed"


def close(a: Poses | None, b: Poses, tolerance: float = 1e-6) -> bool:
    return a is not None and bool(np.abs(a.as_matrix() - b.as_matrix()).max() < tolerance)


@pytest.fixture(scope="module")
def walk_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Walk().write(tmp_path_factory.mktemp("walk") / "walk.mcap", metadata={"odometry": "simulated: exact"})


# --- what is read ----------------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
def test_frames_are_what_was_written_in_every_form(form: Form, walk_file: Path, tmp_path: Path) -> None:
    reader = SequenceReader(form(walk_file, tmp_path))
    frames = list(reader)
    assert [f.time_ns for f in frames] == [BEGIN_NS + 100_000_000 * i for i in range(12)]
    assert reader.num_images == 12
    assert reader.camera == CAMERA
    assert close(reader.base_from_camera, BASE_FROM_CAMERA, 1e-12)
    assert reader.skipped == {}
    for i, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.image, picture(i))
        assert frame.camera == CAMERA
        assert close(frame.world_from_camera, world_from_camera(frame.time_ns), 1e-12)
    assert frames[0].odometry is None
    for before, frame in pairwise(frames):
        truth = world_from_camera(before.time_ns).inverse() @ world_from_camera(frame.time_ns)
        assert frame.odometry is not None
        # Between messages 20 ms apart the walk is not quite of constant velocity.
        assert close(frame.odometry.previous_from_current, truth, 1e-4)
        assert truth.log()[:3] @ truth.log()[:3] > 1e-4
        # Five intervals of 20 ms; a turn of 0.1 s changes little.
        carry = BASE_FROM_CAMERA.inverse().adjoint()
        expected = carry @ TWIST_COVARIANCE @ carry.T * 5 * 0.02**2
        np.testing.assert_allclose(frame.odometry.covariance, expected, atol=0.02 * np.abs(expected).max())


@pytest.mark.parametrize("form", FORMS)
def test_every_iteration_reads_anew(form: Form, walk_file: Path, tmp_path: Path) -> None:
    reader = SequenceReader(form(walk_file, tmp_path))
    assert [f.time_ns for f in reader] == [f.time_ns for f in reader]


def test_the_file_says_where_its_odometry_comes_from(walk_file: Path, tmp_path: Path) -> None:
    assert SequenceReader(walk_file).odometry_description == "simulated: exact"
    assert SequenceReader(Walk().write(tmp_path / "silent.mcap")).odometry_description is None


def test_without_odometry_every_image_is_read(tmp_path: Path) -> None:
    path = rewrite(Walk().write(tmp_path / "in.mcap"), tmp_path / "out.mcap", keep=lambda topic, _: topic != "/odom")
    frames = list(SequenceReader(path, odometry="unread"))
    assert len(frames) == 12
    assert all(frame.odometry is None and frame.world_from_camera is not None for frame in frames)
    with pytest.raises(SequenceError, match=r"no odometry topic.*nav_msgs/Odometry.*/tf_static \(tf2_msgs/TFMessage\)"):
        SequenceReader(path)


def test_a_segment_of_a_sequence_is_read(walk_file: Path) -> None:
    reader = SequenceReader(walk_file, SequenceOptions(start_s=0.25, duration_s=0.5))
    assert [f.time_ns for f in reader] == [BEGIN_NS + 100_000_000 * i for i in range(3, 8)]
    assert reader.skipped == {OUTSIDE: 7}


def test_zero_covariances_are_replaced_by_the_stated_motion_noise(tmp_path: Path) -> None:
    path = Walk(twist_covariance=np.zeros((6, 6))).write(tmp_path / "walk.mcap")
    noise = MotionNoise(translation_per_sqrt_m=0.3)
    frame = list(SequenceReader(path, SequenceOptions(motion_noise=noise)))[1]
    assert frame.odometry is not None
    camera_from_base = BASE_FROM_CAMERA.inverse()
    base_increment = BASE_FROM_CAMERA @ frame.odometry.previous_from_current @ camera_from_base
    carry = camera_from_base.adjoint()
    expected = carry @ noise.covariance(base_increment, 0.1) @ carry.T
    # As of one increment: between two images the twist of the walk hardly changes.
    np.testing.assert_allclose(frame.odometry.covariance, expected, rtol=1e-3, atol=1e-7)
    assert frame.odometry.duration_s == pytest.approx(0.1)


def test_placeholders_for_variances_leave_the_covariance_of_an_increment_small(tmp_path: Path) -> None:
    path = Walk(twist_covariance=np.diag([0.04, 1e6, 1e6, 1e6, 1e6, 0.003])).write(tmp_path / "walk.mcap")
    frame = list(SequenceReader(path))[1]
    assert frame.odometry is not None
    assert 0.0 < np.abs(frame.odometry.covariance).max() < 0.01


def test_true_poses_are_interpolated_but_not_over_gaps(tmp_path: Path) -> None:
    walk = Walk()
    # True poses at 20 Hz, off the images' stamps, and none between 0.4 and 0.75 s.
    times_ns = [BEGIN_NS + 50_000_000 * i - 20_000_000 for i in range(26) if not 9 <= i <= 15]
    walk.truth = [(t, world_from_camera(t)) for t in times_ns]
    frames = list(SequenceReader(walk.write(tmp_path / "walk.mcap")))
    assert len(frames) == 12
    for i, frame in enumerate(frames):
        if i in (4, 5, 6, 7):
            assert frame.world_from_camera is None
        else:
            assert close(frame.world_from_camera, world_from_camera(frame.time_ns), 1e-3)


def test_odometry_logged_late_is_waited_for(tmp_path: Path) -> None:
    def late(topic: str, time_ns: int) -> int:
        return time_ns + 300_000_000 * (topic == "/odom")

    path = rewrite(Walk().write(tmp_path / "in.mcap"), tmp_path / "out.mcap", log_time=late)
    with open(path, "rb") as file:
        order = [channel.topic for _, channel, _ in make_reader(file).iter_messages([IMAGES, "/odom"])]
    assert order[:3] == [IMAGES] * 3  # the precondition
    assert len(list(SequenceReader(path))) == 12


def test_raw_images_are_read_and_beside_compressed_ones_must_be_named(tmp_path: Path) -> None:
    path = tmp_path / "raw.mcap"
    rows = np.concatenate([picture(3)[..., ::-1].reshape(CAMERA.height, -1), np.zeros((CAMERA.height, 6), np.uint8)], 1)
    with open(path, "wb") as file, Writer(file) as writer:
        types = ("sensor_msgs/Image", "sensor_msgs/CompressedImage", "nav_msgs/Odometry")
        raw, compressed, odometry = (writer.register_msgdef(schema_name(t), schema_text(t)) for t in types)
        for i in range(4):
            stamp = {"sec": 5, "nanosec": i * 50_000_000}
            pose = {"pose": {"position": {"x": 0.1 * i}, "orientation": {"w": 1.0}}}
            message = {"header": {"stamp": stamp}, "child_frame_id": "camera", "pose": pose}
            writer.write_message("/vo", odometry, message, log_time=i)
            header = {"stamp": stamp, "frame_id": "/camera"}
            size = {"height": CAMERA.height, "width": CAMERA.width, "step": rows.shape[1]}
            image = {"header": header, "encoding": "bgr8", "data": rows.tobytes(), **size}
            writer.write_message("/camera/image_raw", raw, image, log_time=i)
            writer.write_message("/camera/image_raw/compressed", compressed, {"header": header}, log_time=i)
    with pytest.raises(SequenceError, match=r"2 image topics.*/camera/image_raw \(sensor_msgs/Image\)"):
        SequenceReader(path)
    reader = SequenceReader(path, SequenceOptions(image_topic="/camera/image_raw"))
    frames = list(reader)
    assert len(frames) == 4
    assert reader.camera is None
    for frame in frames:
        np.testing.assert_array_equal(frame.image, picture(3))
        assert frame.world_from_camera is None
    assert frames[3].odometry is not None
    np.testing.assert_allclose(frames[3].odometry.previous_from_current.translation, [0.1, 0, 0], atol=1e-12)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("with_index", [True, False])
def test_memory_does_not_grow_with_the_file(with_index: bool, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    peaks, sizes = [], []
    for num_images in (50, 200):
        walk = Walk(num_images)
        # PNG files with 50 kB of rubbish behind their end: large on disk, quick to decode.
        walk.images = [(t, data + rng.bytes(50_000)) for t, data in walk.images]
        walk.odometry = walk.odometry[::4]
        path = walk.write(tmp_path / f"{num_images}.mcap")
        reader = SequenceReader(path if with_index else as_file_without_index(path, tmp_path))
        assert next(iter(reader)) is not None  # decoders are made once and kept
        tracemalloc.start()
        assert sum(1 for _ in reader) == num_images
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        sizes.append(path.stat().st_size)
    assert sizes[1] > 3.9 * sizes[0]
    assert peaks[1] < 1.1 * peaks[0]
    assert peaks[1] < 0.5 * sizes[1]


# --- topics ----------------------------------------------------------------------------------------


def with_second(tmp_path: Path, topic: str, name: str) -> Path:
    """A file in which the later half of a topic's messages lies on another topic."""
    source = Walk().write(tmp_path / "in.mcap")
    middle_ns = BEGIN_NS + 600_000_000
    first = rewrite(source, tmp_path / "a.mcap", keep=lambda t, ns: t != topic or ns < middle_ns)
    renamed = rewrite(
        source, tmp_path / "b.mcap", keep=lambda t, ns: t == topic and ns >= middle_ns, topic_names={topic: name}
    )
    bag = tmp_path / "bag"
    bag.mkdir()
    first.rename(bag / "a.mcap")
    renamed.rename(bag / "b.mcap")
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  relative_file_paths:\n  - a.mcap\n  - b.mcap\n")
    return bag


@pytest.mark.parametrize(
    ("topic", "role"),
    [(IMAGES, "image"), ("/odom", "odometry"), ("/ground_truth/pose", "ground-truth")],
)
def test_of_several_topics_one_must_be_named(topic: str, role: str, tmp_path: Path) -> None:
    path = with_second(tmp_path, topic, "/other")
    with pytest.raises(SequenceError, match=rf"2 {role} topics.*--{role}-topic.*{topic}.*/other"):
        SequenceReader(path)
    options = replace(SequenceOptions(), **{role.replace("-", "_") + "_topic": topic})
    assert SequenceReader(path, options).num_images in (6, 12)


def test_the_ground_truth_can_be_left_out_by_an_empty_name(walk_file: Path) -> None:
    frames = list(SequenceReader(walk_file, SequenceOptions(ground_truth_topic="")))
    assert len(frames) == 12
    assert all(frame.world_from_camera is None for frame in frames)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (SequenceOptions(image_topic="/nowhere"), r"no topic /nowhere.*found.*/odom \(nav_msgs/Odometry\)"),
        (SequenceOptions(image_topic="/odom"), r"/odom is nav_msgs/Odometry, expected sensor_msgs/Image or"),
    ],
)
def test_a_topic_that_is_missing_or_of_another_type_is_named(
    options: SequenceOptions, said: str, walk_file: Path
) -> None:
    with pytest.raises(SequenceError, match=said):
        SequenceReader(walk_file, options)


def test_a_topic_of_two_types_is_refused_with_both(tmp_path: Path) -> None:
    bag = with_second(tmp_path, "/odom", "/ground_truth/pose")
    said = r"'/ground_truth/pose' has messages of 'geometry_msgs/PoseStamped' \('cdr'\) and of 'nav_msgs/Odometry'"
    with pytest.raises(SequenceError, match=said):
        list(SequenceReader(bag, SequenceOptions(ground_truth_topic="/ground_truth/pose")))


# --- extrinsics ------------------------------------------------------------------------------------


def test_without_tf_the_error_names_both_frames_and_an_option_helps(walk_file: Path, tmp_path: Path) -> None:
    path = rewrite(walk_file, tmp_path / "out.mcap", keep=lambda topic, _: topic != "/tf_static")
    with pytest.raises(SequenceError, match=r"no transform from 'base_link'.*to 'camera_optical_frame'.*found frames"):
        SequenceReader(path)
    with pytest.raises(SequenceError, match=r"--base-from-camera: .*zero length"):
        SequenceReader(path, SequenceOptions(base_from_camera=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    values = np.concatenate([BASE_FROM_CAMERA.translation, BASE_FROM_CAMERA.as_quat_xyzw()]).tolist()
    given = SequenceReader(path, SequenceOptions(base_from_camera=tuple(values)))
    reference = list(SequenceReader(walk_file))
    for frame, expected in zip(given, reference, strict=True):
        if expected.odometry is not None:
            assert frame.odometry is not None
            assert close(frame.odometry.previous_from_current, expected.odometry.previous_from_current, 1e-9)


def test_odometry_of_the_camera_itself_needs_no_tf(walk_file: Path, tmp_path: Path) -> None:
    path = rewrite(walk_file, tmp_path / "out.mcap", keep=lambda topic, _: topic != "/tf_static")
    reader = SequenceReader(path, SequenceOptions(camera_frame="/base_link"))
    assert close(reader.base_from_camera, Poses.identity(), 1e-12)


@pytest.mark.usefixtures("unchecked")
def test_transforms_lead_through_a_robot_of_many_frames(shared_data: Path, tmp_path: Path) -> None:
    """The camera of a TurtleBot 4, as its /tf_static has it: from base_link up through the camera's bracket."""
    source = shared_data / "ros_bags" / "nav2_turtlebot.mcap"
    bag = Bag(source)
    frames = [
        t.child_frame_id
        for raw in bag.messages(["/tf_static"])
        for t in decoder("tf2_msgs/TFMessage")(raw.data).transforms
    ]
    optical = next(name for name in frames if name.endswith("rgb_camera_optical_frame"))
    # The recording has no images: our walk's take their place, in the same file.
    walk = Walk().write(tmp_path / "walk.mcap")
    folder = tmp_path / "bag"
    folder.mkdir()
    rewrite(walk, folder / "images.mcap", keep=lambda topic, _: topic == IMAGES)
    rewrite(source, folder / "robot.mcap", keep=lambda topic, _: topic in ("/odom", "/tf", "/tf_static"))
    (folder / "metadata.yaml").write_text("relative_file_paths:\n- images.mcap\n- robot.mcap\n")
    pose = SequenceReader(folder, SequenceOptions(camera_frame=optical)).base_from_camera
    assert pose is not None
    # Upright on the robot: the optical axis points ahead and the image's x axis to the robot's right.
    np.testing.assert_allclose(pose.rotation, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=0.05)
    assert 0.0 < pose.translation[2] < 0.5


# --- what is skipped -------------------------------------------------------------------------------


def test_an_undecodable_image_is_skipped_and_the_next_increment_spans_it(tmp_path: Path) -> None:
    walk = Walk()
    walk.images[5] = (walk.images[5][0], b"no image")
    reader = SequenceReader(walk.write(tmp_path / "walk.mcap"))
    frames = list(reader)
    assert reader.skipped == {"undecodable image": 1}
    assert len(frames) == 11
    truth = world_from_camera(frames[4].time_ns).inverse() @ world_from_camera(frames[5].time_ns)
    assert frames[5].time_ns - frames[4].time_ns == 200_000_000
    assert frames[5].odometry is not None
    assert close(frames[5].odometry.previous_from_current, truth, 1e-4)


def test_bytes_that_are_no_image_message_are_skipped(walk_file: Path, tmp_path: Path) -> None:
    def cut(topic: str, time_ns: int, data: bytes) -> bytes:
        return data[:7] if topic == IMAGES and time_ns == BEGIN_NS + 300_000_000 else data

    reader = SequenceReader(rewrite(walk_file, tmp_path / "out.mcap", data=cut))
    assert len(list(reader)) == 11
    assert reader.skipped == {"undecodable image": 1}


@pytest.mark.parametrize("back_ns", [0, 300_000_000])
def test_image_stamps_that_were_there_before_are_skipped(back_ns: int, tmp_path: Path) -> None:
    walk = Walk()
    path = walk.write(tmp_path / "in.mcap")
    before_ns = BEGIN_NS + 400_000_000 - back_ns
    header = before_ns // 1_000_000_000, before_ns % 1_000_000_000

    def stamped(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic != IMAGES or time_ns != BEGIN_NS + 500_000_000:
            return data
        # The stamp is the first thing after the four bytes that begin every message.
        return data[:4] + np.array(header, "<u4").tobytes() + data[12:]

    reader = SequenceReader(rewrite(path, tmp_path / "out.mcap", data=stamped))
    times = [frame.time_ns for frame in reader]
    assert len(times) == 11
    assert times == sorted(set(times))
    assert reader.skipped == {"time stamp not increasing": 1}


def test_images_that_odometry_does_not_cover_are_skipped(tmp_path: Path) -> None:
    walk = Walk()
    # Starts after the first two images, ends before the last one, and is silent from 0.45 to 1.01 s.
    ms = 1_000_000
    walk.odometry = [
        (t, pose)
        for t, pose in walk.odometry
        if 150 * ms <= t - BEGIN_NS <= 1090 * ms and not 450 * ms < t - BEGIN_NS < 1000 * ms
    ]
    reader = SequenceReader(walk.write(tmp_path / "walk.mcap"))
    indices = [(frame.time_ns - BEGIN_NS) // (100 * ms) for frame in reader]
    assert indices == [2, 3, 4]
    assert reader.skipped == {"odometry does not cover": 9}


def test_odometry_that_is_not_finite_ends_the_reading_with_topic_and_time(tmp_path: Path) -> None:
    walk = Walk()
    nan = walk.odometry[12][0]
    walk.odometry[12] = (nan, Poses(np.eye(3), np.array([np.nan, 0.0, 0.0])))
    path = walk.write(tmp_path / "in.mcap")
    with pytest.raises(SequenceError, match=rf"in\.mcap: /odom at {nan} ns: odometry: .*not finite"):
        list(SequenceReader(path))


def test_odometry_without_a_rotation_ends_the_reading_with_topic_and_time(tmp_path: Path) -> None:
    walk = Walk()
    flat = walk.odometry[30][0]
    path = walk.write(tmp_path / "in.mcap")

    def flattened(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic != "/odom" or time_ns != flat:
            return data
        # header (8 + 4 + "odom\0"), child frame (4 + "base_link\0"), then aligned to 8 from byte 4 on: the pose.
        start = data.index(b"base_link\0") + len(b"base_link\0")
        start += -(start - 4) % 8 + 24
        return data[:start] + bytes(32) + data[start + 32 :]

    with pytest.raises(SequenceError, match=rf"out\.mcap: /odom at {flat} ns: odometry: .*quaternion of length 0"):
        list(SequenceReader(rewrite(path, tmp_path / "out.mcap", data=flattened)))


def test_odometry_stamps_that_stand_or_run_backwards_are_skipped(tmp_path: Path) -> None:
    def stalled(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic != "/odom" or (time_ns // 20_000_000) % 10:
            return data
        return data[:4] + np.array([1, 1], "<u4").tobytes() + data[12:]

    reader = SequenceReader(rewrite(Walk().write(tmp_path / "in.mcap"), tmp_path / "out.mcap", data=stalled))
    assert len(list(reader)) == 12
    assert reader.skipped.keys() == {"odometry time stamp not increasing"}


def test_a_true_pose_that_is_not_finite_ends_the_reading_with_topic_and_time(tmp_path: Path) -> None:
    walk = Walk()
    walk.truth[4] = (walk.truth[4][0], Poses(np.eye(3), np.array([np.inf, 0.0, 0.0])))
    path = walk.write(tmp_path / "walk.mcap")
    with pytest.raises(SequenceError, match=rf"/ground_truth/pose at {walk.truth[4][0]} ns: true pose: .*not finite"):
        list(SequenceReader(path))


def far_ahead(of_topic: str, walk: Path, target: Path) -> Path:
    """A copy in which one message of a topic, about half a second after the first image, is stamped years later."""
    at_ns = BEGIN_NS + {IMAGES: 500_000_000, "/odom": 507_000_000, "/ground_truth/pose": 500_000_000}[of_topic]

    def stamped(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic != of_topic or time_ns != at_ns:
            return data
        return data[:4] + np.array([2_000_000_000, 0], "<u4").tobytes() + data[12:]

    return rewrite(walk, target, data=stamped)


@pytest.mark.parametrize("odometry", ["required", "optional", "unread"])
def test_a_stamp_far_in_the_future_costs_one_image_only(odometry: OdometryUse, tmp_path: Path) -> None:
    path = far_ahead(IMAGES, Walk().write(tmp_path / "in.mcap"), tmp_path / "out.mcap")
    reader = SequenceReader(path, odometry=odometry)
    assert [f.time_ns for f in reader] == [BEGIN_NS + 100_000_000 * i for i in range(12) if i != 5]
    assert reader.skipped == {"time stamp far ahead": 1}


@pytest.mark.parametrize(
    ("topic", "what", "num_true_poses"), [("/odom", "odometry", 12), ("/ground_truth/pose", "true pose", 11)]
)
def test_a_stamp_far_in_the_future_costs_one_pose_only(
    topic: str, what: str, num_true_poses: int, tmp_path: Path
) -> None:
    path = far_ahead(topic, Walk().write(tmp_path / "in.mcap"), tmp_path / "out.mcap")
    reader = SequenceReader(path)
    frames = list(reader)
    assert len(frames) == 12
    assert all(frame.odometry is not None for frame in frames[1:])
    assert sum(frame.world_from_camera is not None for frame in frames) == num_true_poses
    assert reader.skipped == {f"{what} time stamp far ahead": 1}


def test_with_no_image_left_the_error_says_why(tmp_path: Path) -> None:
    walk = Walk()
    walk.images = [(t, b"no image") for t, _ in walk.images]
    reader = SequenceReader(walk.write(tmp_path / "walk.mcap"))
    with pytest.raises(SequenceError, match=r"no image left of 12 on /camera/.*12 × undecodable.*expected JPEG"):
        list(reader)


# --- order and time --------------------------------------------------------------------------------


MS = 1_000_000


def relogged(walk: Path, target: Path, late_ns: Callable[[str, int], int]) -> Path:
    """A copy in which messages were logged late, by what a function of topic and stamp says."""
    return rewrite(walk, target, log_time=lambda topic, time_ns: time_ns + late_ns(topic, time_ns))


@pytest.mark.parametrize("topic", [IMAGES, "/odom", "/ground_truth/pose"])
def test_neighbours_logged_in_swapped_order_are_used_in_the_order_of_their_stamps(topic: str, tmp_path: Path) -> None:
    source = Walk(30).write(tmp_path / "in.mcap")
    step_ns = 20 * MS if topic == "/odom" else 100 * MS

    def late(name: str, time_ns: int) -> int:
        return 3 * step_ns // 2 if name == topic and (time_ns - BEGIN_NS) // step_ns % 2 else 0

    reader = SequenceReader(relogged(source, tmp_path / "out.mcap", late))
    with open(tmp_path / "out.mcap", "rb") as file:
        stamps = [bytes(message.data[4:12]) for _, _, message in make_reader(file).iter_messages([topic])]
    assert sorted(stamps, key=lambda s: struct.unpack("<II", s)) != stamps  # the precondition
    reference = list(SequenceReader(source))
    for frame, expected in zip(reader, reference, strict=True):
        assert frame.time_ns == expected.time_ns
        np.testing.assert_array_equal(frame.image, expected.image)
        assert close(frame.world_from_camera, world_from_camera(frame.time_ns), 1e-3)
        if expected.odometry is not None:
            assert frame.odometry is not None
            moved = frame.odometry.previous_from_current
            assert close(moved, expected.odometry.previous_from_current, 1e-12)
    assert reader.skipped == {}


def test_images_logged_later_than_the_window_are_counted(tmp_path: Path) -> None:
    def late(name: str, time_ns: int) -> int:
        return 900 * MS if name == IMAGES and time_ns == BEGIN_NS + 1000 * MS else 0

    reader = SequenceReader(relogged(Walk(30).write(tmp_path / "in.mcap"), tmp_path / "out.mcap", late))
    assert len(list(reader)) == 29
    assert reader.counts.as_json() == {
        "stated": 30,
        "read": 30,
        "used": 29,
        "skipped": {"time stamp not increasing": 1},
    }


def stamped(walk: Path, target: Path, topics: Collection[str], stamp: Callable[[int], int]) -> Path:
    """A copy in which some topics have other stamps, logged when they were."""

    def change(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic not in topics:
            return data
        return data[:4] + struct.pack("<II", *divmod(stamp(time_ns), 1_000_000_000)) + data[12:]

    return rewrite(walk, target, data=change)


@pytest.mark.parametrize("moment", [0, 5 * 10**9])
@pytest.mark.parametrize(
    ("topics", "what"),
    [([IMAGES, "/odom"], "12 images"), ([IMAGES], "12 images"), (["/odom"], r"\d+ messages of odometry")],
)
def test_stamps_that_are_all_equal_are_an_error_that_names_the_log_times(
    topics: list[str], what: str, moment: int, walk_file: Path, tmp_path: Path
) -> None:
    path = stamped(walk_file, tmp_path / "out.mcap", topics, lambda _: moment)
    said = "zero" if moment == 0 else f"{moment} ns"
    with pytest.raises(SequenceError, match=rf"headers of all {what} are {said}, expected increasing.*--stamps log"):
        list(SequenceReader(path))
    frames = list(SequenceReader(path, SequenceOptions(stamps="log")))
    reference = list(SequenceReader(walk_file))
    for frame, expected in zip(frames, reference, strict=True):
        assert frame.time_ns == expected.time_ns
        assert close(frame.world_from_camera, world_from_camera(frame.time_ns))
        if expected.odometry is not None:
            assert frame.odometry is not None
            moved = frame.odometry.previous_from_current
            assert close(moved, expected.odometry.previous_from_current, 1e-12)


def test_where_log_times_are_equal_too_no_option_is_named(tmp_path: Path) -> None:
    path = stamped(Walk().write(tmp_path / "in.mcap"), tmp_path / "a.mcap", [IMAGES, "/odom"], lambda _: 0)
    path = rewrite(path, tmp_path / "out.mcap", log_time=lambda topic, time_ns: 1)
    with pytest.raises(SequenceError, match=r"are zero, expected increasing ones$"):
        list(SequenceReader(path))


def test_clocks_that_are_apart_are_named(walk_file: Path, tmp_path: Path) -> None:
    path = stamped(walk_file, tmp_path / "out.mcap", ["/odom"], lambda t: t + 3600 * 10**9)
    said = r"images run from \d+\.123 to \d+\.223 s, odometry from \d+\.\d+ to .* s: they begin 3600\.0 s apart"
    with pytest.raises(SequenceError, match=rf"no image has odometry: {said}, expected one clock \(--stamps log"):
        list(SequenceReader(path))
    reader = SequenceReader(path, odometry="optional")
    assert len(list(reader)) == 12
    assert [notice for notice in reader.notices if re.match(said, notice)]
    assert len(list(SequenceReader(path, SequenceOptions(stamps="log")))) == 12


def test_every_image_is_used_or_skipped_for_a_reason(tmp_path: Path) -> None:
    walk = Walk(200)
    walk.images[40] = (walk.images[40][0], b"no image")
    walk.odometry = [(t, pose) for t, pose in walk.odometry if not 5000 < (t - BEGIN_NS) / MS < 6000]
    path = stamped(
        walk.write(tmp_path / "in.mcap"),
        tmp_path / "out.mcap",
        [IMAGES],
        lambda t: t - 100 * MS * (t == BEGIN_NS + 3000 * MS),
    )
    reader = SequenceReader(path, SequenceOptions(start_s=1.0, duration_s=8.0))
    used = len(list(reader))
    lost = {"undecodable image": 1, "time stamp not increasing": 1, "odometry does not cover": 11}
    assert reader.counts.skipped == {**lost, OUTSIDE: 200 - 81}
    assert reader.counts.read < 200  # reading ended early
    assert (reader.counts.stated, reader.counts.used) == (200, used)
    assert used + reader.counts.skipped.total() == 200
    assert reader.counts.warning is None


def test_where_fewer_than_half_of_the_images_were_used_a_sentence_says_why(tmp_path: Path) -> None:
    walk = Walk(40)
    walk.odometry = [(t, pose) for t, pose in walk.odometry if t < BEGIN_NS + 1000 * MS]
    walk.images[2] = (walk.images[2][0], b"no image")
    path = walk.write(tmp_path / "walk.mcap")
    reader = SequenceReader(path)
    assert len(list(reader)) == 9
    assert reader.counts.warning == "Only 9 of 40 images were used: 30 were skipped, odometry does not cover."
    assert not reader.counts.are_very_few
    next(iter(reader))
    assert reader.counts.warning is None  # who takes no more than that knows
    reader = SequenceReader(path, SequenceOptions(start_s=0.9))
    assert len(list(reader)) == 1
    assert reader.counts.are_very_few
    reader = SequenceReader(path, SequenceOptions(duration_s=0.9))
    assert len(list(reader)) == 9
    assert reader.counts.warning is None


# --- what is refused -------------------------------------------------------------------------------


def test_a_recording_cut_off_is_refused_when_opened(walk_file: Path, tmp_path: Path) -> None:
    data = walk_file.read_bytes()
    for size in (len(data) - 1, len(data) // 2, 20):
        path = tmp_path / "cut.mcap"
        path.write_bytes(data[:size])
        with pytest.raises(SequenceError, match=r"cut\.mcap: truncated: byte \d+ of \d+.*closing MCAP magic"):
            SequenceReader(path)


@pytest.mark.parametrize("content", [b"", b"garbage" * 100, bytes(500)])
def test_garbage_is_refused_by_its_first_bytes(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "garbage.mcap"
    path.write_bytes(content)
    with pytest.raises(SequenceError, match=r"garbage\.mcap: starts with .*expected the MCAP magic"):
        SequenceReader(path)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("form", [form for form in FORMS if form.__name__ != "as_split_folder"])
def test_damage_anywhere_is_an_error_that_names_the_file_or_does_no_harm(
    form: Form, walk_file: Path, tmp_path: Path
) -> None:
    path = form(walk_file, tmp_path)
    data = path.read_bytes()
    reference = list(SequenceReader(path))
    rng = np.random.default_rng(0)
    refusals = []
    for start in rng.integers(8, len(data) - 60, 30):
        damaged = bytearray(data)
        damaged[start : start + 40] = rng.integers(0, 256, 40, dtype=np.uint8).tobytes()
        path.write_bytes(damaged)
        try:
            frames = list(SequenceReader(path))
        except SequenceError as error:
            refusals.append(str(error))
        else:
            # Without chunks there are no checksums; with them, what is not noticed is what is not read.
            if form.__name__ != "as_file_without_chunks":
                for frame, expected in zip(frames, reference, strict=True):
                    np.testing.assert_array_equal(frame.image, expected.image)
                    assert close(frame.world_from_camera, world_from_camera(frame.time_ns))
    assert len(refusals) >= 5
    assert all(path.name in refusal and "\n" not in refusal for refusal in refusals)


def test_a_folder_must_be_a_rosbag2_with_its_files(walk_file: Path, tmp_path: Path) -> None:
    with pytest.raises(SequenceError, match=r"no metadata\.yaml"):
        SequenceReader(tmp_path)
    listing = tmp_path / "metadata.yaml"
    for text, said in [
        ("version: 5\n", "names no files"),
        ("relative_file_paths:\n- gone.mcap\n", r"gone\.mcap', which is not in the folder"),
        ("relative_file_paths:\n- bag_0.db3\n", r"bag_0\.db3', expected \.mcap"),
    ]:
        listing.write_text(text)
        with pytest.raises(SequenceError, match=said):
            SequenceReader(tmp_path)


def test_a_file_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(SequenceError, match=r"nowhere\.mcap: no such file"):
        SequenceReader(tmp_path / "nowhere.mcap")


# --- files of others -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["nav2_turtlebot.mcap", "talker.mcap", "only_topics.mcap"])
def test_recordings_without_images_are_refused_with_a_list_of_topics(name: str, shared_data: Path) -> None:
    with pytest.raises(SequenceError, match=r"no image topic.*found /\w+.*\(\w+/\w+\)"):
        SequenceReader(shared_data / "ros_bags" / name)


def test_a_ros_1_bag_is_told_how_to_become_one_of_ros_2(shared_data: Path) -> None:
    with pytest.raises(SequenceError, match=r"ROS 1 bag.*rosbags-convert"):
        SequenceReader(shared_data / "ros_bags" / "t265_trimmed_locoffice.bag")


@pytest.mark.usefixtures("unchecked")
def test_odometry_of_a_real_robot_gets_the_motion_noise(shared_data: Path) -> None:
    """2639 messages with covariances of zero: increments over 0.5 s are those of a robot, and chain to its path."""
    decode = decoder("nav_msgs/Odometry")
    raws = Bag(shared_data / "ros_bags" / "nav2_turtlebot.mcap").messages(["/odom"])
    samples = [odometry_from_message(decode(raw.data)) for raw in raws]
    times_ns = np.array([s.time_ns for s in samples])
    poses = Poses.stack([s.odom_from_base for s in samples])
    twists = np.stack([s.twist_covariance for s in samples])
    assert len(samples) == 2639
    assert not twists.any()
    chained = poses[0]
    stamps = range(int(times_ns[0]), int(times_ns[-1]), 500_000_000)
    for start, end in pairwise(stamps):
        window = slice(np.searchsorted(times_ns, start, "right") - 1, np.searchsorted(times_ns, end) + 1)
        odometry = odometry_between(
            times_ns[window],
            poses[window],
            twists[window],
            start,
            end,
            base_from_camera=Poses.identity(),
            motion_noise=MotionNoise(),
        )
        moved_m = np.linalg.norm(odometry.previous_from_current.translation)
        assert moved_m < 0.5  # a TurtleBot drives 0.46 m/s at most
        deviation = np.sqrt(np.diag(odometry.covariance))
        assert 0.005 < deviation.min() <= deviation.max() < 0.05
        chained = chained @ odometry.previous_from_current
    last = np.searchsorted(times_ns, stamps[-1])
    assert close(chained, poses[last], 0.02)


def test_images_of_a_real_camera_decode(shared_data: Path) -> None:
    from sequences.images.decoding import decode_image_bytes

    file = next((shared_data / "tum_fr1").rglob("*.jpg"))
    image = decode_image_bytes(file.read_bytes())
    np.testing.assert_array_equal(image, cv2.cvtColor(cv2.imread(str(file), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB))  # pyright: ignore[reportArgumentType, reportCallIssue]
