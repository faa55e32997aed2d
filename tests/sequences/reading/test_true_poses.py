"""True poses and odometry from where robots have them: topics and transforms."""

import tracemalloc
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.datasets.frames import posed_frames
from sequences.errors import SequenceError
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from tests.helpers.sequence_files import BASE_FROM_CAMERA, BEGIN_NS, Walk
from tests.helpers.tf_files import (
    MS,
    TYPES,
    TYPES_OF_UNSAID,
    Event,
    body,
    header,
    images,
    mounted,
    odometry,
    pose,
    read,
    record,
    require_true,
    robot,
    stamps,
    tf,
    told_by,
)


@pytest.mark.parametrize("message_type", TYPES + TYPES_OF_UNSAID)
def test_every_type_gives_the_poses_of_the_camera(message_type: str, tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", images(), mounted(), told_by(message_type, stamps()))
    child = {} if message_type in TYPES else {"ground_truth_child_frame": "base_link"}
    require_true(read(path, ground_truth_topic="/truth", **child))


@pytest.mark.parametrize("message_type", TYPES + TYPES_OF_UNSAID)
def test_a_stated_pose_of_the_camera_replaces_tf(message_type: str, tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", images(), told_by(message_type, stamps()))
    numbers = (*BASE_FROM_CAMERA.translation.tolist(), *BASE_FROM_CAMERA.as_quat_xyzw().tolist())
    named = {"ground_truth_topic": "/truth", "ground_truth_child_frame": "base_link"}
    require_true(read(path, base_from_camera=numbers, **named))


def test_the_body_may_be_another_one_than_that_of_the_odometry(tmp_path: Path) -> None:
    base_from_imu = Poses.exp(np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))
    path = record(
        tmp_path / "a.mcap",
        images(),
        odometry(stamps()),
        tf("base_link", "imu", [BEGIN_NS], lambda _: base_from_imu, "/tf_static"),
        [
            Event(t, "/truth", "geometry_msgs/PoseStamped", {"header": header(t, "map"), "pose": pose(world_from_imu)})
            for t in stamps()
            for world_from_imu in [body(t) @ base_from_imu]
        ],
    )
    numbers = (*BASE_FROM_CAMERA.translation.tolist(), *BASE_FROM_CAMERA.as_quat_xyzw().tolist())
    require_true(read(path, base_from_camera=numbers, ground_truth_child_frame="imu"))


def test_of_a_path_that_grows_the_last_message_holds_all(tmp_path: Path) -> None:
    """Each message corrects all before it: only the last one is right."""
    events = []
    for last in range(1, len(stamps()) + 1):
        wrong = Poses.exp(np.array([0.5, 0, 0, 0, 0, 0]) * (last < len(stamps())))
        poses = [{"header": header(t, "map"), "pose": pose(body(t) @ wrong)} for t in stamps()[:last]]
        events.append(Event(stamps()[last - 1], "/path", "nav_msgs/Path", {"header": header(0, "map"), "poses": poses}))
    path = record(tmp_path / "a.mcap", images(), mounted(), events)
    require_true(read(path, ground_truth_topic="/path", ground_truth_child_frame="base_link"))


def test_a_path_without_stamps_of_its_own_is_refused(tmp_path: Path) -> None:
    poses = [{"header": header(BEGIN_NS, "map"), "pose": pose(body(t))} for t in stamps()]
    message = {"header": header(BEGIN_NS, "map"), "poses": poses}
    path = record(tmp_path / "a.mcap", images(), [Event(BEGIN_NS, "/path", "nav_msgs/Path", message)])
    with pytest.raises(SequenceError, match=r"a\.mcap: /path \(nav_msgs/Path\): 65 poses of one stamp"):
        read(path)


def test_a_body_that_tf_does_not_know_is_named(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", images(), mounted(), told_by("nav_msgs/Odometry", stamps(), child="vicon/cart"))
    with pytest.raises(
        SequenceError, match=r"no transform from 'vicon/cart' \(/truth\) to 'camera'.*--ground-truth-child"
    ):
        read(path)
    require_true(read(path, ground_truth_child_frame="base_link"))


def test_stamps_that_run_backwards_are_counted(tmp_path: Path) -> None:
    events = told_by("nav_msgs/Odometry", stamps())
    late = [Event(events[i + 4].time_ns + 1, "/truth", "nav_msgs/Odometry", events[i].message) for i in (5, 20)]
    path = record(tmp_path / "a.mcap", images(), mounted(), events, late)
    frames = posed_frames(path, options=SequenceOptions(ground_truth_topic="/truth"))
    require_true(list(frames))
    assert frames.skipped == {"true poses: time stamp not increasing": 2}


def test_poses_come_through_the_tree_of_transforms(tmp_path: Path) -> None:
    require_true(read(robot(tmp_path / "a.mcap"), ground_truth_frame="map"))


def test_odometry_and_true_poses_of_tf_are_found_by_themselves(tmp_path: Path) -> None:
    reader = SequenceReader(robot(tmp_path / "a.mcap"))
    frames = list(reader)
    require_true(frames)
    assert (reader.resolved["odometry_frame"], reader.resolved["ground_truth_frame"]) == ("odom", "map")
    assert reader.base_from_camera is not None
    assert max(reader.base_from_camera.distance(BASE_FROM_CAMERA)) < 1e-9
    for before, frame in pairwise(frames):
        assert frame.odometry is not None
        truth = (body(before.time_ns) @ BASE_FROM_CAMERA).inverse() @ body(frame.time_ns) @ BASE_FROM_CAMERA
        assert max(frame.odometry.previous_from_current.distance(truth)) < 1e-3
        assert np.linalg.eigvalsh(frame.odometry.covariance)[0] > 0
    assert reader.notices == []


def test_a_frame_that_is_not_there_or_does_not_move_is_refused(tmp_path: Path) -> None:
    plate = tf("base_link", "plate", [BEGIN_NS], lambda _: BASE_FROM_CAMERA, "/tf_static")
    path = robot(tmp_path / "a.mcap", extra=plate)
    with pytest.raises(SequenceError, match=r"no transforms from 'world' \(--ground-truth-frame\).*base_link, camera"):
        read(path, ground_truth_frame="world")
    with pytest.raises(SequenceError, match=r"'camera' never moves in 'plate' \(--ground-truth-frame\)"):
        read(path, ground_truth_frame="plate")
    with pytest.raises(SequenceError, match=r"tf has no 'vo' in which 'camera' moves \(--odometry-frame\)"):
        SequenceReader(path, SequenceOptions(odometry_frame="vo"))
    with pytest.raises(SequenceError, match=r"--ground-truth-frame and --poses all state where"):
        SequenceOptions(ground_truth_frame="map", poses=Path("a.txt"))


def test_a_camera_that_turns_on_its_robot_is_followed_by_tf_only(tmp_path: Path) -> None:
    def head(t: int) -> Poses:
        return BASE_FROM_CAMERA @ Poses.exp(np.array([0, 0, 0, 0, 0.5, 0]) * ((t - BEGIN_NS) * 1e-9))

    path = record(
        tmp_path / "a.mcap",
        images(),
        tf("base_link", "camera", stamps(), head),
        tf("map", "base_link", stamps(since_ms=-36), body),
        odometry(stamps()),
    )
    for frame in read(path, ground_truth_frame="map"):
        assert frame.world_from_camera is not None
        assert max(frame.world_from_camera.distance(body(frame.time_ns) @ head(frame.time_ns))) < 1e-3
    with pytest.raises(SequenceError, match=r"/tf at \d+ ns: base_link -> camera has moved by .* rad, expected.*fixed"):
        list(SequenceReader(path, SequenceOptions(ground_truth_frame="map")))


def test_odometry_that_is_optional_ends_where_the_camera_moves_on_its_robot(tmp_path: Path) -> None:
    def head(t: int) -> Poses:
        return BASE_FROM_CAMERA @ Poses.exp(np.array([0, 0, 0, 0, 0.5, 0]) * (t > BEGIN_NS + 550 * MS))

    path = record(
        tmp_path / "a.mcap",
        images(),
        tf("base_link", "camera", stamps(), head),
        tf("map", "base_link", stamps(since_ms=-36), body),
        odometry(stamps()),
    )
    frames = posed_frames(path, options=SequenceOptions(ground_truth_frame="map"))
    assert [frame.odometry is not None for frame in frames] == [False] + [True] * 5 + [False] * 6
    assert frames.skipped == {"odometry from where the camera moved on its base": 1}


def test_a_jump_is_counted_and_no_pose_is_interpolated_across_it(tmp_path: Path) -> None:
    """map -> odom jumps by 0.6 m between two messages 90 ms apart, with one image between them."""
    times = stamps(every_ms=90, since_ms=-39)
    after = next(i for i, t in enumerate(times) if t > BEGIN_NS + 600 * MS)
    path = robot(tmp_path / "a.mcap", jump_ns=times[after])
    between = [t for t, _ in Walk().images if times[after - 1] < t < times[after]]
    assert len(between) == 1  # the precondition
    reader = SequenceReader(path)
    assert [frame.time_ns for frame in reader if frame.world_from_camera is None] == between
    assert reader.across_jumps == 1
    (notice,) = reader.notices
    assert notice.startswith(
        f"true poses of tf frame map jump 1 time, first at {times[after] * 1e-9:.3f} s: none for 1 image"
    )
    frames = posed_frames(path)
    assert len(list(frames)) == 11
    assert frames.skipped == {"true pose jumps": 1}
    assert notice in frames.notices[0]


@pytest.mark.parametrize("with_tree", [True, False])
@pytest.mark.usefixtures("unchecked")
def test_memory_does_not_grow_with_the_file(with_tree: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sequences.recordings.mcap_file._MAX_KEPT_BYTES", 0)
    monkeypatch.setattr("sequences.reading.frame_pairing._HORIZON_NS", 10**9)
    peaks = []
    for num_images in (20, 80):
        times = stamps(num_images)
        parts = [tf("map", "base_link", times, body)] if with_tree else [told_by("nav_msgs/Odometry", times)]
        path = record(tmp_path / f"{num_images}.mcap", images(num_images), mounted(), *parts)
        reader = SequenceReader(path, odometry="unread", true_poses="required")
        assert next(iter(reader)).world_from_camera is not None  # decoders are made once and kept
        tracemalloc.start()
        assert sum(frame.world_from_camera is not None for frame in reader) == num_images
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]
