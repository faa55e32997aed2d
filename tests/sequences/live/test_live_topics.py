"""Topics of a running system that come, go, and have several types; odometry of tf."""

from pathlib import Path

import numpy as np
import pytest

from sequences.errors import NotFoundError, SequenceError
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.recordings.source import TF_STATIC, RawMessage
from tests.helpers import tf_files
from tests.helpers.fake_transport import FakeTransport, messages_of, offering
from tests.helpers.live_reading import Robot, at_ms, lived, require_same, tf_record
from tests.helpers.sequence_files import BEGIN_NS, CAMERA, IMAGES, MS, ODOMETRY, close

INFO = "/camera/camera_info"


def test_a_topic_that_is_published_with_two_types_is_refused(raws: list[RawMessage]) -> None:
    transport = offering(raws)
    transport.offer(IMAGES, "sensor_msgs/Image")
    with pytest.raises(SequenceError, match=r"image/compressed has messages of .*Image and of .*expected one type"):
        Robot(transport).try_to_open()


def test_what_is_not_there_yet_is_named(raws: list[RawMessage]) -> None:
    for topic, said in [
        (IMAGES, "no image topic, so no images; expected one of type sensor_msgs/Image, "),
        (ODOMETRY, "no odometry topic, expected one of type nav_msgs/Odometry; found "),
        (TF_STATIC, "no transform from 'base_link' (/odom, child frame) to 'camera_optical_frame'"),
    ]:
        robot = lived([raw for raw in raws if raw.topic != topic])
        assert robot.opened is None
        assert said in robot.wanting[-1]
        assert robot.wanting[-1].startswith("a made-up system: ")


def test_topics_may_come_one_after_the_other(raws: list[RawMessage], walk_file: Path) -> None:
    since_ms = {IMAGES: 0, ODOMETRY: 215, INFO: 315, TF_STATIC: 415}
    late = [
        raw._replace(log_time_ns=BEGIN_NS + since_ms[TF_STATIC] * MS) if raw.topic == TF_STATIC else raw for raw in raws
    ]
    robot = Robot(FakeTransport())
    for raw in sorted(late, key=lambda raw: raw.log_time_ns):
        if at_ms(raw) >= since_ms.get(raw.topic, 1e9):
            robot.transport.offer(raw.topic, raw.type, latched=raw.topic == TF_STATIC)
            robot.live_through([raw])
    said = list(dict.fromkeys(robot.wanting))[-3:]
    for each, wanted in zip(said, ("no odometry topic", "no readable message on /odom", "no transform"), strict=True):
        assert wanted in each
    assert robot.times_ms == [100 * n for n in range(3, 12)]  # from where odometry was heard
    assert robot.reader.camera == CAMERA
    require_same([frame for _, frame in robot.frames][1:], list(SequenceReader(walk_file))[4:])


def test_a_publisher_that_comes_back_with_other_reliability_is_heard_again(raws: list[RawMessage]) -> None:
    robot = Robot(offering(raws))
    robot.live_through([raw for raw in raws if at_ms(raw) < 550])
    before = len(robot.transport.subscribed)
    robot.transport.withdraw(IMAGES)
    robot.heard.refresh()
    assert len(robot.transport.subscribed) == before
    robot.transport.offer(IMAGES, "sensor_msgs/CompressedImage", reliable=False)
    robot.live_through([raw for raw in raws if at_ms(raw) > 550])
    assert [(offer.topic, offer.reliable) for offer in robot.transport.subscribed[before:]] == [(IMAGES, False)]
    assert len(robot.frames) == 12


def test_topics_of_no_use_are_not_listened_to(raws: list[RawMessage]) -> None:
    transport = offering(raws)
    for name, kind in (
        ("/scan", "sensor_msgs/LaserScan"),
        ("/tf", "std_msgs/Empty"),
        ("/clock", "rosgraph_msgs/Clock"),
    ):
        transport.offer(name, kind)
    robot = Robot(transport)
    robot.live_through(raws)
    assert len(robot.frames) == 12
    assert {offer.topic for offer in transport.subscribed} == {IMAGES, ODOMETRY, INFO, TF_STATIC}
    assert "/tf" not in robot.heard
    assert robot.reader.streamed == [IMAGES, ODOMETRY, INFO, TF_STATIC]


def test_odometry_of_tf_says_what_a_topic_would(tmp_path: Path) -> None:
    path = tf_record(tmp_path / "tf.mcap", num_images=20)
    by_tf = lived(messages_of(path))
    require_same([frame for _, frame in by_tf.frames], SequenceReader(path))
    topic = tf_files.odometry(tf_files.stamps(20))
    path = tf_files.record(tmp_path / "topic.mcap", tf_files.images(20), tf_files.mounted(), topic)
    by_topic = lived(messages_of(path))
    assert len(by_tf.frames) == len(by_topic.frames) == 20
    assert by_tf.reader.roles.odometry is None
    for (_, frame), (_, expected) in zip(by_tf.frames[1:], by_topic.frames[1:], strict=True):
        assert frame.odometry is not None
        assert expected.odometry is not None
        assert close(frame.odometry.previous_from_current, expected.odometry.previous_from_current, 1e-3)
        np.testing.assert_allclose(frame.odometry.covariance, expected.odometry.covariance, rtol=0.1, atol=1e-9)
    assert by_tf.reader.odometry_ns == by_topic.reader.odometry_ns
    last = by_tf.reader.odometry_ns
    assert last is not None
    pose = by_tf.reader.odom_from_base(last)
    assert pose is not None
    assert close(pose, tf_files.body(last), 1e-9)


def test_tf_of_one_robot_among_several_is_taken_by_its_name(tmp_path: Path) -> None:
    plain = SequenceReader(tf_record(tmp_path / "tf.mcap"))
    named = tf_record(tmp_path / "robot1.mcap", tf_topics=["/robot1/tf"])
    require_same(list(SequenceReader(named)), plain)  # the only one
    require_same([frame for _, frame in lived(messages_of(named)).frames], plain)
    two = tf_record(tmp_path / "two.mcap", tf_topics=["/robot1/tf", "/robot2/tf"])
    with pytest.raises(SequenceError, match=r"no odometry topic.*; tf is of 2 robots, name one by --tf-topic"):
        SequenceReader(two)
    chosen = SequenceOptions(tf_topic="/robot1/tf")
    require_same(list(SequenceReader(two, chosen)), plain)
    require_same([frame for _, frame in lived(messages_of(two), chosen).frames], plain)
    said = r"no tf on '/robot3/tf' \(--tf-topic\), found: /robot1/tf, /robot2/tf; expected one of these"
    with pytest.raises(NotFoundError, match=said):
        SequenceReader(two, SequenceOptions(tf_topic="/robot3/tf"))
