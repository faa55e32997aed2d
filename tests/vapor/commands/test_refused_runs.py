"""Sequences, models and outputs that a run refuses: one line says why, and nothing is left behind."""

import re

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.datasets.layout_helpers.image_files import images_in
from sequences.outputs import results_folder
from tests.helpers import sequence_files
from tests.helpers.command_line import contents, refuse, refuse_run, words_of_run
from tests.helpers.data_sets import make_tum, write_image
from tests.helpers.sequence_files import IMAGES, ODOMETRY, Walk, rewrite
from tests.helpers.tiny_model import altered
from tests.helpers.video_clips import write_clip
from tests.helpers.video_files import pictures
from vapor.track import main

NOWHERE = Poses(np.eye(3), np.array([np.nan, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("lacking", "said"),
    [
        (IMAGES, ["no image topic", "FFMPEGPacket; found ", "/odom (nav_msgs/Odometry)"]),
        (
            "/tf_static",
            [
                "no transform from 'base_link' (/odom, child frame) to 'camera_optical_frame'",
                "--base-from-camera); --odometry visual makes odometry from the images instead",
            ],
        ),
    ],
)
def test_a_sequence_that_lacks_a_topic_is_refused(lacking, said, walk_of_25, tiny_model, earlier, capsys):
    path = rewrite(walk_of_25, earlier.parent / "poor.mcap", keep=lambda topic, _: topic != lacking)
    refuse_run(path, tiny_model, earlier, capsys, path.name, *said)


def test_recorded_odometry_that_is_missing_is_refused(walk_of_25, tiny_model, earlier, capsys):
    asked = ["--odometry", "recorded"]
    path = rewrite(walk_of_25, earlier.parent / "poor.mcap", keep=lambda topic, _: topic != ODOMETRY)
    said = ["no odometry topic", "expected one of type nav_msgs/Odometry", "--odometry-frame"]
    refuse_run(path, tiny_model, earlier, capsys, path.name, *said, options=asked)
    clip = write_clip(earlier.parent / "walk.mp4", pictures(2), [0, 50])
    said = ["--odometry recorded with images alone, expected a recording with odometry"]
    refuse_run(clip, tiny_model, earlier, capsys, clip.name, *said, options=asked)
    both = ["--odometry", "none", "--odometry-topic", "/odom"]
    said = ["--odometry none beside --odometry-topic or --odometry-frame, expected one of them"]
    refuse_run(walk_of_25, tiny_model, earlier, capsys, *said, options=both)


def test_a_data_set_is_refused_where_it_cannot_be_read_or_has_no_odometry_to_read(tiny_model, earlier, capsys):
    data = make_tum(earlier.parent / "desk")
    said = "desk: --odometry recorded with images alone, expected a recording with odometry"
    refuse_run(data, tiny_model, earlier, capsys, said, options=["--odometry", "recorded"])
    (data / "groundtruth.txt").write_text("1 2 3\n")
    refuse_run(data, tiny_model, earlier, capsys, "groundtruth.txt:1: ")


def test_a_part_by_an_at_is_refused_with_the_options_that_choose_one(walk_of_25, tiny_model, earlier, capsys):
    said = ["@0:9: no such file or folder", "and of images `run`, take a part by @0:9: `run` has --start-s"]
    refuse_run(walk_of_25.with_name(f"{walk_of_25.name}@0:9"), tiny_model, earlier, capsys, *said)
    nowhere = earlier.parent / "nowhere.mcap@0:9"
    assert "a part" not in refuse_run(nowhere, tiny_model, earlier, capsys, "no such file or folder")


@pytest.mark.parametrize("name", ["nav2_turtlebot.mcap", "talker.mcap", "only_topics.mcap"])
def test_recordings_of_real_robots_without_images_are_refused(name, shared_data, tiny_model, earlier, capsys):
    path = shared_data / "ros_bags" / name
    types = "sensor_msgs/Image, sensor_msgs/CompressedImage, foxglove_msgs/CompressedVideo or ffmpeg_image_transport_ms"
    said = f"no image topic, so no images; expected one of type {types}"
    refuse_run(path, tiny_model, earlier, capsys, path.name, said)


def test_of_two_cameras_of_a_real_ros_1_bag_one_must_be_named(shared_data, tiny_model, earlier, capsys):
    path = shared_data / "ros_bags" / "t265_trimmed_locoffice.bag"
    topics = [f"/camera/fisheye{number}/image_raw" for number in (1, 2)]
    said = ["2 image topics", f"--image-topic {topics[0]} or --image-topic {topics[1]}\n"]
    refuse_run(path, tiny_model, earlier, capsys, *said)
    refuse_run(path, tiny_model, earlier, capsys, "; --odometry visual makes", options=["--image-topic", topics[0]])
    misspelt = ["--image-topic", "/camera/fisheye3/image_raw"]
    said = (
        f"found {topics[0]} (sensor_msgs/Image), {topics[1]} (sensor_msgs/Image) and 3 more; did you mean {topics[1]}?"
    )
    refuse_run(path, tiny_model, earlier, capsys, said, options=misspelt)


@pytest.mark.parametrize("command", ["inspect", "run"])
def test_results_are_no_images(command, walk_of_25, tiny_model, earlier, capsys):
    folder = earlier.parent / "seen"
    with results_folder(folder, command, writes=["map.png"]) as new:
        write_image(new / "map.png", 0)
    refuse_run(folder, tiny_model, earlier, capsys, f"but results of `{command}`; expected what they were made from")
    write_image(folder / "1.png", 1)  # the user's
    assert [file.name for file in images_in(folder)] == ["1.png"]


def test_a_folder_with_nothing_to_localize_says_what_was_looked_for(tiny_model, earlier, capsys):
    folder = earlier.parent / "notes"
    folder.mkdir()
    (folder / "stairs_train.txt").write_text("mine")
    said = "notes: no sequence or data set; looked for a video, PNG or JPEG images, .mcap, .db3, .bag, metadata.yaml"
    assert "convert" not in refuse_run(folder, tiny_model, earlier, capsys, said)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty, expected an MCAP file"),
        (b"hello, world" * 50, "starts with b'hello, w', expected the MCAP magic"),
        (b"#ROSBAG V2.0\n" + bytes(99), "damaged or unfinished ROS 1 bag"),
        (b"SQLite format 3\0" + bytes(99), "damaged SQLite"),
    ],
)
def test_garbage_is_refused(content, said, tiny_model, earlier, capsys):
    path = earlier.parent / "garbage.mcap"
    path.write_bytes(content)
    refuse_run(path, tiny_model, earlier, capsys, path.name, said)


