import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from filtering.novelty import ViewMeter
from filtering.se3 import Poses


def forward(lengths):
    return Poses.exp(np.array([0.5 * lengths, 0, 0, 0, 0, 0]))


def turned(lengths):
    return Poses.exp(np.array([0, 0, 0, 0, 0, 0.4 * lengths]))


def walked(meter, steps):
    """What is told along steps (poses), an image after each: all that was new, and the way."""
    new, way = 0.0, 0.0
    for step in steps:
        meter, came = meter.moved(step)
        meter, looked = meter.looked()
        new, way = new + looked, way + came
    return meter, new, way


METER = ViewMeter(length_m=0.5, length_rad=0.4)


@pytest.mark.parametrize("images_per_length", [1, 1.5, 3, 10, 100])
@pytest.mark.parametrize("one", [forward, turned])
def test_a_way_is_worth_as_many_images_as_it_has_lengths_whatever_the_rate(images_per_length, one):
    count = int(6 * images_per_length)
    _, new, way = walked(METER, [one(1.0 / images_per_length)] * count)
    assert way == pytest.approx(6.0)
    assert new == pytest.approx(6.0)


def test_one_image_is_worth_one_image_however_far_the_way_to_it():
    meter, way = METER.moved(forward(7.0))
    assert way == pytest.approx(7.0)
    assert meter.looked()[1] == 1.0


@settings(max_examples=50)
@given(parts=st.lists(st.floats(0.001, 2.0), min_size=1, max_size=30))
def test_a_straight_way_in_any_parts_is_as_long_as_it_is(parts):
    _, new, way = walked(METER, [forward(part) for part in parts])
    assert way == pytest.approx(sum(parts))
    assert new <= way * (1 + 1e-9)


@pytest.mark.parametrize("one", [forward, turned])
def test_standing_and_trembling_are_worth_nothing(one):
    rng = np.random.default_rng(0)
    where = 0.04 * rng.uniform(-1, 1, 2001)
    meter, first, _ = walked(METER, [one(where[0])])
    _, new, way = walked(meter, [one(step) for step in np.diff(where)])
    assert np.abs(np.diff(where)).sum() > 20.0  # precondition: counted along the way, it would be far
    assert first + new < 0.05
    assert way < 0.1


def test_pacing_up_and_down_shows_nothing_new_though_the_camera_comes_far():
    up, down = [forward(0.1)] * 30, [forward(-0.1)] * 30
    meter, new, _ = walked(METER, up)
    assert new == pytest.approx(3.0)
    for _ in range(5):
        meter, again, way = walked(meter, down + up)
        assert again < 0.7  # between the views remembered
        assert way == pytest.approx(6.0)
    _, again, _ = walked(meter, down + up)
    assert again == pytest.approx(0.0, abs=1e-9)


def test_a_turn_and_a_motion_add_up_like_the_sides_of_a_right_angle():
    meter, way = METER.moved(Poses.exp(np.array([0.0, 0, 0.3, 0, 0, 0.4 * 0.8])))
    assert way == pytest.approx(1.0, rel=0.01)  # √(0.6² + 0.8²), but for the curve
    assert meter.looked()[1] == pytest.approx(1.0, rel=0.01)


def test_without_odometry_a_view_is_as_new_as_the_camera_may_have_come():
    meter, way = METER.across_gap(0.1, 0.04)
    assert way == pytest.approx(np.hypot(0.2, 0.1))
    assert meter.looked()[1] == pytest.approx(way)
    far, _ = METER.across_gap(50.0, 4.0)
    far, new = far.looked()
    assert new == 1.0
    assert len(far.views) == 1  # what lies before a gap is nowhere in particular
    assert far.looked()[1] == 0.0


def test_a_view_is_forgotten_after_sixty_others():
    meter, _, _ = walked(METER, [forward(1.001)] * 100)
    assert len(meter.views) == 60
    meter, _ = meter.moved(forward(-100.1))
    assert meter.looked()[1] == 1.0


def test_looking_changes_no_meter_but_gives_another():
    meter, _ = METER.moved(forward(0.5))
    assert meter.looked()[1] == meter.looked()[1] == pytest.approx(0.5)
    assert METER.looked()[1] == 0.0
