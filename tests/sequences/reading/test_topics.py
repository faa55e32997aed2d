"""Which topics are read, and how transforms lead from odometry to the camera."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sequences.errors import SequenceError
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.recordings.bag import Bag
from sequences.recordings.message_definitions import decoder
from sequences.recordings.source import listing
from tests.helpers.sequence_files import BASE_FROM_CAMERA, BEGIN_NS, IMAGES, Walk, close, rewrite


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
    ("topic", "role"), [(IMAGES, "image"), ("/odom", "odometry"), ("/ground_truth/pose", "ground-truth")]
)
def test_of_several_topics_one_must_be_named(topic: str, role: str, tmp_path: Path) -> None:
    path = with_second(tmp_path, topic, "/other")
    with pytest.raises(SequenceError, match=rf"2 {role} topics.*--{role}-topic.*{topic}.*/other"):
        SequenceReader(path)
    options = replace(SequenceOptions(), **{role.replace("-", "_") + "_topic": topic})
    assert SequenceReader(path, options).num_images in (6, 12)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (SequenceOptions(image_topic="/nowhere"), r"no topic /nowhere.*found.*/odom \(nav_msgs/Odometry\)"),
        (SequenceOptions(image_topic="/odom"), r"/odom is nav_msgs/Odometry, expected sensor_msgs/Image, sens"),
    ],
)
def test_a_topic_that_is_missing_or_of_another_type_is_named(
    options: SequenceOptions, said: str, walk_file: Path
) -> None:
    with pytest.raises(SequenceError, match=said):
        SequenceReader(walk_file, options)


def test_of_other_topics_those_of_the_kind_come_first_and_the_nearest_is_asked_for(tmp_path: Path) -> None:
    path = with_second(tmp_path, "/odom", "/other/with/a/long/name")
    with pytest.raises(SequenceError, match=r"no topic /camera/image \(--image-topic\); found ") as error:
        SequenceReader(path, SequenceOptions(image_topic="/camera/image"))
    assert re.search(
        rf"found {IMAGES} \(sensor_msgs/CompressedImage\).* more; did you mean {IMAGES}\?$", str(error.value)
    )
    with pytest.raises(SequenceError, match=r"no topic /camera/image \(--odometry-topic\); found /odom [^?]*$"):
        SequenceReader(path, SequenceOptions(odometry_topic="/camera/image"))


def test_a_topic_without_messages_is_said_to_be_empty(walk_file: Path) -> None:
    topics = [*Bag(walk_file).topics.values()]
    assert ", empty)" not in listing(topics)
    assert listing([replace(topics[0], num_messages=0)]) == f"found {topics[0].name} ({topics[0].type}, empty)"


def test_a_topic_of_two_types_is_refused_with_both(tmp_path: Path) -> None:
    bag = with_second(tmp_path, "/odom", "/ground_truth/pose")
    said = r"'/ground_truth/pose' has messages of 'geometry_msgs/PoseStamped' \('cdr'\) and of 'nav_msgs/Odometry'"
    with pytest.raises(SequenceError, match=said):
        list(SequenceReader(bag, SequenceOptions(ground_truth_topic="/ground_truth/pose")))


def test_without_tf_the_error_names_both_frames_and_an_option_helps(walk_file: Path, tmp_path: Path) -> None:
    path = rewrite(walk_file, tmp_path / "out.mcap", keep=lambda topic, _: topic != "/tf_static")
    with pytest.raises(SequenceError, match=r"no transform from 'base_link'.*to 'camera_optical_frame'.*found frames"):
        SequenceReader(path)
    with pytest.raises(SequenceError, match=r"--base-from-camera: quaternion xyzw is .*, expected a unit quaternion"):
        SequenceReader(path, SequenceOptions(base_from_camera=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    values = np.concatenate([BASE_FROM_CAMERA.translation, BASE_FROM_CAMERA.as_quat_xyzw()]).tolist()
    given = SequenceReader(path, SequenceOptions(base_from_camera=tuple(values)))
    reference = list(SequenceReader(walk_file))
    for frame, expected in zip(given, reference, strict=True):
        if expected.odometry is not None:
            assert frame.odometry is not None
            assert close(frame.odometry.previous_from_current, expected.odometry.previous_from_current, 1e-9)


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