@pytest.mark.usefixtures("unchecked")
def test_damage_behind_most_images_leaves_nothing_behind(walk_of_25, tiny_model, earlier, capsys):
    path = rewrite(walk_of_25, earlier.parent / "damaged.mcap", chunk_size=2000)
    content = bytearray(path.read_bytes())
    last_image = content.rindex(b"\x89PNG\r\n")
    content[last_image + 60] ^= 0xFF
    path.write_bytes(content)
    refuse_run(path, tiny_model, earlier, capsys, path, "damaged MCAP near byte", "expected")


def test_a_transform_that_is_not_finite_is_named(tiny_model, earlier, capsys, monkeypatch):
    walk = Walk(5)
    monkeypatch.setattr(sequence_files, "BASE_FROM_CAMERA", NOWHERE)
    path = walk.write(earlier.parent / "walk.mcap")
    said = ["no transform from 'base_link'", "transform base_link -> camera_optical_frame: translation is not finite"]
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


def test_a_model_of_another_version_is_refused(walk_of_25, tiny_model, earlier, capsys):
    model = altered(tiny_model, earlier.parent / "other.safetensors", lambda t, m: m.update(version="1"))
    refuse_run(walk_of_25, model, earlier, capsys, model, "format version is '1', expected '12'; train the model again")


def test_an_output_that_is_or_lies_in_a_file_is_refused(walk_of_25, tiny_model, tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    words = words_of_run(walk_of_25, tiny_model, tmp_path / "file")
    refuse(words, capsys, tmp_path / "file", "is a file, expected a directory")
    words = words_of_run(walk_of_25, tiny_model, tmp_path / "file" / "out")
    refuse(words, capsys, tmp_path / "file" / "out", "cannot write", "expected a directory")
    assert contents(tmp_path) == {"file": b"mine"}
