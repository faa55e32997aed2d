"""The story the library exists for: what one image leaves ambiguous resolves over time."""

from types import SimpleNamespace

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.localizer import ParticleLocalizer
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import (
    AHEAD,
    ERRORS,
    ODOMETRY_STD,
    OUT_OF_DISTRIBUTION,
    RNG,
    Oracle,
    assert_same_belief,
    climb,
    image_of,
    lifted,
    motion,
    new_localizer,
    seen_at,
    walk,
    weight_near,
)

FLOORS = (-2, -1, 0, 1, 2)


def localize(seed, num_frames, unique, config=None):
    rng = RNG(seed)
    truth, odometry = climb(num_frames, rng=rng)
    localizer = ParticleLocalizer(Oracle(truth, FLOORS, unique), config or LocalizerConfig(), rng=rng)
    estimates = [localizer.step(image_of(i), odometry[i]) for i in range(num_frames)]
    best = Poses.stack([estimate.modes[0].world_from_camera for estimate in estimates])
    return estimates, best.distance(truth)[0], truth


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("seed", range(3))
def test_an_ambiguous_belief_collapses_to_the_truth_once_a_unique_place_is_seen(seed):
    estimates, error_m, _ = localize(seed, 60, unique=range(20, 45))
    assert all(len(estimate.modes) >= 3 for estimate in estimates[:20])
    assert all(estimate.status == "ambiguous" for estimate in estimates[:20])
    assert (error_m[45:] < 0.3).all()
    assert estimates[-1].status == "converged"


def test_the_same_seed_gives_the_same_bits_and_another_seed_does_not():
    first, second, other = (localize(seed, 6, range(0))[0][-1] for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.particles.translation, second.particles.translation)
    np.testing.assert_array_equal(first.log_weights, second.log_weights)
    assert not np.array_equal(first.particles.translation[:1], other.particles.translation[:1])


@pytest.mark.usefixtures("unchecked")
def test_a_first_image_that_is_all_but_sure_of_a_wrong_place_does_not_decide():
    """95 % of its samples are where the camera is not; later images cannot tell the two places apart."""
    localizer = new_localizer()
    first = localizer.update(seen_at(lifted(Poses.identity(), (0.0, 3.0)), (0.95, 0.05)), None)
    assert first.status == "ambiguous"
    assert weight_near(first, (0, 0, 3)) == pytest.approx(0.05**0.5 / (0.05**0.5 + 0.95**0.5))
    estimates, pose = walk(localizer, 100, shares=(0.5, 0.5), heights_m=(0.0, 3.0))
    assert all(estimate.status == "ambiguous" for estimate in estimates)
    assert weight_near(estimates[-1], lifted(pose, (3.0,)).translation[0]) == pytest.approx(0.19, abs=0.02)


def test_a_first_image_that_is_uninformative_is_refused_and_the_next_begins():
    localizer = new_localizer()
    for nothing in (PosePosterior.uninformative(), OUT_OF_DISTRIBUTION):
        with pytest.raises(VaporTrackError, match="first image has no place"):
            localizer.update(nothing, None)
    assert_same_belief(
        localizer.update(seen_at(Poses.identity(1)), None), new_localizer().update(seen_at(Poses.identity(1)), None),
        atol=0,
    )  # fmt: skip


def test_a_first_image_that_is_out_of_distribution_gives_a_belief_that_is_lost_until_a_familiar_one_begins_it_anew():
    localizer = new_localizer()
    wrong = seen_at(Poses.exp(np.array([[30.0, 0, 0, 0, 0, 0]])), ood_score=3.0)
    assert localizer.update(wrong, None).status == "lost"
    assert localizer.update(wrong, AHEAD).status == "lost"
    begun = localizer.update(seen_at(Poses.identity(1)), AHEAD)
    assert begun.status == "converged"
    assert weight_near(begun, (0, 0, 0)) == pytest.approx(1.0)


def test_there_is_nothing_to_predict_before_the_first_image():
    with pytest.raises(VaporTrackError, match="no image was localized yet"):
        new_localizer().predict(AHEAD)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("rate", [1, 3, 10, 30])
