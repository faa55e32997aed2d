"""Live localization with an inertial unit and a barometer, and without published odometry."""

from pathlib import Path

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.inertial.sequence import InertialSequence
from sequences.inertial.topics import read_inertial
from sequences.live.frames import LiveFrames
from sequences.options import ReadingOptions, SequenceOptions
from sequences.reader import SequenceReader
from sequences.recordings.mcap_writer import ros_header
from sequences.recordings.messages import pose_from_message
from sequences.trajectories.tum import read_tum
from tests.helpers.checks import no_checks
from tests.helpers.fake_transport import messages_of, offering
from tests.helpers.inertial_files import (
    IMU,
    inertial_messages,
    standing_with_unit,
    with_messages,
    without_orientation,
)
from tests.helpers.live_reading import Robot
from tests.helpers.live_session import KnowingModel, Running, hurry, replayed, running
from tests.helpers.live_system import stamp
from tests.helpers.sequence_files import BEGIN_NS, ODOMETRY, Walk, world_from_base, world_from_camera
from tests.helpers.simulation import RNG
from vapor.pipeline.config import RunConfig
from vapor.pipeline.model import load_model
from vapor.pipeline.run import _with_inertial
from vapor.pipeline.run import run as run_recording
from vapor.robot.config import LiveConfig
from vapor.track import main

NS = 1_000_000_000


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    hurry(monkeypatch)


def inertial_walk(folder: Path, **messages) -> Path:
    plain = Walk(12).write(folder / "plain.mcap")
    return with_messages(plain, folder / "imu.mcap", IMU, "sensor_msgs/Imu", inertial_messages(**messages))


class Upright(KnowingModel):
    """A model whose training poses show which way is up."""

    def __init__(self) -> None:
        super().__init__()
        turns = np.column_stack([np.zeros((30, 5)), RNG(0).uniform(-3, 3, 30)])
        tilts = np.column_stack([np.zeros((30, 3)), RNG(1).normal(0, 0.2, (30, 3))])
        self.description.prior_poses = Poses.exp(turns) @ world_from_camera(BEGIN_NS) @ Poses.exp(tilts)


def test_a_unit_is_found_its_gravity_is_used_and_its_figures_are_told(tmp_path: Path) -> None:
    path = inertial_walk(tmp_path, change=without_orientation)
    with running(path, model=Upright()) as run:
        replayed(run, path)
        assert all(each.frame.gravity is not None for each in run.estimates[-5:])
        run.wait_told(f"{IMU} and {ODOMETRY}")
        run.wait(lambda: "gravity, standard deviation, deg" in run.values())
        assert 0.1 < float(run.values()["gravity, standard deviation, deg"]) < 10.0
        assert len(run.values()["bias of the gyroscope, rad/s"].split()) == 3
        belief = run.session._belief
        assert belief is not None
        assert belief.localizer.belief.vertical is not None
        run.wait_told(f"no message on {IMU}")


def test_gravity_that_is_upside_down_is_not_used_and_told(tmp_path: Path) -> None:
    def flipped(number, message):
        without_orientation(number, message)
        message["linear_acceleration"] = -message["linear_acceleration"]

    path = inertial_walk(tmp_path, change=flipped)
    with running(path, model=Upright()) as run:
        replayed(run, path)
        run.wait_told("upside down")


def test_a_ride_in_a_lift_is_part_of_the_motion(tmp_path: Path) -> None:
    with_imu = standing_with_unit(tmp_path, seconds=20.0, hz=50.0)
    seconds = np.arange(0.0, 20.0, 0.1)
    heights = np.clip(seconds - 8.0, 0.0, 3.0)
    pressures = 101_325.0 * (1.0 - heights / 44_330.0) ** (1.0 / 0.1903)
    messages = [
        (BEGIN_NS + round(t * 1e9), {"header": ros_header(BEGIN_NS + round(t * 1e9), "base_link"), "fluid_pressure": p})
        for t, p in zip(seconds.tolist(), pressures.tolist(), strict=True)
    ]
    path = with_messages(with_imu, tmp_path / "both.mcap", "/pressure", "sensor_msgs/FluidPressure", messages)
    risen = 0.0
    robot = Robot(offering(messages_of(path)), made=LiveFrames)
    robot.live_through(messages_of(path))
    for _, frame in robot.frames:
        if frame.odometry is not None and frame.gravity is not None:
            risen += float(frame.odometry.previous_from_current.translation @ np.array(frame.gravity.up))
    assert risen == pytest.approx(3.0, abs=0.35)


@pytest.mark.parametrize(("odometry", "told"), [("required", False), ("ignored", True)])
def test_a_barometer_without_published_odometry_is_told_to_be_of_no_use(odometry, told: bool, tmp_path: Path) -> None:
    stamps = [BEGIN_NS + 50_000_000 * n for n in range(20)]
    messages = [(t, {"header": ros_header(t, "base_link"), "fluid_pressure": 101_325.0}) for t in stamps]
    walk = inertial_walk(tmp_path)
    path = with_messages(walk, tmp_path / "both.mcap", "/pressure", "sensor_msgs/FluidPressure", messages)
    robot = Robot(offering(messages_of(path)), made=LiveFrames, odometry=odometry)
    robot.live_through(messages_of(path))
    assert any("/pressure is not used" in notice for notice in robot.reader.sensors.notices) == told
    named = SequenceOptions(pressure_topic="/pressure")
    frames = _with_inertial(SequenceReader(path, named, odometry=odometry), named, usual_up=None)
    assert any("/pressure is not used" in notice for notice in frames.notices) == told


