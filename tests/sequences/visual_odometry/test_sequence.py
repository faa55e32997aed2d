"""Frames of a sequence with odometry from its images."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.frame import Camera, Frame
from sequences.reading.counts import BETWEEN, ImageCounts
from sequences.visual_odometry.sequence import VisualSequence
from tests.helpers.boards import CAMERA, STEP_NS, images_of, walk
from tests.helpers.simulation import motion

IMAGES = images_of(walk("sideways", 30))


class Frames:
    """A sequence in memory."""

    def __init__(self, frames, camera=CAMERA):
        self.frames, self.path, self.camera = frames, Path("memory"), camera
        self.num_images, self.odometry_origin, self.no_odometry = len(frames), None, ""
        self.image_description = self.odometry_description = None
        self.notices, self.resolved = ["a notice"], {}
        self.counts = ImageCounts(len(frames), len(frames), len(frames))

    @property
    def skipped(self):
        return self.counts.skipped

    def __iter__(self):
        return iter(self.frames)


def frames_of(images=IMAGES, *, camera=CAMERA, odometry=None):
    return [Frame(STEP_NS * i, image, odometry if i else None, None, camera) for i, image in enumerate(images)]


def test_every_frame_but_the_first_has_the_motion_since_the_one_before():
    sequence = VisualSequence(Frames(frames_of()), CAMERA)
    found = list(sequence)
    assert [each.odometry is None for each in found] == [True] + [False] * 30
    assert all(each.odometry.duration_s == pytest.approx(STEP_NS * 1e-9) for each in found[1:])
    assert (sequence.odometry_origin, sequence.odometry_description) == ("visual", "visual")
    assert sequence.notices == ["a notice"]
    again = [each.odometry.previous_from_current.translation for each in list(sequence)[1:]]
    np.testing.assert_array_equal(again, [each.odometry.previous_from_current.translation for each in found[1:]])


@pytest.mark.parametrize(("most_hz", "number"), [(10.0, 11), (15.0, 16), (20.0, 21), (31.0, 31)])
def test_images_between_those_asked_for_show_the_motion(most_hz, number):
    every = list(VisualSequence(Frames(frames_of()), CAMERA))
    some = VisualSequence(Frames(frames_of()), CAMERA, most_hz=most_hz)
    found = list(some)
    assert len(found) == number
    counts = some.counts
    assert (counts.used, counts.skipped) == (number, +Counter({BETWEEN: 31 - number}))
    assert counts.are_complete
    assert counts.warning is None
    assert some.skipped == counts.skipped
    whole = Poses.identity()
    for each in every[1:]:
        whole = whole @ each.odometry.previous_from_current
    parts = Poses.identity()
    for each in found[1:]:
        parts = parts @ each.odometry.previous_from_current
    np.testing.assert_allclose(parts.translation, whole.translation, atol=0.05 * np.linalg.norm(whole.translation))


def test_a_motion_with_an_unknown_part_is_unknown_and_is_said():
    images = [*IMAGES[:10], np.full_like(IMAGES[0], 200), *IMAGES[10:]]
    sequence = VisualSequence(Frames(frames_of(images)), CAMERA, most_hz=10.0)
    assert [i for i, each in enumerate(sequence) if each.odometry is None] == [0, 3, 4]
    assert "before 2 images the images do not say how the camera moved" in sequence.notices[-1]


def test_images_without_intrinsics_are_taken_for_those_of_the_stated_camera():
    frames = [replace(each, camera=None) for each in frames_of(IMAGES[:5])]
    larger = Camera(640, 480, 520.0, 520.0, 319.5, 239.5)
    assert [each.odometry is None for each in VisualSequence(Frames(frames, None), larger)] == [True] + [False] * 4


def test_beside_recorded_odometry_both_make_the_motion():
    recorded = motion(0.015, 0, 0, 0, 0, 0, duration_s=STEP_NS * 1e-9)
    sequence = VisualSequence(Frames(frames_of(odometry=recorded)), CAMERA, beside=True)
    found = list(sequence)
    assert sequence.odometry_description == "recorded, and visual"
    real = walk("sideways", 30)
    turned = [
        np.linalg.norm(each.odometry.previous_from_current.between(real[i].inverse() @ real[i + 1]).log()[3:])
        for i, each in enumerate(found[1:])
    ]
    assert np.mean(turned) < 0.002  # which the recorded odometry lacks


def test_images_of_other_cameras_are_taken_along_the_motion_of_the_first():
    alone = list(VisualSequence(Frames(frames_of()), CAMERA))
    mount = Poses.exp(np.array([0.1, 0, 0, 0, 1.5, 0]))
    frames = []
    for frame in frames_of():
        frames.append(replace(frame, camera_name="front"))
        later = replace(frame, time_ns=frame.time_ns + STEP_NS // 3, camera_name="side", reference_from_camera=mount)
        frames.append(replace(later, image=np.zeros_like(frame.image)))
    found = list(VisualSequence(Frames(frames), CAMERA))
    assert [each.time_ns for each in found] == [each.time_ns for each in frames]
    assert [each.camera_name for each in found] == ["front", "side"] * 31
    front = [each for each in found if each.camera_name == "front"]
    for number, (one, other) in enumerate(zip(front[1:], alone[1:], strict=True), start=1):
        side = found[2 * number - 1].odometry
        assert side is not None
        assert side.duration_s == pytest.approx(STEP_NS / 3e9, rel=1e-6)
        whole = side.then(one.odometry)
        np.testing.assert_allclose(
            whole.previous_from_current.as_matrix(), other.odometry.previous_from_current.as_matrix(), atol=1e-9
        )
    assert found[0].odometry is None
    assert found[-1].odometry is None  # nothing shows the motion after the last image of the first camera
    some = list(VisualSequence(Frames(frames), CAMERA, most_hz=10.0))
    assert Counter(each.camera_name for each in some) == Counter(front=11, side=11)


def test_other_cameras_do_not_wait_for_one_that_fell_silent():
    mount, still = Poses.exp(np.array([0.1, 0, 0, 0, 1.5, 0])), motion(0.01, 0, 0, 0, 0, 0, duration_s=STEP_NS * 1e-9)
    frames = [replace(frame, camera_name="front") for frame in frames_of(IMAGES[:3], odometry=still)]
    dark = np.zeros_like(IMAGES[0])
    for i in range(3, 200):
        frames.append(Frame(STEP_NS * i, dark, still, None, CAMERA, camera_name="side", reference_from_camera=mount))
    waited, most = 0, 0

    class Counted(Frames):
        def __iter__(self):
            nonlocal waited, most
            for frame in self.frames:
                waited += 1
                most = max(most, waited)
                yield frame

    for beside in (False, True):
        waited = most = 0
        found, waits = [], []
        for frame in VisualSequence(Counted(frames), CAMERA, beside=beside):
            waits.append(waited)
            waited = 0
            found.append(frame)
        assert most * STEP_NS * 1e-9 < 1.2
        assert waits[100:] == [1] * 100  # once it is silent, each comes at once
        assert len(found) == 200
        known = sum(frame.odometry is not None for frame in found)
        assert known > 150 if beside else known < 5
