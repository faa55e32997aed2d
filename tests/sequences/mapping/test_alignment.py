"""The unit of a model and its axes."""

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.mapping.alignment import find_scale, require_moments, upright
from sequences.mapping.config import MapConfig, Moment
from tests.helpers.mapped_walks import placed_at, straight, walk_of

UNIT_M = 0.37


def scale_by(motion, recorded: Poses, count: int = 80):
    walk = walk_of("robot", count, motion=motion, recorded=recorded)
    return find_scale([walk], placed_at(walk, straight(count), UNIT_M), MapConfig(), depth=8.0)


def test_recorded_poses_of_any_frame_give_the_unit():
    elsewhere = Poses.exp(np.array([5.0, 2.0, 1.0, 0.3, -2.0, 0.4]))
    scale = scale_by("poses", elsewhere @ straight(80))
    assert scale.factor == pytest.approx(UNIT_M, rel=1e-6)
    assert scale.source == "recorded poses of robot"
    assert scale.spread == pytest.approx(0.0, abs=1e-6)


def test_odometry_that_drifts_gives_the_unit_by_short_ways():
    true, rng = straight(200), np.random.default_rng(0)
    pose, drifted = Poses.identity(), [Poses.identity()]
    for number in range(1, 200):
        turn = Poses.exp(np.array([*rng.normal(0, 0.005, 3), 0, 0, 0.01]))  # two degrees a metre
        pose = pose @ (true[number - 1].inverse() @ true[number]) @ turn
        drifted.append(pose)
    assert np.linalg.norm(drifted[-1].translation - true[199].translation) > 20.0
    scale = scale_by("odometry", Poses.stack(drifted), 200)
    assert scale.factor == pytest.approx(UNIT_M, rel=0.02)
    assert scale.spread is not None
    assert scale.spread < 0.02


def test_a_robot_that_stood_gives_no_unit():
    still = straight(1)[[0] * 80]
    assert scale_by("odometry", still).source == ""


def test_without_any_motion_what_is_seen_is_three_units_away():
    walk = walk_of("phone", 80)
    scale = find_scale([walk], placed_at(walk, straight(80)), MapConfig(), depth=12.0)
    assert (scale.factor, scale.source) == (0.25, "")


def by_distance(distance_m: float, *between: str, walks=None, lost=()):
    walks = walks or [walk_of("phone", 41)]
    placed = {}
    for walk in walks:
        placed |= placed_at(walk, straight(len(walk.pictures)), UNIT_M)
    kept = {name: pose for name, pose in placed.items() if name not in lost}
    config = MapConfig(distance_m=distance_m, between=between or ("start", "end"))  # pyright: ignore[reportArgumentType]
    return find_scale(walks, kept, config, depth=1.0)


def test_a_measured_distance_between_two_moments_gives_the_unit():
    positions = straight(41).translation
    whole = float(np.linalg.norm(positions[40] - positions[0]))
    assert by_distance(whole).factor == pytest.approx(UNIT_M)
    part = float(np.linalg.norm(0.5 * (positions[21] + positions[22]) - positions[4]))
    scale = by_distance(part, "1", "0:5.375")
    assert scale.factor == pytest.approx(UNIT_M, rel=1e-4)
    assert scale.source == f"{part:g} m between 1 and 0:5.375"


def test_moments_of_other_walks_and_of_numbered_images_are_found():
    walks = [walk_of("phone", 41), walk_of("photos", 30, has_stamps=False)]
    positions = straight(41).translation
    distance = float(np.linalg.norm(positions[20] - positions[4]))
    assert by_distance(distance, "1", "photos@20", walks=walks).factor == pytest.approx(UNIT_M)


@pytest.mark.parametrize(
    ("between", "said"),
    [
        (("4", "end"), "--between 4: no image of phone is placed there, the nearest one is at 2.0 s"),
        (("1", "1.1"), "where the camera was at the same place"),
    ],
)
def test_moments_that_cannot_be_used_are_refused(between, said):
    lost = {f"phone/{number}.jpg" for number in range(9, 30)}
    with pytest.raises(SequenceError, match=said):
        by_distance(3.0, *between, lost=lost)


@pytest.mark.parametrize(
    ("between", "said"),
    [
        (("start", "11"), "--between 11: phone ends at 10.0 s"),
        (("photos@30", "end"), "--between photos@30: photos ends at 29"),
        (("start", "stairs@end"), "--between stairs@end: no such input, expected one of phone, photos"),
    ],
)
def test_moments_of_no_walk_are_refused_at_once(between, said):
    walks = [walk_of("phone", 41), walk_of("photos", 30, has_stamps=False)]
    with pytest.raises(SequenceError, match=said):
        require_moments(walks, MapConfig(distance_m=3.0, between=between))


@pytest.mark.parametrize("text", ["", "walk2@", "soon", "1:2:3", "-3", "nan"])
def test_what_is_no_moment_is_refused(text):
    with pytest.raises(VaporTrackError, match="expected start, end or seconds"):
        Moment.of(text)


def test_moments_without_a_distance_are_refused():
    with pytest.raises(VaporTrackError, match="--between without a distance"):
        MapConfig(between=("start", "5"))


def looking(pitch: float, yaws: np.ndarray, roll: float = 0.0) -> Poses:
    """Cameras in a world whose z is up; level they look along the ground."""
    level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    rotations = [
        Poses.exp(np.array([0, 0, 0, 0, 0, yaw])).rotation
        @ level
        @ Poses.exp(np.array([0, 0, 0, pitch, 0, roll])).rotation
        for yaw in yaws
    ]
    return Poses(np.array(rotations), np.zeros((len(yaws), 3)))


@pytest.mark.parametrize(("pitch", "turns"), [(0.0, 6.0), (0.0, 0.3), (-0.6, 6.0), (1.1, 3.0)])
def test_z_is_up_however_cameras_are_pitched(pitch, turns):
    model = Poses.exp(np.array([0, 0, 0, 1.0, -2.0, 0.5])) @ looking(pitch, np.linspace(0, turns, 50))
    cameras = Poses(upright(model) @ model.rotation, model.translation)
    expected = Poses(looking(pitch, np.linspace(0, turns, 50)).rotation, model.translation)
    assert np.degrees(cameras.distance(expected)[1]).max() < 3.0
