"""Cameras that zoom or change their mode midway: each image has the intrinsics that were in force."""

from dataclasses import replace
from pathlib import Path

import pytest

from sequences.reader import SequenceReader
from tests.helpers.sequence_files import BEGIN_NS, CAMERA
from tests.helpers.tf_files import MS, camera_infos, images, mounted, odometry, record, stamps

ZOOMED = replace(CAMERA, fx=2 * CAMERA.fx, fy=2 * CAMERA.fy)
STAMPS_NS = [BEGIN_NS + 100 * MS * i for i in range(12)]


@pytest.mark.parametrize("late_ms", [0, 250, -250])
def test_each_image_has_the_intrinsics_of_its_stamp_however_late_they_are_logged(late_ms: int, tmp_path: Path) -> None:
    infos = camera_infos((t, ZOOMED if 5 <= i < 9 else CAMERA) for i, t in enumerate(STAMPS_NS))
    infos = [event._replace(time_ns=event.time_ns + late_ms * MS) for event in infos]
    reader = SequenceReader(record(tmp_path / "a.mcap", images(), mounted(), odometry(stamps()), infos))
    assert [frame.camera for frame in reader] == [CAMERA] * 5 + [ZOOMED] * 4 + [CAMERA] * 3


def test_intrinsics_that_come_only_when_they_change_hold_until_the_next(tmp_path: Path) -> None:
    infos = camera_infos([(STAMPS_NS[0] - 10 * MS, CAMERA), (STAMPS_NS[7], ZOOMED)])
    reader = SequenceReader(record(tmp_path / "a.mcap", images(), mounted(), odometry(stamps()), infos))
    assert [frame.camera for frame in reader] == [CAMERA] * 7 + [ZOOMED] * 5
