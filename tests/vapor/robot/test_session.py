"""Live localization of a walk in a made-up system: what is published, and from Python."""

import asyncio
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.storeys import Storeys
from sequences.options import ReadingOptions
from sequences.recordings.messages import pose_from_message, pose_from_transform
from tests.helpers.fake_transport import messages_of, offering
from tests.helpers.live_session import ELSEWHERE, KnowingModel, hurry, knowing, replayed, running
from tests.helpers.live_system import stamp
from tests.helpers.sequence_files import BEGIN_NS, IMAGES, ODOMETRY, world_from_base, world_from_camera
from vapor.robot.config import LiveConfig
from vapor.robot.session import LiveSession

NS = 1_000_000_000


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    hurry(monkeypatch)


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


def test_with_a_lag_each_pose_comes_again_with_the_stamp_of_its_image(walk: Path) -> None:
    with running(walk, lag=0.5) as run:
        replayed(run, walk)
        run.wait(lambda: len(run.messages("fixed_lag")) >= 7)
        lagged = run.messages("fixed_lag")
        assert [stamp(each.header) for each in lagged] == [BEGIN_NS + NS // 10 * i for i in range(7)]
        for each in lagged:
            metres, _ = pose_from_message(each.pose.pose).distance(world_from_camera(stamp(each.header)))
            assert metres < 0.05


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
