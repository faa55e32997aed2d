"""Faults of camera and odometry: what each changes of a walk."""

import numpy as np
import pytest

from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import translated
from vapor.benchmark.faults.table import (
    FAULTS,
    a_third,
    ahead,
    find_moment,
    frozen,
    image_after,
    late,
    no_images,
    set_back,
    shown,
    standing_still,
    too_long,
    tripled,
)
from vapor.benchmark.recordings.storage import Observed
from vapor.benchmark.trials.replay import Replay
from vapor.tracking.follow import dead_reckoning, posterior_of

pytestmark = pytest.mark.usefixtures("unchecked")

N = 30

DURING = range(10, 15)

OUTSIDE = [image for image in range(N) if image not in DURING]

TIMES_NS = 100_000_000 * np.arange(N, dtype=np.int64)


def walk(unfamiliar: int | None = None) -> Replay:
    """Ever further ahead, and around; each image has two samples, which tell its number."""

    def observed(image: int) -> Observed:
        return Observed(translated([[image, 0.0, 0.0]] * 2), 1.5 if image == unfamiliar else 0.25)

    motions = [Poses.exp(np.array([0.01 * i, 0.0, 0.1, 0.0, 0.02, 0.0])) for i in range(N)]
    odometry = tuple(Odometry(motion, 1e-4 * np.eye(6), 0.1) for motion in motions)
    truth = dead_reckoning(Poses.identity(), odometry)
    return Replay(TIMES_NS, odometry, truth, observed)


def motions(replay: Replay) -> np.ndarray:
    return np.stack([odometry.previous_from_current.as_matrix() for odometry in replay.odometry])


def seen(replay: Replay) -> list[float | None]:
    """The number of the image that the camera shows, None for one that says nothing."""
    samples = [replay.observed(image).samples for image in range(N)]
    return [float(each.translation[0, 0]) if len(each) else None for each in samples]


def scores(replay: Replay, images=range(N)) -> set[float]:
    return {replay.observed(image).ood_score for image in images}


def assert_odometry_is_untouched(faulty: Replay, images=range(N)) -> None:
    np.testing.assert_array_equal(motions(faulty)[list(images)], motions(walk())[list(images)])
    for image in images:
        np.testing.assert_array_equal(faulty.odometry[image].covariance, walk().odometry[image].covariance)


def test_without_images_nothing_is_said_and_nothing_is_out_of_distribution():
    faulty = no_images(walk(), DURING)
    assert seen(faulty) == [None if image in DURING else image for image in range(N)]
    assert scores(faulty, DURING) == {0.0}
    assert scores(faulty, OUTSIDE) == {0.25}
    assert_odometry_is_untouched(faulty)


def test_an_image_that_is_uninformative_moves_the_filter_as_no_image_does():
    replay, (one, other) = walk(), [ParticleLocalizer(None, rng=np.random.default_rng(0)) for _ in range(2)]
    for localizer in (one, other):
        localizer.update(PosePosterior.from_samples(translated([[0.0, 0.0, 0.0]]), posterior().noise), None)
    predicted, updated = one.predict(replay.odometry[3]), other.update(posterior(), replay.odometry[3])
    np.testing.assert_array_equal(predicted.log_weights, updated.log_weights)
    np.testing.assert_array_equal(predicted.covariances, updated.covariances)
    np.testing.assert_array_equal(predicted.particles.as_matrix(), updated.particles.as_matrix())
    assert (predicted.status, predicted.agreement) == (updated.status, updated.agreement)


def posterior(ood_score: float = 0.0) -> PosePosterior:
    return posterior_of(Poses.identity(0), PosePosterior.uninformative().noise, ood_score, None)


def test_a_frozen_camera_is_uninformative_and_is_as_unfamiliar_as_its_last_image():
    replay = walk(unfamiliar=9)
    faulty = frozen(replay, DURING)
    assert seen(faulty) == [None if image in DURING else image for image in range(N)]
    assert scores(faulty, DURING) == {1.5}
    assert scores(faulty, range(9)) == {0.25}
    assert_odometry_is_untouched(faulty)
    assert posterior(1.5).is_out_of_distribution  # as ParticleLocalizer.observe leaves it


