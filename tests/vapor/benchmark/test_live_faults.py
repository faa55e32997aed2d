"""What is made of what was heard while a fault happened."""

import numpy as np
import pytest

from sequences.recordings.message_definitions import decoder, encoder
from vapor.benchmark.__main__ import main
from vapor.benchmark.live.faults import changes, status_at, sure_from, sure_since, wrong_for
from vapor.benchmark.live.robot import Robot
from vapor.benchmark.live.traffic import ODOMETRY, Outgoing

STATUSES = [
    (1.0, "ambiguous"),
    (2.0, "ambiguous"),
    (3.0, "converged"),
    (4.0, "lost"),
    (6.0, "converged"),
    (7.0, "converged"),
]


def test_a_status_holds_until_the_next():
    assert [status_at(STATUSES, at_s) for at_s in (0.5, 2.5, 3.0, 5.9, 9.0)] == [
        "none",
        "ambiguous",
        "converged",
        "lost",
        "converged",
    ]


def test_changes_are_said_once():
    assert changes(STATUSES) == [(1.0, "ambiguous"), (3.0, "converged"), (4.0, "lost"), (6.0, "converged")]
    assert changes([]) == []


@pytest.mark.parametrize(
    ("from_s", "end_s", "since"), [(0.0, 3.5, 3.0), (0.0, 5.0, None), (0.0, 9.0, 6.0), (8.0, 9.0, 8.0)]
)
def test_the_filter_is_sure_since_it_remained_converged_to_the_end(from_s, end_s, since):
    assert sure_since(STATUSES, from_s, end_s) == since


def test_recovered_is_what_is_sure_for_a_second():
    flickering = [(1.0, "ambiguous"), (2.0, "converged"), (2.5, "lost"), (4.0, "converged"), (9.0, "ambiguous")]
    assert sure_from(flickering, 0.0, 10.0) == 4.0
    assert sure_from(flickering, 5.0, 10.0) == 5.0
    assert sure_from(flickering, 8.5, 10.0) is None


def test_time_counts_while_what_is_published_is_a_metre_off():
    assert wrong_for([0.0, 0.1, 0.2, 5.0], [0.0, 2.0, 2.0, 3.0]) == pytest.approx(0.1 + 0.2 + 0.2)
    assert wrong_for([], []) == 0.0
    assert wrong_for([0.0, 0.1], [0.9, 0.2]) == 0.0


def odometry(x: float) -> bytes:
    pose = np.array([x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    fields = {"header": {"frame_id": "odom"}, "child_frame_id": "base_link", "pose": {"pose": pose}}
    return encoder("nav_msgs/Odometry")(fields)


def test_a_robot_drops_what_it_is_asked_to_and_sets_its_clock():
    robot = Robot(restarted=False)
    image, moved = Outgoing(0.0, "/camera", b"1234"), Outgoing(0.0, ODOMETRY, odometry(3.0))
    assert robot.alter(image) == (b"1234", 0)
    robot.request("drop /camera\n")
    assert robot.alter(image) is None
    assert robot.alter(moved) is not None
    robot.request("resume\n")
    robot.request("clock -5\n")
    assert robot.alter(image) == (b"1234", -5_000_000_000)


def test_a_robot_that_was_restarted_has_odometry_from_the_identity_on():
    robot = Robot(restarted=True)
    told = [robot.alter(Outgoing(0.0, ODOMETRY, odometry(x))) for x in (3.0, 3.5)]
    positions = [decoder("nav_msgs/Odometry")(each[0]).pose.pose.position.x for each in told if each is not None]
    assert positions == [0.0, 0.5]


def test_a_fault_that_is_not_known_is_refused(capsys):
    with pytest.raises(SystemExit):
        main(["live-faults", "--model", "staircase", "--sequence", "x.mcap", "--faults", "fire"])
    assert "fault 'fire' is not known, expected some of none, killed" in capsys.readouterr().err
