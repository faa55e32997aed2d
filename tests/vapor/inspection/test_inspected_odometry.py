"""Odometry and clocks inspected: figures against what is known of simulated recordings."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.odometry import OdometryNoise, simulate_odometry
from sequences.scenes.staircase import walk_stairs
from sequences.trajectories.interpolation import interpolate
from sequences.writer import SequenceWriter
from tests.helpers.corridors import recorded
from tests.helpers.full import some
from tests.helpers.inspected import BEGIN_NS, CAMERA, LEVEL, SECOND, panorama, scenery, write
from vapor.commands.inspect import parts
from vapor.inspection.inspect import inspect
from vapor.inspection.odometry import OdometryCheck, check_odometry
from vapor.inspection.verdict import verdict

pytestmark = pytest.mark.usefixtures("no_camera")

AS_THEY_ARE = np.eye(3)


def compared(
    *,
    scale: float = 0.0,
    late_s: float = 0.0,
    axes: np.ndarray = AS_THEY_ARE,
    unit_m: float = 1.0,
    seconds: float = 30.0,
) -> OdometryCheck:
    """Odometry of a simulated walk of stairs at ten images a second, wrong as asked for, against its true poses."""
    rng = np.random.default_rng(3)
    path = walk_stairs(seconds + 2.0, rng=rng)
    path_ns = BEGIN_NS + np.arange(len(path)) * (SECOND // 50)
    noise = OdometryNoise(fixed_scale=scale, translation_bias_m_per_s=0.001, heading_bias_rad_per_s=0.0002)
    odometry, covariances = simulate_odometry(path_ns, path, noise, rng=rng)
    times_ns = BEGIN_NS + SECOND + np.arange(int(10 * seconds)) * (SECOND // 10)
    truth, _ = interpolate(path_ns, path, times_ns, max_gap_s=1.0)
    reported, _ = interpolate(path_ns, odometry, times_ns - round(late_s * SECOND), max_gap_s=1.0)
    reported = Poses(axes.T @ reported.rotation @ axes, reported.translation @ axes / unit_m)
    steps = [None]
    for i in range(1, len(times_ns)):
        steps.append(Odometry(reported[i - 1].inverse() @ reported[i], 0.1 * covariances[1] * 0.1, 0.1))
    images = replace(recorded(truth), times_ns=times_ns, odometry=tuple(steps))
    found = check_odometry(images)
    assert found is not None
    return found


# --- odometry ------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked", "no_odometry_fit")
@pytest.mark.parametrize("late_s", [0.041, -0.12])
def test_odometry_that_is_late_is_said_to_be_by_as_many_milliseconds(late_s):
    found = compared(late_s=late_s, seconds=60.0)
    assert found.typical_late_ms == pytest.approx(1e3 * late_s, abs=8.0)
    assert found.axes is not None
    assert not found.axes.is_turned


@pytest.mark.usefixtures("unchecked")
def test_a_scale_error_of_three_percent_is_found():
    found = compared(scale=0.03)
    assert found.fit is not None
    assert found.fit.scale == pytest.approx(0.03, abs=0.008)
    assert found.axes is not None
    assert found.axes.correlation > 0.95
    assert not any((found.axes.is_turned, found.axes.is_mirrored, found.axes.is_unlike))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("degrees", [25.0, 90.0])
def test_a_camera_turned_on_its_base_is_named_and_put_right_before_errors_are_fitted(degrees):
    turn = Poses.exp(np.array([0.0, 0.0, 0.0, 0.0, np.radians(degrees), 0.0])).rotation
    found = compared(axes=turn, scale=0.03)
    assert found.axes is not None
    assert found.axes.is_turned
    np.testing.assert_allclose(np.degrees(found.axes.rotvec), [0.0, degrees, 0.0], atol=2.0)
    (said,) = [sentence for sentence in verdict([], None, found, [], None).points if "extrinsics" in sentence]
    assert re.search(r"turned by \d+° about \(-?0\.0, 1\.0, -?0\.0\)", said)
    assert found.fit is not None
    assert found.fit.scale == pytest.approx(0.03, abs=0.008)


@pytest.mark.usefixtures("unchecked", "no_odometry_fit")
@pytest.mark.parametrize("across", [(1, -1, 1), (-1, 1, 1)])
def test_a_left_handed_frame_is_named_and_no_turn(across):
    found = compared(axes=np.diag(np.array(across, float)))
    assert found.axes is not None
    assert not any((found.axes.is_turned, found.axes.is_unlike))
    assert any("left-handed" in sentence for sentence in verdict([], None, found, [], None).points)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("unit_m", "unit"), [(1e-3, "millimetres"), (1e3, "millimetres"), (0.3048, "feet"), (1 / 7.3, "another unit")]
)
def test_another_unit_is_named_and_put_right_before_errors_are_fitted(unit_m, unit):
    found = compared(unit_m=unit_m)
    sentences = verdict([], None, found, [], None).points
    (said,) = [sentence for sentence in sentences if sentence.startswith("check units: odometry is ")]
    assert float(said.split()[4]) == pytest.approx(1 / unit_m, rel=0.03)
    assert said.endswith(f" in {unit} instead of metres")
    assert not any("check the scale" in sentence for sentence in sentences)
    assert found.fit is not None
    assert abs(found.fit.scale) < 0.02


# --- clocks --------------------------------------------------------------------------------------------


def clocked(path: Path, *, seconds: float = 30.0, image: Callable[[Poses], np.ndarray] = panorama, **late_s: float):
    """A walk of stairs: images and true poses at 10 Hz, odometry at 50, each by a clock of its own."""
    rng = np.random.default_rng(3)
    walk = walk_stairs(seconds, rng=rng)
    times_ns = BEGIN_NS + np.arange(len(walk)) * (SECOND // 50)
    odometry, covariances = simulate_odometry(times_ns, walk, OdometryNoise(), rng=rng)
    base_from_camera = Poses(LEVEL, np.zeros(3))
    with SequenceWriter(path, camera=CAMERA, base_from_camera=base_from_camera, metadata={}) as writer:

        def write_image(time_ns: int, i: int) -> None:
            writer.write_image(time_ns, image(walk[i] @ base_from_camera))

        def write_odometry(time_ns: int, i: int) -> None:
            writer.write_odometry(time_ns, odometry[i], covariances[i])

        def write_pose(time_ns: int, i: int) -> None:
            writer.write_true_pose(time_ns, walk[i] @ base_from_camera)

        every = {"odometry": (1, write_odometry), "poses": (5, write_pose), "images": (5, write_image)}
        due = [
            (int(times_ns[i]) + round(late_s.get(what, 0.0) * SECOND), i, tell)
            for what, (step, tell) in every.items()
            for i in range(0, len(walk), step)
        ]
        for time_ns, i, tell in sorted(due, key=lambda each: each[:2]):
            tell(time_ns, i)
    return path


@pytest.mark.usefixtures("unchecked", "no_odometry_fit")
@pytest.mark.parametrize(
    ("late_s", "odometry_ms", "images_ms"),
    some(
        1,
        [
            ({"poses": 0.5, "images": 0.5}, -500.0, 500.0),
            ({}, 0.0, 0.0),
            ({"images": -1.5}, 0.0, -1500.0),
            ({"images": 0.5}, 0.0, 500.0),
            ({"odometry": 0.5}, 500.0, -500.0),
            ({"poses": 0.5}, -500.0, 0.0),
        ],
    ),
)
def test_a_clock_that_is_off_is_found_and_named(late_s, odometry_ms, images_ms, tmp_path):
    found = inspect([clocked(tmp_path / "w.mcap", **late_s)])
    (clock,) = found.clocks
    assert clock.against == "odometry"
    assert clock.late_ms == pytest.approx(images_ms, abs=10.0)
    assert found.odometry is not None
    assert found.odometry.typical_late_ms == pytest.approx(odometry_ms, abs=8.0)
    lines = " ".join(map(str, dict(parts(found))["Odometry"]))
    assert re.search(rf"odometry's stamps against the true poses: {SAID[np.sign(odometry_ms)]} \(w\.mcap\)", lines)
    images = rf"images, by the motion that they show: {SAID[np.sign(images_ms)]} against the odometry \(w\.mcap\)"
    assert re.search(images, lines)
    said = [sentence for sentence in found.verdict.points if " against the " in sentence]
    assert len(said) == (odometry_ms != 0) + (images_ms != 0)
    if odometry_ms:
        assert re.match(rf"odometry is {OFF[odometry_ms > 0]} against the true poses", said[0])
    if images_ms:
        assert re.match(rf"the images of w\.mcap are {OFF[images_ms > 0]} against the odometry", said[-1])


OFF = (r"\d+ ms early", r"\d+ ms late")
SAID = {-1.0: r"\d{3,4} ms early", 0.0: r"(?:\d ms (?:early|late)|on time)", 1.0: r"\d{3,4} ms late"}


@pytest.mark.usefixtures("unchecked", "no_odometry_fit")
def test_images_whose_view_does_not_shift_as_the_camera_turns_tell_no_clock(tmp_path):
    found = inspect([clocked(tmp_path / "w.mcap", image=lambda _: scenery(0), images=0.5)])
    assert [clock.late_ms for clock in found.clocks] == [None]
    assert not any("against" in sentence for sentence in found.verdict.points)
    assert found.verdict.points[1].startswith("w.mcap: images do not move like true poses and odometry, ")


@pytest.mark.usefixtures("unchecked", "no_odometry_fit")
@pytest.mark.parametrize("seconds", [6.0, 9.0, 12.0])
def test_few_pairs_of_images_tell_a_clock_or_nothing_and_no_warning(seconds, tmp_path):
    found = inspect([clocked(tmp_path / "w.mcap", seconds=seconds, images=-0.4)])
    (clock,) = found.clocks
    assert clock.late_ms is None or clock.late_ms == pytest.approx(-400.0, abs=20.0)


@pytest.mark.usefixtures("unchecked", "no_odometry_fit")
def test_half_a_period_late_and_upside_down_are_both_named_of_a_camera_that_pans_to_and_fro(tmp_path):
    turns = 0.6 * np.sin(np.arange(300) * 0.1 * np.pi / 2)  # 4 s
    path = Poses.exp(turns[:, None] * np.eye(6)[5]) @ Poses(LEVEL, np.zeros(3))
    late = inspect([write(tmp_path / "w.mcap", path, image=lambda i: panorama(path[max(i - 20, 0)]))])
    assert re.match(r"the images of w\.mcap are \d+ ms (late|early) against the odometry", late.verdict.points[0])
    assert "the images are upside down" in late.verdict.points[1]
