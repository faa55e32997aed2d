"""Planar robots: tilt and height by training poses, over floors, ramps and storeys, and images that disagree."""

import numpy as np
import pytest

from filtering.planar import HeightMap, Planar, VerticalWatch
from filtering.se3 import Poses
from filtering.vertical import KnownHeight, Vertical
from tests.helpers.planar_robot import LEVEL_CAMERA, driven, ramp
from tests.helpers.simulation import OUT_OF_DISTRIBUTION, RNG, seen_at, translated

# --- heights --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("floor", [lambda xy: 0.0 * xy[:, 0], ramp])
def test_heights_near_training_poses_are_known_to_within_their_spread(floor):
    heights = HeightMap(driven(800, rng=RNG(0), height=floor).translation)
    others = driven(300, rng=RNG(1), height=floor).translation
    known = heights.at(others)
    assert np.isfinite(known.std_m).all()
    off = (known.height_m - others[:, 2]) / known.std_m
    assert 0.6 < np.sqrt(np.mean(off**2)) < 1.5
    assert np.median(known.std_m) < 0.015
    on_ramp = (others[:, 0] > 5.0) & (others[:, 0] < 8.0) & (floor is ramp)
    np.testing.assert_allclose(known.slope[on_ramp, 0], 0.2, atol=0.06)


def test_each_storey_has_its_own_heights_and_between_them_next_to_nothing_is_known():
    floors = [driven(400, rng=RNG(i)).translation + np.array([0, 0, 3.0 * i]) for i in range(2)]
    heights = HeightMap(np.concatenate(floors))
    at = heights.at(np.array([[5.0, 5.0, 1.3], [5.0, 5.0, 4.1], [5.0, 5.0, 2.7]]))
    np.testing.assert_allclose(at.height_m[:2], [1.2, 4.2], atol=0.02)
    assert (at.std_m[:2] < 0.05).all()
    assert at.std_m[2] > 1.0


def test_far_from_training_poses_nothing_is_known():
    heights = HeightMap(driven(800, rng=RNG(0)).translation)
    assert np.isinf(heights.at(np.array([[20.0, 5.0, 1.2]])).std_m).all()


def test_along_one_line_of_training_poses_heights_beside_it_are_known_less():
    line = np.column_stack([np.linspace(0, 10, 200), np.zeros(200), ramp(np.linspace(0, 10, 200)[:, None])])
    std_m = HeightMap(line).at(np.array([[2.0, 0.0, 0.0], [2.0, 0.5, 0.0]])).std_m
    assert std_m[1] > std_m[0]


def test_a_height_does_not_depend_on_which_others_are_asked_for():
    heights = HeightMap(driven(300, rng=RNG(0), height=ramp).translation)
    asked = driven(50, rng=RNG(1), height=ramp).translation
    together = heights.at(asked)
    for i in (0, 17, 49):
        for one, all_of_them in zip(heights.at(asked[i : i + 1]), together, strict=True):
            np.testing.assert_allclose(one[0], all_of_them[i], rtol=1e-9, atol=1e-12)


def test_lengths_in_another_unit_give_heights_times_that():
    positions, asked = (driven(n, rng=RNG(n), height=ramp).translation for n in (300, 20))
    one, other = HeightMap(positions).at(asked), HeightMap(100.0 * positions).at(100.0 * asked)
    np.testing.assert_allclose(other.height_m, 100.0 * one.height_m, rtol=1e-6)
    np.testing.assert_allclose(other.std_m, 100.0 * one.std_m, rtol=1e-6)


def test_training_poses_at_one_spot_are_a_height_there():
    at = HeightMap(np.tile([1.0, 2.0, 3.0], (30, 1))).at(np.array([[1.0, 2.0, 3.0]]))
    assert at.height_m[0] == pytest.approx(3.0)
    assert np.isfinite(at.std_m).all()


# --- tilt -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_the_tilt_is_found_in_any_world_and_however_the_camera_is_mounted(seed):
    rng = RNG(seed)
    mount, world = (Poses.exp(np.append(np.zeros(3), rng.standard_normal(3))) for _ in range(2))
    poses = driven(400, rng=rng)
    other = world @ poses @ mount
    found = Planar.found_in(other)
    assert found.is_robot
    assert np.degrees(found.tilt_std_rad) == pytest.approx(np.degrees(0.01), rel=0.15)
    world_up, up = np.asarray(found.vertical.world_up), np.asarray(found.vertical.up)
    sign = np.sign(world_up @ world.rotation[:, 2])  # both may point down: that is the same
    np.testing.assert_allclose(sign * world_up, world.rotation[:, 2], atol=0.005)
    expected = mount.rotation.T @ poses.rotation.mean(axis=0).T @ [0, 0, 1]
    np.testing.assert_allclose(sign * up, expected / np.linalg.norm(expected), atol=0.005)
    assert found.vertical.heights.spread_m < 0.01 + 10.0 * 0.005


