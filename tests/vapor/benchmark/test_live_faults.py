"""What is made of what was heard while a fault happened."""

import pytest

from sequences.recordings.message_definitions import encoder
from vapor.benchmark.__main__ import main
from vapor.benchmark.live.faults import changes, status_at, sure_from, sure_since, wrong_for
from vapor.benchmark.live.robot import NO_ORDER, Order
from vapor.benchmark.live.traffic import stamp_of, with_stamp

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


def test_a_robot_leaves_out_a_topic_and_sets_its_clock():
    message = encoder("geometry_msgs/PoseStamped")({"header": {"frame_id": "map"}})
    message = with_stamp(message, 9_000_000_000)
    assert NO_ORDER.altered("/camera", message) == message
    dropping = Order(dropped="/camera")
    assert dropping.altered("/camera", message) is None
    assert dropping.altered("/odom", message) == message
    late = Order(clock_s=-5.0).altered("/camera", message)
    assert late is not None
    assert stamp_of(late) == 4_000_000_000


def test_a_fault_that_is_not_known_is_refused(capsys):
    with pytest.raises(SystemExit):
        main(["live-faults", "--model", "staircase", "--sequence", "x.mcap", "--faults", "fire"])
    assert "unknown fault 'fire', expected one of none, killed" in capsys.readouterr().err