def test_ood_images_are_lost_after_about_a_second_or_six_images_and_the_map_in_view_again_is_found(rate):
    localizer = new_localizer()
    walk(localizer, 30)
    step = motion(0, 0, 0, 0, 0, 0, std=ODOMETRY_STD / np.sqrt(rate / 10), duration_s=1 / rate)
    unlike = seen_at(Poses.exp(np.array([[9.0, 0, 0, 0, 0, 0]])), ood_score=2.0)
    statuses = [localizer.update(unlike, step).status for _ in range(max(3 * rate, 10))]
    since_s = (statuses.index("lost") + 1) / rate
    # e^(−1.2) is the least agreement, and so is 0.8 to the 5.4
    assert since_s == pytest.approx(max(1.2, 5.4 / rate), abs=max(0.34, 1.0 / rate))
    assert statuses[-1] == "lost"
    pose = localizer.predict(motion(0, 0, 0, 0, 0, 0, std=np.zeros(6), duration_s=0.0)).modes[0].world_from_camera
    statuses = [localizer.update(seen_at(pose), step).status for _ in range(max(4 * rate, 10))]
    since_s = (statuses.index("converged") + 1) / rate
    assert since_s < max(3.0, 8.0 / rate)
    assert "lost" not in statuses[max(rate, 3) :]


@pytest.mark.usefixtures("unchecked")
def test_a_kidnapped_camera_is_followed_within_a_few_lengths_and_meanwhile_the_belief_is_not_sure():
    localizer = new_localizer()
    before, pose = walk(localizer, 40)
    assert before[-1].status == "converged"
    elsewhere = Poses.exp(np.array([40.0, -7, 2, 0, 0, 2.0]))
    estimates, pose = walk(localizer, 60, pose=elsewhere, seed=1)
    near = [weight_near(estimate, elsewhere.translation, within=9.0) for estimate in estimates]
    found = int(np.argmax(np.array(near) > 0.9))
    lengths = 0.1 / ERRORS.length_m * found
    assert 1.0 < lengths < 6.0
    statuses = [estimate.status for estimate in estimates]
    assert "converged" not in statuses[4:found]  # in a third of a second the images before are outweighed
    assert "ambiguous" in statuses[:found]
    assert statuses[-1] == "converged"
    assert estimates[-1].modes[0].world_from_camera.distance(pose)[0] < 0.3


def test_a_belief_too_wide_is_not_converged_though_it_is_one():
    localizer = new_localizer(converged_std_m=0.08)
    assert localizer.update(seen_at(Poses.identity(1)), None).status == "ambiguous"
    assert walk(localizer, 40)[0][-1].status == "converged"


def test_the_best_mode_changes_only_when_another_clearly_outweighs_it():
    localizer = new_localizer(switch_ratio=1.5)
    localizer.update(seen_at(lifted(Poses.identity(), (0.0, 3.0)), (0.55, 0.45)), None)
    orders = []
    estimates, _ = walk(localizer, 60, shares=(0.04, 0.96), heights_m=(0.0, 3.0))
    for estimate in estimates:
        best, other = estimate.modes[:2]
        orders.append((best.world_from_camera.translation[2] > 1.5, best.weight / other.weight))
    switched = next(i for i, (up, _) in enumerate(orders) if up)
    assert any(ratio < 1.0 for _, ratio in orders[:switched])  # it stayed though it was lighter,
    assert all(ratio > 1 / 1.5 for _, ratio in orders[:switched])  # but not by much
    assert all(up for up, _ in orders[switched:])


@pytest.mark.parametrize("nothing", [PosePosterior.uninformative(), seen_at(Poses.identity(1), ood_score=1.5)])
def test_an_image_that_is_uninformative_leaves_the_belief_as_the_motion_alone_does(nothing):
    beliefs = []
    for seen in (None, nothing):
        localizer = new_localizer()
        walk(localizer, 20, shares=(0.6, 0.3), heights_m=(0.0, 3.0))
        beliefs.append(localizer.predict(AHEAD) if seen is None else localizer.update(seen, AHEAD))
    assert_same_belief(*beliefs, atol=0, rtol=0)
    for mode, other in zip(beliefs[0].modes, beliefs[1].modes, strict=True):
        np.testing.assert_array_equal(mode.covariance, other.covariance)
        assert mode.weight == other.weight


def test_an_image_that_equals_the_one_before_comes_from_a_frozen_camera_and_is_uninformative():
    model = SimpleNamespace(observe=lambda image, *, rng: seen_at(Poses.identity(1)))
    localizer = ParticleLocalizer(model, rng=RNG(0))
    found = [localizer.observe(image_of(index)).is_uninformative for index in (1, 1, 2, 1)]
    assert found == [False, True, False, False]


COVARIANCE = np.diag([0.25, 0.25, 0.04, 0.01, 0.01, 0.07])


