"""The story the library exists for: what one image leaves ambiguous resolves over time."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.cameras import View
from filtering.config import GapConfig, LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.hypotheses import POSE
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry, SlowErrors
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.simulation import (
    ERRORS,
    FLOOR_HEIGHT_M,
    ODOMETRY_STD,
    STD,
    Oracle,
    climb,
    image_errors,
    image_of,
    lifted,
    motion,
    seen_at,
)

FLOORS = (-2, -1, 0, 1, 2)
RNG = np.random.default_rng
STAY = motion(0, 0, 0, 0, 0, 0)
AHEAD = motion(0.1, 0, 0, 0, 0, 0.02)
FOREIGN = PosePosterior(Poses.identity(0), np.zeros((0, 6, 6)), np.zeros(0), ERRORS, Poses.identity(0), 3.0)


def new_localizer(seed=0, **settings):
    return ParticleLocalizer(None, LocalizerConfig(**settings), rng=RNG(seed))


def assert_same_belief(one, other, **tolerance):
    np.testing.assert_allclose(one.particles.as_matrix(), other.particles.as_matrix(), **tolerance)
    np.testing.assert_allclose(one.covariances, other.covariances, **tolerance)
    np.testing.assert_allclose(one.log_weights, other.log_weights, **tolerance)


def weight_near(estimate, position, within=1.0):
    near = np.linalg.norm(estimate.particles.translation - np.asarray(position), axis=1) < within
    return float(np.exp(estimate.log_weights)[near].sum())


def walk(localizer, count, *, shares=(1.0,), heights_m=(0.0,), pose=None, seed=0, errors=ERRORS, step=AHEAD):
    """Estimates along a walk whose images err as the model says, and the true pose at its end."""
    rng = RNG(seed)
    pose = Poses.identity() if pose is None else pose
    way = float(np.hypot(*(np.linalg.norm(part) for part in np.split(step.previous_from_current.log(), 2)))) / 0.45
    estimates = []
    for error in image_errors([way] * (count - 1), errors, rng=rng):
        pose = pose @ step.previous_from_current
        seen = lifted(pose @ Poses.exp(error), heights_m)
        estimates.append(localizer.update(seen_at(seen, shares, errors=errors), step))
    return estimates, pose


# --- the story --------------------------------------------------------------------------------------


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


@pytest.mark.usefixtures("unchecked")
def test_without_a_unique_place_the_true_floor_stays_among_the_modes_and_convergence_is_never_claimed():
    estimates, _, truth = localize(11, 40, unique=range(0))
    assert all(estimate.status == "ambiguous" for estimate in estimates)
    for i, estimate in enumerate(estimates):
        nearest = min(float(mode.world_from_camera.distance(truth[i])[0]) for mode in estimate.modes)
        assert nearest < 0.3


def test_modes_are_a_floor_apart_and_their_covariance_does_not_bridge_them():
    estimates, _, _ = localize(12, 5, unique=range(0))
    modes = estimates[-1].modes
    heights = np.sort([mode.world_from_camera.translation[2] for mode in modes])
    np.testing.assert_allclose(np.diff(heights), FLOOR_HEIGHT_M, atol=0.3)
    assert all(np.sqrt(mode.covariance[2, 2]) < 0.3 for mode in modes)
    assert sum(mode.weight for mode in modes) == pytest.approx(1.0, abs=0.05)


def test_the_same_seed_gives_the_same_bits_and_another_seed_does_not():
    first, second, other = (localize(seed, 6, range(0))[0][-1] for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.particles.translation, second.particles.translation)
    np.testing.assert_array_equal(first.log_weights, second.log_weights)
    assert not np.array_equal(first.particles.translation[:1], other.particles.translation[:1])


def test_weights_are_normalised_and_hypotheses_no_more_than_asked():
    localizer = new_localizer(max_hypotheses=10)
    estimates, _ = walk(localizer, 40, shares=(0.4, 0.3, 0.2), heights_m=(0.0, 3, 6))
    for estimate in estimates:
        assert len(estimate.particles) <= 10
        assert np.exp(estimate.log_weights).sum() == pytest.approx(1.0)
        assert (np.diff(estimate.log_weights) <= 1e-12).all()


# --- the beginning ----------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
def test_a_first_image_that_is_all_but_sure_of_a_wrong_place_does_not_decide():
    """95 % of its samples are where the camera is not; later images cannot tell the two places apart."""
    localizer = new_localizer()
    first = localizer.update(seen_at(lifted(Poses.identity(), (0.0, 3.0)), (0.95, 0.05)), None)
    assert first.status == "ambiguous"
    assert weight_near(first, (0, 0, 3)) == pytest.approx(1 / 2.9)
    estimates, pose = walk(localizer, 100, shares=(0.5, 0.5), heights_m=(0.0, 3.0))
    assert all(estimate.status == "ambiguous" for estimate in estimates)
    assert weight_near(estimates[-1], lifted(pose, (3.0,)).translation[0]) > 0.25


def test_odometry_on_the_first_step_is_not_used():
    far = Odometry(Poses.exp(np.array([50.0, 0, 0, 0, 0, 0])), np.eye(6), 0.1)
    estimates = [new_localizer().update(seen_at(Poses.identity(1)), odometry) for odometry in (None, far)]
    assert_same_belief(*estimates, atol=0)


def test_a_first_image_that_says_nothing_is_refused_and_the_next_begins():
    localizer = new_localizer()
    for nothing in (PosePosterior.nothing(), FOREIGN):
        with pytest.raises(VaporTrackError, match="first image says nothing"):
            localizer.update(nothing, None)
    assert_same_belief(
        localizer.update(seen_at(Poses.identity(1)), None), new_localizer().update(seen_at(Poses.identity(1)), None),
        atol=0,
    )  # fmt: skip


def test_a_first_image_that_is_foreign_gives_a_belief_that_is_lost_until_a_familiar_one_begins_it_anew():
    localizer = new_localizer()
    wrong = seen_at(Poses.exp(np.array([[30.0, 0, 0, 0, 0, 0]])), unfamiliarity=3.0)
    assert localizer.update(wrong, None).status == "lost"
    assert localizer.update(wrong, AHEAD).status == "lost"
    begun = localizer.update(seen_at(Poses.identity(1)), AHEAD)
    assert begun.status == "converged"
    assert weight_near(begun, (0, 0, 0)) == pytest.approx(1.0)


def test_there_is_nothing_to_predict_before_the_first_image():
    with pytest.raises(VaporTrackError, match="no image was localized yet"):
        new_localizer().predict(AHEAD)


# --- odometry ---------------------------------------------------------------------------------------


def test_a_motion_in_parts_and_in_one_give_the_same_belief():
    parts = [motion(0.3, 0.1 * k, 0, 0.1, 0, 0.4 - 0.2 * k, duration_s=0.5) for k in range(4)]
    whole = parts[0].then(parts[1]).then(parts[2]).then(parts[3])
    for slow, tolerance in ((SlowErrors(scale=0.0, relative_drift=0.0), 1e-9), (SlowErrors(), 0.02)):
        stds, poses = [], []
        for motions in (parts, [whole]):
            localizer = new_localizer(slow_errors=slow)
            estimate = localizer.update(seen_at(Poses.identity(1)), None)
            for part in motions:
                estimate = localizer.predict(part)
            poses.append(estimate.modes[0].world_from_camera.as_matrix())
            stds.append(np.sqrt(np.diag(estimate.modes[0].covariance)))
        np.testing.assert_allclose(poses[0], poses[1], atol=1e-9)
        np.testing.assert_allclose(stds[0], stds[1], rtol=tolerance)


def test_odometry_that_errs_along_but_not_across_stays_so():
    localizer = new_localizer(slow_errors=SlowErrors(scale=0.0, relative_drift=0.0))
    localizer.update(seen_at(Poses.identity(1), std=[1e-3] * 6), None)
    for _ in range(20):
        estimate = localizer.predict(motion(0.5, 0, 0, 0, 0, 0, std=[0.10, 0.002, 0.002, 1e-5, 1e-5, 1e-5]))
    along, across, up = np.sqrt(np.diag(estimate.modes[0].covariance - ERRORS.least_covariance))[:3]
    assert along == pytest.approx(0.1 * np.sqrt(20), rel=0.01)
    assert across < 0.02
    assert up < 0.02


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("too_long", [0.05, -0.05])
def test_odometry_that_is_5_percent_off_is_found_out(too_long):
    localizer = new_localizer(slow_errors=SlowErrors(scale=0.05, relative_drift=0.1))
    rng, true = RNG(0), Poses.identity()
    step = motion(0.2, 0, 0, 0, 0, 0, std=[2e-3] * 3 + [1e-3] * 3)
    reported = motion(0.2 * (1 + too_long), 0, 0, 0, 0, 0, std=[2e-3] * 3 + [1e-3] * 3)
    for error in image_errors([0.4] * 149, ERRORS, rng=rng):
        true = true @ step.previous_from_current
        estimate = localizer.update(seen_at(true @ Poses.exp(error)), reported)
    scale = localizer._belief.mean[0, 6 - POSE.stop]
    assert scale == pytest.approx(too_long, abs=0.015)
    assert estimate.status == "converged"
    far = localizer.predict(motion(20 * (1 + too_long), 0, 0, 0, 0, 0, duration_s=10.0)).modes[0]
    assert far.world_from_camera.translation[0] == pytest.approx(true.translation[0] + 20.0, abs=0.5)  # not 1 m off


# --- unit of length ---------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("factor", [0.1, 30.0, 1000.0])
def test_nothing_depends_on_the_unit_of_length(factor):
    """Another place every ten images, outliers, a gap: the same weights and statuses, and poses times the factor."""

    def scaled(pose):
        return Poses(pose.rotation, factor * pose.translation)

    lengths = np.array([factor] * 3 + [1.0] * 3)
    config = LocalizerConfig(max_hypotheses=20)
    localizers = [
        ParticleLocalizer(None, used, rng=RNG(0))
        for used in (config, replace(config, gap=GapConfig(speed_m_per_s=1.4 * factor)))
    ]
    rng, pose, models = RNG(2), Poses.identity(), (ERRORS, ERRORS.scaled(factor))
    statuses = set()
    for i in range(60):
        pose = pose @ AHEAD.previous_from_current
        seen = lifted(pose @ Poses.exp(STD * rng.standard_normal(6)), (0.0, 3.0, 6.0))
        if i % 9 == 8:
            seen = Poses(seen.rotation, seen.translation + rng.uniform(-20, 20, 3))
        shares = (0.5, 0.3, 0.1) if i < 30 else (0.9, 0.05, 0.01)
        odometry = None if i == 20 else AHEAD
        grown = odometry and Odometry(
            scaled(AHEAD.previous_from_current), AHEAD.covariance * np.outer(lengths, lengths), AHEAD.duration_s
        )
        one = localizers[0].update(seen_at(seen, shares, errors=models[0]), odometry, elapsed_s=0.5)
        other = localizers[1].update(
            seen_at(scaled(seen), shares, std=STD * lengths, errors=models[1]), grown, elapsed_s=0.5
        )
        assert one.status == other.status
        statuses.add(one.status)
        np.testing.assert_allclose(other.log_weights, one.log_weights, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(
            other.particles.translation / factor, one.particles.translation, rtol=1e-6, atol=1e-6
        )
        np.testing.assert_allclose(
            [other.agreement, other.novelty, other.way], [one.agreement, one.novelty, one.way], rtol=1e-6, atol=1e-9
        )
        for mode, larger in zip(one.modes, other.modes, strict=True):
            assert larger.weight == pytest.approx(mode.weight, rel=1e-6)
            std = np.sqrt(np.diag(mode.covariance))
            np.testing.assert_allclose(np.sqrt(np.diag(larger.covariance)), std * lengths, rtol=1e-6)
    assert statuses == {"ambiguous", "converged"}  # precondition: something happened


# --- gaps -------------------------------------------------------------------------------------------


def test_without_odometry_the_belief_widens_by_the_stated_motion_and_keeps_its_hypotheses():
    localizer = new_localizer(gap=GapConfig(speed_m_per_s=2.0, turn_rad_per_s=0.1))
    before = localizer.update(seen_at(lifted(Poses.identity(), (0.0, 30.0)), (0.6, 0.4)), None)
    after = localizer.update(PosePosterior.nothing(), None, elapsed_s=1.5)
    assert len(after.particles) == len(before.particles) == 2
    np.testing.assert_allclose(after.log_weights, before.log_weights)
    np.testing.assert_allclose(after.particles.translation, before.particles.translation)
    grown = np.diag([3.0**2] * 3 + [0.15**2] * 3)
    np.testing.assert_allclose(after.covariances, before.covariances + grown, atol=1e-12)


def test_after_a_gap_the_image_finds_the_camera_among_the_hypotheses_as_far_as_it_may_have_come():
    localizer = new_localizer()
    _, pose = walk(localizer, 30)
    moved = pose @ Poses.exp(np.array([1.5, -0.5, 0, 0, 0, 0.6]))
    found = localizer.update(seen_at(moved), None, elapsed_s=2.0)
    assert found.modes[0].world_from_camera.distance(moved)[0] < 0.1
    assert found.modes[0].weight > 0.9


def test_a_belief_that_forgets_starts_anew_from_the_image():
    localizer = new_localizer(gap=GapConfig(action="forget"))
    walk(localizer, 30)
    there = seen_at(Poses.exp(np.array([[40.0, 3, 0, 0, 0, 2]])))
    assert_same_belief(localizer.update(there, None), new_localizer().update(there, None), atol=0)


@pytest.mark.parametrize(
    "nothing", [PosePosterior.nothing(), FOREIGN, seen_at(Poses.identity(1), unfamiliarity=2.0), []]
)
def test_a_belief_that_forgets_is_lost_until_an_image_says_something(nothing):
    localizer = new_localizer(gap=GapConfig(action="forget"))
    estimates, _ = walk(localizer, 30)
    there = seen_at(Poses.exp(np.array([[40.0, 3, 0, 0, 0, 2]])))
    after = localizer.update(nothing, None, elapsed_s=1.0)
    assert after.status == "lost"
    assert after.modes[0].world_from_camera.distance(estimates[-1].modes[0].world_from_camera)[0] < 0.01
    assert after.modes[0].widest_std_m > 1.4
    assert localizer.predict(AHEAD).status == "lost"
    assert localizer.update(nothing, AHEAD).status == "lost"
    assert_same_belief(localizer.update(there, AHEAD), new_localizer().update(there, None), atol=0)
    assert localizer.update(there, STAY).status == "converged"


@pytest.mark.parametrize("elapsed_s", [-1.0, float("nan"), float("inf")])
def test_an_elapsed_time_that_is_none_is_refused(elapsed_s):
    localizer = new_localizer()
    localizer.update(seen_at(Poses.identity(1)), None)
    with pytest.raises(VaporTrackError, match="since the previous step, expected a finite time"):
        localizer.update(seen_at(Poses.identity(1)), None, elapsed_s=elapsed_s)


# --- status -----------------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("rate", [1, 3, 10, 30])
def test_foreign_images_are_lost_after_about_a_second_or_six_images_and_the_map_in_view_again_is_found(rate):
    localizer = new_localizer()
    walk(localizer, 30)
    step = motion(0, 0, 0, 0, 0, 0, std=ODOMETRY_STD / np.sqrt(rate / 10), duration_s=1 / rate)
    foreign = seen_at(Poses.exp(np.array([[9.0, 0, 0, 0, 0, 0]])), unfamiliarity=2.0)
    statuses = [localizer.update(foreign, step).status for _ in range(max(3 * rate, 10))]
    since_s = (statuses.index("lost") + 1) / rate
    # e^(−1.2) is the least agreement, and so is 0.8 to the 5.4
    assert since_s == pytest.approx(max(1.2, 5.4 / rate), abs=max(0.34, 1.0 / rate))
    assert statuses[-1] == "lost"
    pose = localizer.predict(motion(0, 0, 0, 0, 0, 0, std=np.zeros(6), duration_s=0.0)).modes[0].world_from_camera
    statuses = [localizer.update(seen_at(pose), step).status for _ in range(max(4 * rate, 10))]
    since_s = (statuses.index("converged") + 1) / rate
    assert since_s < max(3.0, 8.0 / rate)
    assert "lost" not in statuses[max(rate, 3) :]


def test_a_belief_whose_shares_say_sure_is_lost_all_the_same_when_images_fit_it_nowhere():
    localizer = new_localizer()
    before, _ = walk(localizer, 30)
    assert before[-1].status == "converged"
    for _ in range(30):
        estimate = localizer.update(seen_at(Poses.exp(np.array([[50.0, 0, 0, 0, 0, 0]]))), STAY)
    assert estimate.modes[0].weight > 0.9
    assert estimate.status == "lost"
    assert estimate.agreement < 0.3


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


def test_predicting_moves_the_belief_and_never_makes_it_surer():
    localizer = new_localizer()
    before, _ = walk(localizer, 30, shares=(0.6, 0.3), heights_m=(0.0, 3.0))
    last = before[-1]
    for _ in range(200):
        estimate = localizer.predict(AHEAD)
        np.testing.assert_allclose(
            [mode.weight for mode in estimate.modes[:2]], [mode.weight for mode in before[-1].modes[:2]], atol=0.02
        )
        assert estimate.modes[0].widest_std_m >= last.modes[0].widest_std_m - 1e-9
        assert (estimate.agreement, estimate.novelty, estimate.unfamiliarity) == (before[-1].agreement, 0.0, 0.0)
        last = estimate
    moved = before[-1].modes[0].world_from_camera.distance(last.modes[0].world_from_camera)[0]
    assert moved > 3.0
    assert last.modes[0].widest_std_m > 1.5 * before[-1].modes[0].widest_std_m


def test_a_belief_too_wide_is_not_converged_though_it_is_one():
    localizer = new_localizer(converged_std_m=0.08)
    assert localizer.update(seen_at(Poses.identity(1)), None).status == "ambiguous"
    assert walk(localizer, 40)[0][-1].status == "converged"


def test_the_best_mode_changes_only_when_another_clearly_outweighs_it():
    localizer = new_localizer(switch_ratio=1.5)
    localizer.update(seen_at(lifted(Poses.identity(), (0.0, 3.0)), (0.55, 0.45)), None)
    orders = []
    estimates, _ = walk(localizer, 60, shares=(0.25, 0.75), heights_m=(0.0, 3.0))
    for estimate in estimates:
        best, other = estimate.modes[:2]
        orders.append((best.world_from_camera.translation[2] > 1.5, best.weight / other.weight))
    switched = next(i for i, (up, _) in enumerate(orders) if up)
    assert any(ratio < 1.0 for _, ratio in orders[:switched])  # it stayed though it was lighter,
    assert all(ratio > 1 / 1.5 for _, ratio in orders[:switched])  # but not by much
    assert all(up for up, _ in orders[switched:])


# --- images that say nothing ------------------------------------------------------------------------


@pytest.mark.parametrize("nothing", [PosePosterior.nothing(), seen_at(Poses.identity(1), unfamiliarity=1.5)])
def test_an_image_that_says_nothing_leaves_the_belief_as_the_motion_alone_does(nothing):
    beliefs = []
    for seen in (None, nothing):
        localizer = new_localizer()
        walk(localizer, 20, shares=(0.6, 0.3), heights_m=(0.0, 3.0))
        beliefs.append(localizer.predict(AHEAD) if seen is None else localizer.update(seen, AHEAD))
    assert_same_belief(*beliefs, atol=0, rtol=0)
    for mode, other in zip(beliefs[0].modes, beliefs[1].modes, strict=True):
        np.testing.assert_array_equal(mode.covariance, other.covariance)
        assert mode.weight == other.weight


class Recording:
    """An observation model that knows where the camera is and counts the images it is shown."""

    def __init__(self):
        self.images = 0

    def observe(self, image, *, rng):
        self.images += 1
        return seen_at(Poses.exp(0.01 * self.images * np.eye(6)[:1]))


def test_an_image_that_equals_the_one_before_comes_from_a_frozen_camera_and_says_nothing():
    localizer = ParticleLocalizer(Recording(), rng=RNG(0))
    assert not localizer.observe(image_of(1)).says_nothing
    assert localizer.observe(image_of(1)).says_nothing
    assert not localizer.observe(image_of(2)).says_nothing
    assert not localizer.observe(image_of(1)).says_nothing


def test_a_frozen_camera_on_a_moving_robot_moves_the_belief_by_odometry_alone():
    frozen, moved = (ParticleLocalizer(Recording(), rng=RNG(0)) for _ in range(2))
    for localizer in (frozen, moved):
        for i in range(5):
            localizer.step(image_of(i), STAY)
    for _ in range(10):
        assert_same_belief(frozen.step(image_of(4), AHEAD), moved.predict(AHEAD), atol=0)


# --- several cameras --------------------------------------------------------------------------------

FRONT = Poses.exp(np.array([0.3, 0, 0.1, 0, 0, 0]))
BACK = Poses.exp(np.array([-0.3, 0.1, 0.1, 0, 0, np.pi - 0.2]))


def test_a_camera_on_a_rig_says_of_the_rig_what_it_says_of_itself_carried_over():
    rig, alone = new_localizer(), new_localizer()
    rng, pose = RNG(0), Poses.identity()
    for _ in range(15):
        pose = pose @ AHEAD.previous_from_current
        posterior = seen_at(pose @ BACK @ Poses.exp(STD * rng.standard_normal(6)))
        one = rig.update([View(posterior, BACK, "camera")], AHEAD)
        other = alone.update(posterior.seen_from(BACK), AHEAD)
        assert_same_belief(one, other, atol=1e-12)
        assert one.status == other.status
    assert one.modes[0].world_from_camera.distance(pose)[0] < 0.3


def test_two_cameras_of_one_moment_know_more_than_either():
    stds = {}
    for names in (("front",), ("back",), ("front", "back")):
        localizer, rng, pose = new_localizer(), RNG(0), Poses.identity()
        for _ in range(10):
            pose = pose @ AHEAD.previous_from_current
            mounts = {"front": FRONT, "back": BACK}
            seen = {
                name: seen_at(pose @ mounts[name] @ Poses.exp(0.3 * STD * rng.standard_normal(6))) for name in mounts
            }
            estimate = localizer.update([View(seen[name], mounts[name], name) for name in names], AHEAD)
        stds[names] = estimate.modes[0].widest_std_m
        assert estimate.modes[0].world_from_camera.distance(pose)[0] < 0.2
    assert stds["front", "back"] < 0.9 * min(stds["front",], stds["back",])


def test_of_two_cameras_one_may_say_nothing():
    pair, alone = new_localizer(), new_localizer()
    for i in range(10):
        pose = Poses.exp(np.array([0.1 * i, 0, 0, 0, 0, 0]))
        front = View(seen_at(pose @ FRONT), FRONT, "front")
        both = [front, View(PosePosterior.nothing(ERRORS), BACK, "back")]
        step = motion(0.1, 0, 0, 0, 0, 0)
        assert_same_belief(pair.update(both, step), alone.update([front], step), atol=0)


def test_a_camera_seen_later_for_the_first_time_brings_errors_of_its_own():
    localizer = new_localizer()
    for _ in range(50):
        before = localizer.update([View(seen_at(FRONT), FRONT, "front")], STAY)
    after = localizer.update([View(seen_at(FRONT), FRONT, "front"), View(seen_at(BACK), BACK, "back")], STAY)
    assert before.modes[0].widest_std_m > after.modes[0].widest_std_m * 1.1
    assert after.novelty == 1.0  # it looks at what the other did not
    again = localizer.update([View(seen_at(BACK), BACK, "back")], STAY)
    assert again.novelty == 0.0
    assert np.exp(again.log_weights).sum() == pytest.approx(1.0)


def test_the_order_of_two_cameras_does_not_matter_much():
    estimates = []
    for order in (1, -1):
        localizer, rng = new_localizer(), RNG(0)
        for _ in range(10):
            views = [
                View(seen_at(mount @ Poses.exp(0.5 * STD * rng.standard_normal(6))), mount, name)
                for mount, name in ((FRONT, "front"), (BACK, "back"))
            ]
            estimates.append(localizer.update(views[::order], STAY))
    one, other = (estimate.modes[0] for estimate in (estimates[9], estimates[19]))
    assert one.world_from_camera.distance(other.world_from_camera)[0] < 0.02
    assert one.widest_std_m == pytest.approx(other.widest_std_m, rel=0.02)


def test_two_views_of_one_camera_at_one_moment_are_refused():
    view = View(seen_at(Poses.identity(1)), FRONT, "front")
    with pytest.raises(VaporTrackError, match="views of cameras front, front, expected each once"):
        new_localizer().update([view, view], None)


def test_no_view_at_all_is_a_prediction():
    one, other = new_localizer(), new_localizer()
    for localizer in (one, other):
        walk(localizer, 5)
    assert_same_belief(one.update([], AHEAD), other.predict(AHEAD), atol=0)


# --- settings ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        (LocalizerConfig, {"max_hypotheses": 0}),
        (LocalizerConfig, {"kidnap_per_view": -1.0}),
        (LocalizerConfig, {"merge_divergence": float("nan")}),
        (LocalizerConfig, {"least_weight": 0.5}),
        (LocalizerConfig, {"converged_std_m": float("inf")}),
        (LocalizerConfig, {"converged_weight": 1.5}),
        (LocalizerConfig, {"agreement_s": 0.0}),
        (LocalizerConfig, {"switch_ratio": 0.5}),
        (GapConfig, {"speed_m_per_s": -1.0}),
        (GapConfig, {"turn_rad_per_s": float("nan")}),
    ],
)
def test_settings_out_of_range_are_refused(kind, change):
    ((name, value),) = change.items()
    with pytest.raises(VaporTrackError, match=rf"^{name} is {value}, expected between "):
        kind(**change)


def test_a_filter_fed_with_posteriors_needs_no_model_and_says_so_when_shown_an_image():
    with pytest.raises(VaporTrackError, match="no observation model"):
        new_localizer().step(image_of(0), None)


# --- what a review found ----------------------------------------------------------------------------


def test_a_rig_begins_at_its_first_view_that_has_places():
    place = seen_at(Poses.identity(1))
    views = [
        View(PosePosterior.nothing(ERRORS), Poses.identity(), "left"),
        View(place, Poses.identity(), "right"),
    ]
    estimate = ParticleLocalizer(None, rng=np.random.default_rng(0)).update(views, None)
    np.testing.assert_allclose(estimate.modes[0].world_from_camera.translation, 0.0, atol=1e-9)


@pytest.mark.parametrize("elapsed_s", [-1.0, np.inf, np.nan])
def test_an_elapsed_time_that_is_none_is_refused_with_odometry_too(elapsed_s):
    localizer = ParticleLocalizer(None, rng=np.random.default_rng(0))
    with pytest.raises(VaporTrackError, match="since the previous step"):
        localizer.update(seen_at(Poses.identity(1)), None, elapsed_s=elapsed_s)


def test_a_gap_however_long_leaves_a_belief():
    localizer = ParticleLocalizer(None, rng=np.random.default_rng(0))
    localizer.update(seen_at(Poses.identity(1)), None)
    estimate = localizer.update(seen_at(Poses.identity(1)), None, elapsed_s=1e100)
    assert np.isfinite(estimate.modes[0].covariance).all()


def test_a_variance_beyond_all_bounds_is_refused():
    localizer = ParticleLocalizer(None, rng=np.random.default_rng(0))
    localizer.update(seen_at(Poses.identity(1)), None)
    with pytest.raises(VaporTrackError, match="give no odometry"):
        localizer.update(seen_at(Poses.identity(1)), Odometry(Poses.identity(), 1e100 * np.eye(6), 0.1))
