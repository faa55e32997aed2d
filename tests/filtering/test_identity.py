"""Which mode is which from step to step, and how far images are from where modes were expected."""

import numpy as np
import pytest

from filtering.config import GapConfig
from filtering.motion import Odometry, OdometryBias
from filtering.observation import View
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import AHEAD, ERRORS, STAY, STD, lifted, new_localizer, seen_at, walk

NOTHING = PosePosterior.uninformative(ERRORS)


def identities(estimate):
    """Identity of each mode by its height, metres."""
    return {round(float(mode.world_from_camera.translation[2])): mode.identity for mode in estimate.modes}


def test_each_mode_keeps_its_identity_while_the_camera_walks():
    estimates, _ = walk(new_localizer(), 60, shares=(0.5, 0.3, 0.2), heights_m=(0.0, 3.0, 6.0))
    first = identities(estimates[0])
    assert len(set(first.values())) == 3
    assert all(identities(estimate).items() <= first.items() for estimate in estimates)


def test_the_best_one_keeps_its_identity_when_another_overtakes_it():
    localizer = new_localizer()
    first = localizer.update(seen_at(lifted(Poses.identity(), (0.0, 3.0)), (0.6, 0.4)), None)
    pose = Poses.identity()
    for _ in range(30):
        pose = pose @ AHEAD.previous_from_current
        last = localizer.update(seen_at(lifted(pose, (3.0,))), AHEAD)
    assert first.modes[0].identity == identities(first)[0]
    assert last.modes[0].identity == identities(first)[3]


def test_a_place_that_is_born_has_an_identity_that_none_had():
    localizer = new_localizer()
    known = identities(localizer.update(seen_at(Poses.identity()), None))
    elsewhere, pose = {}, Poses.exp(np.array([0.0, 0, 30, 0, 0, 0]))
    for _ in range(60):
        pose = pose @ AHEAD.previous_from_current
        elsewhere |= identities(localizer.update(seen_at(pose), AHEAD))
    assert elsewhere[0] == known[0]
    assert elsewhere[30] not in known.values()
    localizer.forget()
    again = localizer.update(seen_at(pose), None)
    assert again.modes[0].identity > max(elsewhere.values())


def test_where_two_modes_become_one_the_identity_of_the_heavier_stays():
    localizer = new_localizer()
    apart = Poses.exp(np.array([[0.0, 0, 0, 0, 0, 0], [0, 0, 2.0, 0, 0, 0]]))
    first = localizer.update(seen_at(apart, (0.3, 0.7)), None)
    assert len(first.modes) == 2
    localizer.update(seen_at(Poses.exp(np.array([[0.0, 0, 1.0, 0, 0, 0]])), std=10 * STD), STAY)
    one = localizer.belief.known.identify(
        first.modes[:1], localizer.belief.hypotheses, ERRORS.inflated(25.0), localizer.config.modes
    )[0][0]
    assert one.identity == first.modes[0].identity == identities(first)[2]


def test_an_identity_outlives_a_time_without_odometry_that_images_bridge():
    speed = 1.5
    localizer = new_localizer(gap=GapConfig())
    pose = Poses.identity()
    found = [localizer.update(seen_at(pose), None)]
    for _ in range(40):
        pose = pose @ Poses.exp(np.array([speed / 10, 0, 0, 0, 0, 0]))
        found.append(localizer.update(seen_at(pose), None, elapsed_s=0.1))
    found.append(localizer.predict(None, elapsed_s=2.0))  # by the velocity, to 3 m from where it was
    moved = found[-1].modes[0].world_from_camera.distance(found[-2].modes[0].world_from_camera)[0]
    assert moved > 2.0
    assert {estimate.modes[0].identity for estimate in found} == {found[0].modes[0].identity}


def test_the_innovation_is_that_of_the_place_nearest_to_the_mode_before_its_update():
    localizer = new_localizer(odometry_bias=OdometryBias(0.0, relative_drift=0.0))
    first = localizer.update(seen_at(Poses.identity()), None)
    off = np.array([0.06, -0.02, 0.01, 0.02, 0.0, 0.01])
    second = localizer.update(seen_at(lifted(Poses.exp(off), (0.0, 3.0)), (0.5, 0.5)), STAY)
    # Of the error a share is that of the first image: the rest of both images is what differs, and the odometry.
    differs = 2.0 * (1.0 - ERRORS.correlated_fraction) * np.diag(STD**2) + STAY.covariance
    innovation = next(mode.innovation for mode in second.modes if mode.identity == first.modes[0].identity)
    assert first.modes[0].innovation is None
    assert innovation.degrees_of_freedom == 6
    assert innovation.squared == pytest.approx(float(off @ np.linalg.solve(differs, off)), rel=0.1)


def test_there_is_no_innovation_without_an_image_or_with_one_that_shows_places_far_away():
    localizer = new_localizer()
    localizer.update(seen_at(Poses.identity()), None)
    assert localizer.predict(STAY).modes[0].innovation is None
    assert localizer.update(NOTHING, STAY).modes[0].innovation is None
    far = localizer.update(seen_at(lifted(Poses.identity(), (50.0,))), STAY)
    assert identities(far)[0] == far.modes[0].identity
    assert far.modes[0].innovation is None


def test_innovations_of_images_as_modelled_are_on_average_their_degrees_of_freedom():
    seen = [
        mode.innovation.squared
        for seed in range(4)
        for mode in (estimate.modes[0] for estimate in walk(new_localizer(seed), 60, seed=seed)[0][5:])
    ]
    assert np.mean(seen) == pytest.approx(6.0, abs=0.8)


def test_two_images_of_one_step_add_their_innovations():
    localizer = new_localizer()
    views = [View(seen_at(Poses.identity()), Poses.identity(), name) for name in ("left", "right")]
    localizer.update(views, None)
    innovation = localizer.update(views, STAY).modes[0].innovation
    assert innovation is not None
    assert innovation.degrees_of_freedom == 12


def test_the_log_likelihood_is_0_where_all_fits_and_that_of_an_outlier_where_nothing_does():
    localizer = new_localizer(births="rate", max_birth_rate=0.0, birth_rate=0.0, outlier_places=1.0)
    assert localizer.update(seen_at(Poses.identity()), None).log_likelihood == 0.0
    assert localizer.predict(AHEAD).log_likelihood == 0.0
    pose = AHEAD.previous_from_current @ AHEAD.previous_from_current
    assert localizer.update(seen_at(pose), AHEAD).log_likelihood == pytest.approx(0.0, abs=0.01)
    far = localizer.update(seen_at(lifted(pose, (50.0,))), AHEAD)
    power = np.log(ERRORS.outlier_probability)
    assert power < far.log_likelihood < 0.0


def test_the_log_likelihood_does_not_depend_on_the_rate_of_images():
    """Two metres with all images at a place elsewhere cost the same in 10 and in 40 of them."""
    total = []
    for count in (10, 40):
        localizer = new_localizer(max_birth_rate=0.0, birth_rate=0.0)
        localizer.update(seen_at(Poses.identity()), None)
        pose, increment = Poses.identity(), np.array([2.0 / count, 0, 0, 0, 0, 0])
        for _ in range(count):
            pose = pose @ Poses.exp(increment)
            step = Odometry(Poses.exp(increment), STAY.covariance / count, 2.0 / count)
            total_before = localizer.update(seen_at(lifted(pose, (50.0,))), step).log_likelihood
            total.append((count, total_before))
    sums = {count: sum(value for of, value in total if of == count) for count in (10, 40)}
    assert sums[10] < -1.0
    assert sums[40] == pytest.approx(sums[10], rel=0.15)
