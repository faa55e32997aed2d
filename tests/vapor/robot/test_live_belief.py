"""The belief about a robot that is followed live: which images landmarks are looked for in."""

from types import SimpleNamespace

import numpy as np
import pytest

from filtering.measurement_noise import MeasurementNoise
from filtering.motion import Odometry
from filtering.se3 import Poses
from tests.helpers.simulation import seen_at
from vapor.robot import belief as live_belief
from vapor.robot.belief import LiveBelief


@pytest.fixture
def clock(monkeypatch):
    """Seconds that a test sets."""
    now = SimpleNamespace(s=100.0)
    monkeypatch.setattr(live_belief.time, "monotonic", lambda: now.s)
    return now


@pytest.fixture
def belief(unchecked):
    """One whose network is asked nothing, of a map whose views are new after half a metre."""
    noise = MeasurementNoise(verified=MeasurementNoise(length_m=0.5, length_rad=0.5))
    description = SimpleNamespace(calibration=SimpleNamespace(errors=noise))
    model = SimpleNamespace(description=description, verifier="some", verifies=None)
    localizer = SimpleNamespace(observe=lambda image, camera: seen_at(Poses.identity(1)), forget=lambda: None)
    belief = LiveBelief(localizer, model, FRAMES, 0.0, None)
    belief.anchor = anchor_of("converged", 1.0)
    return belief


def anchor_of(status, agreement):
    return SimpleNamespace(estimate=SimpleNamespace(status=status, agreement=agreement))


FRAMES = SimpleNamespace(reader=SimpleNamespace(odometry_ns=None, frame_ns=None))


def seen(belief, metres, camera=""):
    """Whether an image so far from the one before has places, and landmarks are looked for; None: not known how far."""
    step = None if metres is None else Poses.exp(np.array([metres, 0.0, 0.0, 0.0, 0.0, 0.0]))
    motion = None if step is None else Odometry(step, 1e-6 * np.eye(6), 0.03)
    posterior = belief.observe(SimpleNamespace(camera=None, image=None, odometry=motion, time_ns=0, camera_name=camera))
    assert belief._model.verifies != posterior.is_uninformative
    return not posterior.is_uninformative


def test_landmarks_are_looked_for_once_in_a_tenth_of_a_view(belief, clock):
    assert [seen(belief, metres) for metres in (None, 0.02, 0.02, 0.02, 0.02, 0.1)] == [
        True, False, False, True, False, True,
    ]  # fmt: skip


def test_landmarks_are_looked_for_in_each_camera_once_in_a_tenth_of_a_view(belief, clock):
    looked = [
        seen(belief, metres, name) for metres in (0.0, 0.03, 0.03) for name, metres in (("a", metres), ("b", 0.0))
    ]
    assert looked == [True, True, False, False, True, True]


def test_landmarks_are_looked_for_once_a_second_while_the_robot_stands(belief, clock):
    found = []
    for _ in range(90):
        found.append(seen(belief, 0.0))
        clock.s += 1.0 / 30.0
    assert sum(found) == 3


def test_the_motion_to_a_late_image_is_not_counted_twice(belief, clock):
    assert [seen(belief, metres) for metres in (None, 0.03)] == [True, False]
    belief.reader = SimpleNamespace(odometry_ns=None, frame_ns=1)  # which is newer than the next
    assert not seen(belief, 0.03)


def test_landmarks_are_looked_for_where_the_motion_is_unknown_and_after_the_belief_was_forgotten(belief, clock):
    assert [seen(belief, None), seen(belief, 0.0), seen(belief, None)] == [True, False, True]
    belief.forget()
    assert seen(belief, 0.0)


def test_without_a_map_or_before_the_first_estimate_every_image_has_its_places(belief, clock):
    belief.anchor = None
    assert all(seen(belief, 0.0) for _ in range(5))
    belief.anchor, belief._model.verifier = anchor_of("converged", 1.0), None
    assert all(seen(belief, 0.0) for _ in range(5))


@pytest.mark.parametrize(("status", "agreement"), [("ambiguous", 1.0), ("lost", 0.0), ("converged", 0.8)])
def test_every_image_has_its_places_where_the_belief_is_not_sure_or_images_do_not_fit_it(
    status, agreement, belief, clock
):
    belief.anchor = anchor_of(status, agreement)
    assert all(seen(belief, 0.0) for _ in range(5))
