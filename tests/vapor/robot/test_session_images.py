"""Images that come slowly, late or in any order, odometry that begins anew, and clocks."""

import time
from pathlib import Path

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.se3 import Poses
from sequences.recordings.messages import pose_from_message
from sequences.recordings.source import RawMessage
from tests.helpers.fake_transport import messages_of
from tests.helpers.live_session import KnowingModel, hurry, replayed, running
from tests.helpers.live_system import stamp
from tests.helpers.sequence_files import BEGIN_NS, IMAGES, ODOMETRY, Walk, world_from_camera
from tests.helpers.simulation import assert_same_belief

NS = 1_000_000_000


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    hurry(monkeypatch)


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