def test_the_same_as_of_a_run_of_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "stairs.mcap"
    small = ("--width", "168", "--height", "126", "--frames", "40", "--seed", "3", "--imu")
    assert main(["synthesize", "staircase", str(path), *small]) == 0
    config = RunConfig(engine="torch", recording=False)
    run_recording(path, "staircase", tmp_path / "run", config)
    trajectory = read_tum(tmp_path / "run" / "trajectory.tum")
    frames = list(InertialSequence(SequenceReader(path), *read_inertial(path, SequenceOptions())))
    with running(path, model=load_model("staircase", config)) as run:
        replayed(run, path, images=40)
        estimates = run.estimates
    assert [each.time_ns for each in estimates] == trajectory.times_ns.tolist()
    off_deg = [
        np.degrees(np.arccos(min(np.dot(each.frame.gravity.up, frame.gravity.up), 1.0)))
        for each, frame in zip(estimates, frames, strict=True)
        if each.frame.gravity is not None and frame.gravity is not None
    ]
    assert len(off_deg) >= 38
    assert max(off_deg) < 0.5
    found = Poses.stack([each.estimate.modes[0].world_from_camera for each in estimates])
    metres, radians = found.distance(trajectory.poses)
    print(f"gravity apart by {max(off_deg):.2f}°, poses by {metres.max():.3f} m and {np.degrees(radians.max()):.2f}°")
    assert np.median(metres) < 0.05
    assert np.degrees(np.median(radians)) < 0.5


# --- without published odometry -------------------------------------------------------------------


def begin(run: Running, walk: Path) -> None:
    """Send the first image, and all that is there before it, but for odometry."""
    run.wait_until_subscribed()
    for raw in messages_of(walk):
        if raw.log_time_ns <= BEGIN_NS and raw.topic not in (ODOMETRY, "/ground_truth/pose"):
            run.transport.say(raw)


def test_without_published_odometry_it_goes_on_with_the_images_own_and_says_so(tmp_path: Path) -> None:
    walk = Walk(12).write(tmp_path / "walk.mcap")
    with running(walk, without=(ODOMETRY,)) as run:
        begin(run, walk)
        run.wait_told("waits: no odometry topic")
        run.wait_told("it goes on without odometry after 0.5 s")
        run.wait_told("and odometry made from the images")
        run.wait_told("there is no transform")
        replayed(run, walk, skip=(ODOMETRY, "/ground_truth/pose"))
        assert [each.time_ns for each in run.estimates] == [BEGIN_NS + NS // 10 * i for i in range(12)]
        sure = [each.time_ns for each in run.estimates if each.estimate.status == "converged"]
        assert sure
        bases = run.messages("base_pose")
        assert [stamp(base.header) for base in bases] == sure
        for base in bases:
            metres, _ = pose_from_message(base.pose.pose).distance(world_from_base(np.array(stamp(base.header))))
            assert metres < 0.1
        assert run.messages("tf") == []
        assert all(each.map_from_odom is None for each in run.estimates)
        assert "no odometry for" not in run.status().message
        covariance = np.diag([0.25, 0.25, 0.0, 0.0, 0.0, 0.068]).ravel()
        far = {"position": (70.0, -3.0, 0.0), "orientation": (0.0, 0.0, 0.0, 1.0)}
        kind = "geometry_msgs/PoseWithCovarianceStamped"
        run.control("/initialpose", kind, header={"frame_id": "map"}, pose={"pose": far, "covariance": covariance})
        run.wait_told("by /initialpose")


def test_without_odometry_a_silent_camera_makes_the_belief_wider_at_the_time_that_has_passed(tmp_path: Path) -> None:
    walk = Walk(12).write(tmp_path / "walk.mcap")
    with running(walk, without=(ODOMETRY,), odometry="none") as run:
        replayed(run, walk, skip=(ODOMETRY, "/ground_truth/pose"))
        last_ns = run.estimates[-1].time_ns
        run.wait(lambda: "no image for" in run.status().message)
        run.wait(lambda: run.status().message.startswith("ambiguous"))
        run.wait(lambda: stamp(run.messages("pose")[-1].header) > last_ns + NS // 5)
        assert any("and no odometry" in line for line in run.told)


@pytest.mark.parametrize("odometry", ["visual", "both"])
def test_odometry_of_images_is_made_where_it_is_asked_for(odometry: str, tmp_path: Path) -> None:
    walk = Walk(12).write(tmp_path / "walk.mcap")
    with running(walk, odometry=odometry) as run:
        replayed(run, walk)
        assert len(run.estimates) >= 10
        assert any("odometry made from the images" in line for line in run.told)
        assert (len(run.messages("tf")) > 0) == (odometry == "both")


def test_settings_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    walk = Walk(12).write(tmp_path / "walk.mcap")
    named = ReadingOptions(odometry_topic=ODOMETRY)
    with (
        pytest.raises(VaporTrackError, match="--odometry visual beside --odometry-topic"),
        running(walk, odometry="visual", reading=named),
    ):
        pass
    with no_checks(), pytest.raises(VaporTrackError, match="expected one of auto, recorded, visual, both, none"):
        LiveConfig(odometry="wheels")  # pyright: ignore[reportArgumentType]
