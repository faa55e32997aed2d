"""Real ROS 2 nodes: one replays a recording, and hears where its camera is."""

from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.reader import SequenceReader
from sequences.recordings.bag import Bag
from sequences.recordings.messages import frame_name, pose_from_message, pose_from_transform
from sequences.trajectories.interpolation import interpolate
from tests.helpers.full import FULL, some
from tests.helpers.live_system import (
    ODOMETRY,
    Received,
    free_domain,
    live_command,
    ros_python,
    run_node,
    script_of,
    stamp,
)
from vapor.pipeline.config import RunConfig
from vapor.pipeline.run import run

pytestmark = pytest.mark.ros

AHEAD_NS = 100_000_000
SMALL = ("--width", "168", "--height", "126")  # as the model sees
FRAMES, SEED = (300, "7") if FULL else (40, "3")  # of the second the first image tells the place


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from vapor.track import main

    path = tmp_path_factory.mktemp("recording") / "stairs.mcap"
    assert main(["synthesize", "staircase", str(path), "--frames", str(FRAMES), "--seed", SEED, *SMALL]) == 0
    return path


def odometry_of(recording: Path) -> tuple[np.ndarray, Poses]:
    messages = [raw.decode() for raw in Bag(recording).messages([ODOMETRY])]
    times_ns = np.array([stamp(message.header) for message in messages], np.int64)
    return times_ns, Poses.stack([pose_from_message(message.pose.pose) for message in messages])


def every_image_is_answered_with_the_pose_that_run_gives(heard: Received, recording: Path, folder: Path) -> None:
    run(recording, "staircase", folder / "run", RunConfig(engine="torch", recording=False))
    written = [raw.decode() for raw in Bag(folder / "run" / "estimate.mcap").messages(["/estimate/pose"])]
    expected = {stamp(message.header): pose_from_message(message.pose.pose) for message in written}
    told = [each.fields for each in heard.on("/estimate/pose")]
    answers = {stamp(each.header): pose_from_message(each.pose.pose) for each in told}
    assert len(expected) == FRAMES
    assert answers.keys() >= expected.keys()  # once images have ended, where odometry leads is told, too
    metres, radians = zip(*(answers[t].distance(expected[t]) for t in expected), strict=True)
    print(f"{len(answers)} poses, apart by {max(metres):.2e} m and {max(radians):.2e} rad at most")
    assert max(metres) < 1e-6
    assert max(radians) < 1e-6


def the_transform_from_the_map_agrees_with_pose_and_odometry(heard: Received, recording: Path) -> None:
    times_ns, odom_from_base = odometry_of(recording)
    base_from_camera = SequenceReader(recording).base_from_camera
    assert base_from_camera is not None
    told = {stamp(each.fields.header): pose_from_message(each.fields.pose.pose) for each in heard.on("/estimate/pose")}
    at_ns = np.array(sorted(told), np.int64)
    base, _ = interpolate(times_ns, odom_from_base, at_ns, max_gap_s=1.0)
    expected = Poses.stack([told[t] for t in at_ns.tolist()]) @ (base @ base_from_camera).inverse()
    checked: list[tuple[float, float]] = []
    for message in heard.on("/tf"):  # made of the pose of an image that odometry has just passed, one of the last few
        (transform,) = message.fields.transforms
        assert (frame_name(transform.header.frame_id), transform.child_frame_id) == ("map", "odom")
        passed = int(np.searchsorted(at_ns, stamp(transform.header) - AHEAD_NS, side="right"))
        some = expected[np.arange(max(passed - 4, 0), passed)]
        metres, radians = some.distance(pose_from_transform(transform.transform))
        checked.append((float(metres.min()), float(radians.min())))
    number, (apart_m, apart_rad) = len(checked), zip(*checked, strict=True)
    print(f"{number} transforms, apart by {max(apart_m):.2e} m and {max(apart_rad):.2e} rad at most")
    assert number > FRAMES / 2
    assert max(apart_m) < 1e-3
    assert max(apart_rad) < 1e-3


def the_pose_of_the_base_follows_odometry_by_the_transform(heard: Received, recording: Path) -> None:
    times_ns, odom_from_base = odometry_of(recording)
    transforms = {stamp(m.fields.transforms[0].header): m.fields.transforms[0].transform for m in heard.on("/tf")}
    poses, apart_m = heard.on("/estimate/base_pose"), []
    for message in poses:
        time_ns = stamp(message.fields.header)
        (known,) = np.flatnonzero(times_ns == time_ns)
        if (transform := transforms.get(time_ns + AHEAD_NS)) is not None:  # else told again for the same odometry
            base = pose_from_transform(transform) @ odom_from_base[int(known)]
            apart_m.append(float(base.distance(pose_from_message(message.fields.pose.pose))[0]))
    print(f"{len(poses)} poses of the base for {len(heard.on('/estimate/pose'))} images")
    assert len(apart_m) > 2 * FRAMES
    assert np.median(apart_m) < 1e-6


def diagnostics_say_how_long_an_image_takes_and_what_was_left_out(heard: Received) -> None:
    last = heard.on("/diagnostics")[-1].fields.status[0]
    values = {each.key: each.value for each in last.values}
    assert int(values["images localized"]) == FRAMES
    assert 0 < float(values["latency, median, ms"]) < 1000
    assert last.hardware_id == "staircase"


def particles_and_modes_come_with_every_pose(heard: Received) -> None:
    stamps = [stamp(each.fields.header) for each in heard.on("/estimate/pose")]
    particles = heard.on("/estimate/particles")
    assert {*stamps} <= {stamp(each.fields.header) for each in particles}
    assert {len(each.fields.poses) for each in particles} == {300}
    assert {*stamps} <= {stamp(each.fields.markers[-1].header) for each in heard.on("/estimate/modes")}


@pytest.mark.parametrize("distribution", some(1, ["jazzy", "kilted"]))
def test_a_node_that_replays_a_recording_hears_where_its_camera_is(
    distribution: str, recording: Path, tmp_path: Path
) -> None:
    python, domain = ros_python(distribution), free_domain()
    with live_command(domain, "--model", "staircase", "--engine", "torch", log=tmp_path / "live.log"):
        heard = run_node(python, script_of(recording), tmp_path, domain, timeout_s=FRAMES / 10 + 60)
    every_image_is_answered_with_the_pose_that_run_gives(heard, recording, tmp_path)
    the_transform_from_the_map_agrees_with_pose_and_odometry(heard, recording)
    the_pose_of_the_base_follows_odometry_by_the_transform(heard, recording)
    diagnostics_say_how_long_an_image_takes_and_what_was_left_out(heard)
    particles_and_modes_come_with_every_pose(heard)
