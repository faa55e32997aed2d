"""Live localization of a walk in a made-up system."""

import asyncio
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from filtering.storeys import Storeys
from sequences.options import ReadingOptions
from sequences.reader import SequenceReader
from sequences.recordings.bag import Bag
from sequences.recordings.messages import pose_from_message, pose_from_transform
from sequences.recordings.source import RawMessage
from tests.helpers.fake_transport import messages_of, offering
from tests.helpers.live_session import ELSEWHERE, KnowingModel, Running, hurry, knowing, running
from tests.helpers.live_system import stamp
from tests.helpers.sequence_files import BEGIN_NS, IMAGES, ODOMETRY, Walk, world_from_base, world_from_camera
from tests.helpers.simulation import assert_same_belief
from vapor.robot.config import LiveConfig
from vapor.robot.session import LiveSession

NS = 1_000_000_000


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    hurry(monkeypatch)


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Walk(12).write(tmp_path_factory.mktemp("walk") / "walk.mcap")


def replayed(run: Running, walk: Path, *, images: int = 12, skip: tuple[str, ...] = ("/ground_truth/pose",)) -> None:
    """Send a walk, and wait for each image to be localized, so that none is overtaken."""
    sent = 0
    run.wait_until_subscribed()
    for raw in messages_of(walk):
        if raw.topic in skip:
            continue
        if raw.topic == IMAGES:
            if sent >= 1:
                run.wait_for(sent)
            if sent == images:
                return
            sent += 1
        run.transport.say(raw)
        time.sleep(0.003)
    run.wait_for(sent)