def test_other_images_are_shown_while_the_fault_lasts():
    faulty = shown(walk(), DURING, lambda image: Observed(translated([[100.0 + image, 0.0, 0.0]]), 0.5))
    assert seen(faulty) == [100.0 + image if image in DURING else image for image in range(N)]
    assert scores(faulty, DURING) == {0.5}
    assert scores(faulty, OUTSIDE) == {0.25}
    assert_odometry_is_untouched(faulty)


def test_odometry_that_stands_still_reports_what_a_robot_at_rest_does():
    faulty = standing_still(walk(), DURING)
    assert_odometry_is_untouched(faulty, OUTSIDE)
    np.testing.assert_array_equal(motions(faulty)[list(DURING)], np.tile(np.eye(4), (len(DURING), 1, 1)))
    for image in DURING:
        std = np.sqrt(np.diagonal(faulty.odometry[image].covariance) / 0.1)  # after a second
        assert ((std[:3] > 0.008) & (std[:3] < 0.02)).all()
        assert ((std[3:] > 0.003) & (std[3:] < 0.01)).all()
        assert faulty.odometry[image].duration_s == 0.1


def test_tripled_odometry_goes_three_times_as_far_along_the_same_curve():
    faulty = tripled(walk(), DURING)
    assert_odometry_is_untouched(faulty, OUTSIDE)
    for image in DURING:
        once = motions(walk())[image]
        np.testing.assert_allclose(motions(faulty)[image], once @ once @ once, atol=1e-12)


def test_a_scale_error_makes_distances_longer_and_leaves_turns():
    faulty = too_long(walk(), DURING)
    assert_odometry_is_untouched(faulty, OUTSIDE)
    longer = motions(walk())
    longer[list(DURING), :3, 3] *= 1.2
    np.testing.assert_allclose(motions(faulty), longer, atol=1e-15)


def test_odometry_that_is_set_back_jumps_once_to_where_it_began():
    faulty = set_back(walk(), DURING)
    assert_odometry_is_untouched(faulty, [image for image in range(N) if image != DURING.start])
    poses, once = dead_reckoning(Poses.identity(), faulty.odometry), dead_reckoning(Poses.identity(), walk().odometry)
    assert np.linalg.norm(once.translation[9]) > 0.5
    np.testing.assert_allclose(poses[10].as_matrix(), motions(walk())[10], atol=1e-12)


def test_late_odometry_is_that_of_two_images_before():
    faulty = late(walk(), range(N))
    np.testing.assert_array_equal(motions(faulty)[3:], motions(walk())[1:-2])
    np.testing.assert_array_equal(motions(faulty)[:3], motions(walk())[[0, 1, 1]])


def test_a_clock_that_jumps_ahead_gives_the_motion_of_later_and_skips_images_when_it_is_back():
    faulty = ahead(walk(), DURING)
    poses, truth = dead_reckoning(Poses.identity(), faulty.odometry), walk().truth
    when = [*range(10), *range(20, 25), *[24] * 10, *range(25, 30)]  # what odometry tells of at each image
    np.testing.assert_allclose(poses.as_matrix(), truth[np.array(when)].as_matrix(), atol=1e-12)
    assert seen(faulty) == [None if image in range(15, 25) else image for image in range(N)]
    assert [each.duration_s for each in faulty.odometry][15:25] == [0.0] * 10
    assert sum(each.duration_s for each in faulty.odometry) == pytest.approx(0.1 * N)


def test_of_a_third_of_the_images_two_between_say_nothing():
    faulty = a_third(walk(), range(N))
    assert seen(faulty) == [None if image % 3 else image for image in range(N)]
    assert_odometry_is_untouched(faulty)


def test_images_are_counted_by_stamps_where_some_are_missing():
    times_ns = np.delete(TIMES_NS, range(12, 20))  # 0.8 s
    assert FAULTS["black"].during(2, np.append(times_ns, times_ns[-1] + 10**10)) == range(2, 22)
    assert image_after(1.0, 5, times_ns) == 12
    assert image_after(-0.5, 12, times_ns) == 12
    assert find_moment(["converged"], TIMES_NS[:1]) is None