def test_one_that_forgot_begins_as_a_new_one_does():
    used, fresh = new_localizer(), new_localizer()
    walk(used, 20)
    used.forget()
    with pytest.raises(VaporTrackError, match="nothing to predict from"):
        used.predict(AHEAD)
    pose = Poses.exp(np.array([3.0, -2.0, 0.5, 0.1, 0.2, 0.3]))
    for localizer in (used, fresh):
        localizer.update(seen_at(pose, noise=ERRORS), None)
    one, other = used.update(seen_at(pose, noise=ERRORS), AHEAD), fresh.update(seen_at(pose, noise=ERRORS), AHEAD)
    assert_same_belief(one, other, rtol=1e-12, atol=1e-12)
    assert one.status == other.status


def test_a_stated_pose_is_the_belief_with_its_uncertainty():
    localizer = new_localizer()
    walk(localizer, 5)
    pose = Poses.exp(np.array([30.0, 4.0, 1.0, 0.0, 0.0, 1.5]))
    estimate = localizer.start_at(pose, COVARIANCE, ERRORS)
    (mode,) = estimate.modes
    assert float(mode.world_from_camera.distance(pose)[0]) == 0.0
    np.testing.assert_allclose(mode.covariance, COVARIANCE + ERRORS.constant_covariance(np.zeros((6, 6))))
    assert mode.weight == 1.0


def test_images_make_a_stated_pose_exact():
    truth = Poses.exp(np.array([30.0, 4.0, 1.0, 0.0, 0.0, 1.5]))
    localizer = new_localizer()
    localizer.start_at(truth @ Poses.exp(np.array([0.4, -0.3, 0.1, 0.05, 0.0, -0.1])), COVARIANCE, ERRORS)
    estimates, pose = walk(localizer, 12, pose=truth)
    assert float(estimates[-1].modes[0].world_from_camera.distance(pose)[0]) < 0.15
    assert estimates[-1].status == "converged"


@pytest.mark.parametrize("bad", [np.zeros((6, 6)), np.full((6, 6), np.nan), -np.eye(6)])
def test_a_covariance_that_is_none_leaves_the_belief_as_it_was(bad):
    localizer, untouched = new_localizer(), new_localizer()
    walk(localizer, 5)
    walk(untouched, 5)
    with pytest.raises(VaporTrackError):
        localizer.start_at(Poses.identity(), bad, ERRORS)
    assert_same_belief(localizer.predict(AHEAD), untouched.predict(AHEAD))


def test_a_belief_over_an_unknown_motion_is_as_wide_as_the_time_is_long():
    localizer = new_localizer()
    walk(localizer, 20)
    widths = [localizer.predicted(None, elapsed_s=s).modes[0].widest_std_m for s in (0.0, 0.5, 2.0)]
    assert widths[0] < 0.2
    speed = localizer.config.gap.speed_m_per_s
    np.testing.assert_allclose(widths[1:], [0.5 * speed, 2.0 * speed], rtol=0.08)  # speeds change in five seconds
    assert localizer.predicted(None, elapsed_s=2.0).status == "ambiguous"


def test_places_of_no_weight_change_nothing():
    one, other = new_localizer(), new_localizer()
    far = Poses.exp(np.array([[20.0, 0, 0, 0, 0, 0]]))
    for i in range(30):
        here = Poses.exp(np.array([[0.1 * i, 0, 0, 0, 0, 0]]))
        step = motion(0.1, 0, 0, 0, 0, 0)
        both = seen_at(Poses.concatenate([here, far]), (1.0, 0.0))
        assert_same_belief(one.update(both, step), other.update(seen_at(here), step), atol=0)
    assert_same_belief(one.update(seen_at(far, (0.0,)), AHEAD), other.predict(AHEAD), atol=0)
    with pytest.raises(VaporTrackError, match="no place of any weight"):
        new_localizer().update(seen_at(far, (0.0,)), None)


def test_images_without_any_time_between_them_still_show_that_the_camera_is_elsewhere():
    """Odometry whose durations are unknown states 0 s: the images count, not the seconds."""
    localizer = new_localizer(birth_rate=0.0, max_birth_rate=0.0)
    for i in range(40):
        there = Poses.exp(np.array([[0.05 * i + 50.0 * (i >= 20), 0, 0, 0, 0, 0]]))
        estimate = localizer.update(seen_at(there), motion(0.05, 0, 0, 0, 0, 0, duration_s=0.0))
        assert i != 19 or estimate.status == "converged"
    assert estimate.status == "lost"