def test_every_image_is_localized_and_what_a_robot_needs_is_published(walk: Path) -> None:
    with running(walk) as run:
        replayed(run, walk)
        assert [each.time_ns for each in run.estimates] == [BEGIN_NS + NS // 10 * i for i in range(12)]
        for each in run.estimates:
            metres, _ = each.estimate.modes[0].world_from_camera.distance(world_from_camera(each.time_ns))
            assert metres < 0.05
            metres, _ = each.map_from_base.distance(world_from_base(np.array(each.time_ns)))
            assert metres < 0.05
        assert len(run.messages("pose")) >= 12
        time.sleep(0.1)  # odometry behind the last image
        bases = run.messages("base_pose")
        assert len(bases) > 24, "between images, too: one for each message of odometry where nothing waits"
        for base in bases:
            metres, _ = pose_from_message(base.pose.pose).distance(world_from_base(np.array(stamp(base.header))))
            assert metres < 0.1
        headers = [
            (message.transforms[0].header, message.transforms[0].child_frame_id) for message in run.messages("tf")
        ]
        assert {(header.frame_id, child) for header, child in headers} == {("map", "odom")}
        stamps = [stamp(header) for header, _ in headers]
        assert stamps == sorted(set(stamps)), "no transform comes twice with one stamp"
        ahead_ns = stamps[-1] - stamp(bases[-1].header)
        assert 0 <= ahead_ns - NS // 10 <= 12, "a nanosecond more each time that the same odometry is told again"
        assert run.session.skipped == {}


def test_the_pose_of_the_base_has_a_covariance_that_grows_until_the_next_image(walk: Path) -> None:
    with running(walk) as run:
        replayed(run, walk, images=6)
        time.sleep(0.02)
        number = len(run.messages("base_pose"))
        later_ns = run.estimates[-1].time_ns + NS // 10
        for raw in [raw for raw in messages_of(walk) if raw.topic == ODOMETRY and raw.log_time_ns > later_ns][:4]:
            run.transport.say(raw)
            time.sleep(0.02)
        after = run.messages("base_pose")[number:]
        trace = [np.trace(np.array(m.pose.covariance).reshape(6, 6)[:3, :3]) for m in after]
        assert len(trace) == 4
        assert all(later > earlier for earlier, later in pairwise(trace))


def test_neither_transform_nor_base_is_published_while_two_places_are_possible(walk: Path) -> None:
    model, low = KnowingModel(places=2), world_from_camera(BEGIN_NS)
    heights = [float(pose.translation[2]) for pose in (low, ELSEWHERE @ low)]
    model.storeys = Storeys((heights[0], heights[1]))
    with running(walk, model=model) as run:
        replayed(run, walk)
        assert {each.estimate.status for each in run.estimates} == {"ambiguous"}
        assert all(each.map_from_odom is None for each in run.estimates)
        assert run.messages("tf") == run.messages("base_pose") == []
        assert {m.status[0].level for m in run.messages("diagnostics") if m.status[0].values} <= {1, 3}
        assert len(run.messages("pose")) >= 12
        run.wait(lambda: "storey" in run.values())
        weights = [float(run.values()[f"weight of storey {number}"]) for number in range(2)]
        assert sum(weights) == pytest.approx(1.0, abs=2e-4)
        assert min(weights) > 0.2  # either place is as likely


def test_a_message_on_reset_forgets_the_belief(walk: Path) -> None:
    with running(walk, keep_tf=True) as run:
        replayed(run, walk, images=6)
        run.control("/estimate/reset")
        run.wait_told("reset")
        belief: Any = run.session._belief
        assert belief.anchor is None


def test_the_last_transform_is_kept_where_that_is_asked_for(walk: Path) -> None:
    with running(walk, keep_tf=True) as run:
        replayed(run, walk, images=6)
        known = pose_from_transform(run.messages("tf")[-1].transforms[0].transform)
        run.wait(lambda: run.status().message.startswith("ambiguous"))  # silence
        before = len(run.messages("tf"))
        for raw in [raw for raw in messages_of(walk) if raw.topic == ODOMETRY][-3:]:
            run.transport.say(raw)
        run.wait(lambda: len(run.messages("tf")) > before)
        kept = pose_from_transform(run.messages("tf")[-1].transforms[0].transform)
        assert float(known.distance(kept)[0]) == 0.0


def test_a_silent_camera_makes_the_belief_wider_until_it_is_not_converged(walk: Path) -> None:
    with running(walk) as run:
        replayed(run, walk, images=4)
        assert run.status().message == "converged"
        run.wait(lambda: "no odometry for" in run.status().message)
        run.wait(lambda: run.status().message.startswith("ambiguous"))
        assert any(line.startswith("ambiguous") for line in run.told)


def test_a_message_on_initialpose_begins_anew_there(walk: Path) -> None:
    with running(walk) as run:
        replayed(run, walk, images=3)
        far = {"position": (70.0, -3.0, 0.0), "orientation": (0.0, 0.0, 0.0, 1.0)}
        covariance = np.diag([0.25, 0.25, 0.0, 0.0, 0.0, 0.068]).ravel()
        kind = "geometry_msgs/PoseWithCovarianceStamped"
        told = {"pose": {"pose": far, "covariance": covariance}}
        run.control("/initialpose", kind, header={"frame_id": "odom"}, **told)
        run.wait_told("expected one in 'map'")
        run.control("/initialpose", kind, header={"frame_id": "map"}, **told)
        run.wait_told("by /initialpose")
        belief: Any = run.session._belief
        best = belief.localizer.predicted(None).modes[0].world_from_camera
        base = best @ SequenceReader(walk).base_from_camera.inverse()  # pyright: ignore[reportOptionalMemberAccess]
        assert np.allclose(base.translation[:2], [70.0, -3.0])


def test_a_damaged_message_of_a_control_is_told_and_ends_nothing(walk: Path) -> None:
    with running(walk) as run:
        replayed(run, walk, images=2)
        kind = "geometry_msgs/PoseWithCovarianceStamped"
        run.transport.say(RawMessage("/initialpose", 0, b"\x00\x01\x00\x00\x05", kind, "cdr", b""))
        run.wait_told("/initialpose: ")
        assert run.error is None


def test_a_snapshot_has_the_image_and_what_was_believed(walk: Path, tmp_path: Path) -> None:
    with running(walk, snapshots=tmp_path) as run:
        run.wait_until_subscribed()
        run.control("/estimate/save_snapshot")
        run.wait_told("expected an estimate to save")
        replayed(run, walk, images=3)
        run.control("/estimate/save_snapshot")
        run.wait_told("snapshot ")
    (file,) = tmp_path.glob("snapshot-*.mcap")
    assert {*Bag(file).topics} == {"/image", "/estimate/pose", "/estimate/modes", "/estimate/particles"}


def test_what_comes_is_recorded_so_that_a_reader_finds_the_same_frames(walk: Path, tmp_path: Path) -> None:
    with running(walk, record=tmp_path / "drive.mcap") as run:
        replayed(run, walk)
        assert (tmp_path / "drive.mcap.incomplete").exists()
        assert not (tmp_path / "drive.mcap").exists()
    assert [file.name for file in tmp_path.iterdir()] == ["drive.mcap"]
    recorded, original = list(SequenceReader(tmp_path / "drive.mcap")), list(SequenceReader(walk))
    assert [frame.time_ns for frame in recorded] == [frame.time_ns for frame in original]
    for one, other in zip(recorded[1:], original[1:], strict=True):
        assert one.odometry is not None
        assert other.odometry is not None
        assert np.array_equal(one.odometry.covariance, other.odometry.covariance)


def test_a_full_disk_ends_the_recording_and_not_the_localization(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("vapor.robot.recorder.Writer.add_message", full)
    with running(walk, record=tmp_path / "drive.mcap") as run:
        replayed(run, walk)
        run.wait_told("No space left on device")
        assert len(run.estimates) == 12
    assert [file.name for file in tmp_path.iterdir()] == ["drive.mcap.incomplete"]


def test_a_recording_is_never_overwritten(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "drive.mcap").write_bytes(b"of yesterday")
    with running(walk, record=tmp_path / "drive.mcap") as run:
        error = run.wait_for_error()
    assert isinstance(error, VaporTrackError)
    assert "exists, expected the name of a new recording" in str(error)
    assert (tmp_path / "drive.mcap").read_bytes() == b"of yesterday"


def test_a_damaged_image_is_counted_and_said_once(walk: Path) -> None:
    raws = messages_of(walk)
    damaged = next(raw for raw in raws if raw.topic == IMAGES)._replace(data=b"\x00\x01\x00\x00\x01")
    with running(walk) as run:
        replayed(run, walk, images=3)
        for _ in range(3):
            run.transport.say(damaged)
        run.wait(lambda: run.session.skipped.get("undecodable image") == 3)
        run.wait_told("undecodable image")
        time.sleep(0.2)
        assert sum("undecodable image" in line for line in run.told) == 1
        assert run.values()["images skipped, undecodable image"] == "3"


def test_a_slow_network_gets_the_newest_image_and_others_later_or_they_are_counted(walk: Path) -> None:
    with running(walk, model=KnowingModel(seconds=0.15)) as run:
        run.wait_until_subscribed()
        for raw in messages_of(walk):
            run.transport.say(raw)
            if raw.topic == IMAGES:
                time.sleep(0.05)
        run.wait(lambda: run.session.localized + sum(run.session.skipped.values()) == 12)
        times = [(each.time_ns - BEGIN_NS) // (NS // 10) for each in run.estimates]
        newest = sorted(set(times))
        assert 3 <= len(newest) <= 9
        assert times == [*newest, *[11] * (len(times) - len(newest))], "late ones come while nothing newer is there"
        assert set(run.session.skipped) == {"a newer image was there"}
        for each in run.estimates:  # the motion over images that were left out is not lost
            assert each.estimate.modes[0].world_from_camera.distance(world_from_camera(each.time_ns))[0] < 0.05


def test_images_in_any_order_give_the_belief_of_those_in_order(walk: Path) -> None:
    raws = [raw for raw in messages_of(walk) if raw.topic != "/ground_truth/pose"]
    images, others = ([raw for raw in raws if (raw.topic == IMAGES) == is_image] for is_image in (True, False))
    beliefs = []
    for order in (range(12), [0, 1, 2, 4, 3, 5, 9, 7, 8, 6, 11, 10]):
        with running(walk, model=KnowingModel(spread_m=0.0)) as run:
            run.wait_until_subscribed()
            for raw in others:
                run.transport.say(raw)
            for number, index in enumerate(order):
                run.transport.say(images[index])
                run.wait_for(number + 1)
            newest = np.maximum.accumulate([*order])
            assert [each.time_ns for each in run.estimates] == [BEGIN_NS + NS // 10 * int(i) for i in newest]
            assert run.session.skipped == {}
            beliefs.append(run.estimates[-1])
            pose = pose_from_message(run.messages("pose")[-1].pose.pose)
            assert stamp(run.messages("pose")[-1].header) == BEGIN_NS + NS // 10 * 11
            assert pose.distance(beliefs[-1].estimate.modes[0].world_from_camera)[0] < 1e-9
    assert_same_belief(*(each.estimate for each in beliefs), rtol=0, atol=1e-9)
    assert beliefs[0].map_from_base.distance(beliefs[1].map_from_base)[0] < 1e-9


def test_an_image_that_is_late_by_more_than_the_window_is_left_out_and_counted(walk: Path) -> None:
    with running(walk, localizer=LocalizerConfig(late_window_s=0.25)) as run:
        images = [raw for raw in messages_of(walk) if raw.topic == IMAGES]
        run.wait_until_subscribed()
        for raw in messages_of(walk):
            if raw.topic not in (IMAGES, "/ground_truth/pose"):
                run.transport.say(raw)
        for number, index in enumerate([0, 1, 4, 6, 5]):
            run.transport.say(images[index])
            run.wait_for(number + 1)
        run.transport.say(images[3])
        run.wait(lambda: run.session.skipped == {"time stamp not increasing": 1})
        assert run.session.localized == 5


def test_a_network_that_hangs_does_not_leave_the_estimate_converged(walk: Path) -> None:
    model = KnowingModel()
    with running(walk, model=model) as run:
        replayed(run, walk, images=5)
        assert run.status().message == "converged"
        model.seconds = 3.0
        late = [raw for raw in messages_of(walk) if raw.log_time_ns > run.estimates[-1].time_ns + NS // 20]
        end_s = time.monotonic() + 1.0
        for raw in late:  # images and odometry go on
            run.transport.say(raw)
            time.sleep(max(0.0, min(0.02, end_s - time.monotonic())))
        run.wait(lambda: run.status().message.startswith("ambiguous"), 2.5)
        assert len(run.estimates) == 5
        model.seconds = 0.0


def test_a_stated_pose_is_of_now_and_not_of_the_last_image(walk: Path, tmp_path: Path) -> None:
    raws = messages_of(Walk(40).write(tmp_path / "long.mcap"))
    with running(walk) as run:
        replayed(run, walk, images=3)
        for raw in raws:  # it drives on, and nobody sees where
            if raw.topic == ODOMETRY and raw.log_time_ns > run.estimates[-1].time_ns:
                run.transport.say(raw)
        last_ns = raws[-1].log_time_ns
        belief: Any = run.session._belief
        reader = belief.reader
        run.wait(lambda: reader.odometry_ns > last_ns - NS // 10)
        base = world_from_base(np.array(reader.odometry_ns))
        numbers = np.array([*base.translation, *base.as_quat_xyzw()])
        told = {"pose": numbers, "covariance": (1e-4 * np.eye(6)).ravel()}
        run.control("/initialpose", "geometry_msgs/PoseWithCovarianceStamped", header={"frame_id": "map"}, pose=told)
        run.wait_told("by /initialpose")
        pose = run.messages("pose")[-1]
        believed = pose_from_message(pose.pose.pose)
        assert float(believed.distance(world_from_camera(stamp(pose.header)))[0]) < 0.05
        run.wait(lambda: len(run.messages("base_pose")) > 0)
        assert reader.frame_ns == reader.odometry_ns


def test_odometry_that_begins_anew_elsewhere_is_not_followed(walk: Path, tmp_path: Path) -> None:
    away = Walk(12)
    away.odometry = [(t, Poses.exp(np.array([40.0, 0, 0, 0, 0, 0])) @ pose) for t, pose in away.odometry]
    elsewhere = messages_of(away.write(tmp_path / "away.mcap"))
    with running(walk) as run:
        replayed(run, walk, images=5)
        time.sleep(0.05)
        number = len(run.messages("base_pose"))
        for raw in elsewhere:
            if raw.topic == ODOMETRY and raw.log_time_ns > run.estimates[-1].time_ns + NS // 10:
                run.transport.say(raw)
                time.sleep(0.005)
        assert len(run.messages("base_pose")) == number


def test_with_simulated_time_messages_before_the_first_clock_wait_and_are_not_lost(walk: Path) -> None:
    with running(walk, sim_time=True) as run:
        run.wait_until_subscribed("/tf_static")
        for raw in [raw for raw in messages_of(walk) if raw.topic == "/tf_static"]:
            run.transport.say(raw)
        run.wait_told("no message on /clock yet")
        sec, nanosec = divmod(BEGIN_NS, NS)
        run.control("/clock", "rosgraph_msgs/Clock", clock={"sec": sec, "nanosec": nanosec})
        replayed(run, walk, images=4, skip=("/ground_truth/pose", "/tf_static"))
        assert stamp(run.messages("diagnostics")[-1].header) == BEGIN_NS


def test_a_clock_that_steps_back_loses_an_instant_and_no_more(walk: Path, tmp_path: Path) -> None:
    def earlier(raw: RawMessage) -> RawMessage:
        sec = int.from_bytes(raw.data[4:8], "little") - 5
        return raw._replace(data=raw.data[:4] + sec.to_bytes(4, "little") + raw.data[8:])

    raws = [raw for raw in messages_of(Walk(40).write(tmp_path / "long.mcap")) if raw.topic in (IMAGES, ODOMETRY)]
    half = raws[len(raws) // 2].log_time_ns
    with running(walk) as run:
        replayed(run, walk, images=2)
        for raw in raws:
            if raw.log_time_ns < BEGIN_NS + NS // 5:
                continue
            run.transport.say(raw if raw.log_time_ns < half else earlier(raw))
            time.sleep(0.004)
        run.wait(lambda: run.estimates[-1].time_ns < half - 2 * NS)
        stamps = [stamp(message.transforms[0].header) for message in run.messages("tf")]
        assert max(stamps) > half - NS // 2
        later = [each for each in run.estimates if each.time_ns < half - 3 * NS]
        assert later[0].frame.odometry is None


def test_what_is_not_there_yet_is_waited_for_and_said(walk: Path) -> None:
    with running(walk) as run:
        run.transport.withdraw(IMAGES)
        run.wait_told("waits: no image topic")
        assert run.status().message.startswith("waits: no image topic")
        assert run.status().level == 3
        run.transport.offer(IMAGES, "sensor_msgs/CompressedImage")
        replayed(run, walk, images=3)


def test_two_cameras_end_it_with_the_option_that_names_one(walk: Path) -> None:
    with running(walk) as run:
        run.transport.offer("/other/image", "sensor_msgs/Image")
        error = run.wait_for_error()
    assert isinstance(error, VaporTrackError)
    assert "2 image topics, expected one; name it by --image-topic" in str(error)


def test_an_error_of_the_callback_comes_out(walk: Path) -> None:
    def fail(_: Any) -> None:
        raise ZeroDivisionError("of the caller")

    with running(walk, on_estimate=fail) as run:
        run.wait_until_subscribed()
        for raw in messages_of(walk):
            run.transport.say(raw)
        assert isinstance(run.wait_for_error(), ZeroDivisionError)


def live_of(walk: Path) -> tuple[LiveSession, Any]:
    transport = offering(messages_of(walk))
    return LiveSession(knowing(KnowingModel()), transport, ReadingOptions(), LiveConfig(), lambda _: None), transport


def test_estimates_come_by_async_for_and_its_end_leaves_the_system(walk: Path) -> None:
    localization, transport = live_of(walk)

    async def talk() -> None:
        while not any(each.topic == IMAGES for each in transport.subscribed):
            await asyncio.sleep(0.01)
        for raw in messages_of(walk):
            transport.say(raw)
            await asyncio.sleep(0.01)

    async def listen() -> list[int]:
        talking, seen = asyncio.create_task(talk()), []
        stream = localization.__aiter__()
        async for estimate in stream:
            seen.append(estimate.time_ns)
            if len(seen) == 3:
                break
        await stream.aclose()
        await talking
        return seen

    seen = asyncio.run(listen())
    assert seen == sorted(set(seen))
    assert transport.is_closed


def test_an_error_comes_out_of_async_for(walk: Path) -> None:
    localization, transport = live_of(walk)
    transport.offer("/other/image", "sensor_msgs/Image")

    async def listen() -> None:
        async for _ in localization:
            pass

    with pytest.raises(VaporTrackError, match="2 image topics"):
        asyncio.run(listen())
    assert transport.is_closed