@pytest.mark.parametrize(
    ("poses", "why"),
    [
        (driven(300, rng=RNG(0), tilt_std=0.06), "tilts as in a hand"),
        (driven(300, rng=RNG(0), turns=0.02), "never turned: any axis would do"),
        (Poses.exp(RNG(0).standard_normal((300, 6))), "turns about all axes"),
    ],
)
def test_training_poses_of_no_robot_are_not_taken_for_one(poses, why):
    assert not Planar.found_in(poses).is_robot, why


def test_errors_of_the_training_poses_are_part_of_the_spread():
    poses = driven(300, rng=RNG(0))
    exact, errs = Planar.found_in(poses), Planar.found_in(poses, tilt_error_rad=0.02, height_error_m=0.1)
    assert errs.tilt_std_rad == pytest.approx(np.hypot(exact.tilt_std_rad, 0.02))
    here = poses.translation[:1]
    assert errs.vertical.heights.at(here).std_m[0] == pytest.approx(
        np.hypot(exact.vertical.heights.at(here).std_m[0], 0.1), rel=0.01
    )


def test_few_training_poses_show_nothing():
    assert Planar.found_in(driven(19, rng=RNG(0))) is None


# --- images that disagree -------------------------------------------------------------------------------

STD = np.array([0.1, 0.1, 0.1, 0.03, 0.03, 0.03])


def watched(poses, planar, *, std=STD):
    watch = VerticalWatch()
    return [watch.step(seen_at(pose @ Poses.exp(std * e), std=std), planar.vertical) for pose, e in poses], watch


def with_errors(poses, *, seed=0):
    return list(zip(poses, RNG(seed).standard_normal((len(poses), 6)), strict=True))


def test_images_of_the_robot_never_let_go_of_it():
    planar = Planar.found_in(driven(400, rng=RNG(0)))
    used, watch = watched(with_errors(driven(300, rng=RNG(1))), planar)
    assert not any(used[:4])  # before images have spoken
    assert all(used[4:])
    assert watch.num_let_go == 0


@pytest.mark.parametrize("held", [{"tilt_std": 0.15}, {"height": lambda xy: 0.0 * xy[:, 0] + 0.6}])
def test_images_of_somebody_who_carries_the_camera_let_go_of_it_soon(held):
    planar = Planar.found_in(driven(400, rng=RNG(0)))
    used, watch = watched(with_errors(driven(100, rng=RNG(1), **held)), planar)
    assert not any(used[20:])
    assert watch.is_let_go
    assert watch.num_let_go >= 80


def test_once_images_agree_again_it_is_used_again():
    planar = Planar.found_in(driven(400, rng=RNG(0)))
    carried, on_wheels = driven(60, rng=RNG(1), tilt_std=0.2), driven(60, rng=RNG(2))
    used, _ = watched(with_errors(Poses.concatenate([carried, on_wheels])), planar)
    assert used[59] is None
    assert used[-1] is planar.vertical


def test_images_without_places_say_nothing():
    planar = Planar.found_in(driven(400, rng=RNG(0)))
    watch = VerticalWatch()
    for pose, error in with_errors(driven(10, rng=RNG(1))):
        watch.step(seen_at(pose @ Poses.exp(STD * error), std=STD), planar.vertical)
    assert all(watch.step(OUT_OF_DISTRIBUTION, planar.vertical) is planar.vertical for _ in range(50))


@pytest.mark.parametrize(("higher_m", "turned_deg"), [(0.2, 0.0), (-0.2, 0.0), (0.0, 4.0)])
def test_another_robot_is_let_go_of_though_no_image_alone_is_unusual(higher_m, turned_deg):
    planar = Planar.found_in(driven(400, rng=RNG(0)))
    other = driven(150, rng=RNG(1)) @ Poses.exp(np.array([0, 0, 0, np.radians(turned_deg), 0, 0]))
    lifted = Poses(other.rotation, other.translation + np.array([0.0, 0.0, higher_m]))
    used, _ = watched(with_errors(lifted), planar)
    assert not any(used[40:])


def test_where_no_height_is_known_the_tilt_alone_counts():
    far = Vertical((0.0, -1.0, 0.0), 0.01, HeightMap(translated([[0, 0, 0], [1.0, 0, 0]]).translation))
    watch, pose = VerticalWatch(), Poses.from_matrix(np.block([[LEVEL_CAMERA, np.full((3, 1), 50.0)], [0, 0, 0, 1.0]]))
    for number in range(10):
        assert watch.step(seen_at(pose, std=STD), far) is (far if number >= 4 else None)


def test_a_known_height_is_one_everywhere():
    at = KnownHeight(2.0, 0.1).at(np.zeros((3, 3)))
    assert at.height_m.tolist() == [2.0] * 3
    assert not at.slope.any()
