"""True poses that are found by themselves, and what is wrong with them."""

from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from tests.helpers import foxglove_files
from tests.helpers.sequence_files import BASE_FROM_CAMERA, BEGIN_NS
from tests.helpers.tf_files import (
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
from vapor.track import main
from vapor.training_data.entries import open_sequences
from vapor.training_data.load import load_training_set


def test_without_any_the_error_says_what_could_give_them(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", images(), mounted(), odometry(stamps()))
    with pytest.raises(SequenceError, match=r"no true poses found.*one of: /odom, odometry as it seems.*--poses"):
        read(path)
    assert next(iter(SequenceReader(path))).world_from_camera is None
    bare = record(tmp_path / "b.mcap", images())
    with pytest.raises(SequenceError, match=r"b\.mcap: no true poses: expected a topic of type geometry.*none"):
        read(bare)


def test_of_two_candidates_the_error_lists_both_with_their_options(tmp_path: Path) -> None:
    extra = told_by("geometry_msgs/PoseWithCovarianceStamped", stamps(), topic="/amcl_pose")
    extra += told_by("geometry_msgs/PoseWithCovarianceStamped", stamps()[:1], topic="/initialpose")  # is none
    path = robot(tmp_path / "a.mcap", extra=extra)
    said = r"/amcl_pose \(geometry_msgs/PoseWith\w+: --ground-truth-topic /amcl_pose\); tf frame map \(--ground"
    with pytest.raises(SequenceError, match=said):
        read(path)
    assert next(iter(SequenceReader(path))).world_from_camera is None
    require_true(read(path, ground_truth_topic="/amcl_pose", ground_truth_child_frame="base_link"))


def test_the_only_candidate_is_taken_and_what_it_was_taken_for_is_said(tmp_path: Path) -> None:
    path = record(
        tmp_path / "a.mcap",
        images(),
        mounted(),
        odometry(stamps()),
        told_by("geometry_msgs/PoseWithCovarianceStamped", stamps()),
    )
    reader = SequenceReader(path)
    frame = next(iter(reader))
    assert frame.world_from_camera is not None
    assert max(frame.world_from_camera.distance(body(frame.time_ns))) < 1e-3  # as of the camera itself
    assert reader.resolved["ground_truth_topic"] == "/truth"
    assert "/truth" in reader.notices[0]
    assert "--ground-truth-child-frame" in reader.notices[0]


def test_odometry_named_as_the_truth_is_not_taken_for_odometry(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", images(), mounted(), odometry(stamps()), told_by("nav_msgs/Odometry", stamps()))
    reader = SequenceReader(path, SequenceOptions(ground_truth_topic="/truth"))
    assert reader.resolved["odometry_topic"] == "/odom"
    require_true(list(reader))
    with pytest.raises(SequenceError, match="2 odometry topics"):
        SequenceReader(path)
    named = SequenceReader(path, SequenceOptions(odometry_topic="/odom"))
    assert named.resolved["ground_truth_topic"] == "/truth"


@pytest.mark.parametrize("message_type", TYPES + TYPES_OF_UNSAID)
def test_poses_of_another_time_are_refused_with_both_ranges(message_type: str, tmp_path: Path) -> None:
    old = told_by(message_type, stamps())
    day_s = 86400

    def earlier(message: dict) -> dict:
        found = {k: earlier(v) if isinstance(v, dict) else v for k, v in message.items()}
        found |= {k: [earlier(part) for part in v] for k, v in message.items() if k == "poses"}
        return found | ({"sec": message["sec"] - day_s} if "sec" in message else {})

    events = [Event(e.time_ns, e.topic, e.type, earlier(e.message)) for e in old]
    path = record(tmp_path / "a.mcap", images(), mounted(), events)
    first, last = (stamps()[i] * 1e-9 - day_s for i in (0, -1))
    said = rf"those of /truth are from {first:.3f} to {last:.3f} s, images from {BEGIN_NS * 1e-9:.3f} to"
    with pytest.raises(SequenceError, match=said):
        read(path, ground_truth_topic="/truth")
    reader = SequenceReader(path, SequenceOptions(ground_truth_topic="/truth"), odometry="unread")
    assert all(frame.world_from_camera is None for frame in reader)
    assert any("those of /truth" in notice for notice in reader.notices)


def test_poses_far_from_the_origin_keep_their_millimetres(tmp_path: Path) -> None:
    utm = Poses.exp(np.array([0.0, 0.0, 0.0, 0.1, -0.2, 0.7]))
    utm = Poses(utm.rotation, np.array([4.5e5, 5.4e6, 300.0]))
    path = record(tmp_path / "a.mcap", images(), mounted(), tf("utm", "base_link", stamps(), lambda t: utm @ body(t)))
    frames = read(path)
    near = read(path, ground_truth_origin=tuple(utm.translation.tolist()))
    for frame, shifted in zip(frames, near, strict=True):
        assert frame.world_from_camera is not None
        assert shifted.world_from_camera is not None
        expected = utm @ body(frame.time_ns) @ BASE_FROM_CAMERA
        assert frame.world_from_camera.distance(expected)[0] < 1e-3
        moved = frame.world_from_camera.translation - utm.translation
        np.testing.assert_allclose(shifted.world_from_camera.translation, moved, atol=1e-8)
    assert np.abs(near[0].world_from_camera.translation).max() < 10  # pyright: ignore[reportOptionalMemberAccess]


def test_a_transform_that_nobody_asks_for_may_be_broken(tmp_path: Path) -> None:
    broken = tf("base_link", "wheel", stamps(), lambda _: Poses(np.eye(3), np.full(3, np.nan)))
    asked = {"ground_truth_frame": "map", "base_from_camera": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)}
    path = record(tmp_path / "a.mcap", images(), odometry(stamps()), tf("map", "base_link", stamps(), body), broken)
    assert len(read(path, **asked)) == 12
    lost = tf("map", "base_link", stamps()[9:10], lambda _: Poses(np.eye(3), np.full(3, np.nan)))
    path = record(tmp_path / "b.mcap", images(), odometry(stamps()), tf("map", "base_link", stamps(), body), lost)
    reader = SequenceReader(path, SequenceOptions(**asked))
    assert len(list(reader)) == 12
    assert reader.skipped == {"unusable true poses": 1}


@pytest.mark.parametrize("encoding", [*foxglove_files.ENCODINGS, "ros"])
@pytest.mark.parametrize("topic", ["/tf", "/tf_static"])
def test_what_is_called_tf_and_has_no_transforms_is_no_tf(topic: str, encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    if encoding == "ros":
        message = {"header": header(BEGIN_NS, "map"), "pose": pose(body(BEGIN_NS))}
        other = [Event(BEGIN_NS, topic, "geometry_msgs/PoseStamped", message)]
        record(path, images(), told_by("geometry_msgs/PoseStamped", stamps()), other)
    else:
        walk = (foxglove_files.images(), foxglove_files.robot(), foxglove_files.calibration(topic))
        foxglove_files.write(path, encoding, *walk)
    reader = SequenceReader(path, odometry="optional")
    assert len(list(reader)) == 12
    assert reader.camera is None


@pytest.mark.parametrize("command", ["train", "calibrate"])
def test_train_and_calibrate_take_the_same_options(
    command: str, tiny_model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, output = robot(tmp_path / "a.mcap"), tmp_path / "out.safetensors"
    model = [str(tiny_model)] if command == "calibrate" else []
    words = [command, *model, str(path), "--output", str(output)]
    assert main([*words, "--ground-truth-frame", "nowhere"]) == 1
    assert "no transforms from 'nowhere' (--ground-truth-frame)" in capsys.readouterr().err
    assert main([*words, "--poses", str(tmp_path / "none.tum")]) == 1
    assert "none.tum: cannot read" in capsys.readouterr().err
    assert not output.exists()


def test_a_training_says_where_positions_are_too_far_for_the_network(tmp_path: Path) -> None:
    far = Poses(np.eye(3), np.array([4.5e5, 5.4e6, 0.0]))
    path = record(tmp_path / "a.mcap", images(), mounted(), tf("utm", "base_link", stamps(), lambda t: far @ body(t)))
    loaded = load_training_set(open_sequences([path]), (32, 24))
    (notice,) = [each for each in loaded.notices if each.startswith("positions")]
    assert "positions up to 5.4e+06 m from zero: the network resolves them to 0.5 m only;" in notice
    reading = SequenceOptions(ground_truth_origin=(4.5e5, 5.4e6, 0.0))
    near = load_training_set(open_sequences([path], reading), (32, 24))
    assert not any(each.startswith("positions") for each in near.notices)
