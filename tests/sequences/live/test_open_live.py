"""Waiting for a system in which something is not there yet."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sequences.errors import SequenceError
from sequences.options import ReadingOptions
from sequences.reader import SequenceReader
from sequences.recordings.source import TF_STATIC
from tests.helpers.fake_transport import messages_of
from tests.helpers.sequence_files import CAMERA, IMAGES, ODOMETRY
from tests.helpers.waiting import Ended, Wait

INFO = "/camera/camera_info"
TOPICS = (IMAGES, ODOMETRY, INFO, TF_STATIC)
WITHIN_S = 0.5  # of what is looked at now and then


@pytest.fixture
def wait(walk_file: Path, monkeypatch: pytest.MonkeyPatch) -> Wait:
    wait = Wait(messages_of(walk_file))
    monkeypatch.setattr("sequences.live.opening.time", SimpleNamespace(monotonic=lambda: wait.now_s))
    return wait


def test_what_is_waited_for_is_said_until_all_is_there(wait: Wait) -> None:
    wait.changes = [
        (8.0, lambda: wait.offer(IMAGES, INFO)),
        (12.0, lambda: wait.say(IMAGES)),
        (18.0, lambda: wait.offer(ODOMETRY)),
        (22.0, lambda: wait.say(ODOMETRY)),
        (28.0, lambda: wait.offer(TF_STATIC)),
        (32.0, lambda: wait.say(TF_STATIC)),
        (38.0, lambda: wait.say(INFO)),
    ]
    reader = wait.open()
    expected = [
        "no image topic, so no images; expected one of type sensor_msgs/Image, ",
        "no image topic, so no images; expected one of type sensor_msgs/Image, ",
        f"no readable message on {IMAGES} ",
        "no odometry topic, expected one of type nav_msgs/Odometry; found ",
        "no readable message on /odom ",
        "no transform from 'base_link' (/odom, child frame) to 'camera_optical_frame' ",
        "no transform from 'base_link' (/odom, child frame) to 'camera_optical_frame' ",
        f"no readable message on {INFO} ",
    ]
    assert [said[: len(start)] for (_, said), start in zip(wait.said, expected, strict=True)] == expected
    times = [time_s for time_s, _ in wait.said]
    assert times[0] < 1 + WITHIN_S
    np.testing.assert_allclose(np.diff(times), 5.0, atol=2.0)
    assert np.diff(times).min() >= 5.0
    assert wait.now_s < 38 + WITHIN_S
    assert wait.changes == []
    assert {offer.topic for offer in wait.transport.subscribed} == set(TOPICS)
    assert reader.camera == CAMERA


def test_the_reader_was_given_all_that_was_heard_meanwhile(wait: Wait, walk_file: Path) -> None:
    wait.offer(*TOPICS)
    wait.changes = [(3.0, lambda: wait.say(*TOPICS))]
    reader = wait.open()
    frame = reader.newest_frame()
    assert frame is not None
    expected = list(SequenceReader(walk_file))[-1]
    assert frame.time_ns == expected.time_ns
    np.testing.assert_array_equal(frame.image, expected.image)
    assert reader.counts.stated == 12
    assert reader.counts.skipped == {"a newer image was there": 11}
    assert len(wait.admitted) == len([raw for raw in wait.raws if raw.topic in TOPICS])


def test_of_images_only_the_latest_are_kept_while_something_is_not_there(wait: Wait) -> None:
    wait.offer(*TOPICS)
    others = [topic for topic in TOPICS if topic != TF_STATIC]
    wait.changes = [(2.0 + n, lambda: wait.say(IMAGES)) for n in range(5)]
    wait.changes += [(8.0, lambda: wait.say(*others)), (9.0, lambda: wait.say(TF_STATIC))]
    assert wait.open().counts.stated == 16


def test_what_is_there_is_not_judged_before_topics_have_settled(wait: Wait) -> None:
    """Of two cameras one appears first, and would be the only one for a moment."""
    wait.changes = [
        (0.3, lambda: wait.transport.offer("/rear/image", "sensor_msgs/Image")),
        (0.9, lambda: wait.offer(*TOPICS)),
    ]
    with pytest.raises(SequenceError, match="2 image topics"):
        wait.open()
    assert wait.now_s >= 1.9
    assert wait.said == []
    assert wait.transport.subscribed == []


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (ReadingOptions(), r"2 image topics, expected one; name it by --image-topic"),
        (ReadingOptions(image_topic=ODOMETRY), r"/odom is nav_msgs/Odometry, expected"),
    ],
)
def test_what_cannot_be_used_is_an_error_and_no_reason_to_wait(options: ReadingOptions, said: str, wait: Wait) -> None:
    wait.transport.offer("/rear/image", "sensor_msgs/Image")
    wait.offer(*TOPICS)
    with pytest.raises(SequenceError, match=f"^a made-up system: {said}"):
        wait.open(options)
    assert wait.now_s < 1 + WITHIN_S
    assert wait.said == []


def test_a_topic_that_is_named_is_waited_for(wait: Wait) -> None:
    wait.transport.offer("/rear/image", "sensor_msgs/Image")
    wait.changes = [(4.0, lambda: wait.offer(*TOPICS)), (7.0, lambda: wait.say(*TOPICS))]
    reader = wait.open(ReadingOptions(image_topic=IMAGES))
    assert wait.said[0][1] == f"no topic {IMAGES} (--image-topic); found /rear/image (sensor_msgs/Image)"
    assert reader.roles.image.name == IMAGES


@pytest.mark.parametrize("at_s", [0.5, 3.0, 50.0])
def test_whoever_admits_events_may_end_the_wait(at_s: float, wait: Wait) -> None:
    wait.changes = [
        (0.1, lambda: wait.put("nothing of ours")),
        (2.0, lambda: wait.offer(*TOPICS)),
        (at_s, lambda: wait.put("end")),
    ]
    wait.changes.sort(key=lambda change: change[0])
    with pytest.raises(Ended):
        wait.open()
    assert wait.admitted == ["nothing of ours", "end"]
    assert wait.now_s < at_s + WITHIN_S
