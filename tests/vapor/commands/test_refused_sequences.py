"""Sequences that a run refuses: one line says why, and nothing is left behind."""

import re

import numpy as np
import pytest

from filtering.se3 import Poses
from tests.helpers import sequence_files
from tests.helpers.command_line import refuse_run, words_of_run
from tests.helpers.sequence_files import IMAGES, ODOMETRY, Walk, rewrite
from vapor.track import main

NOWHERE = Poses(np.eye(3), np.array([np.nan, 0.0, 0.0]))


# --- sequences that cannot be used ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("lacking", "said"),
    [
        (IMAGES, ["no image topic", "sensor_msgs/Image or sensor_msgs/CompressedImage", "/odom (nav_msgs/Odometry)"]),
        (ODOMETRY, ["no odometry topic", "expected one of type nav_msgs/Odometry", "--odometry-frame"]),
        ("/tf_static", ["no transform from 'base_link' to 'camera_optical_frame'", "--base-from-camera"]),
    ],
)
def test_a_sequence_that_lacks_a_topic_is_refused(lacking, said, walk_of_25, tiny_model, earlier, capsys):
    path = rewrite(walk_of_25, earlier.parent / "poor.mcap", keep=lambda topic, _: topic != lacking)
    refuse_run(path, tiny_model, earlier, capsys, path.name, *said)


@pytest.mark.parametrize("name", ["nav2_turtlebot.mcap", "talker.mcap", "only_topics.mcap"])
def test_recordings_of_real_robots_without_images_are_refused(name, shared_data, tiny_model, earlier, capsys):
    path = shared_data / "ros_bags" / name
    refuse_run(path, tiny_model, earlier, capsys, path, "no image topic, expected one of type sensor_msgs/Image")


def test_of_two_cameras_of_a_real_ros_1_bag_one_must_be_named(shared_data, tiny_model, earlier, capsys):
    path = shared_data / "ros_bags" / "t265_trimmed_locoffice.bag"
    refuse_run(path, tiny_model, earlier, capsys, "2 image topics", "/camera/fisheye1/image_raw", "--image-topic")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "expected the MCAP magic"),
        (b"hello, world" * 50, "starts with b'hello, w', expected the MCAP magic"),
        (b"#ROSBAG V2.0\n" + bytes(99), "damaged or unfinished ROS 1 bag"),
        (b"SQLite format 3\0" + bytes(99), "damaged SQLite"),
    ],
)
def test_garbage_is_refused(content, said, tiny_model, earlier, capsys):
    path = earlier.parent / "garbage.mcap"
    path.write_bytes(content)
    refuse_run(path, tiny_model, earlier, capsys, path, said)


def test_a_truncated_recording_is_refused(walk_of_25, tiny_model, earlier, capsys):
    path = earlier.parent / "cut.mcap"
    content = walk_of_25.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    refuse_run(path, tiny_model, earlier, capsys, path, "truncated", "expected the closing MCAP magic")


@pytest.mark.usefixtures("unchecked")
def test_damage_behind_most_images_leaves_nothing_behind(walk_of_25, tiny_model, earlier, capsys):
    path = rewrite(walk_of_25, earlier.parent / "damaged.mcap", chunk_size=2000)
    content = bytearray(path.read_bytes())
    last_image = content.rindex(b"\x89PNG\r\n")
    content[last_image + 60] ^= 0xFF
    path.write_bytes(content)
    refuse_run(path, tiny_model, earlier, capsys, path, "damaged MCAP near byte", "expected")


def test_a_sequence_or_folder_that_is_absent_or_empty_is_refused(tiny_model, earlier, capsys):
    refuse_run(
        earlier.parent / "no.mcap", tiny_model, earlier, capsys, "no.mcap: no such file", "expected an .mcap file"
    )
    (earlier.parent / "bag").mkdir()
    refuse_run(earlier.parent / "bag", tiny_model, earlier, capsys, "bag: folder has no metadata.yaml", "rosbag2")


def test_of_two_image_topics_one_must_be_named(walk_of_25, tiny_model, earlier, capsys):
    left = rewrite(walk_of_25, earlier.parent / "left.mcap", topic_names={IMAGES: "/left/image/compressed"})
    bag = earlier.parent / "bag"
    bag.mkdir()
    for source, name in ((walk_of_25, "bag_0.mcap"), (left, "bag_1.mcap")):
        rewrite(source, bag / name)
    (bag / "metadata.yaml").write_text("  relative_file_paths:\n  - bag_0.mcap\n  - bag_1.mcap\n")
    refuse_run(
        bag, tiny_model, earlier, capsys, bag, "2 image topics", "--image-topic", IMAGES, "/left/image/compressed"
    )


def test_a_transform_that_is_not_finite_is_named(tiny_model, earlier, capsys, monkeypatch):
    walk = Walk(5)
    monkeypatch.setattr(sequence_files, "BASE_FROM_CAMERA", NOWHERE)
    path = walk.write(earlier.parent / "walk.mcap")
    said = ["no transform from 'base_link'", "transform base_link -> camera_optical_frame: pose is not finite"]
    refuse_run(path, tiny_model, earlier, capsys, path.name, *said)


def without_images(walk: Walk) -> None:
    walk.images = [(t, b"no image") for t, _ in walk.images]


def with_odometry_of_another_day(walk: Walk) -> None:
    walk.odometry = [(t + 86_400 * 10**9, pose) for t, pose in walk.odometry]


# --- images and messages that are left out --------------------------------------------------------


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (without_images, [f"no image left of 12 on {IMAGES}", "12 × undecodable image", "expected JPEG, PNG"]),
        (with_odometry_of_another_day, ["no image has odometry", "they begin 86400.0 s apart"]),
    ],
)
def test_where_no_image_is_left_the_run_fails_and_says_why(spoil, said, tiny_model, earlier, capsys):
    walk = Walk()
    spoil(walk)
    path = walk.write(earlier.parent / "walk.mcap")
    refuse_run(path, tiny_model, earlier, capsys, path.name, *said)


@pytest.mark.parametrize(("stream", "topic"), [("odometry", "/odom"), ("truth", "/ground_truth/pose")])
def test_a_pose_that_is_not_finite_is_left_out_and_named_with_topic_and_time(
    stream, topic, tiny_model, earlier, capsys
):
    walk = Walk()
    time_ns = getattr(walk, stream)[5][0]
    getattr(walk, stream)[5] = (time_ns, NOWHERE)
    path = walk.write(earlier.parent / "walk.mcap")
    assert main(words_of_run(path, tiny_model, earlier.parent / "new")) == 0
    said = rf"1 of \d+ .* left out, the first: .*{topic} at {time_ns} ns: .*not finite"
    assert re.search(said, " ".join(capsys.readouterr().out.split()))
