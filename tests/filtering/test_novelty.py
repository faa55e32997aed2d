import numpy as np
import pytest

from filtering.novelty import NoveltyTracker
from filtering.se3 import Poses


def forward(lengths):
    return Poses.exp(np.array([0.5 * lengths, 0, 0, 0, 0, 0]))


def turned(lengths):
    return Poses.exp(np.array([0, 0, 0, 0, 0, 0.4 * lengths]))


def walked(tracker, steps):
    """What is told along steps (poses), an image after each: all that was new, and the distance."""
    new, distance = 0.0, 0.0
    for step in steps:
        tracker, came = tracker.predict(step)
        tracker, seen = tracker.observe()
        new, distance = new + seen, distance + came
    return tracker, new, distance


TRACKER = NoveltyTracker(length_m=0.5, length_rad=0.4)


@pytest.mark.parametrize("images_per_length", [1, 1.5, 3, 10, 100])
@pytest.mark.parametrize("one", [forward, turned])
def test_a_way_is_worth_as_many_images_as_it_has_lengths_whatever_the_rate(images_per_length, one):
    count = int(6 * images_per_length)
    _, new, distance = walked(TRACKER, [one(1.0 / images_per_length)] * count)
    assert distance == pytest.approx(6.0)
    assert new == pytest.approx(6.0)


@pytest.mark.parametrize("one", [forward, turned])
def test_standing_and_trembling_are_worth_nothing(one):
    rng = np.random.default_rng(0)
    where = 0.04 * rng.uniform(-1, 1, 2001)
    tracker, first, _ = walked(TRACKER, [one(where[0])])
    _, new, distance = walked(tracker, [one(step) for step in np.diff(where)])
    assert np.abs(np.diff(where)).sum() > 20.0  # precondition: counted along the distance, it would be far
    assert first + new < 0.05
    assert distance < 0.1


def test_pacing_up_and_down_shows_nothing_new_though_the_camera_comes_far():
    up, down = [forward(0.1)] * 30, [forward(-0.1)] * 30
    tracker, new, _ = walked(TRACKER, up)
    assert new == pytest.approx(3.0)
    for _ in range(5):
        tracker, again, distance = walked(tracker, down + up)
        assert again < 0.7  # between the views remembered
        assert distance == pytest.approx(6.0)
    _, again, _ = walked(tracker, down + up)
    assert again == pytest.approx(0.0, abs=1e-9)


def test_without_odometry_a_view_is_as_new_as_the_camera_may_have_come():
    tracker, distance = TRACKER.after_unknown(0.1, 0.04)
    assert distance == pytest.approx(np.hypot(0.2, 0.1))
    assert tracker.observe()[1] == pytest.approx(distance)
    far, _ = TRACKER.after_unknown(50.0, 4.0)
    far, new = far.observe()
    assert new == 1.0
    assert len(far.views) == 1  # what lies before a gap is nowhere in particular
    assert far.observe()[1] == 0.0


def test_a_view_is_forgotten_after_sixty_others():
    tracker, _, _ = walked(TRACKER, [forward(1.001)] * 100)
    assert len(tracker.views) == 60
    tracker, _ = tracker.predict(forward(-100.1))
    assert tracker.observe()[1] == 1.0
